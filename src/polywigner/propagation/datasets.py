"""Labelled arrays of fields on lines, planes, hemispheres and volumes, and of W and A on 4D grids.

Values are computed in memory, lazily, or into a store. (docs/volumes.md, docs/large_runs.md)
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision, checked_engine, checked_precision
from polywigner.execution.choice import resolved
from polywigner.execution.progress import progress_bar
from polywigner.geometry import Polyhedron, Wavefront
from polywigner.geometry.arguments import (
    checked_choice,
    checked_count,
    checked_row,
    checked_wavelength,
    takes_frequency,
)
from polywigner.geometry.silhouettes import listed_bodies
from polywigner.kernels import kernel_for
from polywigner.propagation.amplitudes import Obstacle, amplitude
from polywigner.propagation.irradiances import irradiance
from polywigner.propagation.point_grids import (
    METHODS,
    Grid,
    box_grid,
    checked_method,
    hemisphere_grid,
    line_grid,
    plane_grid,
    shape_of_grid,
)
from polywigner.propagation.stores import (
    Block,
    Index,
    Scheduler,
    chunks_within,
    lazy_array,
    source_attrs,
    source_coords,
    write_store,
)
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import PlaneSource, checked_radiator
from polywigner.source.obliquities import DEFAULT
from polywigner.source.source_files import source_json
from polywigner.transforms import PhaseSpaceSource, ambiguity, wigner
from polywigner.transforms.wavefronts import flat_source
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

if TYPE_CHECKING:
    import xarray

Chunks: TypeAlias = int | str | Sequence[int | str | Sequence[int] | None] | Mapping[int, Any]
"""Sizes of chunks as dask accepts them."""
Kind = Literal["wigner", "ambiguity"]
Quantity = Literal["irradiance", "amplitude", "phase"]
Values = NDArray[Any]

# Methods with an option ``obliquity``; the boundary conditions of the others imply one.
_WITH_OBLIQUITY = ("wigner", "fraunhofer")
# Options of results and their storage, which are not passed to irradiance or amplitude.
_OF_RESULTS = ("method", "quantity", "dtype", "chunks", "out", "scheduler", "threads", "progress")
# Points computed at a time in memory: tens of megabytes, and enough points for compiled engines.
_BLOCK = 1 << 17
# Samples of a stored chunk: at most 4 MB of float32. Smaller grids have some 64 chunks, so a run
# stores its first chunk within a minute.
_LARGEST_CHUNK, _SMALLEST_CHUNK, _CHUNKS = 1 << 20, 1 << 15, 64
# Smallest number of samples for which the engine of a stored field is chosen: each point needs
# many samples of edges or rays, so compilation pays even for small chunks.
_COMPILED = 1 << 16
# Samples of a chunk of a table: full speed of the kernels, 16 MiB (float32) to 64 MiB (complex).
_TABLE_CHUNK = 1 << 22
# Largest number of samples in memory: 16 GiB of float32.
_MOST_IN_MEMORY = 1 << 32
# Unit and long name.
_QUANTITIES = {
    "irradiance": ("W m-2", "irradiance |U|^2"),
    "amplitude": ("W0.5 m-1", "complex amplitude U"),
    "phase": ("rad", "phase of U"),
}
# Variable, long name and sign convention.
_TABLES: dict[Kind, tuple[str, str, str]] = {
    "wigner": ("W", "Wigner function", "exp(-2 pi i nu.xi)"),
    "ambiguity": ("A", "ambiguity function", "exp(-2 pi i upsilon.x)"),
}


class StoreOptions(TypedDict, total=False):
    """Options of results that are written to a store."""

    scheduler: Scheduler
    threads: int | None
    progress: bool | None


class FieldOptions(StoreOptions, total=False):
    """Options of :func:`plane`, :func:`line`, :func:`hemisphere` and :func:`volume`."""

    method: str | Sequence[str]
    quantity: Quantity
    obliquity: str | None
    bandwidth: float | None
    """Bandwidth of the light in Hz; None: one wavelength. See :func:`irradiance`."""
    obstacles: Obstacle | Sequence[Obstacle] | None
    tolerance: float | None
    dtype: str
    engine: Engine
    chunks: Chunks | None
    out: str | os.PathLike[str] | None


class TableOptions(StoreOptions, total=False):
    """Options of :func:`wigner_table` and :func:`ambiguity_table`."""

    chunks: Mapping[str, int] | None
    precision: Precision
    engine: Engine


Variable: TypeAlias = tuple[Block, np.dtype[Any], dict[str, Any]]
"""Block that computes the values of a variable, their type, and attributes."""


# ---- fields -------------------------------------------------------------------------------------


def _field_values(
    source: PlaneSource | Wavefront, grid: Grid, wavelength: float, method: str, quantity: str,
    dtype: np.dtype[Any], options: Mapping[str, Any], origin: Index, shape: Index,
) -> Values:  # fmt: skip
    """Compute the field at the points of a grid from the indices ``origin`` on."""
    compute = irradiance if quantity == "irradiance" else amplitude
    field = compute(source, grid.points(origin, shape), wavelength, method, **options)
    return np.asarray(np.angle(field) if quantity == "phase" else field, dtype)


def _field_attrs(method: str, quantity: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the unit and the settings of a variable."""
    from polywigner import __version__

    defaults = {"engine": "auto"}
    if method in _WITH_OBLIQUITY:
        defaults["obliquity"] = DEFAULT
    units, long_name = _QUANTITIES[quantity]
    return {
        "units": units,
        "long_name": long_name,
        "method": method,
        "quantity": quantity,
        **defaults,
        **options,
        **(_described(options["obstacles"]) if "obstacles" in options else {}),
        "convention": "waves exp(+ikr)/r, time exp(-i omega t); |u|^2 on the source in W m-2",
        "polywigner_version": __version__,
    }


