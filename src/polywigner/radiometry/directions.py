"""Directions to which sources radiate, and bands of frequencies as means over wavelengths."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, Slits, Wavefront
from polywigner.geometry.arguments import checked_number, checked_vectors
from polywigner.illumination import Array
from polywigner.numerics.nodes import flat_rule
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.transforms.wavefronts import checked_wavefront

# Bandwidth times the time that light takes across the source: some so many wavelengths are summed.
_MOST_SPREAD = 500.0
_MEANING = "a bandwidth in Hz above zero, and less than twice the frequency"


def checked_bandwidth(bandwidth: Any, wavelength: float) -> float:
    """Return a bandwidth in Hz about a wavelength in m; ArgumentError if it reaches zero."""
    width = checked_number(bandwidth, "bandwidth", _MEANING)
    carrier = SPEED_OF_LIGHT / wavelength
    if not 0 < width < 2 * carrier:
        raise ArgumentError(
            f"expected {_MEANING}, {2 * carrier:.4g} Hz, got {bandwidth!r}; leave it out for one "
            "wavelength"
        )
    return width


def wavelengths_of_band(
    wavelength: float, bandwidth: float, lag: float, error: float
) -> list[tuple[float, float]]:
    """(wavelength, weight) for the mean over the band, of a source ``lag`` m across."""
    spread = bandwidth * lag / SPEED_OF_LIGHT
    if not spread <= _MOST_SPREAD:
        raise ArgumentError(
            f"expected a bandwidth of at most {_MOST_SPREAD * SPEED_OF_LIGHT / lag:.4g} Hz for a "
            f"source of {lag:.4g} m, got {bandwidth:g}, of which some {spread:.3g} wavelengths "
            "would be summed up; check its unit, or compute parts of the band"
        )
    nodes, weights = flat_rule(math.pi * spread, error)
    frequencies = SPEED_OF_LIGHT / wavelength + bandwidth / 2 * nodes
    return list(zip((SPEED_OF_LIGHT / frequencies).tolist(), weights.tolist(), strict=True))


PlaneSource = Aperture | Array

# Directions that passed through single precision pass.
_UNIT = 1e-6


def checked_radiator(source: Any, partly: bool = False) -> PlaneSource | Wavefront:
    """Return a source of :func:`checked_source`, or one with a curved wave.

    ``partly``: it may be partly coherent; else that raises IlluminationError.
    """
    if not isinstance(source, Wavefront):
        return checked_source(source)
    checked_source(source.source)
    return source if partly else checked_wavefront(source)


def checked_source(source: Any) -> PlaneSource:
    """An aperture, or an array of apertures in the plane z = 0.

    Raises ArgumentError for anything else, GeometryError for an array with elements elsewhere.
    """
    if isinstance(source, Aperture):
        return source
    flat: Any = source
    if isinstance(source, Array):
        flat = source.repeated[0] if source.repeated is not None else source.elements_in_plane[0]
    if not isinstance(source, Array) or isinstance(flat, Slits):
        advice = {
            "Slits": "make rectangles of slits, power needs an area",
            "PlacedAperture": "use its .aperture, and directions relative to it",
            "Polyhedron": "a body has a Fourier transform only",
            "Wavefront": "use its .source, whose wave is flat and coherent",
        }.get(type(flat).__name__, "make one by Aperture(...) of a ring or of shapely polygons")
        raise ArgumentError(
            "expected an Aperture, or an Array of apertures in the plane z = 0, got "
            f"{type(flat).__name__}; {advice}"
        )
    # poses within the plane applied: spatial frequencies then have two components
    return source if source.dimension == 2 else Array(source.elements_in_plane, source.weights)


def checked_directions(directions: Any) -> NDArray[np.float64]:
    """Unit vectors (..., 3) into z >= 0, as given; ArgumentError for others."""
    _check_numpy("direction", directions)
    array = checked_unit_vectors("direction", directions)
    back = array[..., 2] < 0
    if back.any():
        raise ArgumentError(
            "expected a direction into z >= 0, to which the aperture radiates, got "
            f"{array[back][0].tolist()}"
        )
    return array


def checked_positions(x: Any) -> NDArray[np.float64]:
    """Positions (..., 2) on the aperture, in metres; ArgumentError for anything else."""
    _check_numpy("x", x)
    array = checked_vectors(x, "expected finite positions x of shape (..., 2)", (2,))
    if not np.isfinite(array).all():
        raise ArgumentError("expected finite positions x, got inf or nan; leave them out")
    return array


def checked_unit_vectors(name: str, vectors: Any) -> NDArray[np.float64]:
    """Vectors (..., 3) of length 1 after rounding, as given; ArgumentError for others."""
    expected = f"expected {name} as unit vectors of shape (..., 3)"
    array = checked_vectors(vectors, expected, (3,))
    length = np.linalg.norm(array, axis=-1)
    wrong = ~(np.abs(length - 1) <= _UNIT)
    if wrong.any():
        raise ArgumentError(
            f"{expected}, got {array[wrong][0].tolist()}, of length {length[wrong][0]:.6g}; "
            "divide it by its length"
        )
    return array


def _check_numpy(name: str, values: Any) -> None:
    if execution.is_drjit(values):
        raise ArgumentError(
            f"expected {name} as a NumPy array, got a Dr.Jit array; use {name}.numpy(), or "
            "polywigner.wigner and polywigner.fourier, which take both"
        )
