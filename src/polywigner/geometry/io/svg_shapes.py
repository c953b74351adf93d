"""Shapes of an SVG file as closed curves: lengths, transforms, path data, viewports."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from importlib import import_module
from typing import Any

import numpy as np

from polywigner.errors import FileFormatError
from polywigner.geometry.io.curves import Arc, Bezier, Curve, Points, ends, transformed
from polywigner.geometry.io.limits import LARGEST_NUMBER

# Possessive (++) and atomic (?>) throughout, so that no text takes longer than its length.
_NUMBER = r"(?>[+-]?(?:[0-9]++\.?[0-9]*+|\.[0-9]++)(?:[eE][+-]?[0-9]++)?)"
_COMMA = r"(?>\s*+,\s*+|\s*+)"
_LENGTH = re.compile(rf"\s*+({_NUMBER})(%|[a-zA-Z]*+)\s*+")
_LIST = re.compile(rf"\s*+(?:{_NUMBER}{_COMMA})*+")
_TRANSFORMS = re.compile(
    r"(?:\s*+(?:matrix|translate|scale|rotate|skew[XY])\s*+"
    rf"\(\s*+(?:{_NUMBER}{_COMMA})++\)\s*+,?+)*+\s*+"
)
_NUMBERS = re.compile(_NUMBER)
_COMMAND = re.compile(r"([MmZzLlHhVvCcSsQqTtAa])([^MmZzLlHhVvCcSsQqTtAa]*+)")
_ARC = rf"{_NUMBER}{_COMMA}" * 3 + rf"[01]{_COMMA}" * 2 + rf"{_NUMBER}{_COMMA}" * 2
_ARCS = re.compile(rf"\s*+(?:{_ARC})++")
_FLAGS = re.compile(_ARC)
_ARITY = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2}

PIXEL = Fraction(254, 960_000)
"""The metres of a CSS pixel, 1/96 inch."""

PHYSICAL = {
    "mm": Fraction(1, 1000), "cm": Fraction(1, 100), "Q": Fraction(1, 4000),
    "in": Fraction(254, 10_000), "pt": Fraction(254, 720_000), "pc": Fraction(254, 60_000),
}  # fmt: skip
"""The metres of the units that state a size."""

# Fraction("1e999999999") fills memory.
_LONGEST_NUMBER = 40


def _shown(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:60] + "...")


def _refuse(what: str, text: str) -> FileFormatError:
    return FileFormatError(f"expected {what}, got {_shown(text)}; correct it")


def _split_length(text: str, name: str) -> tuple[str, str]:
    match = _LENGTH.fullmatch(text)
    if match is None or len(match[1]) > _LONGEST_NUMBER:
        raise _refuse(f"{name} as a length such as 12.5mm", text)
    return match[1], match[2]


def length(text: str, name: str, reference: float | None) -> float:
    """Length in user units; `reference` is the length of 100 %, if known."""
    number, unit = _split_length(text, name)
    value = float(number)
    if unit == "%":
        if reference is None:
            raise _refuse(f"{name} in units, since the drawing has no viewBox", text)
        return value / 100 * reference
    if unit in PHYSICAL:
        return value * float(PHYSICAL[unit] / PIXEL)
    if unit in ("", "px"):
        return value
    raise _refuse(f"{name} in px, mm, cm, Q, in, pt or pc", text)


def physical_length(text: str, name: str) -> Fraction | None:
    """The metres of a width such as "20mm", above zero; None if it states no size (px, %)."""
    number, unit = _split_length(text, name)
    value = float(number)
    if not (0 < value < math.inf):
        raise _refuse(f"{name} above zero", text)
    if unit not in PHYSICAL:
        if unit not in ("", "px", "%"):
            raise _refuse(f"{name} in px, mm, cm, Q, in, pt or pc", text)
        return None
    if abs(math.log10(value)) > 50:  # bounds the digits of the fraction
        raise _refuse(f"{name} of a sensible size", text)
    return Fraction(number) * PHYSICAL[unit]


def numbers_of(text: str, name: str) -> list[float]:
    """The numbers of a list such as "0,0 10,5"."""
    if not _LIST.fullmatch(text):
        raise _refuse(f"{name} as numbers", text)
    return [float(number) for number in _NUMBERS.findall(text)]


def _count(text: str) -> int:
    return sum(1 for _ in _NUMBERS.finditer(text))


def matrix_of(text: str) -> tuple[Points, Points]:
    """Return a transform list as the matrix (2, 2) and offset (2,) of p -> p @ matrix + offset."""
    try:
        found = _library().Matrix(text) if _TRANSFORMS.fullmatch(text) else None
    except (ValueError, IndexError, TypeError):  # too few arguments
        found = None
    if found is None:
        raise _refuse("a transform such as translate(10 5) rotate(45)", text)
    values = [float(v) for v in (found.a, found.b, found.c, found.d, found.e, found.f)]
    return np.array(values[:4]).reshape(2, 2), np.array(values[4:])


def _library() -> Any:
    return import_module("svgelements")


def subpaths_of(data: str) -> list[list[Curve]]:
    """The subpaths of path data, each closed by a line where it is open, as a fill closes it."""
    expected = _checked_segments(data)
    try:
        path = _library().Path(data)
    except Exception:  # of the kinds it may raise, none is documented
        path = ()
    if len(path) != expected:
        raise _refuse("path data as SVG 2 writes it", data)
    return _closed_curves(path)


def _closed_curves(path: Any) -> list[list[Curve]]:
    subpaths: list[list[Curve]] = []
    for segment in path:
        kind = type(segment).__name__
        if kind in ("Move", "Close"):  # after a Z without an M, the next subpath starts there, too
            subpaths.append([])
        else:
            subpaths[-1].append(_curve(segment, kind))
    return [closed(subpath) for subpath in subpaths if subpath]


def closed(subpath: list[Curve]) -> list[Curve]:
    """With a line from its end to its start, where they differ."""
    start, end = ends(subpath[0])[0], ends(subpath[-1])[1]
    return subpath if (start == end).all() else [*subpath, np.array([end, start])]


def _point(point: Any) -> list[float]:
    return [float(point.x), float(point.y)]


def _curve(segment: Any, kind: str) -> Curve:
    start, end = _point(segment.start), _point(segment.end)
    if kind == "QuadraticBezier":
        return Bezier(np.array([start, _point(segment.control), end]))
    if kind == "CubicBezier":
        return Bezier(np.array([start, _point(segment.control1), _point(segment.control2), end]))
    if kind == "Arc" and start != end and segment.rx and segment.ry and segment.sweep:
        centre, prx, pry = (np.array(_point(p)) for p in (segment.center, segment.prx, segment.pry))
        return Arc(centre, prx - centre, pry - centre, segment.get_start_t(), segment.sweep)
    return np.array([start, end])  # Line, and arcs without a radius


def _checked_segments(data: str) -> int:
    """The number of segments in path data; an error where it does not follow the grammar."""
    stripped = data.strip()
    if stripped and stripped[0] not in "Mm":
        raise _refuse("path data that starts with M", data)
    segments = 0
    for command in _COMMAND.finditer(data):
        letter, arguments = command.groups()
        kind = letter.upper()
        if kind == "A":
            count = sum(1 for _ in _FLAGS.finditer(arguments)) if _ARCS.fullmatch(arguments) else 0
        elif kind == "Z":
            count = 0 if arguments.strip() else 1
        else:
            count = _count(arguments) if _LIST.fullmatch(arguments) else 0
            count = 0 if count % _ARITY[kind] else count // _ARITY[kind]
        if not count:
            raise FileFormatError(
                f"expected the numbers of a path's {letter}, got {_shown(arguments)}; correct it"
            )
        segments += count
    return segments


def _without_comments(text: str) -> str:
    """Text without comments between /* and */, or after a /* that does not end."""
    first, *others = text.split("/*")
    return first + "".join(other.partition("*/")[2] for other in others)


