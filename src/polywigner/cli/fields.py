"""Commands for fields: the places and methods of their texts, samples, and files of the values."""

from __future__ import annotations

import json
import math
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from polywigner.cli.output import check_writable
from polywigner.errors import ArgumentError, QuantityError, value_text
from polywigner.quantities import parse_angle, parse_coordinate, parse_length

if TYPE_CHECKING:
    from polywigner import Aperture
    from polywigner import Array as ApertureArray


_FORMATS = ("nc", "zarr", "vti")


def format_suffixes(formats: Sequence[str], known: Sequence[str] = _FORMATS) -> tuple[str, ...]:
    """Suffixes of the files of values, each once; by default those of fields."""
    for name in formats:
        if name not in known:
            raise ArgumentError(f"--format: expected one of {', '.join(known)}, got {name!r}")
    return tuple(f".{name}" for name in dict.fromkeys(formats))


# Attributes of a store of fields.
_OF_FIELDS = {"wavelength", "frequency", "source"}


def check_files(files: Sequence[Path]) -> None:
    """Fail before the long work rather than after it: where one of the files cannot be written.

    A store of an earlier run is replaced, as a file is; one that `polywigner volume` fills chunk by
    chunk is not, for it may have taken hours."""
    check_writable([path for path in files if not (path.suffix == ".zarr" and path.is_dir())])
    for path in files:
        if path.suffix == ".zarr" and os.path.lexists(path) and not _is_written_whole(path):
            raise ArgumentError(
                f"expected {path} to be free, or a store that an earlier `polywigner propagate` "
                "wrote, got something else there; choose another name with --out"
            )


def _is_written_whole(store: Path) -> bool:
    from polywigner.geometry.io.limits import bytes_of

    try:
        attrs = json.loads(bytes_of(store / "zarr.json"))["attributes"]
        return attrs.keys() >= _OF_FIELDS and "written" not in attrs
    except (OSError, ValueError, KeyError, TypeError):
        return False


# Fewest samples, for a smooth picture, and most, for a short wait: a factor of four in time.
_FEWEST = {"line": (401,), "arc": (321,), "plane": (129, 129), "hemisphere": (61, 120)}
_MOST = {"line": (1601,), "arc": (1281,), "plane": (257, 257), "hemisphere": (121, 240)}
_FEWEST_OF_BOX, _MOST_OF_BOX = (64,) * 3, (101,) * 3


def samples_of_place(
    source: Aperture | ApertureArray, place: Place, wavelength: float, amplitude: bool
) -> tuple[int, ...]:
    """Samples along each axis of a place: as given, else as many as its field needs, within bounds.

    A warning says where the bounds are too narrow.
    """
    import polywigner as pw

    if place.shape:
        return place.shape
    where = {"line": {"line": place.points}, "plane": {"box": place.points}}
    region: Any = where.get(place.kind, {"radius": place.radius})
    quantity: Any = "amplitude" if amplitude else "irradiance"
    axes = pw.suggest_sampling(source, wavelength, quantity, **region).axes
    if place.kind in where:
        needed = [axis.count for axis in axes if axis.high > axis.low]
    else:
        theta, phi = axes
        steps = place.reach / theta.high * (theta.count - 1)
        if place.kind == "arc":
            needed = [math.ceil(2 * steps) + 1]
        else:
            needed = [math.ceil(steps) + 1, phi.count - 1]
    return _within("--samples", needed, _FEWEST[place.kind], _MOST[place.kind])


def samples_of_box(
    source: Aperture | ApertureArray, corners: tuple[Point, Point], wavelength: float
) -> tuple[int, ...]:
    """Along x, y and z of a box, as many as the irradiance needs, within bounds."""
    import polywigner as pw

    axes = pw.suggest_sampling(source, wavelength, "irradiance", box=corners).axes
    return _within("--shape", [axis.count for axis in axes], _FEWEST_OF_BOX, _MOST_OF_BOX)


