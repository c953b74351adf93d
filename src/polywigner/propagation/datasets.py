"""Fields along lines, on planes and hemispheres, and in volumes, as labelled arrays.

Values are computed now, lazily, or into a store. (docs/volumes.md)
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
from polywigner.execution import Engine, Precision, checked_engine
from polywigner.execution.choice import resolved
from polywigner.execution.progress import progress_bar
from polywigner.geometry import Polyhedron, Wavefront
from polywigner.geometry.arguments import checked_choice, checked_wavelength, takes_frequency
from polywigner.geometry.silhouettes import listed_bodies
from polywigner.propagation.amplitudes import Obstacle, amplitude
from polywigner.propagation.irradiances import irradiance
from polywigner.propagation.places import (
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
from polywigner.transforms.xarray_arguments import labelled_arrays

if TYPE_CHECKING:
    import xarray

Chunks: TypeAlias = int | str | Sequence[int | str | Sequence[int] | None] | Mapping[int, Any]
"""Sizes of chunks as dask takes them."""
Quantity = Literal["irradiance", "amplitude", "phase"]
Values = NDArray[Any]

# Methods that take an obliquity; the boundary conditions of the others imply one.
_WITH_OBLIQUITY = ("wigner", "fraunhofer")
# Options that describe results and how they are stored, rather than their computation.
_OF_RESULTS = ("method", "quantity", "dtype", "chunks", "out", "scheduler", "threads", "progress")
# Characters of a line that names obstacles.
_LONGEST_NAMES = 150
# Points at a time: the bar moves, a block needs tens of megabytes, and one that is halved still has
# enough points for the compiled engines.
_BLOCK = 1 << 17
# Samples of a stored chunk: at most 4 MB of float32, a file that disks and clusters like. Smaller
# grids have some dozens of chunks, so that a run saves its parts within seconds or a minute.
_LARGEST_CHUNK, _SMALLEST_CHUNK, _CHUNKS = 1 << 20, 1 << 15, 64
# Sums over edges and rays make many samples of one point: worth a compiler even for small chunks.
_COMPILED = 1 << 16

# Most samples in memory: 16 GiB of float32.
_MOST_IN_MEMORY = 1 << 32
# Unit and long name.
_QUANTITIES = {
    "irradiance": ("W m-2", "irradiance |U|^2"),
    "amplitude": ("W0.5 m-1", "complex amplitude U"),
    "phase": ("rad", "phase of U"),
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
    precision: Precision
    engine: Engine
    chunks: Chunks | None
    out: str | os.PathLike[str] | None


Variable: TypeAlias = tuple[Block, np.dtype[Any], dict[str, Any]]
"""The values of one variable on any part of its axes, their type, and attributes."""


def _values(
    source: PlaneSource | Wavefront, grid: Grid, wavelength: float, method: str, quantity: str,
    dtype: np.dtype[Any], options: Mapping[str, Any], origin: Index, shape: Index,
) -> Values:  # fmt: skip
    """Compute values of a shape, from the point with the numbers ``origin`` on.

    ``options`` : keywords of :func:`irradiance` or :func:`amplitude`.
    """
    compute = irradiance if quantity == "irradiance" else amplitude
    field = compute(source, grid.points(origin, shape), wavelength, method, **options)
    return np.asarray(np.angle(field) if quantity == "phase" else field, dtype)


def _attrs(method: str, quantity: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes of a variable: unit, and all settings but the wavelength."""
    from polywigner import __version__

    defaults = {"engine": "auto", "precision": "double"}
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
    """Describe bodies in one line, and by the digest of their positions and outlines."""
    tables = [
        [body.vertices.tolist(), body.faces]
        if isinstance(body, Polyhedron)
        else [source_json(body.aperture), body.pose.tolist()]
        for body in obstacles
    ]
    text = f"{len(tables)} obstacles: {'; '.join(map(repr, obstacles)):.{_LONGEST_NAMES}}"
    digest = hashlib.sha256(json.dumps(tables).encode()).hexdigest()
    return {"obstacles": text, "obstacles_sha256": digest}


