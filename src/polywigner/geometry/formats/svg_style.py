"""Which of an SVG file's elements are painted: attributes, style sheets, inheritance."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from polywigner.errors import FileFormatError
from polywigner.geometry.formats.limits import MOST_RULES
from polywigner.geometry.formats.svg_values import length, rules_of, style_of

__all__ = ["Style", "Styles", "check_supported", "is_painted"]

_INHERITED = ("fill", "fill-rule", "fill-opacity", "visibility")
_GEOMETRY = ("x", "y", "width", "height", "cx", "cy", "r", "rx", "ry", "d")
_OWN = (
    "display", "opacity", "transform", "transform-origin", "clip-path", "mask", "filter",
    *_GEOMETRY,
)  # fmt: skip
_UNSUPPORTED = ("clip-path", "mask", "filter", "transform-origin")
_SIMPLE = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-")


@dataclass(frozen=True, eq=False)
class Style:
    """The properties that decide what is painted."""

    inherited: dict[str, str] = field(default_factory=dict)
    own: dict[str, str] = field(default_factory=dict)
    hidden: bool = False
    """An element around it, or it itself, has no opacity."""


class Styles:
    """The rules of a file's style sheets."""

    def __init__(self, sheet: str) -> None:
        self.rules = [
            (selector, relevant)
            for selector, declarations in rules_of(sheet)
            if (relevant := _relevant(declarations))
        ]
        if len(self.rules) > MOST_RULES:
            raise FileFormatError(
                f"expected a style sheet of at most {MOST_RULES} rules, got {len(self.rules)}; "
                "save as plain SVG"
            )
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
        names = element.get("class", "").split()[:MOST_RULES]
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
        return Style(parent.inherited | given, own, parent.hidden or _is_zero(own.get("opacity")))


def _relevant(declarations: dict[str, str]) -> dict[str, str]:
    return {name: declarations[name] for name in (*_INHERITED, *_OWN) if name in declarations}


def _is_zero(text: str | None) -> bool:
    if text is None:
        return False
    value = length(text, "an opacity", 1.0)
    if not math.isfinite(value):
        raise FileFormatError(f"expected an opacity from 0 to 1, got {text[:60]!r}")
    return value <= 0


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
    fill = style.inherited.get("fill", "black").lower()
    rule = style.inherited.get("fill-rule", "nonzero")
    if rule not in ("nonzero", "evenodd"):
        raise FileFormatError(f"expected the fill-rule nonzero or evenodd, got {rule[:60]!r}")
    return not (
        _is_transparent(fill)
        or style.hidden
        or style.inherited.get("visibility") in ("hidden", "collapse")
        or _is_zero(style.inherited.get("fill-opacity"))
    )


def check_supported(style: Style, tag: str) -> None:
    """Raise for what changes the picture and is not read."""
    for name in _UNSUPPORTED:
        if style.own.get(name, "none") != "none":
            raise FileFormatError(
                f"expected shapes without {name}, got a {tag} element with one; apply it to the "
                "path in a drawing program, or remove it"
            )