def _within(
    option: str, needed: list[int], fewest: tuple[int, ...], most: tuple[int, ...]
) -> tuple[int, ...]:
    chosen = tuple(
        min(max(n, low), high) for n, low, high in zip(needed, fewest, most, strict=True)
    )
    if any(n > high for n, high in zip(needed, most, strict=True)):
        text = " x ".join(map(str, map(max, needed, chosen)))
        warnings.warn(
            f"{' x '.join(map(str, chosen))} samples miss fringes of this field: "
            f'{option} "{text}" would show all, or look at a smaller region',
            RuntimeWarning,
            stacklevel=3,
        )
    return chosen


class MethodText(NamedTuple):
    """A method with its settings; ``name`` tells it from the others of a run."""

    name: str
    method: str
    obliquity: str | None

    @property
    def options(self) -> dict[str, Any]:
        """The argument that :func:`polywigner.line` and its like take for it."""
        if self.method != "wigner":
            return {"method": self.method}
        return {"method": self.method, "obliquity": self.obliquity}


def parse_methods(texts: Sequence[str], obliquity: str | None) -> tuple[MethodText, ...]:
    """Methods, of wigner rays perhaps with an obliquity: ``"wigner kirchhoff"``."""
    methods = tuple(_method(text, obliquity) for text in texts)
    names = [method.name for method in methods]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ArgumentError(f"--method: expected different methods, got {twice[0]!r} twice")
    return methods


def _method(text: str, obliquity: str | None) -> MethodText:
    from polywigner.illumination.obliquities import OBLIQUITIES
    from polywigner.propagation import METHODS

    methods, obliquities, words = ("wigner", *METHODS), tuple(OBLIQUITIES), text.split()
    method = words[0] if words else ""
    if method not in methods:
        raise ArgumentError(
            f"--method: expected one of {', '.join(methods)}, got {value_text(text)}"
        )
    for word in words[1:]:
        if method != "wigner" or word not in obliquities:
            raise ArgumentError(
                "--method: expected words after wigner only, an obliquity "
                f"({', '.join(obliquities)}), got {value_text(text)}"
            )
        obliquity = word
    return MethodText("-".join(words), method, obliquity)


def compared_with(wanted: Sequence[MethodText], against: str | None) -> str:
    """The name of the method that the others are compared with: by default the last exact one."""
    names = [method.name for method in wanted]
    if against is not None:
        name = "-".join(against.split())
        if name not in names:
            raise ArgumentError(
                f"--against: expected one of the methods, {', '.join(names)}, got {against!r}"
            )
        return name
    exact = [m.name for m in wanted if m.method not in ("wigner", "fresnel", "fraunhofer")]
    return (exact or names)[-1]


def print_differences(fields: Mapping[str, Any], reference: str) -> None:
    """One line for each method, of its largest and its rms difference from the reference.

    ``fields`` : name -> xarray.DataArray, all over the same points; lazy ones are read by chunks.
    """
    from polywigner.figures.levels import COMPARED_DB, summary

    print(f"Differences from {reference}, where it is above {COMPARED_DB:g} dB of its peak, in dB:")
    width = max(len(name) for name in fields)
    print(f"  {'method':{width}}  largest      rms  points")
    for name in (name for name in fields if name != reference):
        apart = summary(fields[name], fields[reference])
        left = f", {apart.negative} not above zero left out" if apart.negative else ""
        numbers = f"{apart.largest:+7.3f}  {apart.rms:7.4f}  {apart.points} of {fields[name].size}"
        print(f"  {name:{width}}  {numbers}{left}")


Point = tuple[float, float, float]

_LONGEST = 200
_WIDEST = 80.0  # degrees from the axis, of an arc that does not say
_GRAZING = math.radians(89.5)  # of a hemisphere, as where suggested samples end
_MOST_POINTS = 1 << 26  # half a gigabyte for each method
_DIMENSIONS = {"line": 1, "arc": 1, "plane": 2, "hemisphere": 2}


