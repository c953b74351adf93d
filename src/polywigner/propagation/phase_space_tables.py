"""Tables of W and A on grids of their four coordinates: in memory, lazy, or in a store."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision, checked_engine, checked_precision
from polywigner.execution.choice import resolved
from polywigner.geometry.arguments import check_options, checked_row
from polywigner.kernels import kernel_for
from polywigner.propagation.stores import (
    LARGEST_CHUNK,
    Index,
    StoreOptions,
    results_on_grid,
    source_attrs,
    source_coords,
)
from polywigner.transforms import PhaseSpaceSource, ambiguity, wigner
from polywigner.transforms.wavefronts import flat_source
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray

Kind = Literal["wigner", "ambiguity"]

# For each transform: name of the variable, long name, sign convention, and dtype of the values in
# single precision.
_TABLES: dict[Kind, tuple[str, str, str, type]] = {
    "wigner": ("W", "Wigner function", "exp(-2 pi i nu.xi)", np.float32),
    "ambiguity": ("A", "ambiguity function", "exp(-2 pi i upsilon.x)", np.complex64),
}


class TableOptions(StoreOptions, total=False):
    """Options of :func:`wigner_table` and :func:`ambiguity_table`."""

    precision: Precision
    engine: Engine


def wigner_table(
    source: PhaseSpaceSource,
    x: ArrayLike,
    y: ArrayLike,
    nu_x: ArrayLike,
    nu_y: ArrayLike,
    out: str | os.PathLike[str] | None = None,
    **options: Unpack[TableOptions],
) -> xarray.Dataset:
    """Return W(x, y, nu_x, nu_y) of a plane source on a grid of the four coordinates.

    With ``out`` the table is written to disk chunk by chunk, and may be larger than memory
    (docs/large_runs.md). Sources and accuracy: see :func:`wigner`.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    x, y : array_like, shape (n,)
        Positions in m.
    nu_x, nu_y : array_like, shape (n,)
        Spatial frequencies in 1/m.
    out : path, optional
        Folder of a zarr store (format 3) to create or to complete. Needs the extra ``datasets``.
    chunks : int, str or sequence, optional
        As in :func:`plane`. The default with ``out`` is chunks of up to 4 million samples.
    precision : {"single", "double"}
        Precision of sums and results.
    engine : {"auto", "numpy", "llvm", "cuda"}
        See :func:`wigner`.
    scheduler, threads, progress : optional
        As in :func:`plane`.

    Returns
    -------
    xarray.Dataset
        The real variable W (x, y, nu_x, nu_y) in m^2, lazy with ``chunks`` or ``out``.

    Raises
    ------
    PolywignerError
        As :func:`plane`.

    >>> import polywigner as pw
    >>> table = pw.wigner_table(pw.shapes.square(1.0), [0.0], [0.0], [0.0, 0.5], [0.0])
    >>> table.W.shape
    (1, 1, 2, 1)
    """
    axes = {"x": x, "y": y, "nu_x": nu_x, "nu_y": nu_y}
    return _table("wigner", source, axes, out, options)


def ambiguity_table(
    source: PhaseSpaceSource,
    upsilon_x: ArrayLike,
    upsilon_y: ArrayLike,
    xi_x: ArrayLike,
    xi_y: ArrayLike,
    out: str | os.PathLike[str] | None = None,
    **options: Unpack[TableOptions],
) -> xarray.Dataset:
    """Return A(upsilon_x, upsilon_y, xi_x, xi_y) of a plane source on a grid.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0.
    upsilon_x, upsilon_y : array_like, shape (n,)
        Frequency shifts in 1/m.
    xi_x, xi_y : array_like, shape (n,)
        Lags in m.
    out : path, optional
        Folder of a zarr store, as in :func:`wigner_table`.
    **options
        Options of :func:`wigner_table`.

    Returns
    -------
    xarray.Dataset
        The complex variable A (upsilon_x, upsilon_y, xi_x, xi_y) in m^2.

    Raises
    ------
    PolywignerError
        As :func:`plane`.

    >>> import polywigner as pw
    >>> table = pw.ambiguity_table(pw.shapes.square(1.0), [0.0, 0.5], [0.0], [0.0], [0.0])
    >>> table.A.shape
    (2, 1, 1, 1)
    """
    axes = {"upsilon_x": upsilon_x, "upsilon_y": upsilon_y, "xi_x": xi_x, "xi_y": xi_y}
    return _table("ambiguity", source, axes, out, options)


def _values(
    kind: Kind, source: PhaseSpaceSource, axes: Sequence[NDArray[np.float64]], how: Any,
    origin: Index, shape: Index,
) -> NDArray[Any]:  # fmt: skip
    """Compute W or A on a block of a grid; ``origin`` is the index of the block's first point."""
    parts = [a[o : o + n] for a, o, n in zip(axes, origin, shape, strict=True)]
    first, second = (
        np.stack(np.meshgrid(*pair, indexing="ij"), axis=-1) for pair in (parts[:2], parts[2:])
    )
    # Kernels compute a slice of the source for each x (W) or each xi (A). They are fastest if the
    # leading axes vary x or xi.
    if kind == "wigner":
        return np.asarray(wigner(source, first[:, :, None, None, :], second, **how))
    values = ambiguity(source, first, second[:, :, None, None, :], **how)
    return np.ascontiguousarray(values.transpose(2, 3, 0, 1))


def _table(
    kind: Kind,
    source: PhaseSpaceSource,
    axes: Mapping[str, ArrayLike],
    out: str | os.PathLike[str] | None,
    options: TableOptions,
) -> xarray.Dataset:
    check_options(options, TableOptions)
    if kernel_for(kind, flat_source(source)).dimension != 2:
        raise ArgumentError(
            "a table of four coordinates requires a source in a plane, got "
            f"{type(source).__name__}; call polywigner.{kind} for other sources"
        )
    coords = {name: _checked_axis(name, values) for name, values in axes.items()}
    precision = checked_precision(options.get("precision", "single")) or "double"
    samples = min(LARGEST_CHUNK, math.prod(axis.size for axis in coords.values()))
    # The engine is chosen once, so that all chunks use the same engine, even on different machines.
    engine: Any = resolved(checked_engine(options.get("engine", "auto")), samples)
    symbol, label, convention, single = _TABLES[kind]
    number_type = np.result_type(single, np.float32 if precision == "single" else np.float64)
    settings = {"precision": precision, "engine": engine}
    block = partial(_values, kind, source, [axis.values for axis in coords.values()], settings)
    about = {"kind": kind, "convention": convention, **settings}
    return results_on_grid(
        {symbol: (block, number_type, {"units": "m2", "long_name": label})},
        coords,
        source_coords(source),
        about | source_attrs(source),
        {**options, "out": out},
        compiled=engine != "numpy",
    )


def _checked_axis(name: str, values: ArrayLike) -> xarray.Variable:
    expected = f"expected {name} as finite numbers of shape (n,)"
    array = checked_row(values, expected)
    if np.ndim(values) != 1 or not np.isfinite(array).all():
        raise ArgumentError(f"{expected}, got {values!r:.200}")
    units = "1/m" if name.startswith(("nu", "upsilon")) else "m"
    return labelled_array(array, (name,), {"units": units})