def _described(obstacles: Sequence[Obstacle]) -> dict[str, str]:
    """Describe bodies in one line, and by a digest of their positions and outlines."""
    tables = [
        [body.vertices.tolist(), body.faces]
        if isinstance(body, Polyhedron)
        else [source_json(body.aperture), body.pose.tolist()]
        for body in obstacles
    ]
    text = f"{len(tables)} obstacles: {'; '.join(map(repr, obstacles)):.150}"
    digest = hashlib.sha256(json.dumps(tables).encode()).hexdigest()
    return {"obstacles": text, "obstacles_sha256": digest}


def _dataset(
    source: Any, grid: Grid, wavelength: float, options: FieldOptions, dtype: str = "float64"
) -> xarray.Dataset:
    """Return fields on a grid, with one variable for each method; ``dtype``: the default."""
    out, chunks, shape = options.get("out"), options.get("chunks"), shape_of_grid(grid)
    _check_options(options, FieldOptions, out)
    quantity = checked_choice(options.get("quantity", "irradiance"), "quantity", list(_QUANTITIES))
    number = checked_choice(options.get("dtype", dtype), "dtype", ("float32", "float64"))
    number_type = np.result_type(number, *([np.complex64] if quantity == "amplitude" else []))
    methods, how = _checked_methods(options.get("method", "wigner")), _settings(options, quantity)
    radiator, length = checked_radiator(source, partly=True), checked_wavelength(wavelength)
    is_lazy, engine = chunks is not None or out is not None, "auto"
    if is_lazy:
        size = math.prod(shape) // _CHUNKS
        if out is not None and chunks in (None, "auto"):
            chunks = chunks_within(shape, min(max(size, _SMALLEST_CHUNK), _LARGEST_CHUNK))
        # one engine for all chunks, also on other machines
        engine = how["engine"] = resolved(how.get("engine", "auto"), max(_COMPILED, size))
    variables = {}
    with _warnings_once():
        for method in methods:
            settings = dict(how)
            if method not in _WITH_OBLIQUITY:
                settings.pop("obliquity", None)
            block = partial(_field_values, radiator, grid, length, method, quantity, number_type)
            if is_lazy or len(methods) > 1:
                # wrong arguments raise here, before hours of work
                block({**settings, "engine": "numpy"}, (0,) * len(shape), (1,) * len(shape))
            attrs = _field_attrs(method, quantity, settings)
            variables[method] = partial(block, settings), number_type, attrs
        return _results(
            variables,
            tuple(grid.coords),
            grid.coords | source_coords(radiator) | _positions(grid),
            {"wavelength": length, "frequency": SPEED_OF_LIGHT / length, **source_attrs(radiator)},
            options | {"out": out, "chunks": chunks},
            _BLOCK,
            engine != "numpy",
        )