class Place(NamedTuple):
    """Where a field is wanted: of a line ``points``; of an arc or hemisphere lists of angles.

    ``kind`` is "line", "arc", "plane" or "hemisphere"; ``shape`` is empty where nothing was said.
    """

    kind: str
    points: tuple[Point, ...]
    shape: tuple[int, ...]
    radius: float = 0.0
    phi: float = 0.0
    reach: float = 0.0


def place_text(place: Place) -> str:
    """Where a field is, as a picture says it."""
    from polywigner.figures.style import number_text
    from polywigner.geometry.display import length_unit

    values = [abs(value) for point in place.points for value in point]
    unit = length_unit(max(values, default=place.radius))

    def printed(*lengths: float) -> str:
        return ", ".join(number_text(float(f"{x / unit.metres:.4g}")) for x in lengths)

    if place.kind == "line":
        start, end = (f"({printed(*point)})" for point in place.points)
        return f"line from {start} to {end} {unit.name}"
    if place.kind == "plane":
        first, last = place.points
        fixed = next(k for k in range(3) if first[k] == last[k])
        return f"plane {'xyz'[fixed]} = {printed(first[fixed])} {unit.name}"
    cut = f", φ = {number_text(float(f'{math.degrees(place.phi):.4g}'))}°"
    return f"{place.kind} of radius {printed(place.radius)} {unit.name}" + (
        cut if place.kind == "arc" else ""
    )


def parse_place(texts: Mapping[str, str | None], samples: str | None) -> Place:
    """The one place among the texts of ``line``, ``arc``, ``plane`` and ``hemisphere``."""
    given = {name: text for name, text in texts.items() if text is not None}
    if len(given) != 1:
        got = " and ".join(f"--{name}" for name in given) or "none"
        raise ArgumentError(
            f"expected one of {', '.join(f'--{name}' for name in texts)}, got {got}; say where the "
            "field is wanted"
        )
    ((kind, text),) = given.items()
    shape = () if samples is None else parse_shape("--samples", samples, _DIMENSIONS[kind])
    if shape and min(shape) < 2:
        raise ArgumentError(
            f"--samples: expected two or more along each axis, got {value_text(samples)}; "
            "one point makes no picture"
        )
    if math.prod(shape) > _MOST_POINTS:
        raise ArgumentError(
            f"--samples: expected at most {_MOST_POINTS} points, got {math.prod(shape)}; use "
            "`polywigner volume`, which writes to disk"
        )
    try:
        return _PARSERS[kind](text, shape)
    except QuantityError as error:
        raise QuantityError(f"--{kind}: {error}") from None


def _line(text: str, shape: tuple[int, ...]) -> Place:
    ends = _split(text, r"\s+to\s+")
    if len(ends) != 2:
        raise QuantityError(
            'expected two points such as "0 mm, 0 mm, 2 mm to 0 mm, 0 mm, 150 mm", got '
            f"{value_text(text)}"
        )
    return Place("line", tuple(_point(end) for end in ends), shape)


def _arc(text: str, shape: tuple[int, ...]) -> Place:
    parts = _split(text, ",")
    if not 1 <= len(parts) <= 3:
        raise QuantityError(
            'expected a distance such as "50 mm", and perhaps two angles, as in "50 mm, 45 deg, '
            f'80 deg", got {value_text(text)}'
        )
    phi, reach = (parse_angle(a) for a in (*parts[1:], "0 deg", f"{_WIDEST:g} deg")[:2])
    if len(parts) == 2:
        reach = math.radians(_WIDEST)
    if not 0 < reach < math.pi / 2:
        raise QuantityError(
            f"expected a largest angle between 0 and 90 deg, got {value_text(text)}; write degrees "
            'with their unit, such as "80 deg"'
        )
    return Place("arc", (), shape, _length(parse_length(parts[0]), parts[0]), phi, reach)


