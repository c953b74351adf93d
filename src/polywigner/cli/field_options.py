"""Options of commands for fields: points and methods as texts, samples, and files of the values."""

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


def suffixes_of(formats: Sequence[str]) -> tuple[str, ...]:
    """Return the suffixes of the files of values, each once."""
    return tuple(f".{name}" for name in dict.fromkeys(formats))


# Attributes of a store of fields.
_OF_FIELDS = {"wavelength", "frequency", "source"}


def check_files(files: Sequence[Path]) -> None:
    """Raise ArgumentError before the work if one of the files cannot be written.

    A store of an earlier `polywigner propagate` is replaced like a file. A store of `polywigner
    volume` is not, because its computation can take hours.
    """
    check_writable([path for path in files if not (path.suffix == ".zarr" and path.is_dir())])
    for path in files:
        if path.suffix == ".zarr" and os.path.lexists(path) and not _is_of_propagate(path):
            raise ArgumentError(
                f"{path} is not a store of an earlier `polywigner propagate`; choose another name "
                "with --out"
            )


def _is_of_propagate(store: Path) -> bool:
    from polywigner.geometry.io.limits import bytes_of

    try:
        attrs = json.loads(bytes_of(store / "zarr.json"))["attributes"]
        return attrs.keys() >= _OF_FIELDS and "written" not in attrs
    except (OSError, ValueError, KeyError, TypeError):
        return False


# Fewest samples, for a smooth figure, and most, for a short wait: a factor of four in time.
_FEWEST = {"line": (401,), "arc": (321,), "plane": (129, 129), "hemisphere": (61, 120)}
_MOST = {"line": (1601,), "arc": (1281,), "plane": (257, 257), "hemisphere": (121, 240)}
_FEWEST_OF_BOX, _MOST_OF_BOX = (64,) * 3, (101,) * 3


def samples_of_place(
    source: Aperture | ApertureArray, place: Place, wavelength: float, amplitude: bool
) -> tuple[int, ...]:
    """Return the requested samples along each axis, else the number that the field needs.

    The default number is bounded. A warning is issued if the bounds are too narrow.
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
        is_arc = place.kind == "arc"
        needed = [math.ceil(2 * steps) + 1] if is_arc else [math.ceil(steps) + 1, phi.count - 1]
    return _within("--samples", needed, _FEWEST[place.kind], _MOST[place.kind])


def samples_of_box(
    source: Aperture | ApertureArray, corners: tuple[Point, Point], wavelength: float
) -> tuple[int, ...]:
    """Return the samples along x, y and z of a box that the irradiance needs, within bounds."""
    import polywigner as pw

    axes = pw.suggest_sampling(source, wavelength, "irradiance", box=corners).axes
    return _within("--shape", [axis.count for axis in axes], _FEWEST_OF_BOX, _MOST_OF_BOX)


def _within(
    option: str, needed: list[int], fewest: tuple[int, ...], most: tuple[int, ...]
) -> tuple[int, ...]:
    chosen = tuple(map(min, map(max, needed, fewest), most))
    if any(map(int.__gt__, needed, most)):
        text = " x ".join(map(str, map(max, needed, chosen)))
        warnings.warn(
            f"{' x '.join(map(str, chosen))} samples miss fringes of this field: "
            f'{option} "{text}" would show all, or look at a smaller region',
            RuntimeWarning,
            stacklevel=3,
        )
    return chosen


class MethodText(NamedTuple):
    """A method with its settings; ``name`` distinguishes it from the others of a run."""

    name: str
    method: str
    obliquity: str | None

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of :func:`polywigner.line` and its like for the method."""
        if self.method != "wigner":
            return {"method": self.method}
        return {"method": self.method, "obliquity": self.obliquity}


def parse_methods(texts: Sequence[str], obliquity: str | None) -> tuple[MethodText, ...]:
    """Parse methods; "wigner" may have an obliquity of its own, as in ``"wigner kirchhoff"``."""
    methods = tuple(_method(text, obliquity) for text in texts)
    names = [method.name for method in methods]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ArgumentError(f"--method: expected different methods, got {twice[0]!r} twice")
    return methods


def _method(text: str, obliquity: str | None) -> MethodText:
    from polywigner.geometry.arguments import checked_choice
    from polywigner.propagation import METHODS
    from polywigner.source.obliquities import OBLIQUITIES

    method, _, of_wigner = text.partition(" ")
    checked_choice(method, "--method", ("wigner", *METHODS))
    if of_wigner:
        if method != "wigner":
            raise ArgumentError(f"--method: expected an obliquity after wigner only, got {text!r}")
        obliquity = checked_choice(of_wigner, f"the obliquity of --method {text!r}", OBLIQUITIES)
    return MethodText(text.replace(" ", "-"), method, obliquity)


def compared_with(wanted: Sequence[MethodText], against: str | None) -> str:
    """Return the name of the reference method, by default the last exact one."""
    from polywigner.geometry.arguments import checked_choice

    names = [method.name for method in wanted]
    if against is not None:
        return checked_choice(against.replace(" ", "-"), "--against", names)
    exact = [m.name for m in wanted if m.method not in ("wigner", "fresnel", "fraunhofer")]
    return (exact or names)[-1]


