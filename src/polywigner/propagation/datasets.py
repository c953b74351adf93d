"""Fields on grids of points, block by block, and the labelled arrays made of them."""

from __future__ import annotations

import json
import pickle
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, Literal, TypedDict, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision
from polywigner.execution.progress import progress_bar
from polywigner.geometry import Polyhedron, Wavefront
from polywigner.geometry.arguments import checked_choice, checked_wavelength
from polywigner.geometry.silhouettes import listed_bodies
from polywigner.illumination.obliquities import CONDITIONS, DEFAULT, checked_obliquity
from polywigner.illumination.source_files import table_of
from polywigner.propagation.amplitudes import Obstacle, amplitude
from polywigner.propagation.grids import Grid, shape_of_grid
from polywigner.propagation.irradiances import checked_tolerance, irradiance
from polywigner.propagation.places import METHODS, checked_amplitude_tolerance, checked_method
from polywigner.propagation.shadows import checked_shadow_tolerance
from polywigner.propagation.stores_checks import (
    Index,
    Layout,
    chunks_within,
    digest_of,
    required,
    source_attrs,
    source_coords,
)
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import PlaneSource, checked_bandwidth, checked_radiator

Quantity = Literal["irradiance", "amplitude", "phase"]

# The others have the obliquity of their own boundary condition.
WITH_OBLIQUITY = ("wigner", "fraunhofer")
# Characters of a line that names obstacles.
_LONGEST_NAMES = 150


class FieldOptions(TypedDict, total=False):
    """Options of :func:`plane` and its like, which says more of them."""

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
    progress: bool | None


@dataclass(frozen=True)
class FieldSettings:
    """Options on which a field value depends beside its source and place."""

    wavelength: float
    methods: tuple[str, ...]
    quantity: str
    obliquity: str | None
    tolerance: float | None
    dtype: str
    precision: str | None
    engine: str
    bandwidth: float | None = None
    obstacles: tuple[Obstacle, ...] = ()

    @property
    def stored(self) -> np.dtype[Any]:
        """The type of the values."""
        real = np.dtype(self.dtype)
        return np.result_type(real, np.complex64) if self.quantity == "amplitude" else real

    def of(self, method: str) -> dict[str, Any]:
        """The settings that matter for one method, as texts and numbers."""
        settings: dict[str, Any] = {"method": method, "quantity": self.quantity}
        if method in WITH_OBLIQUITY:
            settings["obliquity"] = self.obliquity or DEFAULT
        if self.tolerance is not None:
            settings |= {"tolerance": self.tolerance}
        if self.bandwidth is not None:
            settings |= {"bandwidth": self.bandwidth}
        if self.obstacles:
            settings |= _settings_of(self.obstacles)
        return settings


def _settings_of(obstacles: Sequence[Obstacle]) -> dict[str, str]:
    """Bodies as settings: one line for readers, and the digest of their places and outlines."""
    names, tables = [], []
    for body in obstacles:
        if isinstance(body, Polyhedron):
            names.append(repr(body))
            tables.append([body.vertices.tolist(), body.faces])
        else:
            names.append(f"plate {body.aperture!r}")
            tables.append([table_of(body.aperture), body.pose.tolist()])
    text = "; ".join(names)
    if len(text) > _LONGEST_NAMES:
        text = f"{len(names)} obstacles: {text[:_LONGEST_NAMES]}..."
    return {"obstacles": text, "obstacles_sha256": digest_of(json.dumps(tables))}


