"""Filled shapes of an SVG file as the picture looks: (x, y) becomes (x, -y), without strokes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from importlib import import_module
from typing import Any

import numpy as np
import shapely

from polywigner.errors import FileFormatError
from polywigner.geometry.io.curves import Points, flattened
from polywigner.geometry.io.drawing import Drawing, File, Format, check_known, overlap_remedy
from polywigner.geometry.io.limits import MOST_NESTED
from polywigner.geometry.io.outlines import Polygon, filled
from polywigner.geometry.io.svg_shapes import (
    PIXEL,
    SHAPES,
    Place,
    Shape,
    Style,
    Styles,
    check_supported,
    corner,
    fitted,
    is_painted,
    length,
    matrix_of,
    physical_length,
    shape_of,
    view_box,
)
from polywigner.geometry.parts import combined_on_grid, polygons_in
from polywigner.geometry.rings import rings_of_polygon

_NAMESPACE = "{http://www.w3.org/2000/svg}"
_NAMES = ("{http://www.inkscape.org/namespaces/inkscape}label", "data-name", "id")
_LINK = "{http://www.w3.org/1999/xlink}href"

_CONTAINERS = {"svg", "g", "a", "switch"}
_OPAQUE = {"text", "image", "foreignObject"}
_SERVERS = {"linearGradient", "radialGradient", "meshgradient", "pattern", "hatch", "solidcolor"}


def parsed(content: bytes) -> Any:
    """The root element. A plain DOCTYPE may stand; declarations in it and other files may not."""
    defused: Any = import_module("defusedxml.ElementTree")
    common: Any = import_module("defusedxml.common")
    parser = defused.XMLParser(forbid_dtd=False)
    parser.parser.StartDoctypeDeclHandler = _refuse_declarations
    try:
        parser.feed(content)
        root = parser.close()
    except FileFormatError:
        raise
    except common.DefusedXmlException:
        _refuse_declarations("", None, None, True)
    except (SyntaxError, ValueError, LookupError) as error:  # ParseError is a SyntaxError
        line = getattr(error, "position", (1, 0))[0]
        raise FileFormatError(f"expected SVG, got text that is not XML in line {line}") from None
    try:
        list(root.iter())
    except RecursionError:  # defusedxml's elements look through each other
        _check_depth(MOST_NESTED + 1)
    if _tag(root) != "svg":
        raise FileFormatError("expected an svg element, got XML of another kind")
    return root


def _refuse_declarations(name: str, system: Any, public: Any, has_declarations: bool) -> None:
    if has_declarations:
        raise FileFormatError(
            "expected SVG without entities or other declarations of its own, got one; save as "
            "plain SVG"
        )


def _check_depth(depth: int) -> None:
    if depth > MOST_NESTED:
        raise FileFormatError(
            f"expected elements nested at most {MOST_NESTED} deep, got more (or a use that "
            "contains itself); ungroup them"
        )


def _tag(element: Any) -> str:
    """Name of an SVG element; empty for comments and other namespaces."""
    tag = element.tag if isinstance(element.tag, str) else "{"
    return tag.removeprefix(_NAMESPACE) if not tag.startswith("{") or _NAMESPACE in tag else ""


def _names(element: Any) -> list[str]:
    """Names of a group or shape in drawing programs, the displayed one first."""
    return [element.get(key) for key in _NAMES if element.get(key)]


class Document:
    """A walk over the elements that are drawn, on `layers` (names or ids) alone if there are."""

    def __init__(self, root: Any, layers: Sequence[str] = ()) -> None:
        self.root = root
        self.layers = frozenset(layers)
        known = {name: _tag(e) == "g" for e in root.iter() for name in _names(e)}
        if not self.layers <= known.keys():
            check_known(layers, [name for name in known if known[name] or name in self.layers])
        sheet = "".join(e.text or "" for e in root.iter() if _tag(e) == "style")
        servers = [e.get("id") for e in root.iter() if _tag(e) in _SERVERS and e.get("id")]
        self.styles = Styles(sheet, servers)
        self.named = {e.get("id"): e for e in reversed(list(root.iter())) if e.get("id")}

    def shapes(self, matrix: Points) -> Iterator[Shape]:
        box = view_box(self.root)
        viewport = (None, None) if box is None else (box[2], box[3])
        style = Style(servers=self.styles.servers)
        place = Place(matrix, np.zeros(2), style, viewport, is_asked=not self.layers)
        inside = self._entered(self.root, place)
        if inside.style.own.get("display") != "none":
            yield from self._children(self.root, inside)

    def _entered(self, element: Any, place: Place) -> Place:
        """The place inside an element: its style, its transform."""
        _check_depth(place.depth + 1)
        tag, names = _tag(element), _names(element)
        style = self.styles.of(element, tag, place.style)
        is_asked = place.is_asked or not self.layers.isdisjoint(names)
        if not place.is_asked:  # a layer asked for is read, hidden or not
            style = replace(style, own={k: v for k, v in style.own.items() if k != "display"})
        around = (*place.unchecked, (style, tag)) if style.own.get("display") != "none" else ()
        for some, name in around if is_asked else ():
            check_supported(some, name)
        inside = replace(
            place,
            style=style,
            depth=place.depth + 1,
            layer=names[0] if tag == "g" and names else place.layer,
            is_asked=is_asked,
            unchecked=() if is_asked else around,
        )
        text = style.own.get("transform")
        if text not in (None, "", "none"):
            inside = inside.moved(*matrix_of(text))
        return inside

    def _children(self, element: Any, place: Place) -> Iterator[Shape]:
        for child in element:
            yield from self._drawn(child, place)

    def _drawn(self, element: Any, place: Place) -> Iterator[Shape]:
        tag = _tag(element)
        if tag not in _CONTAINERS | SHAPES | _OPAQUE | {"use"}:
            return
        inside = self._entered(element, place)
        if inside.style.own.get("display") == "none":
            return
        if tag in SHAPES:
            if inside.is_asked and is_painted(inside.style):
                yield shape_of(element, tag, inside)
        elif tag == "use":
            yield from self._used(element, inside)
        elif tag in _OPAQUE:
            if inside.is_asked and (tag != "text" or is_painted(inside.style)):
                raise FileFormatError(
                    f"expected shapes, got a {tag} element; convert it to paths or remove it"
                )
        elif tag == "svg":
            yield from self._children(element, self._viewport(element, inside))
        else:
            yield from self._children(_chosen(element) if tag == "switch" else element, inside)

    def _used(self, element: Any, place: Place) -> Iterator[Shape]:
        link = (element.get("href") or element.get(_LINK) or "").strip()
        target = self.named.get(link[1:]) if link.startswith("#") else None
        if target is None:
            raise FileFormatError(
                f"expected a use of an element in the same file, got {link[:60]!r}; unlink it"
            )
        place = place.moved(np.eye(2), corner(element, place))
        if _tag(target) not in ("symbol", "svg"):
            yield from self._drawn(target, place)
            return
        inside = self._entered(target, place)
        size = [element.get(name) or target.get(name) for name in ("width", "height")]
        yield from self._children(target, self._viewport(target, inside, size))

    def _viewport(
        self, element: Any, place: Place, size: Sequence[str | None] | None = None
    ) -> Place:
        """The place inside a nested svg or symbol: its corner, and the scale of its viewBox."""
        if size is None:
            size = [element.get("width"), element.get("height")]
        place = place.moved(np.eye(2), corner(element, place))
        box = view_box(element)
        extents = [
            reference if text in (None, "auto") else length(str(text), "a size", reference)
            for text, reference in zip(size, place.viewport, strict=True)
        ]
        if box is None:
            return replace(place, viewport=(extents[0], extents[1]))
        width, height = (
            given if given is not None else own for given, own in zip(extents, box[2:], strict=True)
        )
        scale, shift = fitted(element.get("preserveAspectRatio", ""), box, (width, height))
        return replace(place.moved(np.diag(scale), shift), viewport=box[2:])


def _chosen(switch: Any) -> list[Any]:
    """The one element of a switch that is drawn: the first that asks for no extension."""
    return [child for child in switch if _tag(child) and not child.get("requiredExtensions")][:1]


def read_svg(file: File) -> Drawing:
    """The filled shapes of an SVG file, y up, each flattened and filled by its own rule."""
    root = parsed(file.content)
    metres, matrix = _unit(root, file.unit_metres)
    shapes = list(Document(root, file.layers).shapes(matrix))
    if not shapes:
        raise FileFormatError(
            "expected filled shapes, got none; give the outlines a fill (strokes have no inside)"
        )
    subpaths = [subpath for shape in shapes for subpath in shape.subpaths]
    outlines = flattened(subpaths, file.tolerance and file.tolerance / metres)
    rings = iter(outlines)
    painted = [filled([next(rings) for _ in shape.subpaths], shape.rule) for shape in shapes]
    polygons = _visible(painted, [shape.is_white for shape in shapes])
    if not polygons:
        raise FileFormatError(
            "expected shapes that enclose an area, got none that do and that no white shape covers"
        )
    names = [shape.layer for shape in shapes for _ in shape.subpaths]
    remedy = overlap_remedy(outlines, names)
    if len({shape.fill for shape in shapes}) > 1 and "lies around" not in remedy:
        remedy = (
            "their colours differ: paint white what is to be closed, cut one out of the other, or "
            "give union=True (--union), which joins them whatever their colour"
        )
    return Drawing(polygons, metres, remedy)


def _visible(painted: Sequence[list[Polygon]], is_white: Sequence[bool]) -> list[Polygon]:
    """The polygons of shapes after white shapes have hidden the parts below them.

    White shapes themselves are closed, unless all shapes are white.
    """
    if all(is_white) or not any(is_white):
        return [polygon for polygons in painted for polygon in polygons]
    visible = np.array([], dtype=object)
    for polygons, white in zip(painted, is_white, strict=True):
        areas = [shapely.Polygon(outer, holes) for outer, *holes in polygons]
        if not white:
            visible = np.concatenate([visible, np.array(areas, dtype=object)])
            continue
        for area in areas:
            hidden = shapely.intersects(visible, area)
            left = [combined_on_grid(shapely.difference, some, area) for some in visible[hidden]]
            pieces = [piece for geometry in left for piece in polygons_in(geometry)]
            visible = np.concatenate([visible[~hidden], np.array(pieces, dtype=object)])
    return [rings_of_polygon(polygon) for polygon in visible]


def _unit(root: Any, unit_metres: float) -> tuple[float, Points]:
    """Metres of a unit of the file's coordinates, and the map that flips y.

    A width or height in mm, cm, Q, in, pt or pc states the size of the viewBox, or, without one,
    that a unit is a CSS pixel. Otherwise a unit is what the caller says.
    """
    sizes = {}
    for name in ("width", "height"):
        text = root.get(name)
        physical = None if text in (None, "auto") else physical_length(text, f"the {name}")
        if physical is not None:
            sizes[name] = physical
    box = view_box(root)
    if not sizes:
        return unit_metres, np.diag([1.0, -1.0])
    if box is None:
        return float(PIXEL), np.diag([1.0, -1.0])
    extents = {"width": Fraction(box[2]), "height": Fraction(box[3])}
    x, y = (float(sizes[n] / extents[n]) if n in sizes else None for n in ("width", "height"))
    if x is None or y is None:
        metres = y if x is None else x
        assert metres is not None
        return metres, np.diag([1.0, -1.0])
    fit = root.get("preserveAspectRatio", "").split()
    if "none" in fit:
        return x, np.diag([1.0, -y / x])
    return (max if "slice" in fit else min)(x, y), np.diag([1.0, -1.0])


FORMATS = (
    Format("SVG", (".svg",), read_svg, rb"<", ("defusedxml.ElementTree", "svgelements"), True),
)
