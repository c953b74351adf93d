"""Powers by which links are divided."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, IlluminationError, PolywignerError
from polywigner.propagation.far_fields import powers_of
from polywigner.propagation.vector_fields import polarised_parts, vector_powers
from polywigner.radiometry.directions import directions_and_weights, largest_lag
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import CONDITIONS, DEFAULT, Obliquity
from polywigner.transforms import fourier
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.wavefronts import flat_source

Complex = NDArray[np.complex128]

NORMALISATIONS = ("radiated", "aperture")
"""Powers of a source that links use: radiated into the half space in front, or int |u|^2."""

# Fraction of the power of its elements below which a source cancels itself.
_DARK = 1e-12


def checked_normalise(name: Any, error: type[PolywignerError] = ArgumentError) -> str:
    """Return ``name``, or raise the error with the valid names."""
    if not isinstance(name, str) or name not in NORMALISATIONS:
        names = " or ".join(f'"{known}"' for known in NORMALISATIONS)
        raise error(f"expected normalise to be {names}, got {name!r}")
    return str(name)


def root_of_norm(
    source: Any, wavelength: float, method: str, normalise: str, jones: Complex | None = None
) -> float:
    """Return the square root of a source's power in W for |u|^2 in W/m^2, a divisor of couplings.

    ``radiated``: the power that a source radiates with the boundary condition of the method, which
    uses u for the field or its normal derivative, as in (RX1); with Jones vectors (2,) or (k, 2)
    the power of its currents. ``aperture``: int |u|^2.

    Raises IlluminationError for a source that cancels itself, or radiates nothing.
    """
    key = None if jones is None else (jones.tobytes(), jones.shape)  # arrays have no hash
    return _root_of_norm(source, wavelength, method, normalise, key)


@lru_cache(maxsize=128)
def _root_of_norm(source: Any, wavelength: float, method: str, normalise: str, jones: Any) -> float:
    if jones is not None:
        parts = polarised_parts(source, np.frombuffer(jones[0], complex).reshape(jones[1]))
        if normalise == "aperture":
            return math.sqrt(sum(energy_of(part) for part, _ in parts))
        return math.sqrt(vector_powers(parts, wavelength, method)[0])
    _check_field(source)
    if normalise == "aperture":
        return math.sqrt(energy_of(source))
    condition = CONDITIONS[method if method in CONDITIONS else DEFAULT]
    form = normal_form(source)
    if not condition.needs_normal_derivative or (form.is_flat and not form.frequencies.any()):
        return math.sqrt(powers_of(source, wavelength, condition.name)[0])
    return math.sqrt(_radiated(source, wavelength, condition))


def _check_field(source: Any) -> None:
    norm = energy_of(flat_source(source))  # a curved wave has the same modulus
    parts: float = sum(
        (abs(e.weight) * float(np.abs(e.amplitudes).max())) ** 2 * e.shape.area
        for e in normal_form(source).in_plane.elements
    )
    if not norm > _DARK * parts:
        raise IlluminationError(
            f"expected a source with a field, got elements that cancel, int |u|^2 = {norm:.3g}"
        )


def _radiated(source: Any, wavelength: float, condition: Obliquity) -> float:
    """Return int g |F|^2 dOmega/lambda^2 in W, with u as the boundary condition requires it."""
    power = 0.0
    for directions, solid_angle in directions_and_weights(largest_lag(source), wavelength):
        factor = condition.amplitude(directions[:, 2]) ** 2 * solid_angle / wavelength**2
        power += float(np.square(np.abs(fourier(source, directions[:, :2] / wavelength))) @ factor)
    return power
