"""Tables and short texts for fields, layouts, weights and shapes, as in source files and options.

A table names a function, and its keys are the parameters of the function; docs/source_files.md
lists them all. msgspec checks keys and types. Errors begin with the path of the key, such as
``weights[1].sll``.
"""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from polywigner import quantities
from polywigner.errors import ArgumentError, FileFormatError, QuantityError, at_key, value_text
from polywigner.geometry import Aperture, Wavefront, shapes
from polywigner.geometry.wavefront import TakesWaves
from polywigner.source import arrays, tapers
from polywigner.source.array import Array, phased_array, repeated_element
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


Complex = float | tuple[float, float]
"""A number, or a pair [real, imaginary]."""


def metres(values: Any) -> Any:
    """Coordinates as numbers in m, in lists nested to any depth."""
    if isinstance(values, list | tuple):
        return [metres(value) for value in values]
    return values if type(values) is float else quantities.parse_coordinate(values)


_PARSERS: dict[type, Callable[[Any], Any]] = {
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


def wavelength_in(table: Any, default: float | None = None) -> float | None:
    """The wavelength in m that a table specifies, also by its frequency; else the default."""
    if table.frequency is not None and table.wavelength is not None:
        raise FileFormatError("expected a frequency or a wavelength, got both; leave one out")
    if table.frequency is not None:
        return quantities.wavelength_of(table.frequency)
    return default if table.wavelength is None else float(table.wavelength)


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
_FROM_CONTEXT = ("dimension", "positions", "shape", "frequency")
"""Parameters without a key, which follow from other tables."""

_FUNCTIONS: dict[type, Callable[..., Any]] = {}


def _union_of(functions: Mapping[str, Callable[..., Any]], base: type = Kind) -> Any:
    """The union of the tables of functions by name."""
    tables = []
    for name, function in functions.items():
        required, optional = [], []
        for key, parameter in inspect.signature(function).parameters.items():
            if key in _IN_PLACE_OF:
                optional += [(k, kind | None, None) for k, kind in _IN_PLACE_OF[key].items()]
            elif key not in _FROM_CONTEXT:
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


def _row(count: int, pitch: float) -> NDArray[np.float64]:
    return arrays.grid_positions(count, 1, pitch)[:, :1]


FieldTable = _union_of({
    "uniform": tapers.uniform, "steering": tapers.steering, "waves": Illumination,
    "cosine_taper": tapers.cosine_taper, "taylor_taper": tapers.taylor_taper,
    "te_mode": tapers.te_mode, "fourier_taper": tapers.fourier_taper,
})  # fmt: skip
LayoutTable = _union_of({
    "row": _row, "grid": arrays.grid_positions, "triangular": arrays.triangular_positions,
    "rings": arrays.ring_positions,
})  # fmt: skip
WeightTable = _union_of({
    "window": arrays.window_weights, "steering": arrays.steering_weights,
    "focusing": arrays.focusing_weights,
})  # fmt: skip
ShapeTable = _union_of({name: getattr(shapes, name) for name in shapes.__all__}, _Shape)


def called(table: Any, wavelength: float | None = None, **context: Any) -> Any:
    """Call the function of a table with its values.

    `wavelength`, in m, is used by a table without its own. `context` has the parameters that are no
    keys, for functions that have them.
    """
    function, values = _FUNCTIONS[type(table)], msgspec.structs.asdict(table)
    parameters = inspect.signature(function).parameters
    if "wavelength" in values:
        values["wavelength"] = wavelength_in(table, wavelength)
        if values["wavelength"] is None:
            raise FileFormatError(
                "expected a frequency or a wavelength, got none; give one with it or at the top of "
                "the file"
            )
        del values["frequency"]
    if "direction" in values:
        theta, phi = values.pop("theta"), values.pop("phi")
        if (values["direction"] is None) == (theta is None):
            got = "neither" if theta is None else "both"
            raise FileFormatError(f"expected a direction or the angle theta, got {got}")
        if phi is not None and (theta is None or context["dimension"] == 1):
            raise FileFormatError("expected phi only with theta, and not for slits")
        if theta is not None:
            values["direction"] = tapers.direction_of(theta, phi or 0.0)[: context["dimension"]]
    for key in {"amplitudes", "coefficients"} & set(values):
        values[key] = complex_numbers(values[key], 1 if values.get("height") is None else 2)
    if "shape" in parameters and context["shape"] is None:
        raise FileFormatError(
            "expected positions of kind row, grid or triangular for a window, got others"
        )
    return function(**values, **{key: value for key, value in context.items() if key in parameters})


def product_of(key: str, tables: Any, wavelength: float | None, **context: Any) -> Any:
    """The product of the objects of a table or of a list of tables."""
    factors = []
    for k, table in enumerate(tables if isinstance(tables, list) else [tables]):
        with at_key(f"{key}[{k}]" if isinstance(tables, list) else key):
            factors.append(called(table, wavelength, **context))
    return functools.reduce(operator.mul, factors)


# Errors of msgspec as errors of the package.

_WORDS = {
    "object": "table", "array": "list", "str": "text", "int": "whole number", "float": "number",
    "bool": "true or false",
}  # fmt: skip


def converted(table: Any, kind: Any, strict: bool = True) -> Any:
    """A table as an object of the schema; FileFormatError with the path of a wrong key or value.

    Numbers may be texts if not strict.
    """
    try:
        hook: Any = lambda kind, value: kind(_PARSERS[kind](value))  # noqa: E731
        return msgspec.convert(table, kind, strict=strict, dec_hook=hook)
    except msgspec.ValidationError as error:
        raise FileFormatError(_explained(str(error), table, kind)) from None


def tables_of(kind: Any) -> list[Any]:
    """The tables that a type consists of."""
    if isinstance(kind, type) and issubclass(kind, Table):
        return [kind]
    return [table for part in getattr(kind, "__args__", ()) for table in tables_of(part)]


def _explained(message: str, value: Any, kind: Any) -> str:
    """The message of a msgspec error with the path, the accepted values and the wrong one."""
    text, _, path = message.partition(" - at `$")
    path = path.strip(".`")
    steps = re.findall(r"([^.\[\]]+)|\[(\d+)\]", path)
    is_tag = text.startswith("Invalid value")
    for name, index in steps[:-1] if is_tag else steps:
        if name not in ("", "kind", "name"):
            fields = msgspec.structs.fields(_table_for(value, kind))
            kind = next(field.type for field in fields if field.encode_name == name)
        value = value[name or int(index)]
    tables = {table.__struct_config__.tag: table for table in tables_of(kind)}
    wrong_key = text.rstrip("`").rpartition("`")[2]
    if is_tag:
        text = _expected("one of", list(tables), value[steps[-1][0]])
    elif text.startswith("Object missing"):
        choice = f", one of {', '.join(tables)}" if wrong_key in ("kind", "name") else ""
        text = f"expected the key {wrong_key!r}{choice}, got none"
    elif text.startswith("Object contains unknown"):
        table = _table_for(value, kind)
        tag = table.__struct_config__.tag_field
        keys = [*([tag] if tag else []), *table.__struct_fields__]
        text = _expected("the keys", keys, wrong_key)
    elif text.startswith("Expected"):
        text = re.sub(r", got .*| \| null|`", "", text).replace(" | ", " or ")
        text = re.sub(r"\w+", lambda word: _WORDS.get(word[0], word[0]), text)
        text = f"{text.lower()}, got {value_text(value)}"
    return f"{path}: {text}" if path else text


def _table_for(value: dict[str, Any], kind: Any) -> Any:
    """The table of a type that a dictionary with a valid tag stands for."""
    configs = ((table, table.__struct_config__) for table in tables_of(kind))
    return next(table for table, config in configs if value.get(config.tag_field) == config.tag)


def _expected(what: str, names: list[str], got: Any) -> str:
    """A message that lists known names and suggests the one nearest to the wrong one."""
    near = difflib.get_close_matches(str(got), names, 1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"expected {what} {', '.join(names)}, got {value_text(got)}{hint}"


# Short texts, which stand for a table each. Groups of the patterns are keys of the table.

SOURCE_TEXTS = ("taper", "array", "window", "steering", "focus", "curved", "coherence")
"""Names of the texts of :func:`apply_texts`."""

_SIDELOBES = r"(?: +(?P<sll>[\d.]+) *dB(?: +(?P<nbar>\d{1,3}))?)?"
_AXIS = r"(?: +(?P<axis>[xy]))?"
_LATTICE = r"(?P<nx>\d{1,7}) *[x×] *(?P<ny>\d{1,7}) *,(?P<pitch_x>[^,]+)(?:,(?P<pitch_y>[^,]+))?"

_PATTERNS: dict[str, dict[str, str]] = {
    "taper": {
        "cosine_taper": r"cosine(?: *(?P<power>\d{1,2}))?" + _AXIS,
        "taylor_taper": "taylor" + _SIDELOBES + _AXIS,
        "te_mode": r"te(?P<m>\d)(?P<n>\d)",
    },
    "array": {"grid": _LATTICE, "triangular": "triangular +" + _LATTICE},
    "window": {"window": "(?P<window>[a-z]+)" + _SIDELOBES},
}
_EXPECTED = {
    "taper": 'a taper such as "cosine", "cosine 2 x", "te10", "taylor 30 dB"',
    "array": 'an array such as "12 x 16, 2 mm" or "triangular 12 x 16, 2 mm, 1.9 mm"',
    "window": 'a window such as "taylor 25 dB" or "hamming"',
}


def _table(name: str, text: str) -> dict[str, Any]:
    """The table of a source file that a text stands for."""
    if name == "steering":
        return {"kind": name, **dict(zip(("theta", "phi"), direction_angles(text), strict=True))}
    if name == "focus":
        return {"kind": "focusing", "point": [part.strip() for part in text.split(",")]}
    written = text.strip() if name == "array" else text.strip().lower()
    for kind, pattern in _PATTERNS[name].items():
        match = re.fullmatch(pattern, written, re.IGNORECASE)
        if match is not None:
            groups = match.groupdict().items()
            return {"kind": kind, **{key: value for key, value in groups if value is not None}}
    raise QuantityError(f"expected {_EXPECTED[name]}, got {value_text(text)}")


def apply_texts(source: Any, texts: Mapping[str, str], wavelength: float | None) -> Any:
    """Return a source with the field, the copies, the weights and the wave that texts describe.

    Lengths without a unit are in metres, angles in radians. Errors begin with the name of the text:
    QuantityError or FileFormatError for a text that cannot be read, ArgumentError for one that does
    not fit the source.

    Parameters
    ----------
    source
        An Aperture; with `steering`, `focus`, `curved` and `coherence` also a phased array.
    texts
        Texts by their names, :data:`SOURCE_TEXTS`; docs/source_files.md has their grammar.
    wavelength
        Wavelength in metres, for steering, focus and curved waves.
    """
    if "window" in texts and "array" not in texts:
        raise ArgumentError("window: expected an array for it, got none; give array as well")
    shape = None
    for name in SOURCE_TEXTS:
        if name not in texts:
            continue
        text, got = texts[name], type(source).__name__
        with at_key(name):
            if name in ("taper", "array") and not isinstance(source, Aperture):
                raise ArgumentError(
                    f"expected an aperture for it, got {got}; write it into the source file"
                )
            if name in ("curved", "coherence") and not isinstance(source, TakesWaves):
                raise ArgumentError(f"expected an aperture, slits or an array for it, got {got}")
            if name == "taper":
                source = _tapered(source, _table(name, text))
            elif name == "array":
                layout = converted(_table(name, text), LayoutTable, strict=False)
                source, shape = phased_array(source, called(layout)), (layout.nx, layout.ny)
            elif name == "curved":
                source = _curved(source, text, wavelength)
            elif name == "coherence":
                source = source.partially_coherent(quantities.parse_length(text))
            else:
                source = _weighted(source, _table(name, text), wavelength, shape)
    return source


def _tapered(aperture: Aperture, table: dict[str, Any]) -> Aperture:
    xmin, ymin, xmax, ymax = aperture.bounds
    sizes = {"width": xmax - xmin, "height": ymax - ymin}
    axis = table.pop("axis", None)
    if axis is not None:
        del sizes["height" if axis == "x" else "width"]
    if table.get("m") == "0":
        table["component"] = "x"
    field = called(converted(table | sizes, FieldTable, strict=False), dimension=2)
    return _times(aperture, field.moved(aperture.centre))


def _times(aperture: Aperture, field: Illumination) -> Aperture:
    """An aperture whose field is multiplied by another."""
    other: Any = aperture.illumination
    return aperture.with_illumination(field if other is None else other * field)


def _weighted(source: Any, table: dict[str, Any], wavelength: float | None, shape: Any) -> Any:
    """An array with further weights, or an aperture that is steered by its field."""
    if isinstance(source, Aperture) and table["kind"] == "steering":
        return _times(source, called(converted(table, FieldTable), wavelength, dimension=2))
    if not isinstance(source, Array) or source.repeated is None:
        kind = "curved wave" if isinstance(source, Wavefront) else type(source).__name__
        raise ArgumentError(
            f"expected an array of equal elements with a flat wave, got {kind}; give array as "
            "well, or write it into the source file"
        )
    element, positions = source.repeated
    weights = converted(table, WeightTable, strict=False)
    factor = called(weights, wavelength, positions=positions, shape=shape, dimension=2)
    return repeated_element(element, positions, source.weights * factor)


def _curved(source: Any, text: str, wavelength: float | None) -> Wavefront:
    """A source with a curved wave about the centre of its bounds."""
    if wavelength is None:
        raise ArgumentError("expected a frequency or a wavelength with it, got none")
    radii = [radius_of(part.strip()) for part in text.split(",")]
    low, high = np.reshape(source.bounds, (2, -1))
    wave: Wavefront = source.curved(radii, wavelength, (low + high) / 2)
    return wave


def direction_angles(text: str) -> tuple[float, float]:
    """Theta, from 0, and phi in rad of "20 deg" or "20 deg, 90 deg"; else QuantityError."""
    theta, *phi = (quantities.parse_angle(part.strip()) for part in text.split(","))
    if len(phi) > 1 or not abs(theta) < math.pi / 2:  # perhaps degrees without a unit
        raise QuantityError(
            'expected a direction such as "20 deg" or "20 deg, 90 deg", within 90 deg of the '
            f"normal, got {value_text(text)}; write degrees with their unit"
        )
    if theta == 0:
        return 0.0, 0.0
    return abs(theta), (sum(phi) + (math.pi if theta < 0 else 0.0)) % (2 * math.pi)
