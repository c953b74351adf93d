"""Fields along lines, on planes and hemispheres, and in volumes, as labelled arrays.

Values are computed now, lazily, or into a store. (docs/volumes.md)
"""

from __future__ import annotations

import json
import math
import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, Unpack, get_args

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
    check_memory,
    chunks_within,
    digest_of,
    lazy_array,
    source_attrs,
    source_coords,
    source_text,
    write_store,
)
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import PlaneSource, checked_radiator
from polywigner.source.obliquities import DEFAULT
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

_UNITS = {"irradiance": "W m-2", "amplitude": "W0.5 m-1", "phase": "rad"}
_LONG_NAMES = {
    "irradiance": "irradiance |U|^2",
    "amplitude": "complex amplitude U",
    "phase": "phase of U",
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


@dataclass(frozen=True, eq=False)
class _FieldBlock:
    """The values of one method on any part of a grid."""

    source: PlaneSource | Wavefront
    grid: Grid
    wavelength: float
    method: str
    quantity: str
    dtype: np.dtype[Any]
    options: Mapping[str, Any]
    """Keywords of :func:`irradiance` or :func:`amplitude`."""

    def __call__(self, origin: Index, shape: Index) -> Values:
        """Compute values of a shape, from the point with the numbers ``origin`` on."""
        points = self.grid.points(origin, shape)
        compute = irradiance if self.quantity == "irradiance" else amplitude
        field = compute(self.source, points, self.wavelength, self.method, **self.options)
        return np.asarray(np.angle(field) if self.quantity == "phase" else field, self.dtype)

    @property
    def attrs(self) -> dict[str, Any]:
        """Attributes of the variable: unit, and all settings but the wavelength."""
        from polywigner import __version__

        options = {"engine": "auto", "precision": "double", **self.options}
        if self.method in _WITH_OBLIQUITY:
            options.setdefault("obliquity", DEFAULT)
        if "obstacles" in options:
            options |= _described(options["obstacles"])
        return {
            "units": _UNITS[self.quantity],
            "long_name": _LONG_NAMES[self.quantity],
            "method": self.method,
            "quantity": self.quantity,
            **options,
            "convention": "waves exp(+ikr)/r, time exp(-i omega t); |u|^2 on the source in W m-2",
            "polywigner_version": __version__,
        }


def _described(obstacles: Sequence[Obstacle]) -> dict[str, str]:
    """Describe bodies in one line, and by the digest of their positions and outlines."""
    names, tables = [], []
    for body in obstacles:
        if isinstance(body, Polyhedron):
            names.append(repr(body))
            tables.append([body.vertices.tolist(), body.faces])
        else:
            names.append(f"plate {body.aperture!r}")
            tables.append([source_text(body.aperture), body.pose.tolist()])
    text = "; ".join(names)
    if len(text) > _LONGEST_NAMES:
        text = f"{len(names)} obstacles: {text[:_LONGEST_NAMES]}..."
    return {"obstacles": text, "obstacles_sha256": digest_of(json.dumps(tables))}


def _dataset(
    source: Any, grid: Grid, wavelength: float, options: FieldOptions, dtype: str = "float64"
) -> xarray.Dataset:
    """Return fields on a grid, with one variable for each method, named after the method.

    ``dtype`` is the default type of values.
    """
    out = options.get("out")
    check_options(options, FieldOptions, out)
    blocks = _blocks(source, grid, wavelength, options, dtype)
    chunks, shape = options.get("chunks"), shape_of_grid(grid)
    is_lazy, engine = chunks is not None or out is not None, "auto"
    with _warnings_once():
        for block in blocks if is_lazy or len(blocks) > 1 else ():
            # one point raises now what would be raised after hours of work
            first = replace(block, options={**block.options, "engine": "numpy"})
            first((0,) * len(shape), (1,) * len(shape))
        if is_lazy:
            size = math.prod(shape) // _CHUNKS
            if out is not None and chunks in (None, "auto"):
                chunks = chunks_within(shape, min(max(size, _SMALLEST_CHUNK), _LARGEST_CHUNK))
            # every chunk on the same engine, wherever it is computed
            engine = resolved(options.get("engine", "auto"), max(_COMPILED, size))
            blocks = [
                replace(block, options={**block.options, "engine": engine}) for block in blocks
            ]
        coords = grid.coords | source_coords(blocks[0].source) | _positions(grid)
        about = {"wavelength": blocks[0].wavelength}
        about["frequency"] = SPEED_OF_LIGHT / about["wavelength"]
        return labelled_results(
            {block.method: (block, block.dtype, block.attrs) for block in blocks},
            tuple(grid.coords),
            coords,
            about | source_attrs(blocks[0].source),
            out,
            options,
            _BLOCK,
            chunks,
            engine != "numpy",
        )


def check_options(options: Mapping[str, Any], kinds: type, out: object) -> None:
    """Raise ArgumentError for options that a TypedDict does not have, or that need a store."""
    names = kinds.__annotations__
    for name in options:
        if name not in names:
            raise ArgumentError(f"expected options among {', '.join(names)}, got {name!r}")
    for name in ("scheduler", "threads"):
        if out is None and options.get(name) is not None:
            raise ArgumentError(f"expected out with {name}, got none; name a store to write to")


def labelled_results(
    variables: Mapping[str, Variable],
    dims: tuple[str, ...],
    coords: Mapping[str, Any],
    attrs: Mapping[str, Any],
    out: str | os.PathLike[str] | None,
    options: StoreOptions,
    at_a_time: int,
    chunks: Chunks | None,
    compiled: bool,
) -> xarray.Dataset:
    """Return variables over axes ``dims``.

    Without ``chunks`` they are computed now, up to ``at_a_time`` samples in one call; else lazily,
    or into the store ``out``. ``compiled``: see :func:`lazy_array`.
    """
    shape = tuple(len(coords[name]) for name in dims)
    threads, progress = options.get("threads"), options.get("progress")
    if chunks is None:
        check_memory(shape)

    def values_of(name: str, block: Block, dtype: np.dtype[Any]) -> Any:
        if chunks is None:
            return _computed(name, block, np.empty(shape, dtype), at_a_time, progress)
        return lazy_array(block, shape, chunks, dtype, compiled=compiled, threads=threads)

    result = labelled_arrays(
        {
            name: (dims, values_of(name, block, dtype), about)
            for name, (block, dtype, about) in variables.items()
        },
        coords,
        attrs,
    )
    if out is None:
        return result
    how: dict[str, Any] = {"compiled": compiled, "threads": threads, "progress": progress}
    return write_store(out, result, scheduler=options.get("scheduler"), **how)


def _computed(
    name: str, block: Block, values: Values, at_a_time: int, progress: bool | None
) -> Values:
    """Fill an array with the values of a block, part by part."""
    size = chunks_within(values.shape, at_a_time)
    counts = [-(-n // c) for n, c in zip(values.shape, size, strict=True)]
    with progress_bar(name, math.prod(counts), show=progress) as advance:
        for index in np.ndindex(*counts):
            origin = tuple(i * c for i, c in zip(index, size, strict=True))
            part = tuple(slice(o, o + c) for o, c in zip(origin, size, strict=True))
            values[part] = block(origin, values[part].shape)
            advance()
    return values


def _blocks(
    source: Any, grid: Grid, wavelength: float, options: FieldOptions, dtype: str
) -> list[_FieldBlock]:
    """Return a block for each method."""
    quantity = checked_choice(options.get("quantity", "irradiance"), "quantity", get_args(Quantity))
    number = checked_choice(options.get("dtype", dtype), "dtype", ("float32", "float64"))
    methods = _checked_methods(options.get("method", "wigner"), quantity)
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
        if "wigner" in methods:
            raise ArgumentError(
                f"expected an exact method with obstacles, got 'wigner'; use {DEFAULT!r}"
            )
    radiator, length = checked_radiator(source, partly=True), checked_wavelength(wavelength)
    complex_number = np.result_type(number, np.complex64)
    stored = complex_number if quantity == "amplitude" else np.dtype(number)
    plain = {name: value for name, value in how.items() if name != "obliquity"}
    return [
        _FieldBlock(radiator, grid, length, method, quantity, stored,
                    how if method in _WITH_OBLIQUITY else plain)
        for method in methods
    ]  # fmt: skip


def _checked_methods(method: Any, quantity: str) -> tuple[str, ...]:
    is_one = isinstance(method, str) or not isinstance(method, Sequence)
    methods = (method,) if is_one else tuple(method)
    if not methods or len(set(map(str, methods))) < len(methods):
        raise ArgumentError(f"expected one method, or several different ones, got {method!r}")
    for name in methods:
        if quantity != "irradiance" and name == "wigner":
            raise ArgumentError(
                f'expected a method with a phase for the {quantity}, got "wigner", which has '
                f"irradiances only; use one of {', '.join(METHODS)}"
            )
        checked_method(name, ("wigner", *METHODS))
    return methods


def _positions(grid: Grid) -> dict[str, Any]:
    """Return x, y and z of the points of a grid that has other axes."""
    others = [k for k, name in enumerate("xyz") if name not in grid.coords]
    if not others:
        return {}
    shape = shape_of_grid(grid)
    points = grid.points((0,) * len(shape), shape)
    found: dict[str, Any] = {}
    for k in others:
        constant = set(grid.coords) <= set("xyz")
        dims = () if constant else tuple(grid.coords)
        found["xyz"[k]] = (dims, points.flat[k] if constant else points[..., k], {"units": "m"})
    return found


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
