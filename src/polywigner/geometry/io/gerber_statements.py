"""Statements of a Gerber file that are read, and the objects that gerbonara makes of them.

gerbonara passes over or mistakes what it does not know (step and repeat, blocks, transformed
apertures), so that a file is checked here first, against what it is known to read rightly. What is
taken from it are places, centres, and parameters of apertures; its drawing of them is not used.
"""

from __future__ import annotations

import importlib
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from polywigner.errors import FileFormatError
from polywigner.geometry.io.limits import token

_PIECE = re.compile(r"\s*(?:(G0?4[^*]*)\*|%([^%]*)%|([^%*]*)\*)")
# A word of codes and numbers, which messages quote; of any other text they tell the length.
_PLAIN = re.compile(r"(?:[GDMXYIJ][-+.\d]{1,12}){1,6}", re.ASCII)
_NUMBER = r"[+-]?\d+"
_LENGTH = r"\+?(?:\d+\.?\d*|\.\d+)"
_NAME = r"[A-Za-z_.$][\w.$-]*"

_OPERATION = re.compile(
    rf"(?P<mode>G0?[123])?(?:X{_NUMBER})?(?:Y{_NUMBER})?"
    rf"(?P<centre>I{_NUMBER}(?:J{_NUMBER})?|J{_NUMBER})?D0?(?P<code>[123])"
)
_FORMAT = re.compile(r"FS[LT]A(X[1-7][1-7])Y(?P<same>[1-7][1-7])")
_SHAPE = re.compile(
    rf"ADD0*(?P<number>[1-9]\d{{1,8}})(?:[CRO],{_LENGTH}(?:X{_LENGTH})*|"
    rf"(?P<polygon>P),{_LENGTH}X\d+(?:X(?P<turn>[+-]?{_LENGTH}))?(?:X{_LENGTH})?|"
    rf"{_NAME}(?:,[+-]?{_LENGTH}(?:X[+-]?{_LENGTH})*)?)"
)
_MACRO = re.compile(rf"AM(?P<name>{_NAME})\*(?P<body>.*)", re.DOTALL)
_MACRO_BLOCK = re.compile(r"(?:\$[1-9]\d*=|(?P<code>\d+),)[-+0-9.$xX/(),]+")
_MACRO_CODES = (1, 4, 5, 20, 21)

# Statements that change nothing: attributes, names, and transformations that are none.
_ZERO = r"[+-]?0*\.?0*"
_ONE = r"\+?0*1(?:\.0*)?"
_NEUTRAL = re.compile(
    r"T[FAOD].*|[IL]N.*|IPPOS|ASAXBY|MI(?:A0)?(?:B0)?|LMN|IR0+|SR|"
    rf"OF(?:A{_ZERO})?(?:B{_ZERO})?|SF(?:A{_ONE})?(?:B{_ONE})?|LR{_ZERO}|LS{_ONE}|"
    rf"SRX0*1Y0*1(?:I{_ZERO})?(?:J{_ZERO})?",
    re.DOTALL,
)
# What is refused, by how it begins, and what to do about it.
_REFUSED = {
    "SR": "step and repeat; export the board without panelling",
    "AB": "an aperture block; export with plain apertures",
    "LM": "mirrored apertures; export with plain apertures",
    "LR": "rotated apertures; export with plain apertures",
    "LS": "scaled apertures; export with plain apertures",
    "IP": "a negative image; export it as positive",
    "AS": "exchanged axes; export without image transformations",
    "MI": "a mirrored image; export without image transformations",
    "IR": "a rotated image; export without image transformations",
    "OF": "a shifted image; export without image transformations",
    "SF": "a scaled image; export without image transformations",
    "IF": "another file to include; export a single file",
    "FS": "a coordinate format that is not absolute, or not alike in x and y; export with %FSLA",
    "G91": "incremental coordinates; export with absolute ones",
    "X": "coordinates without D01, D02 or D03, or not whole numbers; export it anew as RS-274X",
    "Y": "coordinates without D01, D02 or D03, or not whole numbers; export it anew as RS-274X",
}


