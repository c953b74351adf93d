"""Sources with a curved wave: the flat source, and F as Fresnel integrals along edges."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import IlluminationError
from polywigner.execution import check_not_stopped
from polywigner.geometry import Aperture, Slits, Wavefront
from polywigner.illumination import Array
from polywigner.kernels.boundary.chirps import chirp_over_intervals, chirp_over_rings

__all__ = ["checked_wavefront", "chirp_transform", "flat_of", "principal_axes"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def flat_of(source: Any) -> Any:
    """The flat source of a Wavefront; any other source as it is."""
    return source.source if isinstance(source, Wavefront) else source


def checked_wavefront(wave: Wavefront) -> Wavefront:
    """The source, unless it is one that transforms do not take.

    Raises IlluminationError for one that is partly coherent.
    """
    if not wave.is_coherent:
        raise IlluminationError(
            "expected a coherent source, got one that is coherent over "
            f"{wave.coherence_width:g} m, of which there is no field with a phase; use "
            "polywigner.irradiance or radiant_intensity, which take it"
        )
    return wave


def principal_axes(curvature: Floats) -> tuple[Floats, Floats]:
    """Curvatures (d,) along the axes that are the columns of a rotation (d, d)."""
    if not np.any(curvature - np.diag(np.diagonal(curvature))):
        return np.diagonal(curvature).copy(), np.eye(len(curvature))
    values, axes = np.linalg.eigh(curvature)
    return values, axes


def chirp_transform(source: Any, q: Floats, axes: Floats, centre: Floats, nu: Floats) -> Complex:
    """int u(x) exp(i pi (x - c).Q (x - c) - 2 pi i nu.x) dx at points (n, d), shape (n,).

    ``q``: (n, d) or (d,) curvatures along the columns of ``axes`` (d, d).
    """
    curvatures = np.broadcast_to(q, nu.shape)
    total = np.zeros(len(nu), np.complex128)
    with np.errstate(invalid="ignore"):  # of frequencies that are no numbers
        for element, shift, weight in _elements(source):
            check_not_stopped()
            # a copy moved by s is the element itself, its wave about c - s
            found = _of_element(element, curvatures, axes, centre - shift, nu)
            total += weight * np.exp(-2j * math.pi * (nu @ shift)) * found
    return total


def _elements(source: Any) -> Iterator[tuple[Aperture | Slits, Floats, complex]]:
    if not isinstance(source, Array):
        yield source, np.zeros(1 if isinstance(source, Slits) else 2), 1.0
    elif source.repeated is not None:
        element, positions = source.repeated
        for position, weight in zip(positions, source.weights.tolist(), strict=True):
            yield element, position, weight
    else:
        none = np.zeros(source.dimension if source.dimension == 1 else 2)
        for one, weight in zip(source.elements_in_plane, source.weights.tolist(), strict=True):
            yield one, none, weight


def _of_element(
    element: Aperture | Slits, q: Floats, axes: Floats, centre: Floats, nu: Floats
) -> Complex:
    field = element.illumination
    uniform = element.with_illumination(None)
    if field is None:
        return _uniform(uniform, q, axes, centre, nu)
    total = np.zeros(len(nu), np.complex128)
    for amplitude, kappa in zip(field.amplitudes.tolist(), field.frequencies, strict=True):
        total += amplitude * _uniform(uniform, q, axes, centre, nu - kappa)
    return total


def _uniform(
    element: Aperture | Slits, q: Floats, axes: Floats, centre: Floats, nu: Floats
) -> Complex:
    """About the middle o of the element: x = o + y, with y in the axes of the wave."""
    middle = np.atleast_1d(np.asarray(element.centre, dtype=np.float64))
    away = (middle - centre) @ axes
    inner = nu @ axes - q * away
    turns = ((q * away) @ away) / 2 - nu @ middle
    phase = np.exp(2j * math.pi * (turns - np.round(turns)))
    values = np.empty(len(nu), np.complex128)
    largest = np.argmax(np.abs(q), axis=1)
    for axis in range(q.shape[1]):
        mine = np.flatnonzero(largest == axis)
        if len(mine):
            values[mine] = _bent(element, middle, axes, axis, q[mine], inner[mine])
    return np.asarray(phase * values)


def _bent(
    element: Aperture | Slits, middle: Floats, axes: Floats, axis: int, q: Floats, nu: Floats
) -> Complex:
    """About the origin, with the larger curvature along one of the axes."""
    if isinstance(element, Slits):
        return chirp_over_intervals(element.intervals - middle, q[:, 0], nu[:, 0])
    order = [axis, 1 - axis]
    turn = axes[:, order]
    rings = tuple((ring - middle) @ turn for ring in element.rings)
    found = chirp_over_rings(rings, q[:, order], nu[:, order])
    return found * np.sign(np.linalg.det(turn))  # exchanged axes turn outlines over
