"""Fields on grids of points as labelled arrays: computed now, lazy, or written to a store."""

from __future__ import annotations

import json
import math
import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision, checked_engine
from polywigner.execution.choice import resolved
from polywigner.execution.progress import progress_bar
from polywigner.geometry import Polyhedron, Wavefront
from polywigner.geometry.arguments import checked_choice, checked_wavelength
from polywigner.geometry.silhouettes import listed_bodies
from polywigner.propagation.amplitudes import Obstacle, amplitude
from polywigner.propagation.grids import Grid, shape_of_grid
from polywigner.propagation.irradiances import irradiance
from polywigner.propagation.places import METHODS, checked_method
from polywigner.propagation.stores import (
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


class FieldOptions(TypedDict, total=False):
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
    scheduler: Scheduler
    threads: int | None
    progress: bool | None


@dataclass(frozen=True, eq=False)
class FieldBlock:
    """The values of one method on any part of a grid; can be sent to other processes."""

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


def dataset(
    source: Any, grid: Grid, wavelength: float, options: FieldOptions, dtype: str = "float64"
) -> xarray.Dataset:
    """Return fields on a grid, with one variable for each method, named after the method.

    Without ``chunks`` and ``out``, all values are computed now. Parameters and errors: see
    :func:`plane`; ``dtype`` is the default type of values.
    """
    blocks = _blocks(source, grid, wavelength, options, dtype)
    chunks, out, shape = options.get("chunks"), options.get("out"), shape_of_grid(grid)
    for name in ("scheduler", "threads"):
        if out is None and options.get(name) is not None:
            raise ArgumentError(f"expected out with {name}, got none; name a store to write to")
    is_lazy = chunks is not None or out is not None
    with _warnings_once():
        for block in blocks if is_lazy or len(blocks) > 1 else ():
            # one point raises now what would be raised after hours of work
            first = replace(block, options={**block.options, "engine": "numpy"})
            first((0,) * len(shape), (1,) * len(shape))
        if not is_lazy:
            check_memory(shape)
            progress = options.get("progress")
            return _labelled(blocks, [_computed(block, progress) for block in blocks])
    size = math.prod(shape) // _CHUNKS
    if out is not None and chunks in (None, "auto"):
        chunks = chunks_within(shape, min(max(size, _SMALLEST_CHUNK), _LARGEST_CHUNK))
    # every chunk on the same engine, wherever it is computed
    engine = resolved(options.get("engine", "auto"), max(_COMPILED, size))
    blocks = [replace(block, options={**block.options, "engine": engine}) for block in blocks]
    how: dict[str, Any] = {"compiled": engine != "numpy", "threads": options.get("threads")}
    lazy = _labelled(
        blocks, [lazy_array(block, shape, chunks, block.dtype, **how) for block in blocks]
    )
    if out is None:
        return lazy
    how |= {"scheduler": options.get("scheduler"), "progress": options.get("progress")}
    return write_store(out, lazy, **how)


def _blocks(
    source: Any, grid: Grid, wavelength: float, options: FieldOptions, dtype: str
) -> list[FieldBlock]:
    """Return a block for each method."""
    names = FieldOptions.__annotations__
    unknown = [name for name in options if name not in names]
    if unknown:
        raise ArgumentError(f"expected options among {', '.join(names)}, got {unknown[0]!r}")
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
    blocks = []
    for method in methods:
        own = dict(how)
        if method not in _WITH_OBLIQUITY:
            own.pop("obliquity", None)
        blocks.append(FieldBlock(radiator, grid, length, method, quantity, stored, own))
    return blocks


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


def _labelled(blocks: Sequence[FieldBlock], arrays: Sequence[Any]) -> xarray.Dataset:
    """Return the values of all methods with axes, units and settings."""
    source, grid, wavelength = blocks[0].source, blocks[0].grid, blocks[0].wavelength
    dims, pairs = tuple(grid.coords), zip(blocks, arrays, strict=True)
    about = {"wavelength": wavelength, "frequency": SPEED_OF_LIGHT / wavelength}
    return labelled_arrays(
        {block.method: (dims, array, block.attrs) for block, array in pairs},
        grid.coords | source_coords(source) | _positions(grid),
        about | source_attrs(source),
    )


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


def _computed(block: FieldBlock, progress: bool | None) -> Values:
    """Compute all values of a block, part by part."""
    shape = shape_of_grid(block.grid)
    values, size = np.empty(shape, block.dtype), chunks_within(shape, _BLOCK)
    counts = [-(-n // c) for n, c in zip(shape, size, strict=True)]
    with progress_bar(block.method, math.prod(counts), show=progress) as advance:
        for index in np.ndindex(*counts):
            origin = tuple(i * c for i, c in zip(index, size, strict=True))
            part = tuple(slice(o, o + c) for o, c in zip(origin, size, strict=True))
            values[part] = block(origin, values[part].shape)
            advance()
    return values


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
