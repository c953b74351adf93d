"""gerbonara reads the objects of a Gerber file, in a process of its own (``library_process``).

What is taken from it are numbers of the file: places, centres, and parameters of apertures. Its own
drawing of apertures is not used. Nothing of this package is imported here.
"""

from __future__ import annotations

import importlib
import re
import warnings
from typing import Any

# What gerbonara warns about and yet reads as Gerber says.
_HARMLESS = ".*(Arc is missing|D01 interpolation with a zero-size)"

_FIELDS = {
    "CircleAperture": ("diameter", "hole_dia"),
    "RectangleAperture": ("w", "h", "hole_dia"),
    "ObroundAperture": ("w", "h", "hole_dia"),
    "PolygonAperture": ("diameter", "n_vertices", "hole_dia"),
}
_MACRO_FIELDS = {
    1: ("exposure", "diameter", "x", "y", "rotation"),
    5: ("exposure", "n_vertices", "x", "y", "diameter", "rotation"),
    20: ("exposure", "width", "start_x", "start_y", "end_x", "end_y", "rotation"),
    21: ("exposure", "width", "height", "x", "y", "rotation"),
}


class _Refused(LookupError):
    """Statement that this module refuses, apart from errors of the library's own tables."""


def _primitive(primitive: Any, bound: dict[int, float], unit: Any) -> list[Any]:
    def value(expression: Any) -> float:
        return float(expression.calculate(bound, unit))

    if primitive.code == 4:
        points = [[value(x), value(y)] for x, y in primitive.points]
        return [4, value(primitive.exposure), points, value(primitive.rotation)]
    names = _MACRO_FIELDS[primitive.code]
    return [primitive.code, *(value(getattr(primitive, name)) for name in names)]


class _Apertures:
    """The apertures that objects use, each told once."""

    def __init__(self, most: int) -> None:
        self.told: list[list[Any]] = []
        self._numbers: dict[int, int] = {}
        self._left = most

    def number(self, aperture: Any) -> int:
        if aperture is None:
            raise _Refused("expected an aperture before D01 and D03, got none; export it anew")
        if id(aperture) not in self._numbers:
            self._numbers[id(aperture)] = len(self.told)
            self.told.append(self._parameters(aperture))
        return self._numbers[id(aperture)]

    def _parameters(self, aperture: Any) -> list[Any]:
        kind = type(aperture).__name__
        if kind in _FIELDS:
            return [kind, *(getattr(aperture, name) for name in _FIELDS[kind])]
        bound = dict(enumerate(aperture.parameters, start=1))
        primitives = aperture.macro.primitives
        self._left -= sum(len(getattr(p, "coords", "_")) for p in primitives)
        if self._left < 0:
            raise _Refused("expected fewer primitives in macros, got more; use regions")
        return ["macro", [_primitive(p, bound, aperture.unit) for p in primitives]]


def _told(thing: Any, apertures: _Apertures) -> list[Any]:
    kind, dark = type(thing).__name__, bool(thing.polarity_dark)
    if kind == "Region":
        arcs = [arc and [bool(arc[0]), *arc[1]] for arc in thing.arc_centers]
        return [kind, dark, [list(point) for point in thing.outline], arcs]
    number = apertures.number(thing.aperture)
    if kind == "Flash":
        return [kind, dark, number, thing.x, thing.y]
    if kind == "Line":
        return [kind, dark, number, thing.p1, thing.p2]
    return [kind, dark, number, thing.p1, thing.p2, [bool(thing.clockwise), *thing.center]]


def answer(asked: dict[str, Any]) -> dict[str, Any]:
    """Objects in the order of the file and the apertures that they use, in the file's unit.

    Raises LookupError for what gerbonara refuses, or warns about.
    """
    library: Any = importlib.import_module("gerbonara.rs274x")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", message=_HARMLESS)
            file = library.GerberFile.from_string(asked["text"])
            apertures = _Apertures(asked["most"])
            objects = [_told(thing, apertures) for thing in file.objects]
    except _Refused:
        raise
    except Exception as error:
        # Numbers of lines are those of the checked text, not of the file.
        why = re.sub(r"^<unknown>:\d+ ", "", str(error.__cause__ or error).partition("\n")[0])
        raise LookupError(
            f"expected Gerber that gerbonara reads, got: {why[:200].rstrip('.')}; export it anew"
        ) from None
    return {"objects": objects, "apertures": apertures.told}