def checked_settings(
    wavelength: Any, options: FieldOptions, dtype: str = "float64"
) -> FieldSettings:
    """Check options, and fill in defaults."""
    known = FieldOptions.__annotations__
    unknown = [name for name in options if name not in known]
    if unknown:
        raise ArgumentError(f"expected options among {', '.join(known)}, got {unknown[0]!r}")
    quantity = checked_choice(options.get("quantity", "irradiance"), "quantity", get_args(Quantity))
    stored = checked_choice(options.get("dtype", dtype), "dtype", ("float32", "float64"))
    tolerance = options.get("tolerance")
    obliquity = options.get("obliquity")
    methods = _checked_methods(options.get("method", "wigner"), quantity)
    precision = execution.checked_precision(options.get("precision"))
    length, bandwidth = checked_wavelength(wavelength), options.get("bandwidth")
    bodies = _checked_obstacles(options, methods, bandwidth)
    if tolerance is not None:
        tolerance = checked_tolerance(tolerance)
        if bodies and quantity != "irradiance":
            checked_shadow_tolerance(tolerance)
        elif methods != ("wigner",):  # now, rather than when the first method is done
            most = tolerance if quantity != "irradiance" else min(tolerance, 0.1)
            checked_amplitude_tolerance(most, precision != "single")
    if bandwidth is not None:
        bandwidth = checked_bandwidth(bandwidth, length)
        if quantity != "irradiance":
            raise ArgumentError(
                f"expected light of one wavelength for the {quantity}, got a bandwidth of "
                f"{bandwidth:g} Hz; a band has an irradiance only"
            )
    return FieldSettings(
        length,
        methods,
        quantity,
        None if obliquity is None else checked_obliquity(obliquity),
        tolerance,
        stored,
        precision,
        execution.checked_engine(options.get("engine", "auto")),
        bandwidth,
        bodies,
    )


def _checked_obstacles(
    options: FieldOptions, methods: Sequence[str], bandwidth: Any
) -> tuple[Obstacle, ...]:
    """The bodies of the options; ArgumentError for options that fields behind bodies lack."""
    obstacles = options.get("obstacles")
    if obstacles is None:
        return ()
    bodies = listed_bodies(obstacles)
    for name in methods:
        if name not in CONDITIONS:
            raise ArgumentError(
                f"expected obstacles with one of the methods {', '.join(CONDITIONS)}, got "
                f'{name!r}; use "{DEFAULT}"'
            )
    if bandwidth is not None:
        raise ArgumentError(
            f"expected light of one wavelength with obstacles, got a bandwidth of {bandwidth!r} "
            "Hz; average over wavelengths yourself"
        )
    return bodies


def _checked_methods(method: Any, quantity: str) -> tuple[str, ...]:
    one = isinstance(method, str) or not isinstance(method, Sequence)
    methods = (method,) if one else tuple(method)
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


Values = NDArray[Any]

# Points at a time: the bar moves, a block needs tens of megabytes, and one that is halved still has
# enough points for the compiled engines.
_BLOCK = 1 << 17

_UNITS = {"irradiance": "W m-2", "amplitude": "W0.5 m-1", "phase": "rad"}
_LONG_NAMES = {
    "irradiance": "irradiance |U|^2",
    "amplitude": "complex amplitude U",
    "phase": "phase of U",
}


def field_on(
    source: PlaneSource | Wavefront, points: Values, method: str, settings: FieldSettings
) -> Values:
    """The quantity of the settings at points (..., 3), by one of the methods: values (...)."""
    how: dict[str, Any] = {"method": method}
    how |= {"precision": settings.precision, "engine": settings.engine}
    if settings.tolerance is not None:
        how["tolerance"] = settings.tolerance
    if method in WITH_OBLIQUITY:
        how["obliquity"] = settings.obliquity
    if settings.obstacles:
        how["obstacles"] = settings.obstacles
    if settings.quantity != "irradiance":
        field = amplitude(source, points, settings.wavelength, **how)
        return np.asarray(field if settings.quantity == "amplitude" else np.angle(field))
    if settings.bandwidth is not None:
        how["bandwidth"] = settings.bandwidth
    return np.asarray(irradiance(source, points, settings.wavelength, **how))


