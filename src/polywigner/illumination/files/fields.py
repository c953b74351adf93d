"""The elements' part of a source file: fields and weights by name, and positions.

The keys of a table are the parameters of the function that it names. Directions may be given as
angles, and wavelengths as frequencies, which the whole file may share.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.illumination import arrays, tapers
from polywigner.illumination.tapers import unit_vector
from polywigner.illumination.waves import Illumination
from polywigner.quantities import (
    parse_angle,
    parse_coordinate,
    parse_decibels,
    parse_frequency,
    parse_length,
    wavelength_of,
)

__all__ = [
    "Positions",
    "Table",
    "angle",
    "at",
    "checked_list",
    "checked_table",
    "complex_numbers",
    "coordinates",
    "decibels",
    "drawing_options",
    "flag",
    "frequency",
    "illumination_of",
    "length",
    "number",
    "numbers",
    "positions_of",
    "radius_of",
    "text",
    "wavelength_in",
    "weights_of",
    "whole",
]

Table = Mapping[str, Any]

# Polygons are lists (1) of rings (2) of vertices (3) of coordinates (4).
_DEEPEST = 4
_LONGEST_SHOWN = 60


@contextmanager
def at(place: str) -> Iterator[None]:
    """Put the place in front of the message of what is raised inside."""
    try:
        yield
    except PolywignerError as error:
        raise type(error)(f"{place}: {error}") from None


def checked_table(value: Any, required: Collection[str], optional: Collection[str] = ()) -> Table:
    """A table with all required keys and none beyond the optional ones."""
    if not isinstance(value, dict):
        raise FileFormatError(f"expected a table, got {shown(value)}")
    accepted = (*required, *optional)
    for key in value:
        if key not in accepted:
            raise FileFormatError(f"expected the keys {', '.join(accepted)}, got {shown(key)}")
    for key in required:
        if key not in value:
            raise FileFormatError(f"expected the key {key!r}, got a table without it")
    return value


def checked_list(value: Any) -> list[Any]:
    """A list."""
    if not isinstance(value, list):
        raise FileFormatError(f"expected a list, got {shown(value)}")
    return value


def shown(value: Any) -> str:
    """A value of a file as messages quote it: one short line."""
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    try:
        quoted = repr(value)
    except ValueError:  # a whole number of thousands of digits
        quoted = "a number of thousands of digits"
    return quoted if len(quoted) <= _LONGEST_SHOWN else quoted[:_LONGEST_SHOWN] + "..."


def number(value: Any) -> float:
    """A finite number."""
    try:
        plain = isinstance(value, (int, float)) and not isinstance(value, bool)
        result = float(value) if plain else math.nan
    except OverflowError:
        result = math.nan
    if not math.isfinite(result):
        raise FileFormatError(f"expected a finite number, got {shown(value)}")
    return result


def whole(value: Any) -> int:
    """A whole number."""
    if not isinstance(value, int) or isinstance(value, bool):
        raise FileFormatError(f"expected a whole number, got {shown(value)}")
    return value


def flag(value: Any) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise FileFormatError(f"expected true or false, got {shown(value)}")
    return value


def text(value: Any) -> str:
    """A text."""
    if not isinstance(value, str):
        raise FileFormatError(f"expected a text, got {shown(value)}")
    return value


def _quantity(value: Any, parse: Callable[[str], float]) -> float:
    return parse(value) if isinstance(value, str) else number(value)


def length(value: Any) -> float:
    """A length above zero: a text such as "10 mm", or metres."""
    return parse_length(value if isinstance(value, str) else number(value))


def radius_of(value: Any) -> float:
    """A radius of a curved wave: a length of either sign, or "inf" for a flat one."""
    if isinstance(value, str) and value.strip().lower() in ("inf", "flat"):
        return math.inf
    return _quantity(value, parse_coordinate)


def angle(value: Any) -> float:
    """An angle: a text such as "20 deg", or radians."""
    return _quantity(value, parse_angle)


def decibels(value: Any) -> float:
    """A level: a text such as "25 dB", or decibels."""
    return _quantity(value, parse_decibels)


def frequency(value: Any) -> float:
    """A frequency above zero: a text such as "94 GHz", or hertz."""
    return parse_frequency(value if isinstance(value, str) else number(value))


def _nested(value: Any, convert: Callable[[Any], Any], depth: int = _DEEPEST) -> Any:
    if not isinstance(value, list):
        return convert(value)
    if not depth:
        raise FileFormatError("expected numbers, got lists nested too deeply")
    return [_nested(item, convert, depth - 1) for item in value]


def numbers(value: Any) -> Any:
    """Finite numbers, or lists of them as they are nested."""
    return _nested(value, number)


def coordinates(value: Any) -> Any:
    """Lengths of either sign, as texts or metres, or lists of them as they are nested."""
    return _nested(value, lambda item: _quantity(item, parse_coordinate))


def complex_numbers(value: Any, depth: int = 1) -> Any:
    """Lists, nested `depth` deep, of complex numbers: real ones, or pairs [real, imaginary]."""
    if depth:
        return [complex_numbers(item, depth - 1) for item in checked_list(value)]
    if not isinstance(value, list):
        return complex(number(value))
    if len(value) != 2:
        raise FileFormatError(f"expected a complex number as [real, imaginary], got {shown(value)}")
    return complex(number(value[0]), number(value[1]))


def drawing_options(table: Table) -> dict[str, Any]:
    """Which layers of a drawing, and whether to join what overlaps."""
    layer = table.get("layer")
    names = [layer] if isinstance(layer, str) or layer is None else checked_list(layer)
    layers = tuple(text(name) for name in names if name is not None)
    return {"layer": layers or None, "union": flag(table.get("union", False))}


@dataclass(frozen=True, eq=False)
class Positions:
    """Where the elements of a phased array are."""

    places: NDArray[np.float64]
    """(n, d) in metres."""
    shape: tuple[int, ...] | None = None
    """How many there are along each axis of a lattice; None of other layouts."""


@dataclass(frozen=True)
class _Surroundings:
    """Settings on which a field or weights depend beside their own table."""

    dimension: int
    wavelength: float | None
    positions: Positions | None = None


# Tapers or weights that are multiplied: some for either axis, and a steering.
_MOST_FACTORS = 20

Converters = Mapping[str, Callable[[Any], Any]]


@dataclass(frozen=True)
class _Kind:
    """How a table of this kind becomes a field, weights, or positions."""

    build: Callable[[dict[str, Any], _Surroundings], Any]
    required: Converters
    optional: Converters

    def __call__(self, table: Table, around: _Surroundings) -> Any:
        checked_table(table, ("kind", *self.required), tuple(self.optional))
        converters = {**self.required, **self.optional}
        values = {}
        for name in table:
            if name != "kind":
                with at(name):
                    values[name] = converters[name](table[name])
        return self.build(values, around)


def wavelength_in(table: Table, default: float | None = None) -> float | None:
    """The wavelength that a table gives, as such or by its frequency; else the default."""
    if "frequency" in table and "wavelength" in table:
        raise FileFormatError("expected a frequency or a wavelength, got both; leave one out")
    if "frequency" in table:
        with at("frequency"):
            return wavelength_of(frequency(table["frequency"]))
    if "wavelength" in table:
        with at("wavelength"):
            return length(table["wavelength"])
    return default


def _wavelength(values: dict[str, Any], around: _Surroundings) -> float:
    found = wavelength_in(values, around.wavelength)
    if found is None:
        raise FileFormatError(
            'expected a frequency such as "77 GHz" or a wavelength, got none; give one here or at '
            "the top of the file"
        )
    return found


def _direction(values: dict[str, Any], dimension: int) -> Any:
    """The direction, from itself or from the angles off the normal and around it."""
    if ("direction" in values) == ("theta" in values):
        got = "both" if "theta" in values else "neither"
        raise FileFormatError(f"expected a direction or the angle theta, got {got}")
    if "direction" in values:
        if "phi" in values:
            raise FileFormatError("expected phi with theta only, got it with a direction")
        return values["direction"]
    theta, phi = values["theta"], values.get("phi", 0.0)
    if dimension == 1 and "phi" in values:
        raise FileFormatError("expected no phi for slits, got one; theta may be negative")
    sine = math.sin(theta)
    s = unit_vector([sine * math.cos(phi), sine * math.sin(phi), math.cos(theta)])
    return s[:dimension]


def _guided(values: dict[str, Any], around: _Surroundings) -> Illumination:
    if around.dimension == 1:
        raise FileFormatError("expected an aperture for a mode of a guide, got slits")
    return tapers.te_mode(**values)


def _series(values: dict[str, Any], around: _Surroundings) -> Illumination:
    with at("coefficients"):
        depth = 2 if "height" in values else 1
        values["coefficients"] = complex_numbers(values["coefficients"], depth)
    return tapers.fourier_taper(**values, dimension=around.dimension)


def _window(values: dict[str, Any], around: _Surroundings) -> NDArray[np.float64]:
    positions = around.positions
    if positions is None or positions.shape is None:
        raise FileFormatError(
            "expected positions of kind row, grid or triangular for the weights of a window, got "
            "others; give the weights as numbers"
        )
    return arrays.window_weights(positions.shape, **values)


def _names(value: Any) -> Any:
    return _listed(text)(value) if isinstance(value, list) else text(value)


def _places(around: _Surroundings) -> NDArray[np.float64]:
    assert around.positions is not None  # weights are read with positions only
    return around.positions.places


def _listed(convert: Callable[[Any], Any]) -> Callable[[Any], list[Any]]:
    return lambda value: [convert(item) for item in checked_list(value)]


def _untouched(value: Any) -> Any:
    return value


_SIZES: Converters = {"width": length, "height": length}
_WAVELENGTH: Converters = {"frequency": _untouched, "wavelength": _untouched}
_STEERING: Converters = {"direction": numbers, "theta": angle, "phi": angle, **_WAVELENGTH}

_FIELDS: dict[str, _Kind] = {
    "uniform": _Kind(lambda v, on: tapers.uniform(on.dimension), {}, {}),
    "steering": _Kind(
        lambda v, on: tapers.steering(_direction(v, on.dimension), _wavelength(v, on)),
        {},
        _STEERING,
    ),
    "cosine_taper": _Kind(
        lambda v, on: tapers.cosine_taper(**{"width": None, **v}, dimension=on.dimension),
        {},
        {**_SIZES, "power": whole},
    ),
    "taylor_taper": _Kind(
        lambda v, on: tapers.taylor_taper(**{"width": None, **v}, dimension=on.dimension),
        {},
        {**_SIZES, "sll": decibels, "nbar": whole},
    ),
    "te_mode": _Kind(_guided, _SIZES, {"m": whole, "n": whole, "component": text}),
    "fourier_taper": _Kind(
        _series, {"width": length, "coefficients": _untouched}, {"height": length}
    ),
    "waves": _Kind(
        lambda v, on: Illumination(v["amplitudes"], v["frequencies"]),
        {"amplitudes": complex_numbers, "frequencies": numbers},
        {},
    ),
}

_LATTICE: Converters = {"nx": whole, "ny": whole, "pitch_x": length}
_LAYOUTS: dict[str, _Kind] = {
    "row": _Kind(
        lambda v, on: Positions(
            arrays.grid_positions(v["count"], 1, v["pitch"])[:, :1], (v["count"],)
        ),
        {"count": whole, "pitch": length},
        {},
    ),
    "grid": _Kind(
        lambda v, on: Positions(arrays.grid_positions(**v), (v["nx"], v["ny"])),
        _LATTICE,
        {"pitch_y": length},
    ),
    "triangular": _Kind(
        lambda v, on: Positions(arrays.triangular_positions(**v), (v["nx"], v["ny"])),
        _LATTICE,
        {"pitch_y": length},
    ),
    "rings": _Kind(
        lambda v, on: Positions(arrays.ring_positions(**v)),
        {"radii": _listed(coordinates), "counts": _listed(whole)},
        {},
    ),
}

_WEIGHTS: dict[str, _Kind] = {
    "window": _Kind(_window, {"window": _names}, {"sll": decibels, "nbar": whole}),
    "steering": _Kind(
        lambda v, on: arrays.steering_weights(
            _places(on), _direction(v, on.dimension), _wavelength(v, on)
        ),
        {},
        _STEERING,
    ),
    "focusing": _Kind(
        lambda v, on: arrays.focusing_weights(_places(on), v["point"], _wavelength(v, on)),
        {"point": coordinates},
        _WAVELENGTH,
    ),
}


def illumination_of(
    value: Any, dimension: int, wavelength: float | None, count: Callable[[int], None]
) -> Illumination:
    """The field of a table, or the product of those in a list of tables.

    `count` is told how many plane waves there are going to be, before they are multiplied.
    """
    around = _Surroundings(dimension, wavelength)
    field: Illumination | None = None
    for factor in _factors(value, _FIELDS, around):
        count(len(factor) * (1 if field is None else len(field)))
        field = factor if field is None else field * factor
    assert field is not None
    return field


def positions_of(value: Any, dimension: int) -> Positions:
    """Positions (n, d) from a list, or from a table that names a layout."""
    if isinstance(value, dict):
        return _one(value, _LAYOUTS, _Surroundings(dimension, None))
    return Positions(arrays.checked_positions(coordinates(value), (dimension,)))


def weights_of(value: Any, positions: Positions, wavelength: float | None) -> Any:
    """Complex weights (n,) from a list of numbers, or the product of a table or several."""
    if isinstance(value, list) and not any(isinstance(item, dict) for item in value):
        return complex_numbers(value)
    around = _Surroundings(positions.places.shape[1], wavelength, positions)
    return functools.reduce(operator.mul, _factors(value, _WEIGHTS, around))


def _factors(value: Any, kinds: Mapping[str, _Kind], around: _Surroundings) -> Iterator[Any]:
    """What a table describes, or each of a list of tables."""
    if not isinstance(value, list):
        yield _one(value, kinds, around)
        return
    if not 0 < len(value) <= _MOST_FACTORS:
        got = f"a list of {len(value)}" if value else "an empty list"
        raise FileFormatError(
            f"expected a table or a list of tables, at most {_MOST_FACTORS}, got {got}"
        )
    for k, item in enumerate(value):
        with at(f"number {k}"):
            factor = _one(item, kinds, around)
        yield factor


def _one(table: Any, kinds: Mapping[str, _Kind], around: _Surroundings) -> Any:
    name = table.get("kind") if isinstance(table, dict) else None
    if not isinstance(name, str) or name not in kinds:
        got = shown(name) if name is not None else f"{shown(table)} without a kind"
        raise FileFormatError(f"expected a table of kind {', '.join(kinds)}, got {got}")
    with at(name):
        return kinds[name](table, around)