def print_differences(fields: Mapping[str, Any], reference: str) -> None:
    """Print the largest and the rms difference of each method from the reference.

    ``fields`` : name -> xarray.DataArray, all at the same points; lazy ones are read by chunks.
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

_WIDEST = 80.0  # degrees from the axis, default of an arc
_GRAZING = math.radians(89.5)  # of a hemisphere, as where suggested samples end
_MOST_POINTS = 1 << 26  # half a gigabyte for each method
_DIMENSIONS = {"line": 1, "arc": 1, "plane": 2, "hemisphere": 2}


class Place(NamedTuple):
    """Region of the field: of a line or plane ``points``; of an arc or hemisphere angles in rad.

    ``kind`` is "line", "arc", "plane" or "hemisphere"; ``shape`` is empty without --samples.
    """

    kind: str
    points: tuple[Point, ...]
    shape: tuple[int, ...]
    radius: float = 0.0
    phi: float = 0.0
    reach: float = 0.0


def place_text(place: Place) -> str:
    """Describe the region of a field for the title of a figure."""
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
    text = f"{place.kind} of radius {printed(place.radius)} {unit.name}"
    phi = number_text(float(f"{math.degrees(place.phi):.4g}"))
    return f"{text}, φ = {phi}°" if place.kind == "arc" else text


def parse_place(texts: Mapping[str, str | None], samples: str | None) -> Place:
    """Parse the requested region: a line, an arc, a plane or a hemisphere."""
    given = {name: text for name, text in texts.items() if text is not None}
    if len(given) != 1:
        got = " and ".join(f"--{name}" for name in given) or "none"
        raise ArgumentError(
            f"expected one of {', '.join(f'--{name}' for name in texts)}, got {got}; specify where "
            "the field is computed"
        )
    ((kind, text),) = given.items()
    shape = () if samples is None else parse_shape("--samples", samples, _DIMENSIONS[kind])
    if shape and min(shape) < 2:
        raise ArgumentError(f"--samples: expected two or more along each axis, got {samples!r}")
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
    distance, *angles = _split(text, ",")
    phi, reach = 0.0, math.radians(_WIDEST)
    if len(angles) > 2:
        raise QuantityError(
            'expected a distance such as "50 mm", and perhaps two angles, as in "50 mm, 45 deg, '
            f'80 deg", got {value_text(text)}'
        )
    if angles:
        phi, reach = (*map(parse_angle, angles), reach)[:2]
    if not 0 < reach < math.pi / 2:
        raise QuantityError(
            f"expected a largest angle between 0 and 90 deg, got {text!r}; write degrees "
            'with their unit, such as "80 deg"'
        )
    return Place("arc", (), shape, parse_length(distance), phi, reach)


def _plane(text: str, shape: tuple[int, ...]) -> Place:
    low, high, ranges = _ranges(text)
    if ranges != 2:
        raise QuantityError(
            'expected two ranges and a coordinate such as "-30 mm to 30 mm, -30 mm to 30 mm, '
            f'90 mm", got {text!r}'
        )
    return Place("plane", (low, high), shape)


def _hemisphere(text: str, shape: tuple[int, ...]) -> Place:
    return Place("hemisphere", (), shape, parse_length(text), 0.0, _GRAZING)


_PARSERS = {"line": _line, "arc": _arc, "plane": _plane, "hemisphere": _hemisphere}


def parse_box(text: str) -> tuple[Point, Point]:
    """Parse three ranges; return the lowest and the highest corner of the box."""
    try:
        low, high, ranges = _ranges(text)
        if ranges != 3:
            raise QuantityError(
                'expected three ranges such as "-30 mm to 30 mm, -30 mm to 30 mm, 2 mm to 120 mm", '
                f"got {text!r}"
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
        low, *high = map(parse_coordinate, _split(part, r"\s+to\s+"))
        if len(high) > 1 or (high and not low < high[0]):
            raise QuantityError(
                f'expected a coordinate, or a rising range such as "-30 mm to 30 mm", got {part!r}'
            )
        ends.append((low, *high))
    (x, y, z), ranges = ends, sum(len(pair) for pair in ends) - 3
    return (x[0], y[0], z[0]), (x[-1], y[-1], z[-1]), ranges


def parse_shape(option: str, text: str, dimensions: int) -> tuple[int, ...]:
    """Parse positive whole numbers, one for each dimension: ``"64 x 64 x 96"``."""
    parts = _split(text, "[x×]")
    if len(parts) != dimensions or not all(re.fullmatch(r"0*[1-9][0-9]{0,8}", p) for p in parts):
        example = " x ".join(("64", "64", "96")[:dimensions])
        raise ArgumentError(f'{option}: expected samples such as "{example}", got {text!r}')
    return tuple(int(part) for part in parts)


def parse_levels(option: str, text: str) -> tuple[float, ...]:
    """Parse numbers of decibels, separated by commas, with or without "dB"."""
    try:
        return tuple(float(part.strip().removesuffix("dB")) for part in text.split(","))
    except ValueError:
        raise QuantityError(
            f'{option}: expected levels such as "-6, -12, -18", got {text!r}'
        ) from None


def _point(text: str) -> Point:
    parts = _split(text, ",")
    if len(parts) != 3:
        raise QuantityError(f'expected a point such as "0 mm, 0 mm, 80 mm", got {text!r}')
    x, y, z = map(parse_coordinate, parts)
    return x, y, z


def _split(text: str, pattern: str) -> list[str]:
    return [part.strip() for part in re.split(pattern, text)]