def _check_options(options: Mapping[str, Any], kinds: type, out: object) -> None:
    """Raise ArgumentError for options that are unknown, or require a store."""
    names = kinds.__annotations__
    for name in options:
        if name not in names:
            raise ArgumentError(f"expected options among {', '.join(names)}, got {name!r}")
        if out is None and name in ("scheduler", "threads") and options[name] is not None:
            raise ArgumentError(f"expected out with {name}, got none; name a store to write to")


def _results(
    variables: Mapping[str, Variable],
    dims: tuple[str, ...],
    coords: Mapping[str, Any],
    attrs: Mapping[str, Any],
    options: Mapping[str, Any],
    block_size: int,
    compiled: bool,
) -> xarray.Dataset:
    """Return variables over axes ``dims``, computed according to the options of results.

    Without ``chunks`` they are computed now, in blocks of up to ``block_size`` samples; otherwise
    lazily, or into the store ``out``. ``compiled``: see :func:`lazy_array`.
    """
    shape, chunks = tuple(len(coords[name]) for name in dims), options["chunks"]
    how: Any = {"compiled": compiled, "threads": options.get("threads")}
    if chunks is None and math.prod(shape) > _MOST_IN_MEMORY:
        raise ArgumentError(
            f"expected at most {_MOST_IN_MEMORY} samples in memory, got {math.prod(shape):.3g}; "
            "use chunks, or write them to disk with out"
        )
    data = {}
    for name, (block, dtype, about) in variables.items():
        if chunks is None:
            values: Any = _computed(name, block, shape, dtype, block_size, options.get("progress"))
        else:
            values = lazy_array(block, shape, chunks, dtype, **how)
        data[name] = dims, values, about
    result = labelled_arrays(data, coords, attrs)
    if options["out"] is None:
        return result
    how |= {"scheduler": options.get("scheduler"), "progress": options.get("progress")}
    return write_store(options["out"], result, **how)


