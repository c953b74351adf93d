"""What callers ask of received powers, checked once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_number
from polywigner.mitsuba.rendering import check_seed, check_spp

__all__ = ["Asked", "asked_of"]

_MOST_REFLECTIONS = 3


@dataclass(frozen=True)
class Asked:
    """Checked arguments of :func:`polywigner.mitsuba.received_power`; None: as the scene says."""

    spp: int | None
    seed: int
    integrator: Any
    reflections: int
    tolerance: float
    bandwidth: float | None
    temperature: float | None
    noise_figure: float | None

    def noise_of(self, spec: Any) -> dict[str, Any]:
        """Of a receiver: what is asked, else its own."""
        names = ("bandwidth", "temperature", "noise_figure")
        asked = {name: getattr(self, name) for name in names}
        return {n: getattr(spec, n) if value is None else value for n, value in asked.items()}


def asked_of(
    spp: Any,
    seed: Any,
    integrator: Any,
    reflections: Any,
    tolerance: Any,
    bandwidth: Any,
    temperature: Any,
    noise_figure: Any,
) -> Asked:
    """The arguments; ArgumentError for one out of range. Couplings check their tolerance."""
    return Asked(
        None if spp is None else check_spp(spp),
        check_seed(seed),
        integrator,
        _checked_reflections(reflections),
        checked_number(tolerance, "tolerance", "a number"),
        _checked("bandwidth", bandwidth, "above zero, in Hz"),
        _checked("temperature", temperature, "above zero, in K"),
        _checked("noise_figure", noise_figure, "of zero or more, in dB"),
    )


def _checked(name: str, value: Any, meaning: str) -> float | None:
    if value is None:
        return None
    number = checked_number(value, name, f"a number {meaning}")
    if number < 0 or (number == 0 and "above" in meaning):
        raise ArgumentError(f"expected {name} as a number {meaning}, got {value!r}")
    return number


def _checked_reflections(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise ArgumentError(f"expected reflections as a whole number, got {value!r}")
    if not 0 <= value <= _MOST_REFLECTIONS:
        raise ArgumentError(
            f"expected reflections from 0 to {_MOST_REFLECTIONS}, got {value}; ways by more "
            "mirrors are not searched"
        )
    return int(value)
