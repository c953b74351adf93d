"""Reader of the filled shapes in an SVG file; strokes are ignored.

The library svgelements silently skips invalid text, so this module checks the text beforehand.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from importlib import import_module
from itertools import compress
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely

from polywigner.errors import FileFormatError
from polywigner.geometry.io.outlines import (
    Arc,
    Bezier,
    Curve,
    Drawing,
    File,
    Points,
    Polygon,
    check_known,
    filled,
    flattened,
    sampled,
    transformed,
)
from polywigner.geometry.parts import combined_on_grid, polygons_in
from polywigner.geometry.rings import rings_of_polygon

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

# Patterns of accepted attributes; svgelements silently skips other text. Possessive quantifiers
# limit the matching time.
_NUMBER = r"[+-]?(?>[0-9]++\.?[0-9]*+|\.[0-9]++)(?:[eE][+-]?[0-9]++)?+"
_COMMA = r"(?>\s*+,\s*+|\s*+)"
_LENGTH = re.compile(rf"\s*+({_NUMBER})(%|\w*+)\s*+")
_LIST = re.compile(rf"\s*+(?:{_NUMBER}{_COMMA})*+")
_TRANSFORM = re.compile(
    r"(?:\s*+(?:matrix|translate|scale|rotate|skew[XY])"
    rf"\s*+\(\s*+(?:{_NUMBER}{_COMMA})++\)\s*+,?+)*+\s*+"
)
# Numbers in path data must not end with a decimal point.
_ARGUMENT = _NUMBER.replace(r"\.?[0-9]*+", r"(?:\.[0-9]++)?+") + _COMMA
_PATH = re.compile(
    rf"\s*+(?:(?=[Mm])(?:[MmLlTt]\s*+(?:(?:{_ARGUMENT}){{2}})++|[HhVv]\s*+(?:{_ARGUMENT})++"
    rf"|[Cc]\s*+(?:(?:{_ARGUMENT}){{6}})++|[SsQq]\s*+(?:(?:{_ARGUMENT}){{4}})++"
    rf"|[Aa]\s*+(?:(?:{_ARGUMENT}){{3}}(?:[01]{_COMMA}){{2}}(?:{_ARGUMENT}){{2}})++|[Zz]\s*+)++)?+"
)

PIXEL = Fraction(254, 960_000)
"""Length of a CSS pixel in metres, 1/96 inch."""

_SIZES = {
    "mm": Fraction(1, 1000), "cm": Fraction(1, 100), "Q": Fraction(1, 4000),
    "in": Fraction(254, 10_000), "pt": Fraction(254, 720_000), "pc": Fraction(254, 60_000),
}  # fmt: skip

_NAMESPACE = "{http://www.w3.org/2000/svg}"
_NAMES = ("{http://www.inkscape.org/namespaces/inkscape}label", "data-name", "id")
_LINK = "{http://www.w3.org/1999/xlink}href"

_CONTAINERS = {"svg", "g", "a", "switch", "use"}
_SHAPES = {"path", "rect", "circle", "ellipse", "polygon", "polyline"}
_OPAQUE = {"text", "image", "foreignObject"}
_INHERITED = ("fill", "fill-rule", "fill-opacity", "visibility", "color")
_EFFECTS = ("clip-path", "mask", "filter", "transform-origin")
# Pattern of style-sheet properties that may change an outline or its fill.
_RULE = re.compile(
    rf"[{{;\s](?:{'|'.join((*_INHERITED, *_EFFECTS))}|display|opacity|transform"
    r"|d|[xyr]|[cr][xy]|width|height)\s*:",
    re.I,
)


def _refusal(what: str, text: str) -> FileFormatError:
    """Return the error for an attribute; ``what``: expected value, ``text``: actual value."""
    short = repr(text if len(text) <= 60 else text[:60] + "...")
    return FileFormatError(f"expected {what}, got {short}; correct the attribute")


def _length(text: str, name: str, reference: float | None = None) -> tuple[float, Fraction | None]:
    """Return a length in user units, and its value in metres (None if its unit is not absolute).

    ``name``: name of the attribute, for error messages. ``reference``: length of 100 %; if it is
    None, percentages raise FileFormatError.
    """
    match = _LENGTH.fullmatch(text)
    if match is None or match[2] not in ("", "px", "%", *_SIZES):
        raise _refusal(f"the {name} as a length in px, mm, cm, Q, in, pt or pc", text)
    number, unit = match.groups()
    if not math.isfinite(float(number)):
        raise _refusal(f"a finite {name}", text)
    if unit in _SIZES:
        metres = Fraction(number) * _SIZES[unit]
        return float(metres / PIXEL), metres
    if unit == "%" and reference is None:
        raise _refusal(f"the {name} without a percent sign", text)
    return float(number) * (float(reference or 0.0) / 100 if unit == "%" else 1.0), None


def _affine_of(text: str) -> Points:
    """Return the matrix (3, 3) of a transform attribute: (x, y, 1) maps to (x, y, 1) @ matrix."""
    try:
        matrix = import_module("svgelements").Matrix(_TRANSFORM.fullmatch(text)[0])  # type: ignore[index]
        rows = np.array([float(getattr(matrix, letter)) for letter in "abcdef"]).reshape(3, 2)
    except (ValueError, IndexError, TypeError):
        raise _refusal("a transform such as translate(10 5) rotate(45)", text) from None
    return np.column_stack([rows, [0, 0, 1]])


def _view_box(element: Element) -> tuple[float, ...] | None:
    """Return x, y, width and height of the viewBox of an element; None if it has none."""
    text = element.get("viewBox")
    if text is None:
        return None
    values = [float(number) for number in re.findall(_NUMBER, text)]
    if not _LIST.fullmatch(text) or len(values) != 4 or min(values[2:]) <= 0:
        raise _refusal("a viewBox of four numbers, the last two above zero", text)
    return tuple(values)


def _closed_subpath(subpath: list[Curve]) -> list[Curve]:
    """Return a subpath, with an additional line to its start if it is open."""
    start, end = sampled(subpath[0])[0], sampled(subpath[-1])[-1]
    return subpath if (start == end).all() else [*subpath, np.array([end, start])]


def _subpaths(path: Any) -> list[list[Curve]]:
    """Convert a path of svgelements to closed subpaths, as lists of curves."""
    subpaths: list[list[Curve]] = []
    for segment in path:
        if type(segment).__name__ in ("Move", "Close"):
            subpaths.append([])
        else:
            subpaths[-1].append(_curve(segment))
    return [_closed_subpath(subpath) for subpath in subpaths if subpath]


def _curve(segment: Any) -> Curve:
    """Convert a segment of a path of svgelements to a line, a Bezier curve or an arc."""
    kind = type(segment).__name__
    controls = {"QuadraticBezier": ["control"], "CubicBezier": ["control1", "control2"]}
    points = _named_points(segment, ["start", *controls.get(kind, ()), "end"])
    if kind in controls:
        return Bezier(points)
    is_arc = kind == "Arc" and segment.rx and segment.ry and segment.sweep
    if not is_arc or (points[0] == points[1]).all():
        return points
    centre, u, v = _named_points(segment, ["center", "prx", "pry"])
    return Arc(centre, u - centre, v - centre, segment.get_start_t(), segment.sweep)


def _named_points(segment: Any, names: Sequence[str]) -> Points:
    """Return points of a path segment, such as "start" and "end", as an array (n, 2)."""
    return np.array([(p.x, p.y) for p in map(segment.__getattribute__, names)], dtype=float)


def _outlines_of(
    tag: str, attributes: Mapping[str, str], viewport: Mapping[str, float]
) -> list[list[Curve]]:
    """Return the closed outlines of a shape element, before its transform.

    ``tag``: name of the element. ``viewport``: lengths that correspond to 100 %, with the keys "x",
    "y", "width" and "height".
    """

    def value(name: str) -> float:
        """Return an attribute as a length in user units; 0 if it is missing."""
        return _length(attributes.get(name, "0"), name, viewport.get(name))[0]

    library = import_module("svgelements")
    if tag in ("path", "polygon", "polyline"):
        points = attributes.get("points", "")
        data = attributes.get("d", "") if tag == "path" else points and f"M{points}"
        if not _PATH.fullmatch(data):
            raise _refusal("path data that starts with M, or points, as specified by SVG 2", data)
        return _subpaths(library.Path(data))
    width, height, rx, ry = (value(name) for name in ("width", "height", "rx", "ry"))
    if tag == "circle":
        rx = ry = value("r")
    if min(width, height, rx, ry) < 0:
        raise FileFormatError(
            "expected lengths of zero or more, got a negative length; correct the attribute"
        )
    if tag == "rect":
        radii = [value(name) if name in attributes else None for name in ("rx", "ry")]
        rectangle = library.Rect(value("x"), value("y"), width, height, *radii)
        return _subpaths(library.Path(rectangle)) if width and height else []
    centre = np.array([value("cx"), value("cy")])
    return [[Arc(centre, np.array([rx, 0.0]), np.array([0.0, ry]))]] if rx and ry else []


def _opacity(text: str | None) -> float:
    """Return the opacity in an attribute, limited to the range 0 to 1; the default is 1."""
    return 1.0 if text is None else min(max(_length(text, "opacity", 1.0)[0], 0.0), 1.0)


def _root_element(content: bytes) -> Element:
    """Parse an SVG file, and return its root; raise FileFormatError for other content."""
    try:
        root: Element = import_module("defusedxml.ElementTree").fromstring(content)
    except (SyntaxError, LookupError) as error:
        line = getattr(error, "position", (1, 0))[0]
        raise FileFormatError(
            f"expected SVG, got text that is not valid XML in line {line}"
        ) from None
    # defusedxml raises ValueError for entities and external files.
    except ValueError:
        raise FileFormatError(
            "expected an SVG file without entities or external files; save the drawing as plain SVG"
        ) from None
    if _tag(root) != "svg":
        raise FileFormatError("expected an svg element, got another kind of XML file")
    return root


def _tag(element: Element) -> str:
    """Return the name of an SVG element; empty for comments and other namespaces."""
    tag = element.tag if isinstance(element.tag, str) else "{"
    return tag.removeprefix(_NAMESPACE) if not tag.startswith("{") or _NAMESPACE in tag else ""


def _layer_names(element: Any) -> list[str]:
    """Return the names with which users select an element: its label, data-name and id, if any."""
    return [element.get(key) for key in _NAMES if element.get(key)]


def _properties(element: Element) -> dict[str, str]:
    """Return the attributes and style properties of an element; the style has priority."""
    pairs = (part.partition(":") for part in element.get("style", "").split(";"))
    style = {name.strip().lower(): value.strip() for name, colon, value in pairs if colon}
    return {**element.attrib, **style}


def _colour(style: Mapping[str, str]) -> tuple[str, float]:
    """Return the hexadecimal colour of a fill and its opacity from 0 to 1.

    Without a fill, the result is an empty text and 0. Gradients and patterns are black. The
    opacities of the element and of "fill-opacity" are not included.
    """
    text = style.get("fill", "black").strip().lower()
    if text == "currentcolor":
        text = style.get("color", "black").lower()
    if text == "none":
        return "", 0.0
    colour = import_module("svgelements").Color("black" if text.startswith("url(") else text)
    # svgelements misreads colour functions without commas, so they raise an error.
    if colour.value is None or re.fullmatch(r"(?!url)\w+\([^,]*\)", text):
        raise _refusal("a fill such as red, #f00, rgb(255, 0, 0) or none", text)
    return str(colour.hex), colour.alpha / 255


@dataclass(frozen=True, eq=False)
class _Context:
    """Properties of an element that its children inherit."""

    matrix: Points
    """Matrix of the transform: (x, y, 1) is mapped to (x, y, 1) @ matrix."""
    is_requested: bool
    """Whether the element is in a layer that is to be read."""
    properties: Mapping[str, str]
    """Attributes and style of the element."""
    style: Mapping[str, str]
    """Properties inherited from the enclosing elements."""
    opacity: float = 1.0
    effect: str = ""
    """Unsupported property, such as a mask, of the element or of an enclosing element."""


class _Shape(NamedTuple):
    """A filled shape with the transformation of its enclosing elements."""

    subpaths: list[list[Curve]]
    rule: str
    is_white: bool
    """Whether the shape is opaque and white, so that it hides the shapes below it."""


class _Document:
    """An SVG file with the layers to be read."""

    def __init__(self, root: Any, layers: Sequence[str]) -> None:
        """Index the elements by id.

        Raises ArgumentError if a layer is missing, and FileFormatError for style sheets that affect
        shapes.
        """
        self.root, self.layers = root, frozenset(layers)
        sizes = (_view_box(root) or ())[2:]
        self.viewport = dict(zip(("width", "height", "x", "y"), 2 * sizes, strict=False))
        elements = list(root.iter())
        known = {name: _tag(e) == "g" for e in elements for name in _layer_names(e)}
        if not self.layers <= known.keys():
            check_known(layers, [name for name in known if known[name] or name in self.layers])
        if any(_tag(e) == "style" and _RULE.search(e.text or "") for e in elements):
            raise FileFormatError(
                "expected fills and sizes as attributes, got a style sheet that specifies them; "
                "save the drawing with presentation attributes or style attributes"
            )
        self.named = {e.get("id"): e for e in reversed(elements) if e.get("id")}

    def shapes(self, element: Any, context: _Context) -> Iterator[_Shape]:
        """Yield the filled shapes of an element and of its children, in the order of drawing."""
        tag = _tag(element)
        if tag not in _CONTAINERS | _SHAPES | _OPAQUE:
            return
        inside = self._inner_context(element, tag, context)
        if inside.properties.get("display") == "none" and context.is_requested:
            return
        if tag in _SHAPES | _OPAQUE:
            yield from self._filled_shape(tag, inside)
            return
        children: Iterable[Any] = element
        if tag == "use":
            inside, children = self._target_of_use(inside)
        # A switch element draws only its first child that requires no extensions.
        elif tag == "switch":
            children = [e for e in element if _tag(e) and not e.get("requiredExtensions")][:1]
        elif tag == "svg" and element is not self.root and inside.is_requested:
            raise FileFormatError(
                "expected a single svg element, got a nested svg element; replace it with a group"
            )
        for child in children:
            yield from self.shapes(child, inside)

    def _inner_context(self, element: Any, tag: str, context: _Context) -> _Context:
        """Return the properties of an element, combined with those of enclosing elements."""
        properties = _properties(element)
        style = {n: properties[n] for n in _INHERITED if properties.get(n, "inherit") != "inherit"}
        effects = [name for name in _EFFECTS if properties.get(name, "none") != "none"]
        text = properties.get("transform", "none")
        matrix = context.matrix if text == "none" else _affine_of(text) @ context.matrix
        return _Context(
            matrix,
            context.is_requested or not self.layers.isdisjoint(_layer_names(element)),
            properties,
            {**context.style, **style},
            context.opacity * _opacity(properties.get("opacity")),
            context.effect or (f"a {tag} element with {effects[0]}" if effects else ""),
        )

    def _target_of_use(self, context: _Context) -> tuple[_Context, list[Any]]:
        """Return the context of a use element, including its shift, and a list with its target.

        Raises FileFormatError if the target is missing.
        """
        properties = context.properties
        link = properties.get("href", properties.get(_LINK, "")).strip()
        target = self.named.get(link[1:]) if link.startswith("#") else None
        if target is None or _tag(target) in ("svg", "symbol"):
            raise _refusal("a use element that refers to a group or shape in the same file", link)
        shift = np.eye(3)
        shift[2, :2] = [_length(properties.get(name, "0"), name)[0] for name in "xy"]
        return replace(context, matrix=shift @ context.matrix), [target]

    def _filled_shape(self, tag: str, context: _Context) -> Iterator[_Shape]:
        """Yield the shape of an element, unless it is invisible or not requested.

        Raises FileFormatError for images, masks and other unsupported content.
        """
        colour, alpha = _colour(context.style)
        opacity = alpha * context.opacity * _opacity(context.style.get("fill-opacity"))
        is_hidden = context.style.get("visibility") in ("hidden", "collapse")
        is_painted = not is_hidden and opacity > 0
        if not context.is_requested or not (is_painted or tag in _OPAQUE - {"text"}):
            return
        unread = f"a {tag} element" if tag in _OPAQUE else context.effect
        if unread:
            raise FileFormatError(
                f"expected plain shapes, got {unread}; convert it to paths, or remove it"
            )
        matrix, offset = context.matrix[:2, :2], context.matrix[2, :2]
        subpaths = [
            [transformed(curve, matrix, offset) for curve in subpath]
            for subpath in _outlines_of(tag, context.properties, self.viewport)
        ]
        rule = "evenodd" if context.style.get("fill-rule") == "evenodd" else "nonzero"
        yield _Shape(subpaths, rule, colour == "#ffffff" and opacity >= 1)


def load_svg(file: File) -> Drawing:
    """Load the filled shapes of an SVG file, with y upwards."""
    root = _root_element(file.content)
    metres, matrix = _unit_and_axes(root, file.unit_metres)
    context = _Context(matrix, not file.layers, {}, {})
    shapes = list(_Document(root, file.layers).shapes(root, context))
    if not shapes:
        raise FileFormatError(
            "the drawing contains no filled shapes; set a fill for the outlines, because "
            "strokes do not enclose an area"
        )
    subpaths = [subpath for shape in shapes for subpath in shape.subpaths]
    rings = iter(flattened(subpaths, file.tolerance and file.tolerance / metres))
    painted = [filled([next(rings) for _ in shape.subpaths], shape.rule) for shape in shapes]
    polygons = _visible(painted, [shape.is_white for shape in shapes])
    if not polygons:
        raise FileFormatError("no shapes enclose an area, or white shapes cover all of them")
    return Drawing(polygons, metres)


def _visible(painted: Sequence[list[Polygon]], is_white: Sequence[bool]) -> list[Polygon]:
    """Cut white shapes out of the shapes below them, unless all shapes are white."""
    if all(is_white) or not any(is_white):
        return [polygon for polygons in painted for polygon in polygons]
    visible: list[shapely.Polygon] = []
    for polygons, white in zip(painted, is_white, strict=True):
        areas = [shapely.Polygon(outer, holes) for outer, *holes in polygons]
        visible += [] if white else areas
        for area in areas if white else ():
            near = shapely.intersects(visible, area)
            cut = [combined_on_grid(shapely.difference, s, area) for s in compress(visible, near)]
            visible = [*compress(visible, ~near), *(p for piece in cut for p in polygons_in(piece))]
    return [rings_of_polygon(polygon) for polygon in visible]


def _unit_and_axes(root: Any, unit_metres: float) -> tuple[float, Points]:
    """Return the unit of the file in metres, and the matrix (3, 3) that reverses the y axis.

    An absolute width or height specifies the size of the viewBox. Without a viewBox, the unit is a
    CSS pixel. If neither width nor height is absolute, the unit is ``unit_metres``.
    """
    box, flip = _view_box(root), np.diag([1.0, -1.0, 1.0])
    scales = []
    for axis, name in enumerate(("width", "height")):
        length, size = _length(root.get(name, "auto").replace("auto", "1"), name, 1.0)
        if length <= 0:
            raise _refusal(f"the {name} above zero", root.get(name))
        if size is not None:
            scales.append(float(PIXEL if box is None else size / Fraction(box[2 + axis])))
    if not scales:
        return unit_metres, flip
    if max(scales) > 1.001 * min(scales):
        raise FileFormatError(
            "expected width and height with the aspect ratio of the viewBox, got a different "
            "ratio; correct the width, the height or the viewBox"
        )
    return min(scales), flip