def _computed(
    name: str, block: Block, shape: Index, dtype: Any, block_size: int, progress: bool | None
) -> Values:
    values, size = np.empty(shape, dtype), chunks_within(shape, block_size)
    counts = [-(-n // c) for n, c in zip(shape, size, strict=True)]
    with progress_bar(name, math.prod(counts), show=progress) as advance:
        for index in np.ndindex(*counts):
            origin = tuple(i * c for i, c in zip(index, size, strict=True))
            part = tuple(slice(o, o + c) for o, c in zip(origin, size, strict=True))
            values[part] = block(origin, values[part].shape)
            advance()
    return values


def _settings(options: FieldOptions, quantity: str) -> dict[str, Any]:
    """Return the keywords of :func:`irradiance` or :func:`amplitude`."""
    how: dict[str, Any] = {
        name: value
        for name, value in options.items()
        if name not in _OF_RESULTS and value is not None
    }
    checked_engine(how.get("engine", "auto"))
    if "bandwidth" in how and quantity != "irradiance":
        raise ArgumentError(
            f"expected light of one wavelength for the {quantity}, got a bandwidth of "
            f"{how['bandwidth']!r} Hz; a band has an irradiance only"
        )
    if "obstacles" in how:
        how["obstacles"] = listed_bodies(how["obstacles"])
    return how


def _checked_methods(method: Any) -> tuple[str, ...]:
    methods = tuple(method) if isinstance(method, (list, tuple)) else (method,)
    if not methods or len(set(map(str, methods))) < len(methods):
        raise ArgumentError(f"expected one method, or several different ones, got {method!r}")
    return tuple(checked_method(name, ("wigner", *METHODS)) for name in methods)


def _positions(grid: Grid) -> dict[str, Any]:
    """Return the coordinates x, y and z that are not axes of a grid."""
    axes = tuple(grid.coords)
    origin, missing = (0,) * len(axes), [k for k, name in enumerate("xyz") if name not in axes]
    if len(missing) < 3:  # the missing coordinates are constant
        axes, points = (), grid.points(origin, (1,) * len(axes)).reshape(3)
    else:
        points = grid.points(origin, shape_of_grid(grid))
    return {"xyz"[k]: (axes, points[..., k], {"units": "m"}) for k in missing}


@contextmanager
def _warnings_once() -> Iterator[None]:
    """Issue warnings that differ only by numbers once, at the end of the block."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    kinds = {(w.category, re.sub(r"[\d.]+", "", str(w.message))): w for w in reversed(caught)}
    for warning in reversed(kinds.values()):
        warnings.warn(
            warning.message, warning.category, stacklevel=6
        )  # the caller of `line`, `plane`, ..., which `takes_frequency` wraps


@takes_frequency
def line(
    source: PlaneSource | Wavefront,
    ends: ArrayLike,
    samples: int,
    wavelength: float,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """Compute a field along a line, both ends included.

    Parameters
    ----------
    source, wavelength, options : as of :func:`plane`, as are errors.
    ends : two points (2, 3) in m, z > 0.
    samples : number of points.

    Returns
    -------
    As of :func:`plane`, with the dimension ``distance`` from the first end; x, y and z along it.

    >>> import polywigner as pw
    >>> square, ends = pw.shapes.square(10e-3), [(0, 0, 0.05), (0, 0, 0.2)]
    >>> field = pw.line(square, ends, 5, 3.2e-3, method="fresnel")
    >>> field.fresnel.shape
    (5,)
    """
    return _dataset(source, line_grid(ends, samples), wavelength, options)


@takes_frequency
def plane(
    source: PlaneSource | Wavefront,
    where: ArrayLike,
    shape: tuple[int, int],
    wavelength: float,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """Compute a field on a rectangle of any size, position and resolution (docs/volumes.md).

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, with any fields; or one with a
        curved wave.
    where : ((x0, y0, z0), (x1, y1, z1)) in m with one pair of equal coordinates; or three corners
        (3, 3) of a rectangle in any direction, the first between the other two. z > 0.
    shape : number of points along both axes, edges included.
    wavelength : in m.
    method : "wigner" (default), a method of :func:`amplitude`, or a sequence of several methods.
    quantity : "irradiance" (default), |U|^2 in W/m^2 for |u|^2 in W/m^2; "amplitude", complex; or
        "phase", of the amplitude in rad. "wigner" has an irradiance only.
    obliquity : obliquity factor for "wigner" and "fraunhofer", as for :func:`irradiance`.
    bandwidth : bandwidth in Hz of an irradiance, as for :func:`irradiance`.
    tolerance : as for :func:`irradiance` and :func:`amplitude`; None: their defaults.
    obstacles : bodies and plates, as for :func:`amplitude`, whose shadows diffract
        (docs/shadows.md). They require an exact method and a single wavelength.
    dtype : type of the values, "float64" (default) or "float32" (amplitudes: complex).
    engine : see :func:`fourier`.
    chunks : None: all values are computed now; otherwise the result is lazy, with chunks as dask
        accepts them: a number, one number for each axis, or "auto".
    out : folder of a zarr store (format 3) to which the values are written chunk by chunk. After
        an interruption the same call completes the store. Needs the extra ``datasets``.
    scheduler : with ``out``: address of a dask.distributed scheduler whose workers can access
        ``out``, or a cluster object such as ``LocalCluster``; None: this machine.
    threads : with ``out``: number of threads, on this machine or of each worker; None: all cores,
        or the worker's threads.
    progress : whether to draw a bar; None: on a terminal.

    Returns
    -------
    xarray.Dataset with a variable for each method, named after it, over two of x, y and z; for
    three corners over u and v, the distances from the first corner. Attributes hold units, settings
    and the version; a coordinate holds the source.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError if the engine or the scheduler is not
    available; StoreError if the path cannot be written to, or contains results of other settings;
    MissingExtraError for ``chunks`` and ``out`` without the extra ``datasets``.

    >>> import polywigner as pw
    >>> square, where = pw.shapes.square(10e-3), [(-0.02, -0.02, 0.1), (0.02, 0.02, 0.1)]
    >>> field = pw.plane(square, where, (5, 4), 3.2e-3, method="fresnel")
    >>> sorted(field.fresnel.shape)
    [4, 5]
    """
    return _dataset(source, plane_grid(where, shape), wavelength, options)


@takes_frequency
def hemisphere(
    source: PlaneSource | Wavefront,
    radius: float,
    theta: ArrayLike,
    phi: ArrayLike,
    wavelength: float,
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """Compute a field at one distance from a point, over angles: on a hemisphere or along a cut.

    Parameters
    ----------
    source, wavelength, options : as of :func:`plane`, as are errors.
    radius : distance from ``centre`` in m.
    theta : (n,) angles from the z axis in rad; negative ones, for cuts, lie at the opposite phi.
    phi : (m,) angles from the x axis in rad; or one.
    centre : (3,) in m; all points have z > 0, |theta| < pi/2 about the origin.

    Returns
    -------
    As of :func:`plane`, with the dimensions ``theta`` and ``phi``, and x, y and z over them.

    >>> import polywigner as pw
    >>> square, theta = pw.shapes.square(10e-3), [0.0, 0.5]
    >>> field = pw.hemisphere(square, 0.1, theta, [0.0], 3.2e-3, method="fresnel")
    >>> field.fresnel.shape
    (2, 1)
    """
    return _dataset(source, hemisphere_grid(radius, theta, phi, centre), wavelength, options)


@takes_frequency
def volume(
    source: PlaneSource | Wavefront,
    box: ArrayLike,
    shape: tuple[int, int, int],
    wavelength: float,
    **options: Unpack[FieldOptions],
) -> xarray.Dataset:
    """Compute a field in a box of any size, position and resolution (docs/volumes.md).

    Blocks of the computation take some hundred megabytes in addition to the result. Volumes larger
    than memory need ``chunks`` or ``out``.

    Parameters
    ----------
    source, wavelength, options : as of :func:`plane`, but ``dtype`` is "float32" by default.
    box : ((x0, y0, z0), (x1, y1, z1)) in m, z > 0.
    shape : number of points along x, y and z, faces included.

    Returns
    -------
    As of :func:`plane`, with the dimensions ``x``, ``y`` and ``z``.

    Raises
    ------
    As :func:`plane`.

    >>> import polywigner as pw
    >>> square, box = pw.shapes.square(10e-3), [(-0.02, -0.02, 0.05), (0.02, 0.02, 0.1)]
    >>> field = pw.volume(square, box, (3, 3, 2), 3.2e-3, method="fresnel")
    >>> field.fresnel.size
    18
    """
    return _dataset(source, box_grid(box, shape), wavelength, options, "float32")


# ---- tables -------------------------------------------------------------------------------------


def wigner_table(
    source: PhaseSpaceSource,
    x: ArrayLike,
    y: ArrayLike,
    nu_x: ArrayLike,
    nu_y: ArrayLike,
    out: str | os.PathLike[str] | None = None,
    **options: Unpack[TableOptions],
) -> xarray.Dataset:
    """Compute W(x, y, nu_x, nu_y) of a plane source on a grid of the four coordinates.

    With ``out`` the table is written to disk chunk by chunk, and may be larger than memory
    (docs/large_runs.md). Sources and accuracy: see :func:`wigner`.

    Parameters
    ----------
    source : Aperture, uniform or with an illumination, or an Array of these in the plane z = 0.
    x, y : (n,) positions in m.
    nu_x, nu_y : (n,) spatial frequencies in 1/m.
    out : folder of a zarr store (format 3) to create or to complete; None: in memory. Needs the
        extra ``datasets``.
    chunks : number of samples of a stored chunk along the named axes. The other axes are divided
        such that a chunk has up to 4 million samples.
    precision : "single" (default) or "double" (also None), for sums and results.
    engine : "auto" (default), "numpy", "llvm" or "cuda"; see :func:`wigner`.
    scheduler, threads, progress : as of :func:`plane`.

    Returns
    -------
    xarray.Dataset with the real variable W (x, y, nu_x, nu_y) in m^2; lazy with ``out``.

    Raises
    ------
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
    """Compute A(upsilon_x, upsilon_y, xi_x, xi_y) of a plane source on a grid.

    Parameters
    ----------
    source, out, options : as of :func:`wigner_table`, as are errors.
    upsilon_x, upsilon_y : (n,) frequency shifts in 1/m.
    xi_x, xi_y : (n,) lags in m.

    Returns
    -------
    As of :func:`wigner_table`, with the complex variable A in m^2.

    >>> import polywigner as pw
    >>> table = pw.ambiguity_table(pw.shapes.square(1.0), [0.0, 0.5], [0.0], [0.0], [0.0])
    >>> table.A.shape
    (2, 1, 1, 1)
    """
    axes = {"upsilon_x": upsilon_x, "upsilon_y": upsilon_y, "xi_x": xi_x, "xi_y": xi_y}
    return _table("ambiguity", source, axes, out, options)


def _table_values(
    kind: Kind, source: PhaseSpaceSource, axes: Sequence[NDArray[np.float64]], how: Any,
    origin: Index, shape: Index,
) -> Values:  # fmt: skip
    """Compute W or A on a part of the grid, from the indices ``origin`` on."""
    parts = [a[o : o + n] for a, o, n in zip(axes, origin, shape, strict=True)]
    first, second = (
        np.stack(np.meshgrid(*pair, indexing="ij"), axis=-1) for pair in (parts[:2], parts[2:])
    )
    # Slices depend on x, or on xi: kernels are fastest if these vary along leading axes.
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
    from polywigner import __version__

    _check_options(options, TableOptions, out)
    if kernel_for(kind, flat_source(source)).dimension != 2:
        raise ArgumentError(
            f"expected a source of the plane, got {type(source).__name__}; the table of slits has "
            f"two coordinates only: use polywigner.{kind}"
        )
    chunks = options.get("chunks")
    if chunks is not None and out is None:
        raise ArgumentError("expected out with chunks, got none; name a store to write to")
    coords = {name: _checked_axis(name, values) for name, values in axes.items()}
    sizes = _table_chunks({name: axis.size for name, axis in coords.items()}, chunks or {})
    precision = checked_precision(options.get("precision", "single")) or "double"
    # one engine for all chunks, also on other machines
    engine: Any = resolved(checked_engine(options.get("engine", "auto")), math.prod(sizes))
    symbol, label, convention = _TABLES[kind]
    number_type = np.result_type(
        {"single": np.float32, "double": np.float64}[precision],
        *([np.complex64] if kind == "ambiguity" else []),
    )
    settings = {"precision": precision, "engine": engine}
    block = partial(_table_values, kind, source, [a.values for a in coords.values()], settings)
    return _results(
        {symbol: (block, number_type, {"units": "m2", "long_name": label})},
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
        _TABLE_CHUNK,
        engine != "numpy",
    )


def _table_chunks(lengths: Mapping[str, int], sizes: Mapping[str, int]) -> Index:
    """Return the number of samples of a chunk along all axes, given those along some axes."""
    if not isinstance(sizes, Mapping) or not sizes.keys() <= lengths.keys():
        raise ArgumentError(
            f"expected chunks as samples along some of {', '.join(lengths)} by name, got {sizes!r}"
        )
    fixed = {k: min(checked_count(n, f"chunks along {k}", 1), lengths[k]) for k, n in sizes.items()}
    free = [name for name in lengths if name not in fixed]
    samples = max(1, _TABLE_CHUNK // math.prod(fixed.values()))
    fixed |= dict(zip(free, chunks_within([lengths[n] for n in free], samples), strict=True))
    return tuple(fixed[name] for name in lengths)


def _checked_axis(name: str, values: ArrayLike) -> xarray.Variable:
    expected = f"expected {name} as finite numbers of shape (n,)"
    array = checked_row(values, expected)
    if np.ndim(values) != 1 or not np.isfinite(array).all():
        raise ArgumentError(f"{expected}, got {values!r:.200}")
    units = "1/m" if name.startswith(("nu", "upsilon")) else "m"
    return labelled_array(array, (name,), {"units": units})
