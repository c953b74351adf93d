"""The far field of a source over directions, for each boundary condition, and its power."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, IlluminationError
from polywigner.execution import Engine, Precision
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import checked_wavelength, takes_frequency
from polywigner.illumination import Array
from polywigner.illumination.obliquities import (
    DEFAULT,
    OBLIQUITIES,
    ObliquityName,
    direction_cosines,
    times_direction_cosine,
    warn_of_slopes,
)
from polywigner.illumination.tapers import uniform
from polywigner.propagation.places import checked_name
from polywigner.radiometry.directions import PlaneSource, checked_radiator
from polywigner.radiometry.flux import radiant_intensity
from polywigner.radiometry.hemisphere import directions_and_weights, largest_lag
from polywigner.transforms import fourier
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.wavefronts import flat_of, is_partly_coherent

# Rounding leaves 1e-13 of the energy; a directivity relative to less than this has no digits.
_DARK = 1e-12

# Wider sources take the closed form (RP3), which is off by 1e-5 of int |u|^2 from here on; the
# integral over directions takes seconds here, and minutes at ten times the width.
_WIDE = 600.0
# Area over perimeter, in wavelengths, of outlines without parts as narrow as a wavelength.
_BROAD = 100.0
# Cosine of waves nearer to grazing, of which (RP3) is not sure.
_STEEP = 0.3
# Nodes along an edge, and more for each cycle that |u|^2 has along it.
_NODES, _PER_CYCLE = 8, 4


def far_field(
    source: Any,
    directions: NDArray[np.float64],
    wavelength: float,
    obliquity: str,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> NDArray[Any]:
    """lim r exp(-i k r) U(r s) (...), complex, at unit vectors s (..., 3): docs/patterns.md, (RP1).

    In m times the unit of u; zero where z < 0.
    """
    nu, cosine = directions[..., :2] / wavelength, directions[..., 2]
    front = np.maximum(cosine, 0.0)

    def spectrum(turned: bool) -> Any:
        try:
            field = times_direction_cosine(source, wavelength) if turned else source
        except IlluminationError:  # all waves graze the plane: their cosines are zero
            return 0.0
        return fourier(field, nu, precision=precision, engine=engine)

    condition = OBLIQUITIES[obliquity]
    if not condition.is_boundary_condition:
        total = np.sqrt(front) * spectrum(False)
    else:
        total = condition.field * front * spectrum(False) if condition.field else 0.0
        total = total + condition.slope * spectrum(True) if condition.takes_slopes else total
    values = np.where(cosine < 0, 0.0, total / (1j * wavelength))
    return values.astype(np.complex64 if precision == "single" else np.complex128)


@takes_frequency
def radiated_power(
    source: PlaneSource | Wavefront,
    wavelength: float,
    obliquity: ObliquityName = DEFAULT,
) -> float:
    """Power that leaves through the far hemisphere, P = int |E|^2 dOmega (docs/patterns.md, (RP2)).

    With ``obliquity="paper"`` it is :func:`power`. It differs from int |u|^2 by what is evanescent
    and by the boundary condition: small patches radiate a seventh.

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, |u|^2 on it in W/m^2; or one with a
        curved or partly coherent wave.
    wavelength : in m.
    obliquity : as of :func:`radiation_pattern`.

    Returns
    -------
    In W, to 1e-12 of int |u|^2; of flat sources wider than 600 wavelengths whose elements are broad
    to 1e-5 of it (1e-3 where elements touch), by (RP3) of docs/patterns.md. Cost else: F in some
    15 (diameter/wavelength)^2 + 1000 directions.

    Raises
    ------
    ArgumentError for arguments of the wrong type or range; IlluminationError for a source that
    radiates nothing; GeometryError for an Array whose elements do not lie in the plane z = 0.

    >>> import polywigner as pw
    >>> patch = pw.shapes.rectangle(1.2e-3, 0.9e-3)  # |u|^2 = 1 W/m^2 on 1.08 mm^2
    >>> round(pw.radiated_power(patch, 3.9e-3) / patch.area, 3)
    0.135
    """
    name = checked_name("obliquity", obliquity, OBLIQUITIES)
    radiator, length = checked_radiator(source, partly=True), checked_wavelength(wavelength)
    check_slopes(radiator, name)
    warn_of_slopes(flat_of(radiator), length, name)
    return powers_of(radiator, length, name)[0]


def check_slopes(source: PlaneSource | Wavefront, name: str) -> None:
    """Raise ArgumentError for an obliquity that takes the slopes of a curved wave, or of tilts.

    They are those of waves in all directions at once, of which there is no closed form.
    """
    if isinstance(source, Wavefront) and OBLIQUITIES[name].takes_slopes:
        raise ArgumentError(
            'expected obliquity "rayleigh-sommerfeld-1" or "paper" for a curved wave or partly '
            f"coherent light, got {name!r}, whose factor differs from place to place and from tilt "
            "to tilt; amplitude has it near by, of coherent light"
        )


def powers_of(
    source: PlaneSource | Wavefront, wavelength: float, obliquity: str
) -> tuple[float, float]:
    """The radiated power and int |u|^2, in W.

    Raises IlluminationError for a source that radiates nothing.
    """
    if largest_lag(source) > _WIDE * wavelength:
        wide = _wide_powers(source, wavelength, obliquity)
        if wide is not None:
            return wide
    blocks = directions_and_weights(largest_lag(source), wavelength)
    power = float(sum(w @ _intensity(source, s, wavelength, obliquity) for s, w in blocks))
    energy = energy_of(source)
    if not power > _DARK * max(0.0, energy):
        raise IlluminationError(
            f"expected a source that radiates at a wavelength of {wavelength:g} m, got one whose "
            f"far field carries {power:.3g} W; check the unit of the wavelength, and whether waves "
            "graze the aperture or cancel"
        )
    return power, energy


def _wide_powers(
    source: PlaneSource | Wavefront, wavelength: float, obliquity: str
) -> tuple[float, float] | None:
    """Radiated power and int |u|^2 in W by (RP3), or None for a source that it is not for."""
    if isinstance(source, Wavefront):
        return None
    weights = source.weights if isinstance(source, Array) else np.ones(1)
    power = energy = 0.0
    for element, weight in zip(source.elements_in_plane, np.abs(weights) ** 2, strict=True):
        found = _broad_powers(element, wavelength, obliquity)
        if found is None:
            return None
        power, energy = power + weight * found[0], energy + weight * found[1]
    # what overlaps is not a sum of powers
    whole = energy_of(source)
    return (power, whole) if abs(energy - whole) < _DARK**0.5 * whole else None


def _broad_powers(
    element: Aperture, wavelength: float, obliquity: str
) -> tuple[float, float] | None:
    """Radiated power and int |u|^2 of an aperture in W: (RP3), waves by their cosines."""
    outline = element.with_illumination(None)
    field: Any = element.illumination
    if not outline.area > _BROAD * outline.polygons.length * wavelength:
        return None
    field = uniform() if field is None else field
    c, kappa = field.amplitudes, field.frequencies
    p = direction_cosines(kappa, wavelength)
    if not (p.real > _STEEP).all():
        return None
    condition = OBLIQUITIES[obliquity]
    cosine = direction_cosines((kappa[:, None] + kappa) / 2, wavelength).real
    inside = condition.of_pairs(cosine, p[:, None].real, p.real)
    products = c[:, None] * c.conj() * fourier(outline, kappa - kappa[:, None])
    power = float((products * (inside / cosine)).sum().real)

    strength = np.abs(c) ** 2 / (np.abs(c) ** 2).sum()
    middle, at = strength @ kappa, float(strength @ p.real)
    for ring in outline.rings:
        edges = np.roll(ring, -1, axis=0) - ring
        cycles = np.abs((kappa - middle) @ edges.T).max()
        node, weight = np.polynomial.legendre.leggauss(_NODES + math.ceil(_PER_CYCLE * cycles))
        places = ring[:, None] + edges[:, None] * ((node + 1) / 2)[:, None]
        length = np.hypot(*edges.T)
        around = length * (np.square(np.abs(field(places))) @ weight) / 2
        # sine of half the disc of directions along the edge's normal
        across = np.sqrt(1 - np.square(wavelength * (edges @ middle) / length))
        lost = math.pi * condition.field**2 + 4 * condition.field * condition.slope * across / at
        lost = lost if condition.is_boundary_condition else 2 * across / at**2
        power -= float(around @ np.broadcast_to(lost, around.shape)) * wavelength / (4 * math.pi**2)
    return power, float(products.sum().real)


def _intensity(
    source: PlaneSource | Wavefront, directions: NDArray[np.float64], wavelength: float, name: str
) -> NDArray[np.float64]:
    """Radiant intensity (n,) in W/sr at unit vectors (n, 3) of the front."""
    if not is_partly_coherent(source):
        return np.square(np.abs(far_field(source, directions, wavelength, name)))
    # its factor is the paper's cosine, of Rayleigh-Sommerfeld I the square
    factor = 1.0 if name == "paper" else directions[:, 2]
    return np.asarray(radiant_intensity(source, directions, wavelength) * factor)
