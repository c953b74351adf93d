"""Tables of source files that name a function, with its parameters as keys.

Fields, layouts, weights and shapes are such tables; the types of their values serve all tables.
"""

from __future__ import annotations

import functools
import inspect
import math
import operator
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from polywigner import quantities
from polywigner.errors import FileFormatError, at_key, value_text
from polywigner.geometry import shapes
from polywigner.source import arrays, tapers
from polywigner.source.waves import Illumination

# Types of values. Quantities are numbers in SI units, or texts with a unit.


class Length(float):
    """A length above zero in m, or a text such as "10 mm"."""


class Coordinate(float):
    """A length of either sign in m, or a text such as "-2 mm"."""


class Angle(float):
    """An angle in rad, or a text such as "20 deg"."""


class Frequency(float):
    """A frequency in Hz, or a text such as "77 GHz"."""


class Decibels(float):
    """A level in dB, or a text such as "25 dB"."""


class Coordinates(list[Any]):
    """Coordinates in lists, nested to any depth."""


Metres = float | str
"""A coordinate in a list whose nesting is checked."""
Complex = float | tuple[float, float]
"""A number, or a pair [real, imaginary]."""

_Item = TypeVar("_Item")
NonEmpty = Annotated[list[_Item], msgspec.Meta(min_length=1)]
Ring = Annotated[list[tuple[Metres, Metres]], msgspec.Meta(min_length=3)]


def metres(values: Any) -> Any:
    """Coordinates as numbers in m, in lists nested to any depth."""
    if isinstance(values, list | tuple):
        return [metres(value) for value in values]
    return values if type(values) is float else quantities.parse_coordinate(values)


PARSERS: dict[type, Callable[[Any], Any]] = {
    Length: quantities.parse_length,
    Coordinate: quantities.parse_coordinate,
    Angle: quantities.parse_angle,
    Frequency: quantities.parse_frequency,
    Decibels: quantities.parse_decibels,
    Coordinates: lambda value: metres(value if isinstance(value, list) else [value]),
}


def complex_numbers(values: Any, depth: int = 1) -> Any:
    """Complex numbers of lists, nested `depth` deep, of numbers or pairs [real, imaginary]."""
    try:
        if depth:
            return [complex_numbers(value, depth - 1) for value in values]
        return complex(*values) if isinstance(values, list | tuple) else complex(values)
    except (TypeError, ValueError):
        got = value_text(values)
        raise FileFormatError(f"expected numbers or pairs [real, imaginary], got {got}") from None


def radius_of(value: float | str) -> float:
    """A radius of curvature in m, of either sign; "inf" means a flat wave."""
    return math.inf if value in ("inf", math.inf) else quantities.parse_coordinate(value)


def wavelength_in(frequency: float | None, wavelength: float | None, default: Any = None) -> Any:
    """The wavelength in m that a table gives, directly or by its frequency; else the default."""
    if frequency is not None and wavelength is not None:
        raise FileFormatError("expected a frequency or a wavelength, got both; leave one out")
    if frequency is not None:
        return quantities.wavelength_of(frequency)
    return default if wavelength is None else float(wavelength)


class Table(msgspec.Struct, forbid_unknown_fields=True):
    """A table of a fixed meaning."""


class Kind(Table, tag_field="kind"):
    """A table whose key "kind" selects the class."""


class _Shape(Table, tag_field="name"):
    """A table whose key "name" selects a shape of the catalogue."""


# Tables that name a function. Its parameters are the keys, except those that other tables set. A
# key has the type of its parameter, and the same meaning in all tables.

_OF_ANNOTATION: dict[str, Any] = {
    "float": Coordinate, "ArrayLike": Coordinates, "int": int, "bool": bool, "str": str,
}  # fmt: skip
_OF_KEY: dict[str, Any] = {
    "sll": Decibels, "window": str | list[str], "counts": list[int], "coefficients": list[Any],
    "amplitudes": list[Complex], "frequencies": list[float | list[float]],
}  # fmt: skip
_IN_PLACE_OF: dict[str, dict[str, Any]] = {
    "wavelength": {"frequency": Frequency, "wavelength": Length},
    "direction": {"direction": float | list[float], "theta": Angle, "phi": Angle},
}
"""Keys of a table that stand for one parameter of its function."""

_FUNCTIONS: dict[type, Callable[..., Any]] = {}