def _dataset(
    source: Any, grid: Grid, wavelength: float, options: FieldOptions, dtype: str = "float64"
) -> xarray.Dataset:
    """Return fields on a grid, with one variable for each method, named after the method.

    ``dtype`` is the default type of values.
    """
    out, chunks, shape = options.get("out"), options.get("chunks"), shape_of_grid(grid)
    check_options(options, FieldOptions, out)
    quantity = checked_choice(options.get("quantity", "irradiance"), "quantity", list(_QUANTITIES))
    number = np.dtype(checked_choice(options.get("dtype", dtype), "dtype", ("float32", "float64")))
    if quantity == "amplitude":
        number = np.result_type(number, np.complex64)
    methods, how = _checked_methods(options.get("method", "wigner")), _settings(options, quantity)
    radiator, length = checked_radiator(source, partly=True), checked_wavelength(wavelength)
    is_lazy, engine = chunks is not None or out is not None, "auto"
    if is_lazy:
        size = math.prod(shape) // _CHUNKS
        if out is not None and chunks in (None, "auto"):
            chunks = chunks_within(shape, min(max(size, _SMALLEST_CHUNK), _LARGEST_CHUNK))
        # every chunk on the same engine, wherever it is computed
        engine = how["engine"] = resolved(how.get("engine", "auto"), max(_COMPILED, size))
    variables = {}
    with _warnings_once():
        for method in methods:
            settings = dict(how)
            if method not in _WITH_OBLIQUITY:
                settings.pop("obliquity", None)
            block = partial(_values, radiator, grid, length, method, quantity, number)
            if is_lazy or len(methods) > 1:
                # one point raises now what would be raised after hours of work
                block({**settings, "engine": "numpy"}, (0,) * len(shape), (1,) * len(shape))
            about = _attrs(method, quantity, settings)
            variables[method] = partial(block, settings), number, about
        return labelled_results(
            variables,
            tuple(grid.coords),
            grid.coords | source_coords(radiator) | _positions(grid),
            {"wavelength": length, "frequency": SPEED_OF_LIGHT / length, **source_attrs(radiator)},
            options | {"out": out, "chunks": chunks},
            _BLOCK,
            engine != "numpy",
        )


def check_options(options: Mapping[str, Any], kinds: type, out: object) -> None:
    """Raise ArgumentError for options that a TypedDict does not have, or that need a store."""
    names = kinds.__annotations__
    for name in options:
        if name not in names:
            raise ArgumentError(f"expected options among {', '.join(names)}, got {name!r}")
        if out is None and name in ("scheduler", "threads") and options[name] is not None:
            raise ArgumentError(f"expected out with {name}, got none; name a store to write to")


