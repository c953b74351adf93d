"""From a radiance to a diffraction integral: the factor h of the emitted radiance.

The Wigner radiance W/lambda^2 leaves the choice of the diffraction integral open. A floor
parallel to the aperture receives (R1), to leading order,

    I = (1/lambda^2) int W g / |r|^2 dx,

and a renderer that lights it with the radiance L collects int L cos^2(theta) / |r|^2 dx: one
cosine from the emitter, one from the receiver. Hence L = h W/lambda^2 with h = g/cos^2. The
emitter cannot know the receiver, so h is defined by that parallel floor.
"""

from __future__ import annotations

from typing import Any

from polywigner.errors import SceneError
from polywigner.geometry import Wavefront
from polywigner.illumination.direction_cosines import fields_of, grazing_error
from polywigner.illumination.obliquities import (
    OBLIQUITIES,
    Forms,
    emission_factor,
    takes_slopes,
    weighted_sources,
)
from polywigner.propagation.far_fields import check_slopes
from polywigner.transforms.wavefronts import flat_of

__all__ = [
    "OBLIQUITIES",
    "check_obliquity",
    "depends_on_wavelength",
    "emission_factor",
    "emissions",
]


def check_obliquity(name: str) -> str:
    """``name`` itself, or a SceneError that lists what there is."""
    if name not in OBLIQUITIES:
        raise SceneError(
            f"expected an obliquity, got {name!r}; use one of {', '.join(OBLIQUITIES)}"
        )
    return name


def depends_on_wavelength(source: Any, name: str) -> bool:
    """Whether `emissions` do: if the directions of waves matter and there are oblique ones."""
    fields = fields_of(flat_of(source))
    return takes_slopes(name) and any(field is not None for field in fields)


def emissions(source: Any, wavelength: float, name: str) -> list[tuple[Any, Forms]]:
    """Sources whose W, each times h of its forms, add up to the radiance times wavelength^2.

    Raises IlluminationError where nothing radiates, because all waves graze the aperture, and
    ArgumentError for an obliquity that takes the slopes of a curved wave.
    """
    check_slopes(source, check_obliquity(name))
    found = weighted_sources(flat_of(source), name, wavelength)
    if not any(any(forms) for _, forms in found):
        raise grazing_error(wavelength)
    if isinstance(source, Wavefront):
        return [(source.on(field), forms) for field, forms in found]
    return found