def _plane(text: str, shape: tuple[int, ...]) -> Place:
    low, high, ranges = _ranges(text)
    if ranges != 2:
        raise QuantityError(
            'expected two ranges and a coordinate such as "-30 mm to 30 mm, -30 mm to 30 mm, '
            f'90 mm", got {value_text(text)}'
        )
    return Place("plane", (low, high), shape)


def _hemisphere(text: str, shape: tuple[int, ...]) -> Place:
    return Place("hemisphere", (), shape, _length(parse_length(text), text), 0.0, _GRAZING)


_PARSERS = {"line": _line, "arc": _arc, "plane": _plane, "hemisphere": _hemisphere}


def parse_box(text: str) -> tuple[Point, Point]:
    """The lowest and the highest corner of a box given by three ranges."""
    try:
        low, high, ranges = _ranges(text)
        if ranges != 3:
            raise QuantityError(
                'expected three ranges such as "-30 mm to 30 mm, -30 mm to 30 mm, 2 mm to 120 mm", '
                f"got {value_text(text)}"
            )
    except QuantityError as error:
        raise QuantityError(f"--box: {error}") from None
    return low, high


def _ranges(text: str) -> tuple[Point, Point, int]:
    """Both ends along x, y and z, and how many of them differ."""
    parts = _split(text, ",")
    if len(parts) != 3:
        raise QuantityError(f"expected x, y and z, separated by commas, got {value_text(text)}")
    ends = []
    for part in parts:
        ends.append([_length(parse_coordinate(e), e) for e in _split(part, r"\s+to\s+")])
        if len(ends[-1]) > 2 or (len(ends[-1]) == 2 and not ends[-1][0] < ends[-1][1]):
            raise QuantityError(
                f'expected a coordinate, or a rising range such as "-30 mm to 30 mm", got '
                f"{value_text(part)}"
            )
    low = (ends[0][0], ends[1][0], ends[2][0])
    high = (ends[0][-1], ends[1][-1], ends[2][-1])
    return low, high, sum(len(pair) for pair in ends) - 3


def parse_shape(option: str, text: str, dimensions: int) -> tuple[int, ...]:
    """Whole numbers above zero, as many as dimensions: ``"64 x 64 x 96"``."""
    parts = _split(text, "[x×]")
    if len(parts) != dimensions or not all(re.fullmatch(r"0*[1-9][0-9]{0,8}", p) for p in parts):
        example = " x ".join(("64", "64", "96")[:dimensions])
        raise ArgumentError(
            f'{option}: expected samples such as "{example}", got {value_text(text)}'
        )
    return tuple(int(part) for part in parts)


def parse_levels(option: str, text: str) -> tuple[float, ...]:
    """Numbers of decibels, separated by commas, with or without "dB"."""
    levels = []
    for part in _split(text, ","):
        match = re.fullmatch(r"([+-]?[0-9]{1,4}(?:\.[0-9]{0,6})?)(?:\s*dB)?", part)
        if match is None:
            raise QuantityError(
                f'{option}: expected levels such as "-6, -12, -18", got {value_text(text)}'
            )
        levels.append(float(match[1]))
    return tuple(levels)


def _point(text: str) -> Point:
    parts = _split(text, ",")
    if len(parts) != 3:
        raise QuantityError(f'expected a point such as "0 mm, 0 mm, 80 mm", got {value_text(text)}')
    x, y, z = (_length(parse_coordinate(part), part) for part in parts)
    return x, y, z


def _length(length: float, text: str) -> float:
    """One that grids take."""
    from polywigner.propagation.places import LARGEST

    if not abs(length) <= LARGEST:
        raise QuantityError(f"expected lengths of at most {LARGEST:g} m, got {value_text(text)}")
    return length


def _split(text: str, pattern: str) -> list[str]:
    if len(text) > _LONGEST:
        raise QuantityError(f"expected up to {_LONGEST} characters, got {value_text(text)}")
    return [part.strip() for part in re.split(pattern, text)]
