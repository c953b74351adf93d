"""Values in tables of source files: keys and kinds; fields, positions and weights by name.

A key means the same in all tables, and is a parameter of the function that its table names.
Directions may be given as angles, and wavelengths as frequencies, which the whole file may share.
Errors begin with the place of what they are about.
"""

from __future__ import annotations

import functools
import math
import operator
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry import Aperture, Polyhedron
from polywigner.geometry.io.limits import (
    LARGEST_FILE,
    MOST_WAVES,
    check_bytes,
    check_most,
    check_rings,
    check_vertices,
)
from polywigner.illumination import arrays, tapers
from polywigner.illumination.lattices import checked_positions
from polywigner.illumination.waves import Illumination
from polywigner.quantities import (
    parse_angle,
    parse_coordinate,
    parse_decibels,
    parse_frequency,
    parse_length,
    wavelength_of,
)

Table = Mapping[str, Any]
Converter = Callable[[Any], Any]

VERSION = 1
"""Version of the format; files of another are refused."""

# Tapers or weights that are multiplied: some for either axis, and a steering.
_MOST_FACTORS = 20

# Polygons are lists (1) of rings (2) of vertices (3) of coordinates (4).
_DEEPEST = 4
_LONGEST_SHOWN = 60


@contextmanager
def at(place: str) -> Iterator[None]:
    """Put the place in front of the message of a PolywignerError raised inside."""
    try:
        yield
    except PolywignerError as error:
        raise type(error)(f"{place}: {error}") from None


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


def check_keys(table: Any, required: Collection[str], optional: Collection[str] = ()) -> None:
    """Check that a table has all required keys and none beyond the optional ones."""
    if not isinstance(table, dict):
        raise FileFormatError(f"expected a table, got {shown(table)}")
    accepted = (*required, *optional)
    for key in table:
        if key not in accepted:
            raise FileFormatError(f"expected the keys {', '.join(accepted)}, got {shown(key)}")
    for key in required:
        if key not in table:
            raise FileFormatError(f"expected the key {key!r}, got a table without it")


def values_of(table: Table, converters: Mapping[str, Converter]) -> dict[str, Any]:
    """Convert the values of those keys of a table that have a converter; omit the others."""
    values = {}
    for key, value in table.items():
        if key in converters:
            with at(key):
                values[key] = converters[key](value)
    return values


def name_in(table: Any, names: Collection[str], key: str = "kind", expected: str = "a kind") -> str:
    """Return the name under a key of a table, one of the known names."""
    name = table.get(key) if isinstance(table, dict) else None
    if not isinstance(name, str) or name not in names:
        got = shown(name) if name is not None else f"{shown(table)} without a {key}"
        raise FileFormatError(f"expected {expected} out of {', '.join(names)}, got {got}")
    return name


def of_type(kind: type, expected: str) -> Converter:
    """A converter that takes values of one type only, as they are."""

    def check(value: Any) -> Any:
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise FileFormatError(f"expected {expected}, got {shown(value)}")
        return value

    return check


listed = of_type(list, "a list")
whole = of_type(int, "a whole number")
flag = of_type(bool, "true or false")
text = of_type(str, "a text")


def each(convert: Converter) -> Converter:
    """A converter of lists from one of items."""
    return lambda value: [convert(item) for item in listed(value)]


def one_or_each(convert: Converter) -> Converter:
    """A converter of one item or of a list of them."""
    return lambda value: each(convert)(value) if isinstance(value, list) else convert(value)


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


def _quantity(parse: Callable[[str], float]) -> Converter:
    """A converter of texts with a unit; plain numbers are in SI units already."""
    return lambda value: parse(value) if isinstance(value, str) else number(value)


def _above_zero(parse: Callable[[str | float], float]) -> Converter:
    return lambda value: parse(value if isinstance(value, str) else number(value))


angle = _quantity(parse_angle)
decibels = _quantity(parse_decibels)
coordinate = _quantity(parse_coordinate)
length = _above_zero(parse_length)
frequency = _above_zero(parse_frequency)


def radius_of(value: Any) -> float:
    """A radius of a curved wave: a length of either sign, or "inf" for a flat one."""
    flat = isinstance(value, str) and value.strip().lower() in ("inf", "flat")
    return math.inf if flat else float(coordinate(value))


def nested(convert: Converter, depth: int = _DEEPEST) -> Converter:
    """A converter of an item, or of lists of items as they are nested."""

    def converted(value: Any, left: int = depth) -> Any:
        if not isinstance(value, list):
            return convert(value)
        if not left:
            raise FileFormatError("expected numbers, got lists nested too deeply")
        return [converted(item, left - 1) for item in value]

    return converted


numbers = nested(number)
coordinates = nested(coordinate)


def complex_numbers(value: Any, depth: int = 1) -> Any:
    """Lists, nested `depth` deep, of complex numbers: real ones, or pairs [real, imaginary]."""
    if depth:
        return [complex_numbers(item, depth - 1) for item in listed(value)]
    if not isinstance(value, list):
        return complex(number(value))
    if len(value) != 2:
        raise FileFormatError(f"expected a complex number as [real, imaginary], got {shown(value)}")
    return complex(number(value[0]), number(value[1]))


