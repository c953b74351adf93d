"""Outlines of the elements of an SVG file: lengths, transforms, path data, viewports."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fractions import Fraction
from importlib import import_module
from typing import Any

import numpy as np

from polywigner.errors import FileFormatError
from polywigner.geometry.io.curves import Arc, Bezier, Curve, Points, sampled

# svgelements skips what does not follow this grammar. Possessive quantifiers bound the time.
_NUMBER = r"[+-]?(?>[0-9]++\.?[0-9]*+|\.[0-9]++)(?:[eE][+-]?[0-9]++)?+"
_COMMA = r"(?>\s*+,\s*+|\s*+)"
_LENGTH = re.compile(rf"\s*+({_NUMBER})(%|\w*+)\s*+")
_LIST = re.compile(rf"\s*+(?:{_NUMBER}{_COMMA})*+")
_TRANSFORM = re.compile(
    r"(?:\s*+(?:matrix|translate|scale|rotate|skew[XY])"
    rf"\s*+\(\s*+(?:{_NUMBER}{_COMMA})++\)\s*+,?+)*+\s*+"
)
_N = _NUMBER.replace(r"\.?[0-9]*+", r"(?:\.[0-9]++)?+") + _COMMA  # without "5."
_PATH = re.compile(
    rf"\s*+(?:(?=[Mm])(?:[MmLlTt]\s*+(?:(?:{_N}){{2}})++|[HhVv]\s*+(?:{_N})++"
    rf"|[Cc]\s*+(?:(?:{_N}){{6}})++|[SsQq]\s*+(?:(?:{_N}){{4}})++"
    rf"|[Aa]\s*+(?:(?:{_N}){{3}}(?:[01]{_COMMA}){{2}}(?:{_N}){{2}})++|[Zz]\s*+)++)?+"
)

PIXEL = Fraction(254, 960_000)
"""Metres per CSS pixel, 1/96 inch."""

_SIZES = {
    "mm": Fraction(1, 1000), "cm": Fraction(1, 100), "Q": Fraction(1, 4000),
    "in": Fraction(254, 10_000), "pt": Fraction(254, 720_000), "pc": Fraction(254, 60_000),
}  # fmt: skip

SHAPES = frozenset({"path", "rect", "circle", "ellipse", "polygon", "polyline"})
"""Elements with an inside."""

Viewport = tuple[float | None, float | None]
"""Width and height of 100 %, where they are known."""
Affine = tuple[Points, Points]
"""Matrix (2, 2) and offset (2,) of p -> p @ matrix + offset."""


def refusal(what: str, text: str) -> FileFormatError:
    """Return the error for an attribute."""
    shown = repr(text if len(text) <= 60 else text[:60] + "...")
    return FileFormatError(f"expected {what}, got {shown}; correct it")


def _split_length(text: str, name: str) -> tuple[str, str]:
    match = _LENGTH.fullmatch(text)
    if match is None or match[2] not in ("", "px", "%", *_SIZES):
        raise refusal(f"the {name} as a length in px, mm, cm, Q, in, pt or pc", text)
    return match[1], match[2]


def length(text: str, name: str, reference: float | None) -> float:
    """Return a length in user units; `reference` is the length of 100 %, if known."""
    number, unit = _split_length(text, name)
    if unit != "%":
        return float(number) * float(_SIZES.get(unit, PIXEL) / PIXEL)
    if reference is None:
        raise refusal(f"the {name} in units, since the drawing has no viewBox", text)
    return float(number) / 100 * reference


def physical_length(text: str, name: str) -> Fraction | None:
    """Return the metres of a width such as "20mm"; None if it states no size (px, %)."""
    number, unit = _split_length(text, name)
    if not 0 < float(number) < math.inf:
        raise refusal(f"the {name} above zero", text)
    return Fraction(number) * _SIZES[unit] if unit in _SIZES else None


def _numbers_of(text: str, name: str) -> list[float]:
    if not _LIST.fullmatch(text):
        raise refusal(f"{name} as numbers", text)
    return [float(number) for number in re.findall(_NUMBER, text)]


def affine_of(text: str) -> Affine:
    """Return the map of a transform attribute."""
    try:
        matrix = import_module("svgelements").Matrix(_TRANSFORM.fullmatch(text)[0])  # type: ignore[index]
        values = [float(getattr(matrix, letter)) for letter in "abcdef"]
    except (ValueError, IndexError, TypeError):  # no match, or too few arguments
        raise refusal("a transform such as translate(10 5) rotate(45)", text) from None
    return np.array(values[:4]).reshape(2, 2), np.array(values[4:])


def view_box(element: Any) -> tuple[float, float, float, float] | None:
    """Return x, y, width and height of the viewBox of an element that has one."""
    text = element.get("viewBox")
    if text is None:
        return None
    values = _numbers_of(text, "the viewBox")
    if len(values) != 4 or not np.isfinite(values).all() or min(values[2:]) <= 0:
        raise refusal("a viewBox of four numbers, the last two above zero", text)
    return values[0], values[1], values[2], values[3]


def fitted(fit: str, box: tuple[float, ...], size: tuple[float, float]) -> Affine:
    """Return the map of a viewBox into a viewport of this size, by preserveAspectRatio."""
    scale = np.array(size) / box[2:]
    words = fit.split()
    align = next((word for word in words if word[0] in "xn"), "xMidYMid")
    if align != "none":
        scale[:] = scale.max() if "slice" in words else scale.min()
    fractions = {"Min": 0.0, "Max": 1.0}
    free = [fractions.get(align[1:4], 0.5), fractions.get(align[5:8], 0.5)]
    return np.diag(scale), free * (size - scale * box[2:]) - scale * box[:2]


def _subpaths(path: Any) -> list[list[Curve]]:
    """Return the subpaths of an svgelements path, closed by a line, as a fill closes them."""
    subpaths: list[list[Curve]] = []
    for segment in path:
        # After a Z without an M, the next subpath starts at the same point.
        if type(segment).__name__ in ("Move", "Close"):
            subpaths.append([])
        else:
            subpaths[-1].append(_curve(segment))
    return [_closed(subpath) for subpath in subpaths if subpath]


def _closed(subpath: list[Curve]) -> list[Curve]:
    start, end = sampled(subpath[0])[0], sampled(subpath[-1])[-1]
    return subpath if (start == end).all() else [*subpath, np.array([end, start])]


def _curve(segment: Any) -> Curve:
    kind = type(segment).__name__
    controls = {"QuadraticBezier": ["control"], "CubicBezier": ["control1", "control2"]}
    names = ["start", *controls.get(kind, ()), "end"]
    points = np.array([(p.x, p.y) for p in map(segment.__getattribute__, names)], dtype=float)
    if kind in controls:
        return Bezier(points)
    is_arc = kind == "Arc" and segment.rx and segment.ry and segment.sweep
    if not is_arc or (points[0] == points[1]).all():
        return points
    ends = (segment.center, segment.prx, segment.pry)
    centre, u, v = np.array([(p.x, p.y) for p in ends], dtype=float)
    return Arc(centre, u - centre, v - centre, segment.get_start_t(), segment.sweep)


def outlines_of(tag: str, attributes: Mapping[str, str], viewport: Viewport) -> list[list[Curve]]:
    """Return the closed outlines of a shape; percentages are of the viewport."""

    def value(name: str, axis: int | None = None, least: float = -math.inf) -> float:
        known = [side for side in viewport if side is not None]
        mean = math.hypot(*known) / math.sqrt(2) if len(known) == 2 else None
        number = length(attributes.get(name, "0"), name, mean if axis is None else viewport[axis])
        if not least <= number < math.inf:
            raise FileFormatError(f"expected a finite {name} from zero up, got {number:g}")
        return number

    library = import_module("svgelements")
    if tag == "path":
        data = attributes.get("d", "")
        if not _PATH.fullmatch(data):
            raise refusal("path data that starts with M and follows SVG 2", data)
        return _subpaths(library.Path(data))
    if tag in ("polygon", "polyline"):
        values = _numbers_of(attributes.get("points", ""), "the points")
        if len(values) % 2:
            raise FileFormatError("expected points as pairs of numbers, got an odd number of them")
        return [_closed([np.array(values).reshape(-1, 2)])] if values else []
    names = ("r", "r") if tag == "circle" else ("rx", "ry")
    rx, ry = (
        None if attributes.get(name, "auto").strip() == "auto"
        else value(name, None if name == "r" else axis, 0.0)
        for axis, name in enumerate(names)
    )  # fmt: skip
    if tag == "rect":
        sides = [value("width", 0, 0.0), value("height", 1, 0.0)]
        rectangle = library.Rect(value("x", 0), value("y", 1), *sides, rx, ry)
        return _subpaths(library.Path(rectangle)) if all(sides) else []
    x, y = ry if rx is None else rx, rx if ry is None else ry
    centre = np.array([value("cx", 0), value("cy", 1)])
    return [[Arc(centre, np.array([x, 0.0]), np.array([0.0, y]))]] if x and y else []
