"""Integrals of chirps over sections of a source, for systems that image it along one axis.

I = int u(x) exp(i pi/lambda (s_1 x_1^2 - 2 q_1 x_1)) dx_1 at one x_2: Fresnel integrals between
edges. Source: (O6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture
from polywigner.numerics.chirps import chirp_integral, waves_of_turns
from polywigner.propagation.panels import Radiator

__all__ = ["Chirp", "line_integral"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Chirp:
    """exp(i pi/lambda (x^T S x - 2 q.x)) in the axes of S."""

    axes: Floats
    """Columns: directions of x_1 and x_2, a rotation."""
    curvature: Floats
    """s_1 and s_2, |s_1| the larger one, in 1/m."""
    wavelength: float


def line_integral(radiator: Radiator, chirp: Chirp, x2: Floats, slope: Floats) -> Complex:
    """The integral over x_1 alone at ``x2``, with q_1 = ``slope``, both (n,), in m of the field."""
    values = np.zeros(len(x2), np.complex128)
    curvature, wavelength = float(chirp.curvature[0]), chirp.wavelength
    for element in radiator.elements:
        edges, middle = _edges_of(element.outline, chirp.axes)
        for shift, weight in zip(element.shifts @ chirp.axes, element.weights, strict=True):
            place, across = shift + middle, x2 - shift[1] - middle[1]
            own = slope - curvature * place[0]
            turns = place[0] * (0.5 * curvature * place[0] - slope) / wavelength
            for amplitude, kappa in zip(element.amplitudes, element.frequencies, strict=True):
                wave = kappa @ chirp.axes
                found = np.zeros(len(x2), np.complex128)
                for (x, y), (ex, ey) in edges.tolist():
                    above, below = (y + ey > across), (y > across)
                    some = np.flatnonzero(above != below)
                    at = x + ex * ((across[some] - y) / (ey or 1.0))
                    frequency = own[some] / wavelength - wave[0]
                    part = chirp_integral(at, curvature / wavelength, frequency)
                    found[some] += math.copysign(1.0, ey) * part
                phase = turns + wave[0] * middle[0] + wave[1] * (across + middle[1])
                values += weight * amplitude * found * waves_of_turns(phase)
    return values


def _edges_of(outline: Aperture, axes: Floats) -> tuple[Floats, Floats]:
    """Beginnings and extents (m, 2, 2) of edges from the middle of their box, and that place."""
    rings = [ring @ axes for ring in outline.rings]
    begin = np.concatenate(rings)
    extent = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings]) - begin
    middle = begin.min(axis=0) / 2 + begin.max(axis=0) / 2
    return np.stack([begin - middle, extent], axis=1), middle