def style_of(text: str) -> dict[str, str]:
    """The declarations of a style such as "fill:none; fill-rule:evenodd"."""
    declarations = (part.partition(":") for part in _without_comments(text).split(";"))
    return {
        name.strip().lower(): value.replace("!important", "").strip()
        for name, colon, value in declarations
        if colon
    }


def rules_of(text: str) -> list[tuple[str, dict[str, str]]]:
    """The (selector, declarations) of a style sheet, weakest first; statements are passed over."""
    rules = []
    for block in _without_comments(text).split("}"):
        selectors, brace, declarations = block.partition("{")
        if "{" in declarations:
            raise _refuse("style rules that are not nested", selectors.strip())
        if brace:
            style = style_of(declarations)
            rules += [(s.strip(), style) for s in selectors.rpartition(";")[2].split(",")]
    return sorted(rules, key=lambda rule: ("#" in rule[0], "." in rule[0], rule[0] != "*"))


SHAPES = frozenset({"path", "rect", "circle", "ellipse", "polygon", "polyline"})
"""The elements with an inside."""


@dataclass(frozen=True, eq=False)
class Place:
    """Where an element stands: the map to the picture, styles and the size of 100 %."""

    matrix: Points
    offset: Points
    style: Style
    viewport: tuple[float | None, float | None]
    depth: int = 0
    layer: str = ""
    """The name of the group around it."""
    is_asked: bool = True
    """Whether it lies on a layer that is read."""
    unchecked: tuple[tuple[Style, str], ...] = ()
    """Styles and tags around it that matter only if it is."""

    def moved(self, matrix: Points, offset: Points) -> Place:
        return replace(self, matrix=matrix @ self.matrix, offset=offset @ self.matrix + self.offset)