@dataclass(eq=False)
class _State:
    """State of a Gerber file after the statements so far."""

    kept: list[str] = field(default_factory=list)
    unit: str = ""
    has_format: bool = False
    is_placed: bool = False
    in_region: bool = False
    quadrants: str = ""
    defined: set[str] = field(default_factory=set)
    is_ended: bool = False


def checked_statements(text: str) -> tuple[str, str]:
    """Return the statements of a Gerber file that matter, and its unit "MM" or "IN".

    Raises FileFormatError for statements that are not read, and for files without an end.
    """
    state = _State()
    for statement, is_extended in _statements(text):
        if state.is_ended:
            raise FileFormatError(
                f"expected nothing after M02, which ends a Gerber file, got {_shown(statement)}; "
                "give one layer in one file"
            )
        (_extended if is_extended else _word)(state, statement)
    if not state.is_ended:
        raise FileFormatError(
            "expected Gerber that ends with M02, got a file without; it may be cut short: "
            "export it anew"
        )
    if state.in_region:
        raise FileFormatError("expected G37 after each G36, got none; export it anew")
    return "\n".join(state.kept), state.unit


def _statements(text: str) -> Iterator[tuple[str, bool]]:
    """Each statement without its asterisk, and whether it stands between percent signs."""
    place = 0
    while found := _PIECE.match(text, place):
        place = found.end()
        comment, extended, word = found.groups()
        if extended is not None:
            whole = extended.strip()
            if not whole.endswith("*"):
                raise _unknown(whole)
            macro = whole.startswith("AM")
            for part in [whole] if macro else whole[:-1].split("*"):
                yield part.strip(), True
        elif comment is None and word.strip():
            yield re.sub(r"\s", "", word), False
    if text[place:].strip():
        raise FileFormatError(
            "expected Gerber statements that end with an asterisk, got text without one; "
            "the file may be cut short, or none of Gerber: export it anew"
        )


def _shown(statement: str) -> str:
    words = statement.strip()
    return repr(words) if _PLAIN.fullmatch(words) else token(words)


def _unknown(statement: str) -> FileFormatError:
    words = statement.strip()
    reason = next((why for start, why in _REFUSED.items() if words.startswith(start)), None)
    if reason is None:
        reason = "which is not read; export it anew as RS-274X"
    return FileFormatError(f"expected one layer of plain Gerber, got {_shown(words)}: {reason}")


def _check(condition: bool, expected: str, statement: str) -> None:
    if not condition:
        raise FileFormatError(
            f"expected {expected}, got {_shown(statement)}; export it anew as RS-274X"
        )


def _word(state: _State, word: str) -> None:
    if found := _OPERATION.fullmatch(word):
        _operation(state, found)
    elif word in ("G36", "G37"):
        _check(state.in_region == (word == "G37"), "G36 and G37 by turns", word)
        state.in_region = word == "G36"
    elif word in ("G74", "G75"):
        state.quadrants = word
    elif word in ("G70", "G71"):
        agrees = state.unit == ("IN" if word == "G70" else "MM")
        _check(agrees, "one unit, by %MOMM*% or %MOIN*% first", word)
        return
    elif word == "G90":
        return
    elif re.fullmatch(r"M0?[02]", word):
        state.is_ended = True
    elif re.fullmatch(r"(?:G5[45])?D0*[1-9]\d{1,8}", word):
        number = word.partition("D")[2].lstrip("0")
        _check(number in state.defined, "an aperture that is defined", word)
    elif not re.fullmatch(r"G0?[123]", word):
        raise _unknown(word)
    state.kept.append(re.sub(r"^G(?=[123]\b|[123][XYIJD])", "G0", word) + "*")


def _operation(state: _State, found: re.Match[str]) -> None:
    word, code = found[0], found["code"]
    _check(bool(state.unit) and state.has_format, "%FS and %MO before coordinates", word)
    _check(code == "2" or state.is_placed or code == "3", "D02 before the first D01", word)
    _check(found["centre"] is None or code == "1", "I and J with D01 alone", word)
    if found["centre"]:
        _check(state.quadrants == "G75", "arcs after G75 (of up to a full turn)", word)
    state.is_placed = True