def _union_of(functions: Mapping[str, Callable[..., Any]], base: type, *context: str) -> Any:
    """The union of the tables of functions by name; the context names parameters without a key."""
    tables = []
    for name, function in functions.items():
        required, optional = [], []
        for key, parameter in inspect.signature(function).parameters.items():
            if key in _IN_PLACE_OF:
                optional += [(k, kind | None, None) for k, kind in _IN_PLACE_OF[key].items()]
            elif key != "frequency" and key not in context:
                annotation, _, null = parameter.annotation.partition(" | ")
                kind = _OF_KEY.get(key) or _OF_ANNOTATION[annotation]
                if parameter.default is not parameter.empty:
                    optional.append((key, kind | None, parameter.default))
                elif null:
                    optional.append((key, kind | None, None))
                else:
                    required.append((key, kind))
        tables.append(msgspec.defstruct(name, [*required, *optional], bases=(base,), tag=name))
        _FUNCTIONS[tables[-1]] = function
    return functools.reduce(operator.or_, tables)


def called(table: Any, wavelength: float | None = None, **context: Any) -> Any:
    """Call the function of a table with its values.

    `wavelength`, in m, is used by a table without its own. `context` has the parameters that are no
    keys, for functions that have them.
    """
    function, values = _FUNCTIONS[type(table)], msgspec.structs.asdict(table)
    parameters = inspect.signature(function).parameters
    if "wavelength" in values:
        length = wavelength_in(values.pop("frequency"), values["wavelength"], wavelength)
        if length is None:
            raise FileFormatError(
                "expected a frequency or a wavelength, got none; give one with it or at the top of "
                "the file"
            )
        values["wavelength"] = length
    if "direction" in values:
        theta, phi = values.pop("theta"), values.pop("phi")
        if (values["direction"] is None) == (theta is None):
            got = "neither" if theta is None else "both"
            raise FileFormatError(f"expected a direction or the angle theta, got {got}")
        if phi is not None and (theta is None or context["dimension"] == 1):
            raise FileFormatError("expected phi only with theta, and not for slits")
        if theta is not None:
            values["direction"] = tapers.direction_of(theta, phi or 0.0)[: context["dimension"]]
    for key in ("amplitudes", "coefficients"):
        if key in values:
            depth = 1 if values.get("height") is None else 2
            values[key] = complex_numbers(values[key], depth)
    if "shape" in parameters and context["shape"] is None:
        raise FileFormatError(
            "expected positions of kind row, grid or triangular for the weights of a window, got "
            "others; give the weights as numbers"
        )
    return function(**values, **{key: value for key, value in context.items() if key in parameters})


def product_of(key: str, given: Any, *wavelength: float | None, **context: Any) -> Any:
    """The product of the objects of a table or of a list of tables."""
    tables = {key: given}
    if isinstance(given, list):
        tables = {f"{key}[{k}]": table for k, table in enumerate(given)}
    factors = []
    for place, table in tables.items():
        with at_key(place):
            factors.append(called(table, *wavelength, **context))
    return functools.reduce(operator.mul, factors)


def _row(count: int, pitch: float) -> NDArray[np.float64]:
    return arrays.grid_positions(count, 1, pitch)[:, :1]


if TYPE_CHECKING:
    FieldTable: TypeAlias = Any
    LayoutTable: TypeAlias = Any
    WeightTable: TypeAlias = Any
    ShapeTable: TypeAlias = Any
else:
    _FIELDS = {
        "uniform": tapers.uniform, "steering": tapers.steering, "waves": Illumination,
        "cosine_taper": tapers.cosine_taper, "taylor_taper": tapers.taylor_taper,
        "te_mode": tapers.te_mode, "fourier_taper": tapers.fourier_taper,
    }  # fmt: skip
    _LAYOUTS = {
        "row": _row, "grid": arrays.grid_positions, "triangular": arrays.triangular_positions,
        "rings": arrays.ring_positions,
    }  # fmt: skip
    _WEIGHTS = {
        "window": arrays.window_weights, "steering": arrays.steering_weights,
        "focusing": arrays.focusing_weights,
    }  # fmt: skip
    FieldTable = _union_of(_FIELDS, Kind, "dimension")
    LayoutTable = _union_of(_LAYOUTS, Kind)
    WeightTable = _union_of(_WEIGHTS, Kind, "positions", "shape")
    ShapeTable = _union_of({name: getattr(shapes, name) for name in shapes.__all__}, _Shape)