@dataclass(frozen=True, eq=False)
class Shape:
    subpaths: list[list[Curve]]
    rule: str
    layer: str
    fill: str = "black"
    """Colour of the fill."""
    is_white: bool = False
    """Whether the fill is white and opaque, and hides the shapes below it."""


def view_box(element: Any) -> tuple[float, float, float, float] | None:
    text = element.get("viewBox")
    if text is None:
        return None
    values = numbers_of(text, "the viewBox")
    sizes = len(values) == 4 and all(1 / LARGEST_NUMBER < v < LARGEST_NUMBER for v in values[2:])
    if not sizes or not all(map(math.isfinite, values)):
        raise FileFormatError(
            f"expected a viewBox of four numbers, the last two above zero, got {text[:60]!r}"
        )
    return values[0], values[1], values[2], values[3]


def fitted(
    fit: str, box: tuple[float, float, float, float], size: tuple[float, float]
) -> tuple[Points, Points]:
    """Scale and shift that put a viewBox into a viewport of this size."""
    x, y, width, height = box
    scale = np.array([size[0] / width, size[1] / height])
    words = fit.split() or ["xMidYMid"]
    align = next((word for word in words if word not in ("defer", "meet", "slice")), "xMidYMid")
    if align != "none":
        scale[:] = scale.max() if "slice" in words else scale.min()
    spare = np.array(size) - scale * (width, height)
    shares = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}
    share = [shares.get(align[1:4], 0.5), shares.get(align[5:8], 0.5)]
    return scale, share * spare - scale * (x, y)


def corner(element: Any, place: Place) -> Points:
    return np.array([_length(element, name, place, k) for k, name in enumerate("xy")])


def _attribute(element: Any, name: str, place: Place) -> str | None:
    """An attribute that tells the geometry; in SVG 2 a style may set it, and is the stronger."""
    text: str | None = place.style.own.get(name, element.get(name))
    return text


def _length(element: Any, name: str, place: Place, axis: int | None) -> float:
    """A length in user units; 0 where it is missing. `axis` None: of the mean size."""
    text = _attribute(element, name, place)
    if text is None:
        return 0.0
    width, height = place.viewport
    reference = place.viewport[axis] if axis is not None else None
    if axis is None and width is not None and height is not None:
        reference = math.hypot(width, height) / math.sqrt(2)
    return length(text, f"the {name} of an element", reference)


