"""The radiance of a source for each diffraction integral: the factor h of W/lambda^2.

The Wigner radiance W/lambda^2 leaves the choice of the diffraction integral open. Each of them has
a far field whose radiant intensity is g |F|^2/lambda^2, and radiance, an integral over the source
of which is intensity over the cosine, is

    L = h W/lambda^2,    h = g/cos(theta).

So the power that leaves is that of the far field, and a surface receives |U|^2 times its own
cosine, to leading order (R1). With g = cos, the paper's flux, h is 1.
"""

from __future__ import annotations

from typing import Any

from polywigner.errors import SceneError
from polywigner.geometry import Wavefront
from polywigner.illumination import obliquities
from polywigner.illumination.obliquities import Forms, fields_of, grazing_error, weighted_sources
from polywigner.propagation.far_fields import check_slopes
from polywigner.transforms.wavefronts import flat_of

__all__ = ["OBLIQUITIES", "check_obliquity", "depends_on_wavelength", "emissions"]

OBLIQUITIES = tuple(obliquities.OBLIQUITIES)


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
    return obliquities.OBLIQUITIES[name].takes_slopes and any(field is not None for field in fields)


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
