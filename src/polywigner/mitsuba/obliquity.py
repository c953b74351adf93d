"""From a radiance to a diffraction integral: the factor h(theta) of the emitted radiance.

The Wigner radiance W/lambda^2 leaves the choice of the diffraction integral open. A floor
parallel to the aperture receives (maths: propagation, leading order)

    I = (1/lambda^2) int W g(theta) / |r|^2 dx,

and a renderer that lights it with the radiance L collects int L cos^2(theta) / |r|^2 dx: one
cosine from the emitter, one from the receiver. Hence L = h W/lambda^2 with h = g/cos^2. The
emitter cannot know the receiver, so h is defined by that parallel floor.
"""

from __future__ import annotations

from typing import Any

from polywigner.errors import SceneError

__all__ = ["OBLIQUITIES", "check_obliquity", "emission_factor"]

OBLIQUITIES = ("rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2", "paper")


def check_obliquity(name: str) -> str:
    """``name`` itself, or a SceneError that lists what there is."""
    if name not in OBLIQUITIES:
        raise SceneError(
            f"expected an obliquity, got {name!r}; use one of {', '.join(OBLIQUITIES)}"
        )
    return name


def emission_factor(name: str, cosine: Any) -> Any:
    """h(theta) for the cosine of the angle from the aperture's normal, above zero.

    Floats or arrays of any engine; dimensionless. All but the first grow without bound towards
    grazing directions; the two cosines of a parallel floor make the received part finite again.
    """
    if name == "rayleigh-sommerfeld-1":
        return 1.0
    if name == "paper":
        return 1.0 / cosine
    if name == "rayleigh-sommerfeld-2":
        return 1.0 / (cosine * cosine)
    half = (1.0 + cosine) / (2.0 * cosine)
    return half * half