def shape_of(element: Any, tag: str, place: Place) -> Shape:
    if tag == "path":
        subpaths = subpaths_of(_attribute(element, "d", place) or "")
    elif tag in ("polygon", "polyline"):
        subpaths = _polygon(element)
    elif tag == "rect":
        subpaths = _rectangle(element, place)
    else:
        subpaths = _ellipse(element, tag, place)
    image = [
        [transformed(curve, place.matrix, place.offset) for curve in subpath]
        for subpath in subpaths
    ]
    style = place.style
    rule, fill = style.inherited.get("fill-rule", "nonzero"), style.fill
    return Shape(image, rule, place.layer, fill, style.is_opaque and _is_white(fill))


def _polygon(element: Any) -> list[list[Curve]]:
    values = numbers_of(element.get("points", ""), "the points")
    if len(values) % 2:
        raise FileFormatError("expected points as pairs of numbers, got an odd number of them")
    return [closed([np.array(values).reshape(-1, 2)])] if len(values) >= 4 else []


def _size(element: Any, name: str, place: Place, axis: int | None) -> float:
    value = _length(element, name, place, axis)
    if value < 0:
        raise FileFormatError(f"expected the {name} of an element from zero up, got {value:g}")
    return value


def _ellipse(element: Any, tag: str, place: Place) -> list[list[Curve]]:
    centre = np.array([_length(element, name, place, k) for k, name in enumerate(("cx", "cy"))])
    radii = (_size(element, "r", place, None),) * 2 if tag == "circle" else _radii(element, place)
    u, v = np.diag(radii)
    return [[Arc(centre, u, v, 0.0, 2 * math.pi)]] if all(radii) else []


def _radii(element: Any, place: Place) -> tuple[float, float]:
    """Radii along x and y; one that is missing or "auto" is as the other."""
    given = [
        None
        if (_attribute(element, name, place) or "auto").strip() == "auto"
        else _size(element, name, place, k)
        for k, name in enumerate(("rx", "ry"))
    ]
    x, y = (given[k] if given[k] is not None else given[1 - k] for k in (0, 1))
    return x or 0.0, y or 0.0


def _rectangle(element: Any, place: Place) -> list[list[Curve]]:
    x, y = corner(element, place).tolist()
    width, height = _size(element, "width", place, 0), _size(element, "height", place, 1)
    library, radii = _library(), _radii(element, place)
    if not width or not height or not math.isfinite(x + y + width + height):
        corners = np.array([[x, y], [x + width, y + height]])
        return [[corners]] if width and height else []  # refused with all numbers beyond
    return _closed_curves(library.Path(library.Rect(x, y, width, height, *radii)))


_INHERITED = ("fill", "fill-rule", "fill-opacity", "visibility", "color")
_GEOMETRY = ("x", "y", "width", "height", "cx", "cy", "r", "rx", "ry", "d")
_OWN = (
    "display", "opacity", "transform", "transform-origin", "clip-path", "mask", "filter",
    *_GEOMETRY,
)  # fmt: skip
_UNSUPPORTED = ("clip-path", "mask", "filter", "transform-origin")
_SIMPLE = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-")


# A fill by a gradient or pattern, and the colour where the file has none of that name.
_SERVER = re.compile(
    r"""url\(\s*+["']?+#([^"')]++)["']?+\s*+\)\s*+(.*+)""", re.IGNORECASE | re.DOTALL
)


@dataclass(frozen=True, eq=False)
class Style:
    """Properties that decide whether a shape is painted."""

    inherited: dict[str, str] = field(default_factory=dict)
    own: dict[str, str] = field(default_factory=dict)
    opacity: float = 1.0
    """Product of the opacities of the element and of those around it."""
    servers: frozenset[str] = frozenset()
    """Names of the gradients and patterns of the file."""

    @property
    def fill(self) -> str:
        """Colour of the fill, or the name of a gradient or pattern; "none" if there is neither."""
        text = self.inherited.get("fill", "black").strip()
        if found := _SERVER.fullmatch(text):
            text = text if found[1].strip() in self.servers else found[2].strip() or "none"
        elif text.lower().startswith("url("):
            text = text.partition(")")[2].strip() or "none"
        if text.lower() == "currentcolor":
            text = self.inherited.get("color", "black")
        return text.lower()

    @property
    def is_opaque(self) -> bool:
        return self.opacity >= 1 and _opacity(self.inherited.get("fill-opacity")) >= 1