@dataclass(frozen=True, eq=False)
class FieldBlock:
    """The values of a method on any part of a grid; can be sent to other processes."""

    source: PlaneSource | Wavefront
    grid: Grid
    method: str
    settings: FieldSettings

    def __call__(self, origin: Index, shape: Index) -> Values:
        """Values of this shape, from the point with the numbers ``origin`` on."""
        points = self.grid.points(origin, shape)
        return field_on(self.source, points, self.method, self.settings).astype(
            self.settings.stored
        )

    @property
    def attrs(self) -> dict[str, Any]:
        """Attributes of the variable: units and all settings but the wavelength."""
        from polywigner import __version__

        settings, quantity = self.settings, self.settings.quantity
        return {
            "units": _UNITS[quantity],
            "long_name": _LONG_NAMES[quantity],
            **settings.of(self.method),
            "precision": settings.precision or "double",
            "engine": settings.engine,
            "convention": "waves exp(+ikr)/r, time exp(-i omega t); |u|^2 on the source in W m-2",
            "polywigner_version": __version__,
        }


def dataset(
    source: Any,
    grid: Grid,
    settings: FieldSettings,
    progress: bool | None = None,
    chunks: Any = None,
) -> Any:
    """An xarray.Dataset with one variable for each method, named after it.

    ``chunks``: None computes now; anything that dask takes for chunks computes when values are
    asked for. Raises ArgumentError for other chunks, MissingExtraError without xarray or dask.
    """
    import xarray

    radiator = checked_radiator(source, partly=True)
    blocks = [FieldBlock(radiator, grid, method, settings) for method in settings.methods]
    with _warnings_once():
        arrays = [
            _filled(block, progress) if chunks is None else _lazy(block, chunks) for block in blocks
        ]
    dims = tuple(grid.coords)
    found = zip(blocks, arrays, strict=True)
    return xarray.Dataset(
        {block.method: (dims, array, block.attrs) for block, array in found},
        coords=grid.coords | source_coords(radiator) | _places(grid),
        attrs=described(settings) | source_attrs(radiator),
    )


def described(settings: FieldSettings) -> dict[str, Any]:
    """Attributes of a dataset: few, since all of them are shown with it."""
    return {
        "wavelength": settings.wavelength,
        "frequency": SPEED_OF_LIGHT / settings.wavelength,
    }


def _places(grid: Grid) -> dict[str, Any]:
    """x, y and z of the points of a grid whose axes are other ones."""
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


def _filled(block: FieldBlock, progress: bool | None) -> Values:
    shape = shape_of_grid(block.grid)
    values = np.empty(shape, block.settings.stored)
    size = chunks_within(shape, _BLOCK)
    parts = Layout(block.method, values.dtype, block.grid.coords, size)
    with progress_bar(block.method, parts.count, show=progress) as advance:
        for index in np.ndindex(parts.grid):
            origin, extent = parts.extent(index)
            part = tuple(slice(o, o + n) for o, n in zip(origin, extent, strict=True))
            values[part] = block(origin, extent)
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


def _lazy(block: FieldBlock, chunks: Any) -> Any:
    arrays, core = required("dask.array"), required("dask.array.core")
    shape, dtype = shape_of_grid(block.grid), block.settings.stored
    try:
        sizes = core.normalize_chunks(chunks, shape, dtype=dtype)
        if not all(n > 0 for axis in sizes for n in axis):  # a number that is none is not, either
            raise ValueError("chunks of no samples")
    except (TypeError, ValueError, ArithmeticError) as error:
        raise ArgumentError(
            f"expected chunks as dask takes them, a number, a tuple of {len(shape)}, or 'auto', "
            f"got {chunks!r}: {error}"
        ) from None
    token = required("dask.base").tokenize(pickle.dumps(block))
    return arrays.map_blocks(
        _part,
        chunks=sizes,
        dtype=dtype,
        meta=np.empty((0,) * len(shape), dtype),
        name=f"{block.method}-{token}",
        block=block,
    )


def _part(block: FieldBlock, block_info: Any = None) -> Values:
    place = block_info[None]["array-location"]
    with nullcontext() if block.settings.engine == "numpy" else execution.kernel_threads():
        return block(tuple(a for a, _ in place), tuple(b - a for a, b in place))