def _version(value: Any) -> int:
    if whole(value) != VERSION:
        raise FileFormatError(f"expected {VERSION}, got {shown(value)}")
    return VERSION


def _layers(value: Any) -> tuple[str, ...] | None:
    names = value if isinstance(value, list) else [value]
    return tuple(text(name) for name in names if name is not None) or None


def _untouched(value: Any) -> Any:
    """A value that depends on others of its table; the kind of the table converts it."""
    return value


HEAD: dict[str, Converter] = {
    "version": _version,
    "frequency": frequency,
    "wavelength": length,
    "polarisation": _untouched,
}
"""Keys at the top of a file, whatever its kind."""

_OF_CONVERTERS: dict[Converter, str] = {
    length: "wavelength coherence_width width height pitch pitch_x pitch_y",
    frequency: "frequency",
    coordinates: "polygons intervals vertices to_world centre point",
    each(coordinates): "radii",
    one_or_each(radius_of): "radius",
    angle: "theta phi",
    decibels: "sll",
    numbers: "direction curvature frequencies cycles slopes",
    complex_numbers: "amplitudes",
    whole: "power nbar m n count nx ny",
    each(whole): "counts",
    each(each(whole)): "faces",
    flag: "union verbatim",
    text: "file unit component",
    one_or_each(text): "window",
    _layers: "layer",
    listed: "elements",
    _untouched: "shape illumination coefficients element positions weights paths",
}
KEYS = {key: convert for convert, keys in _OF_CONVERTERS.items() for key in keys.split()}
"""Each key of the tables, which means the same in all, and its check and conversion."""


class Positions(NamedTuple):
    """Positions of the elements of a phased array."""

    places: NDArray[np.float64]
    """(n, d) in metres."""
    shape: tuple[int, ...] | None = None
    """Numbers of elements along each axis of a lattice; None of other layouts."""


_NONE = Positions(np.empty((0, 2)))


@dataclass(frozen=True)
class Around:
    """Settings that a table depends on beside its own keys."""

    folder: Path
    allow_outside: bool
    """Whether other files may stand elsewhere than in the folder."""
    wavelength: float | None
    """At the top of the file, in metres."""
    dimension: int = 2
    """Dimension of the element that is lit or repeated: 1 or 2."""
    positions: Positions = _NONE
    """Positions of the array whose weights the table gives."""
    read: dict[tuple[Any, ...], Aperture | Polyhedron] = field(default_factory=dict)
    """Other files that were read, by path, unit and options."""
    counted: Counter[str] = field(default_factory=Counter)

    def count(self, **more: int) -> None:
        """Add to the rings, vertices, waves and bytes of the file and files that it names."""
        self.counted.update(more)
        check_rings(self.counted["rings"])
        check_vertices(self.counted["vertices"])
        check_most(self.counted["waves"], MOST_WAVES, "plane waves", "use fewer or lower tapers")
        check_bytes(self.counted["bytes"], LARGEST_FILE, "other files")


@dataclass(frozen=True)
class Kind:
    """A kind of table: its keys, and the function that builds an object of their values."""

    build: Callable[[dict[str, Any], Around], Any]
    required: str = ""
    optional: str = ""

    def __call__(self, table: Table, around: Around) -> Any:
        check_keys(table, ("kind", *self.required.split()), self.optional.split())
        return self.build(values_of(table, KEYS), around)


Kinds = Mapping[str, Kind]


def made(table: Any, kinds: Kinds, around: Around) -> Any:
    """The object that a table of one of the kinds describes."""
    return kinds[name_in(table, kinds)](table, around)


def wavelength_in(values: Mapping[str, Any], default: float | None) -> float | None:
    """The wavelength that values give, as such or by their frequency; else the default."""
    if "frequency" in values and "wavelength" in values:
        raise FileFormatError("expected a frequency or a wavelength, got both; leave one out")
    if "frequency" in values:
        with at("frequency"):
            return wavelength_of(values["frequency"])
    return values.get("wavelength", default)


def field_of(value: Any, around: Around) -> Illumination:
    """The field of a table, or the product of fields in a list of tables."""
    product: Illumination | None = None
    for factor in _factors(value, _FIELDS, around):
        # counted before they are multiplied
        around.count(waves=len(factor) * (1 if product is None else len(product)))
        product = factor if product is None else product * factor
    assert product is not None
    return product


def _factors(value: Any, kinds: Kinds, around: Around) -> Iterator[Any]:
    """The object of a table, or of each of a list of tables."""
    if not isinstance(value, list):
        yield _named(value, kinds, around)
        return
    if not 0 < len(value) <= _MOST_FACTORS:
        got = f"a list of {len(value)}" if value else "an empty list"
        raise FileFormatError(
            f"expected a table or a list of tables, at most {_MOST_FACTORS}, got {got}"
        )
    for k, item in enumerate(value):
        with at(f"number {k}"):
            factor = _named(item, kinds, around)
        yield factor