class Styles:
    """The rules of a file's style sheets, and the names of its gradients and patterns."""

    def __init__(self, sheet: str, servers: Iterable[str] = ()) -> None:
        self.servers = frozenset(servers)
        self.rules = [
            (selector, relevant)
            for selector, declarations in rules_of(sheet)
            if (relevant := _relevant(declarations))
        ]
        for selector, _ in self.rules:
            element, _, name = selector.removeprefix("#").partition(".")
            if selector != "*" and not set(element + name) <= _SIMPLE:
                raise FileFormatError(
                    "expected style rules for an element, .class or #id, got "
                    f"{selector[:60]!r}; save as plain SVG with presentation attributes"
                )

    def of(self, element: Any, tag: str, parent: Style) -> Style:
        """The element's style: attributes, then style sheets, then its own style attribute."""
        found = _relevant(dict(element.attrib))
        names = element.get("class", "").split()
        known = {"*", tag, f"#{element.get('id')}"}
        known |= {f".{name}" for name in names} | {f"{tag}.{name}" for name in names}
        for selector, declarations in self.rules:
            if selector in known:
                found |= declarations
        found |= _relevant(style_of(element.get("style", "")))
        given = {
            name: found[name] for name in _INHERITED if found.get(name, "inherit") != "inherit"
        }
        own = {name: found[name] for name in _OWN if name in found}
        opacity = parent.opacity * _opacity(own.get("opacity"))
        return Style(parent.inherited | given, own, opacity, self.servers)


def _relevant(declarations: dict[str, str]) -> dict[str, str]:
    return {name: declarations[name] for name in (*_INHERITED, *_OWN) if name in declarations}


def _opacity(text: str | None) -> float:
    """The number from 0 to 1 of an opacity."""
    value = 1.0 if text is None else length(text, "an opacity", 1.0)
    if not math.isfinite(value):
        raise FileFormatError(f"expected an opacity from 0 to 1, got {str(text)[:60]!r}")
    return min(max(value, 0.0), 1.0)


def _is_white(fill: str) -> bool:
    colour = import_module("svgelements").Color(fill)
    return bool(colour.value is not None and colour.hex in ("#fff", "#ffffff"))


def _is_transparent(fill: str) -> bool:
    """Whether a fill is none, or a colour whose fourth number, its opacity, is zero."""
    colour = fill.lower()
    if colour.startswith("#"):
        return len(colour) in (5, 9) and colour.endswith("0" * (len(colour) // 4))
    function, bracket, numbers = colour.partition("(")
    if bracket and function in ("rgb", "rgba", "hsl", "hsla"):
        parts = numbers.rstrip(") ").replace(",", " ").replace("/", " ").split()
        return len(parts) == 4 and not parts[3].rstrip("%").strip("0.")
    return colour in ("none", "transparent")


def is_painted(style: Style) -> bool:
    """Whether the inside of a shape shows, in whatever colour."""
    rule = style.inherited.get("fill-rule", "nonzero")
    if rule not in ("nonzero", "evenodd"):
        raise FileFormatError(f"expected the fill-rule nonzero or evenodd, got {rule[:60]!r}")
    return not (
        _is_transparent(style.fill)
        or style.opacity == 0
        or style.inherited.get("visibility") in ("hidden", "collapse")
        or _opacity(style.inherited.get("fill-opacity")) == 0
    )


def check_supported(style: Style, tag: str) -> None:
    """Raise FileFormatError for properties that change the picture and are not read."""
    for name in _UNSUPPORTED:
        if style.own.get(name, "none") != "none":
            raise FileFormatError(
                f"expected shapes without {name}, got a {tag} element with one; apply it to the "
                "path in a drawing program, or remove it"
            )
