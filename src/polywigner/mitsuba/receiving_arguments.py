"""What callers ask of received powers, checked once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.mitsuba.received import noise_power_of
from polywigner.mitsuba.rendering import check_seed, check_spp
from polywigner.quantities import NOISE_PARSERS, parse_noise
from polywigner.reception.couplings import checked_tolerance

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
        asked = {name: getattr(self, name) for name in NOISE_PARSERS}
        noise = {n: getattr(spec, n) if value is None else value for n, value in asked.items()}
        power = noise_power_of(**noise)
        if power is not None and not 0 < power < math.inf:
            raise ArgumentError(
                f"expected noise k T B F of a number of watts, got {power} W from {noise}; check "
                "the units of bandwidth (Hz) and temperature (K)"
            )
        return noise


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
    """The arguments; ArgumentError, QuantityError for one out of range."""
    return Asked(
        None if spp is None else check_spp(spp),
        check_seed(seed),
        integrator,
        _checked_reflections(reflections),
        checked_tolerance(tolerance),
        **parse_noise(bandwidth, temperature, noise_figure),
    )


def _checked_reflections(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise ArgumentError(f"expected reflections as a whole number, got {value!r}")
    if not 0 <= value <= _MOST_REFLECTIONS:
        raise ArgumentError(
            f"expected reflections from 0 to {_MOST_REFLECTIONS}, got {value}; ways by more "
            "mirrors are not searched"
        )
    return int(value)
