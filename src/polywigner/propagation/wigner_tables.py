"""Wigner and ambiguity functions on grids of four coordinates, in memory or on disk."""

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
from polywigner.geometry.arguments import checked_count, checked_row
from polywigner.kernels import kernel_for
from polywigner.propagation.datasets import StoreOptions, check_options, labelled_results
from polywigner.propagation.stores import Index, chunks_within, source_attrs, source_coords
from polywigner.transforms import PhaseSpaceSource, ambiguity, wigner
from polywigner.transforms.wavefronts import flat_of
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray

Kind = Literal["wigner", "ambiguity"]

# Samples of a chunk: enough for the kernels to run at full speed, and 16 MiB (float32) to 64 MiB
# (complex double) large.
_CHUNK_SAMPLES = 1 << 22
_REAL = {"single": "float32", "double": "float64"}
_COMPLEX = {"single": "complex64", "double": "complex128"}
# Symbol, name, sign convention, and types of values.
_NAMES = {
    "wigner": ("W", "Wigner function", "exp(-2 pi i nu.xi)", _REAL),
    "ambiguity": ("A", "ambiguity function", "exp(-2 pi i upsilon.x)", _COMPLEX),
}


class TableOptions(StoreOptions, total=False):
    """Options of :func:`wigner_table` and :func:`ambiguity_table`."""

    chunks: Mapping[str, int] | None
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
    """W(x, y, nu_x, nu_y) of a plane source on a grid of its four coordinates.

    With ``out`` it is written to disk chunk by chunk, and may be larger than memory. The same call
    completes a store that an interrupted run has left (docs/large_runs). Source and accuracy: see
    :func:`wigner`.

    Parameters
    ----------
    source : Aperture, uniform or with an illumination, or an Array of these in the plane z = 0.
    x, y : (n,) positions in m.
    nu_x, nu_y : (n,) spatial frequencies in 1/m.
    out : folder of a zarr store (format 3) to create or to complete; None: in memory. Needs the
        extra ``datasets``.
    chunks : samples along the named axes of a chunk on disk; those not named are cut so that a
        chunk has up to 4 million samples.
    precision : of sums and results, "single" (default) or "double" (None: double).
    engine : "auto" (default), "numpy", "llvm" or "cuda"; see :func:`wigner`.
    scheduler : address of a dask.distributed scheduler whose workers see ``out``, or a cluster
        object such as ``LocalCluster``; None: this machine.
    threads : number of threads, on this machine or of each worker; None: all cores, or the worker's
        threads.
    progress : whether to draw a progress bar; None: on a terminal.

    Returns
    -------
    xarray.Dataset with the variable W (x, y, nu_x, nu_y), in m^2, real; from disk lazily.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine, or the scheduler;
    StoreError for a path that cannot be written to, or with results of other settings;
    MissingExtraError without the extra.

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
    """A(upsilon_x, upsilon_y, xi_x, xi_y) of a plane source on a grid of its four coordinates.

    Everything is as for :func:`wigner_table`, but ``upsilon_x`` and ``upsilon_y`` are (n,)
    frequency shifts in 1/m, ``xi_x`` and ``xi_y`` (n,) lags in m, and the variable A is complex.

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
    """Compute values of a shape, from the sample with the numbers ``origin`` on."""
    parts = [a[o : o + n] for a, o, n in zip(axes, origin, shape, strict=True)]
    first, second = _grid(*parts[:2]), _grid(*parts[2:])
    # Slices depend on x, or on xi: kernels are fastest if that changes along leading axes.
    if kind == "wigner":
        return np.asarray(wigner(source, first[:, :, None, None, :], second, **how))
    values = ambiguity(source, first, second[:, :, None, None, :], **how)
    return np.ascontiguousarray(values.transpose(2, 3, 0, 1))


def _grid(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1)


def _table(
    kind: Kind,
    source: PhaseSpaceSource,
    axes: Mapping[str, ArrayLike],
    out: str | os.PathLike[str] | None,
    options: TableOptions,
) -> xarray.Dataset:
    from polywigner import __version__

    check_options(options, TableOptions, out)
    if kernel_for(kind, flat_of(source)).dimension != 2:
        raise ArgumentError(
            f"expected a source of the plane, got {type(source).__name__}; the table of slits has "
            f"two coordinates only: use polywigner.{kind}"
        )
    chunks = options.get("chunks")
    if chunks is not None and out is None:
        raise ArgumentError("expected out with chunks, got none; name a store to write to")
    coords = {name: _checked_axis(name, values) for name, values in axes.items()}
    sizes = _chunks({name: axis.size for name, axis in coords.items()}, chunks or {})
    precision = checked_precision(options.get("precision", "single")) or "double"
    # every chunk on the same engine, wherever it is computed
    engine: Any = resolved(checked_engine(options.get("engine", "auto")), math.prod(sizes))
    symbol, label, convention, dtypes = _NAMES[kind]
    settings = {"precision": precision, "engine": engine}
    block = partial(_values, kind, source, [a.values for a in coords.values()], settings)
    return labelled_results(
        {symbol: (block, np.dtype(dtypes[precision]), {"units": "m2", "long_name": label})},
        tuple(coords),
        coords | source_coords(source),
        {
            "kind": kind,
            "convention": convention,
            **settings,
            "polywigner_version": __version__,
            **source_attrs(source),
        },
        {**options, "out": out, "chunks": None if out is None else sizes},
        _CHUNK_SAMPLES,
        engine != "numpy",
    )


def _chunks(lengths: Mapping[str, int], sizes: Mapping[str, int]) -> Index:
    """Return the samples of a chunk along all axes, from those along some of the axes."""
    if not isinstance(sizes, Mapping) or not sizes.keys() <= lengths.keys():
        raise ArgumentError(
            f"expected chunks as samples along some of {', '.join(lengths)} by name, got {sizes!r}"
        )
    fixed = {k: min(checked_count(n, f"chunks along {k}", 1), lengths[k]) for k, n in sizes.items()}
    free = [name for name in lengths if name not in fixed]
    samples = max(1, _CHUNK_SAMPLES // math.prod(fixed.values()))
    fixed |= dict(zip(free, chunks_within([lengths[n] for n in free], samples), strict=True))
    return tuple(fixed[name] for name in lengths)


def _checked_axis(name: str, values: ArrayLike) -> xarray.Variable:
    expected = f"expected {name} as finite numbers of shape (n,)"
    array = checked_row(values, expected)
    if np.ndim(values) != 1 or not np.isfinite(array).all():
        raise ArgumentError(f"{expected}, got {values!r:.200}")
    units = "1/m" if name.startswith(("nu", "upsilon")) else "m"
    return labelled_array(array, (name,), {"units": units})
