"""First-order systems as texts: what the light passes, in its order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from polywigner.errors import QuantityError
from polywigner.quantities import parse_angle, parse_coordinate

if TYPE_CHECKING:
    from polywigner import FirstOrder

__all__ = ["system_from"]

_EXAMPLE = '"space 50 mm, lens 50 mm, space 50 mm"'


def system_from(text: str) -> FirstOrder:
    """The system of a text: parts with commas between them, the first is passed first.

    Parts are ``space z``, ``lens f``, ``lens fx fy`` with ``inf`` for none, ``magnifier m``,
    ``fourier f``, ``fractional order f`` and ``turn angle``. Raises QuantityError for others.
    """
    import polywigner as pw

    system = pw.FirstOrder.magnifier(1.0)
    for part in text.split(","):
        system = _part(part) @ system
    return system


def _part(text: str) -> FirstOrder:
    from polywigner import FirstOrder

    kind, _, rest = text.strip().partition(" ")
    rest = rest.strip()
    if kind == "space":
        return FirstOrder.free_space(parse_coordinate(rest))
    if kind == "lens":
        focal = tuple(map(_focal_length, _quantities(rest)))
        return FirstOrder.lens(focal[0] if len(focal) == 1 else focal)  # type: ignore[arg-type]
    if kind == "magnifier":
        return FirstOrder.magnifier(_number(rest, "magnification"))
    if kind == "fourier":
        return FirstOrder.fourier(parse_coordinate(rest))
    if kind == "fractional":
        order, _, scale = rest.partition(" ")
        return FirstOrder.fractional(_number(order, "order"), parse_coordinate(scale))
    if kind == "turn":
        return FirstOrder.rotation(parse_angle(rest))
    raise QuantityError(
        f"expected a system such as {_EXAMPLE}, of space, lens, magnifier, fourier, fractional and "
        f"turn, got {text.strip()[:40]!r}"
    )


def _quantities(text: str) -> list[str]:
    """Numbers with the units behind them."""
    found: list[str] = []
    for word in text.split():
        if found and word[0].isalpha() and word != "inf":
            found[-1] += f" {word}"
        else:
            found.append(word)
    return found or [text]


def _focal_length(text: str) -> float:
    return float("inf") if text == "inf" else parse_coordinate(text)


def _number(text: str, what: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise QuantityError(
            f"expected the {what} as a number, as in a system {_EXAMPLE}, got {text[:40]!r}"
        ) from None