def _named(table: Any, kinds: Kinds, around: Around) -> Any:
    """The object of a table, with its kind in the place of errors."""
    with at(name_in(table, kinds)):
        return made(table, kinds, around)


def _direction(values: dict[str, Any], dimension: int) -> Any:
    """The direction, from itself or from the angles off the normal and around it."""
    if ("direction" in values) == ("theta" in values):
        got = "both" if "theta" in values else "neither"
        raise FileFormatError(f"expected a direction or the angle theta, got {got}")
    if "direction" in values:
        if "phi" in values:
            raise FileFormatError("expected phi with theta only, got it with a direction")
        return values["direction"]
    if dimension == 1 and "phi" in values:
        raise FileFormatError("expected no phi for slits, got one; theta may be negative")
    return tapers.direction_of(values["theta"], values.get("phi", 0.0))[:dimension]


def _wavelength(values: dict[str, Any], around: Around) -> float:
    found = wavelength_in(values, around.wavelength)
    if found is None:
        raise FileFormatError(
            'expected a frequency such as "77 GHz" or a wavelength, got none; give one here or at '
            "the top of the file"
        )
    return found


def _taper(function: Callable[..., Illumination]) -> Callable[[dict[str, Any], Around], Any]:
    return lambda values, around: function(**{"width": None, **values}, dimension=around.dimension)


def _series(values: dict[str, Any], around: Around) -> Illumination:
    with at("coefficients"):
        depth = 2 if "height" in values else 1
        values["coefficients"] = complex_numbers(values["coefficients"], depth)
    return tapers.fourier_taper(**values, dimension=around.dimension)


def _mode(values: dict[str, Any], around: Around) -> Illumination:
    if around.dimension == 1:
        raise FileFormatError("expected an aperture for a mode of a guide, got slits")
    return tapers.te_mode(**values)


_STEERING = "direction theta phi frequency wavelength"
_FIELDS: dict[str, Kind] = {
    "uniform": Kind(lambda v, around: tapers.uniform(around.dimension)),
    "steering": Kind(
        lambda v, around: tapers.steering(_direction(v, around.dimension), _wavelength(v, around)),
        "",
        _STEERING,
    ),
    "cosine_taper": Kind(_taper(tapers.cosine_taper), "", "width height power"),
    "taylor_taper": Kind(_taper(tapers.taylor_taper), "", "width height sll nbar"),
    "te_mode": Kind(_mode, "width height", "m n component"),
    "fourier_taper": Kind(_series, "width coefficients", "height"),
    "waves": Kind(lambda v, around: Illumination(**v), "amplitudes frequencies"),
}


def positions_of(value: Any, around: Around) -> Positions:
    """Positions (n, d) from a list, or from a table that names a layout."""
    if isinstance(value, dict):
        layout: Positions = _named(value, _LAYOUTS, around)
        return layout
    return Positions(checked_positions(coordinates(value), (around.dimension,)))


def _row(values: dict[str, Any], around: Around) -> Positions:
    count = values["count"]
    return Positions(arrays.grid_positions(count, 1, values["pitch"])[:, :1], (count,))


def _lattice(layout: Callable[..., Any]) -> Callable[[dict[str, Any], Around], Positions]:
    return lambda values, around: Positions(layout(**values), (values["nx"], values["ny"]))


_LAYOUTS: dict[str, Kind] = {
    "row": Kind(_row, "count pitch"),
    "grid": Kind(_lattice(arrays.grid_positions), "nx ny pitch_x", "pitch_y"),
    "triangular": Kind(_lattice(arrays.triangular_positions), "nx ny pitch_x", "pitch_y"),
    "rings": Kind(lambda v, around: Positions(arrays.ring_positions(**v)), "radii counts"),
}


def weights_of(value: Any, around: Around) -> Any:
    """Complex weights (n,) from a list of numbers, or the product of a table or several."""
    if isinstance(value, list) and not any(isinstance(item, dict) for item in value):
        return complex_numbers(value)
    return functools.reduce(operator.mul, _factors(value, _WEIGHTS, around))


def _window(values: dict[str, Any], around: Around) -> NDArray[np.float64]:
    if around.positions.shape is None:
        raise FileFormatError(
            "expected positions of kind row, grid or triangular for the weights of a window, got "
            "others; give the weights as numbers"
        )
    return arrays.window_weights(around.positions.shape, **values)


def _steered(values: dict[str, Any], around: Around) -> NDArray[np.complex128]:
    towards = _direction(values, around.dimension)
    return arrays.steering_weights(around.positions.places, towards, _wavelength(values, around))


def _focused(values: dict[str, Any], around: Around) -> NDArray[np.complex128]:
    point = values["point"]
    return arrays.focusing_weights(around.positions.places, point, _wavelength(values, around))


_WEIGHTS: dict[str, Kind] = {
    "window": Kind(_window, "window", "sll nbar"),
    "steering": Kind(_steered, "", _STEERING),
    "focusing": Kind(_focused, "point", "frequency wavelength"),
}
