"""The state of the explorer as one immutable value; to and from the text of a link."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, get_args
from urllib.parse import parse_qsl, quote, urlencode

from polywigner.errors import ArgumentError, PolywignerError
from polywigner.geometry import Aperture, shapes
from polywigner.quantities import parse_frequency, parse_length, wavelength_of

Unit = Literal["m", "cm", "mm", "µm", "nm"]
Part = Literal["level", "real", "phase"]

UNITS: Mapping[str, int] = {"m": 1, "cm": 100, "mm": 1000, "µm": 10**6, "nm": 10**9}
"""Number of each unit in a metre: dividing by it rounds a typed length correctly."""

CATALOGUE: Mapping[str, Callable[[], Aperture]] = {
    "square": lambda: shapes.square(10),
    "rectangle": lambda: shapes.rectangle(12, 8),
    "triangle": lambda: shapes.triangle(12, 10),
    "hexagon": lambda: shapes.regular_polygon(6, 6),
    "octagon": lambda: shapes.regular_polygon(8, 6),
    "disc": lambda: shapes.disc(5, 32),
    "ring": lambda: shapes.ring(6, 3, 24),
    "star": lambda: shapes.star(5, 7, 3),
    "chevron": lambda: shapes.chevron(20, 12, 4),
    "two chevrons": lambda: shapes.chevron_pair(20, 12, 4),
    "vee": lambda: shapes.vee(12, 10, 2),
    "u shape": lambda: shapes.u_shape(12, 10, 3),
    "bow-tie": lambda: shapes.bow_tie(14, 8, 1),
    "double slit": lambda: shapes.double_slit(2, 12, (-4, 4)),
    "18 hexagons": lambda: shapes.hexagonal_segments(2.5, 0.1),
}
"""Shapes of some ten units, whatever the unit."""


Point = tuple[float, float]
Ring = tuple[Point, ...]

MOST_VERTICES = 1000
"""Most vertices with handles to drag; a transform of a thousand edges takes seconds."""
MOST_RINGS = 100

_LONGEST_TEXT = 100
_FROM_ZERO = ("coherence", "distance", "reach", "snap")
_LARGEST = 1e12  # of any number, in units: nothing overflows in squares
_SQUARE: tuple[Ring, ...] = (((-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0)),)


@dataclass(frozen=True)
class State:
    """Aperture, light and views of the page. Lengths are in ``unit``, exactly as typed.

    Raises
    ------
    ArgumentError for values of the wrong kind or out of range, QuantityError for a wave that is
    none. Outlines need not be polygons: they cross themselves while they are dragged.
    """

    rings: tuple[Ring, ...] = _SQUARE
    """Outlines; those inside others are holes."""
    unit: Unit = "mm"
    wave: str = "94 GHz"
    """A frequency or a wavelength."""
    taper: str = ""
    """Taper of the element, as :func:`polywigner.illumination.texts.fed` takes it; "" for none."""
    array: str = ""
    window: str = ""
    steering: str = ""
    polarisation: str = ""
    """Polarisation of the far field, as :func:`polywigner.field` takes it; "" for a scalar one."""
    x: Point = (0.0, 0.0)
    """The chosen position, in units."""
    nu: Point = (0.0, 0.0)
    """The chosen spatial frequency, in cycles per unit."""
    coherence: float = 0.0
    """Width over which the source is coherent, in units; 0: all of it."""
    defocus: float = 0.0
    """W20 at the farthest vertex, in waves."""
    distance: float = 50.0
    """Distance of the plane of the near field from the source."""
    order: int = 1
    """Order of Wigner rays in the lag, 1 or 3."""
    reach: float = 0.0
    """Largest direction cosine shown; 0: eight lobes, or all that propagates."""
    part: Part = "level"
    """The part of the Fourier transform that is shown."""
    snap: float = 0.0
    """Step of the raster that vertices are dragged to, in units; 0: none."""

    def __post_init__(self) -> None:
        if self.unit not in UNITS:
            raise ArgumentError(f"expected a unit among {', '.join(UNITS)}, got {self.unit!r}")
        if self.part not in get_args(Part):
            raise ArgumentError(f"expected part among {', '.join(get_args(Part))}")
        if self.order not in (1, 3):
            raise ArgumentError(f"expected order 1 or 3, got {self.order!r}")
        object.__setattr__(self, "rings", _checked_rings(self.rings))
        for name in ("x", "nu"):
            object.__setattr__(self, name, _checked_point(name, getattr(self, name)))
        for name, low in (("defocus", -_LARGEST), *((n, 0) for n in _FROM_ZERO)):
            object.__setattr__(self, name, _checked_number(name, getattr(self, name), low))
        if not self.distance > 0 or self.reach > 1:
            raise ArgumentError("expected a distance above zero, and a reach of at most 1")
        for name in ("wave", "taper", "array", "window", "steering", "polarisation"):
            text = getattr(self, name)
            if not isinstance(text, str) or len(text) > _LONGEST_TEXT:
                raise ArgumentError(f"{name}: expected a text of at most {_LONGEST_TEXT} letters")
        self.wavelength  # noqa: B018 (its error)

    @property
    def wavelength(self) -> float:
        """In m."""
        try:
            return wavelength_of(parse_frequency(self.wave))
        except PolywignerError:
            pass
        try:
            return parse_length(self.wave)
        except PolywignerError:
            raise ArgumentError(
                'expected a frequency or a wavelength such as "94 GHz" or "3.19 mm", got '
                f"{self.wave!r}"
            ) from None

    @property
    def per_metre(self) -> int:
        """Units in a metre."""
        return UNITS[self.unit]

    def metres(self, length: float) -> float:
        """A length in units as metres, correctly rounded."""
        return length / self.per_metre

    def moved(self, **changes: Any) -> State:
        """A state with some values replaced."""
        return replace(self, **changes)


def _checked_number(name: str, value: Any, low: float = -_LARGEST) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not low <= number <= _LARGEST:
        raise ArgumentError(f"{name}: expected a finite number from {low:g}, got {value!r}")
    return number


def _checked_point(name: str, value: Any) -> Point:
    try:
        first, second = value
    except (TypeError, ValueError):
        raise ArgumentError(f"{name}: expected two numbers, got {value!r}") from None
    return _checked_number(name, first), _checked_number(name, second)


def _checked_rings(rings: Any) -> tuple[Ring, ...]:
    checked = tuple(tuple(_checked_point("a vertex", p) for p in ring) for ring in rings)
    count = sum(map(len, checked))
    if len(checked) > MOST_RINGS or count > MOST_VERTICES:
        raise ArgumentError(
            f"expected at most {MOST_RINGS} outlines with {MOST_VERTICES} vertices, got "
            f"{len(checked)} with {count}; use polywigner transform for such a file"
        )
    return checked


def to_query(state: State) -> str:
    """The state as the query of a link, without defaults."""
    plain = State()
    texts = {
        field.name: _text(getattr(state, field.name))
        for field in fields(State)
        if field.name != "rings" and getattr(state, field.name) != getattr(plain, field.name)
    }
    outline = ";".join(" ".join(map(_text, ring)) for ring in state.rings)
    return urlencode({"rings": outline, **texts}, quote_via=quote, safe=",;")


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ",".join(map(_text, value))
    if isinstance(value, float):
        return repr(value).removesuffix(".0")
    return str(value)


def from_query(query: str) -> State:
    """The state of a link.

    Raises ArgumentError for a link that is damaged, or of values that cannot be shown.
    """
    known: dict[str, Any] = {field.name: type(field.default) for field in fields(State)}
    values: dict[str, Any] = {}
    for name, text in parse_qsl(query.removeprefix("?"), keep_blank_values=True):
        if name not in known:
            raise ArgumentError(f"expected the link of an explorer, got one with {name[:20]!r}")
        kind = known[name]
        try:
            if name == "rings":
                values[name] = [[p.split(",") for p in r.split()] for r in text.split(";") if r]
            else:
                values[name] = text.split(",") if kind is tuple else kind(text)
        except ValueError:
            raise ArgumentError(
                f"expected a number for {name}, got {text[:40]!r}; the link is damaged"
            ) from None
    return State(**values)


_LONGEST = 200


@dataclass(frozen=True)
class History:
    """States before and after the present one; only the last 200 are kept."""

    present: State = field(default_factory=State)
    past: tuple[State, ...] = ()
    future: tuple[State, ...] = ()

    def then(self, state: State) -> History:
        """Return a history with a new present; an equal state is no step."""
        if state == self.present:
            return self
        return History(state, (*self.past, self.present)[-_LONGEST:])

    def instead(self, state: State) -> History:
        """With another present that is no step of its own, as in the middle of a drag."""
        return History(state, self.past, self.future)

    def undone(self) -> History:
        """One step back, where there is one."""
        if not self.past:
            return self
        return History(self.past[-1], self.past[:-1], (self.present, *self.future))

    def redone(self) -> History:
        """One step forward again, where there is one."""
        if not self.future:
            return self
        return History(self.future[0], (*self.past, self.present), self.future[1:])


_SOURCE = frozenset({"rings", "unit", "wave", "taper", "array", "window", "steering"})
_NEEDS: Mapping[str, frozenset[str]] = {
    "fourier": _SOURCE | {"reach", "part"},
    "wigner_nu": _SOURCE | {"x", "reach", "coherence"},
    "wigner_x": _SOURCE | {"nu", "coherence"},
    "otf": _SOURCE | {"defocus"},
    "far": _SOURCE | {"reach", "polarisation"},
    "near": _SOURCE | {"distance", "order"},
    "values": _SOURCE | {"x", "nu", "coherence"},
}
_PLAIN = State()
_NAMES = tuple(field.name for field in fields(State))


def needed(state: State, name: str) -> State:
    """The state with all that a view does not depend on as it is at the start."""
    others = {field: getattr(_PLAIN, field) for field in _NAMES if field not in _NEEDS[name]}
    return state.moved(**others)