def labelled_results(
    variables: Mapping[str, Variable],
    dims: tuple[str, ...],
    coords: Mapping[str, Any],
    attrs: Mapping[str, Any],
    options: Mapping[str, Any],
    at_a_time: int,
    compiled: bool,
) -> xarray.Dataset:
    """Return variables over axes ``dims``.

    ``options`` : those of :class:`StoreOptions`, with ``chunks`` and ``out``. Without ``chunks``
    the variables are computed now, up to ``at_a_time`` samples in one call; else lazily, or into
    the store ``out``. ``compiled``: see :func:`lazy_array`.
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
            values = np.empty(shape, dtype)
            _fill(name, block, values, at_a_time, options.get("progress"))
        else:
            values = lazy_array(block, shape, chunks, dtype, **how)
        data[name] = dims, values, about
    result = labelled_arrays(data, coords, attrs)
    if options["out"] is None:
        return result
    how |= {"scheduler": options.get("scheduler"), "progress": options.get("progress")}
    return write_store(options["out"], result, **how)


def _fill(name: str, block: Block, values: Values, at_a_time: int, progress: bool | None) -> None:
    """Fill an array with the values of a block, part by part."""
    size = chunks_within(values.shape, at_a_time)
    counts = [-(-n // c) for n, c in zip(values.shape, size, strict=True)]
    with progress_bar(name, math.prod(counts), show=progress) as advance:
        for index in np.ndindex(*counts):
            origin = tuple(i * c for i, c in zip(index, size, strict=True))
            part = tuple(slice(o, o + c) for o, c in zip(origin, size, strict=True))
            values[part] = block(origin, values[part].shape)
            advance()


def _settings(options: FieldOptions, quantity: str) -> dict[str, Any]:
    """Return the keywords of :func:`irradiance` or :func:`amplitude`."""
    given = options.items()
    how: dict[str, Any] = {k: v for k, v in given if k not in _OF_RESULTS and v is not None}
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
    is_one = isinstance(method, str) or not isinstance(method, Sequence)
    methods = (method,) if is_one else tuple(method)
    if not methods or len(set(map(str, methods))) < len(methods):
        raise ArgumentError(f"expected one method, or several different ones, got {method!r}")
    return tuple(checked_method(name, ("wigner", *METHODS)) for name in methods)


def _positions(grid: Grid) -> dict[str, Any]:
    """Return x, y and z of the points of a grid that has other axes."""
    names, axes, shape = set("xyz") - set(grid.coords), tuple(grid.coords), shape_of_grid(grid)
    points = grid.points((0,) * len(shape), shape) if names else np.empty((0, 3))
    if set(axes) <= set("xyz"):  # the other coordinates are constant
        axes, points = (), points.reshape(-1, 3)[:1].reshape(-1)
    return {
        name: (axes, points[..., k], {"units": "m"})
        for k, name in enumerate("xyz")
        if name in names
    }


@contextmanager
def _warnings_once() -> Iterator[None]:
    """Show one of several warnings that differ by numbers only, at the end of the block."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    kinds = {(w.category, re.sub(r"[\d.]+", "", str(w.message))): w for w in reversed(caught)}
    for warning in reversed(kinds.values()):
        warnings.warn(
            warning.message, warning.category, stacklevel=6
        )  # who called `line` or the like, with the frame that takes frequencies between


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
    method : "wigner" (default), or one of :func:`amplitude`, or several of these side by side.
    quantity : "irradiance" (default), |U|^2 in W/m^2 for |u|^2 in W/m^2; "amplitude", complex, or
        its "phase" in rad, which "wigner" does not have.
    obliquity : of "wigner" and "fraunhofer", as :func:`irradiance` takes it.
    bandwidth : of the light in Hz, for the irradiance, as :func:`irradiance` takes it.
    tolerance : as :func:`irradiance` and :func:`amplitude` take it; None: their defaults.
    obstacles : bodies and plates, as :func:`amplitude` takes them, whose shadows diffract
        (docs/shadows.md); with an exact method and light of one wavelength.
    dtype : type of the values, "float64" (default) or "float32" (amplitudes: complex).
    precision, engine : see :func:`fourier`.
    chunks : None: all values are computed now; or sizes of chunks as dask takes them, a number,
        one for each axis, or "auto": the result is lazy, and values are computed when needed.
    out : folder of a zarr store (format 3) to which the values are written chunk by chunk; the
        same call completes a store that an interrupted run has left. Needs the extra ``datasets``.
    scheduler : with ``out``: address of a dask.distributed scheduler whose workers see ``out``, or
        a cluster object such as ``LocalCluster``; None: this machine.
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
    elements do not lie in the plane z = 0; EngineError without the engine, or the scheduler;
    StoreError for a path that cannot be written to, or holds results of other settings;
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

    Values are computed in blocks, which need some hundred megabytes in addition to the result.
    Volumes larger than memory need ``chunks`` or ``out``.

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
