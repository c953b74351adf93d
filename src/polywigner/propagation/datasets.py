"""Fields on grids of points, block by block, and the labelled arrays made of them."""

from __future__ import annotations

import math
import pickle
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import kernel_threads
from polywigner.geometry import Wavefront
from polywigner.propagation.amplitudes import amplitude
from polywigner.propagation.field_settings import WITH_OBLIQUITY, FieldSettings
from polywigner.propagation.grids import Grid, shape_of_grid
from polywigner.propagation.irradiances import irradiance
from polywigner.propagation.stores_files import required
from polywigner.propagation.stores_layout import Index, chunks_within, source_attrs, source_coords
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import PlaneSource, checked_radiator
from polywigner.radiometry.progress import progress_bar

__all__ = ["FieldBlock", "dataset", "described", "field_on"]

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
    if settings.quantity != "irradiance":
        field = amplitude(source, points, settings.wavelength, **how)
        return np.asarray(field if settings.quantity == "amplitude" else np.angle(field))
    if method == "wigner":
        how["order"] = settings.order
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
    xarray = required("xarray")
    radiator = checked_radiator(source, partly=True)
    blocks = [FieldBlock(radiator, grid, method, settings) for method in settings.methods]
    with _warnings_once():
        arrays = [
            _filled(block, progress) if chunks is None else _lazy(block, chunks) for block in blocks
        ]
    dims = tuple(grid.coords)
    named = grid.coords | source_coords(radiator)
    coords = {name: (axis.dims, axis.values, axis.attrs) for name, axis in named.items()}
    return xarray.Dataset(
        {
            block.method: (dims, array, block.attrs)
            for block, array in zip(blocks, arrays, strict=True)
        },
        coords=coords | _places(grid),
        attrs=described(settings) | source_attrs(radiator),
    )


def described(settings: FieldSettings) -> dict[str, Any]:
    """Attributes of a dataset, few, for all are shown with it: those of variables are not."""
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
    starts = [range(0, n, step) for n, step in zip(shape, size, strict=True)]
    count = math.prod(map(len, starts))
    with progress_bar(block.method, count, show=progress) as advance:
        for origin in product(*starts):
            ends = [min(o + n, most) for o, n, most in zip(origin, size, shape, strict=True)]
            part = tuple(slice(o, end) for o, end in zip(origin, ends, strict=True))
            extent = tuple(end - o for o, end in zip(origin, ends, strict=True))
            values[part] = block(origin, extent)
            advance()
    return values


@contextmanager
def _warnings_once() -> Iterator[None]:
    """Shows one of warnings that differ by numbers only, as those of many blocks, at the end."""
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
    except (TypeError, ValueError) as error:
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
    with nullcontext() if block.settings.engine == "numpy" else kernel_threads():
        return block(tuple(a for a, _ in place), tuple(b - a for a, b in place))