def _extended(state: _State, words: str) -> None:
    if words.startswith("AM"):
        words = _macro(state, words)
    elif found := _SHAPE.fullmatch(words):
        _define(state, found["number"], words)
        if found["turn"] and float(found["turn"]):
            raise FileFormatError(
                f"expected regular polygons with a corner on the right, got {_shown(words)}, which "
                "is rotated; export it as a region"
            )
    elif found := _FORMAT.fullmatch(words):
        _check(not state.has_format, "one %FS", words)
        if found[1][1:] != found["same"]:
            raise _unknown(words)
        state.has_format = True
    elif words in ("MOMM", "MOIN"):
        _check(state.unit in ("", words[2:]), "one unit", words)
        if state.unit:
            return
        state.unit = words[2:]
    elif words in ("LPD", "LPC"):
        _check(not state.in_region, "no change of polarity between G36 and G37", words)
    elif _NEUTRAL.fullmatch(words):
        return
    else:
        raise _unknown(words)
    state.kept.append(f"%{words}*%")


def _define(state: _State, name: str, words: str) -> None:
    _check(bool(state.unit), "%MO before apertures", words)
    _check(name not in state.defined, "each aperture defined once", words)
    state.defined.add(name)


def _macro(state: _State, words: str) -> str:
    """The macro without comments and blanks, of primitives that are read alone."""
    found = _MACRO.fullmatch(words)
    if not found:
        raise _unknown(words)
    _define(state, found["name"], words)
    blocks = []
    for text in found["body"].split("*"):
        block = text.strip()
        if not block or re.match(r"0(?![\d,.])", block):
            continue
        block = re.sub(r"\s", "", block)
        plain = _MACRO_BLOCK.fullmatch(block)
        if not plain or (plain["code"] and int(plain["code"]) not in _MACRO_CODES):
            raise FileFormatError(
                "expected macros of circles, outlines, polygons and lines "
                f"(codes 1, 4, 5, 20, 21), got {_shown(block)}; export it as a region"
            )
        blocks.append(block)
    return f"AM{found['name']}*" + "*".join(blocks)


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

    def __init__(self) -> None:
        self.told: list[list[Any]] = []
        self._numbers: dict[int, int] = {}

    def number(self, aperture: Any) -> int:
        if aperture is None:
            raise FileFormatError(
                "expected an aperture before D01 and D03, got none; export it anew"
            )
        if id(aperture) not in self._numbers:
            self._numbers[id(aperture)] = len(self.told)
            self.told.append(self._parameters(aperture))
        return self._numbers[id(aperture)]

    def _parameters(self, aperture: Any) -> list[Any]:
        kind = type(aperture).__name__
        if kind in _FIELDS:
            return [kind, *(getattr(aperture, name) for name in _FIELDS[kind])]
        bound = dict(enumerate(aperture.parameters, start=1))
        return ["macro", [_primitive(p, bound, aperture.unit) for p in aperture.macro.primitives]]


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


def objects_of(text: str) -> tuple[list[list[Any]], list[list[Any]]]:
    """Objects in the order of the file and the apertures that they use, in the file's unit.

    Raises FileFormatError for what gerbonara refuses, or warns about.
    """
    library: Any = importlib.import_module("gerbonara.rs274x")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", message=_HARMLESS)
            file = library.GerberFile.from_string(text)
            apertures = _Apertures()
            objects = [_told(thing, apertures) for thing in file.objects]
    except FileFormatError:
        raise
    except Exception as error:
        # Numbers of lines are those of the checked text, not of the file.
        why = re.sub(r"^<unknown>:\d+ ", "", str(error.__cause__ or error).partition("\n")[0])
        raise FileFormatError(
            f"expected Gerber that gerbonara reads, got: {why[:200].rstrip('.')}; export it anew"
        ) from None
    return objects, apertures.told
