"""Integrals of chirps over polygons, of other curvatures along one axis than along the other.

I = int u(x) exp(i pi/lambda (s_1 x_1^2 + s_2 x_2^2 - 2 q.x)) dx. Along x_1 it is a chirp's integral
G from a place in the outline's middle, in closed form; by Gauss's theorem the rest is an integral
of G times the chirp of x_2 along the outline, by Gauss's rules with as many nodes as each edge and
point need. Source: (O6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import NumpyOperations, check_not_stopped
from polywigner.geometry import Aperture
from polywigner.numerics.chirps import chirp_integral, waves_of_turns
from polywigner.numerics.nodes import gauss_rules, nodes_needed, rule_of
from polywigner.propagation.panels import Radiator

__all__ = ["Chirp", "astigmatic_integral", "line_integral"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
_OPS = NumpyOperations(double=True)

# The integrand is entire: farther than the largest ellipse that rules are chosen by.
_NO_SINGULARITY = 100.0
# Turns of phase on a piece of an edge, for which the largest rule still has nodes to spare.
_TURNS = 120.0
# Most pieces of one edge: a tenth of a second for each point.
_MOST_PIECES = 1 << 10
_ULP = 2.0**-52
# Values at a time.
_BLOCK = 1 << 15
# In the accuracy demanded, for chirps, which grow faster than waves off the real axis: errors seen
# of 1000 fields are below a twentieth of the tolerance.
_MARGIN = 6.0


@dataclass(frozen=True)
class Chirp:
    """exp(i pi/lambda (x^T S x - 2 q.x)) in the axes of S."""

    axes: Floats
    """Columns: directions of x_1 and x_2, a rotation."""
    curvature: Floats
    """s_1 and s_2, |s_1| the larger one, in 1/m."""
    wavelength: float


def astigmatic_integral(
    radiator: Radiator, chirp: Chirp, q: Floats, tolerance: float
) -> tuple[Complex, Floats]:
    """The integral for q (n, 2), and an estimate of its error, both (n,), in m^2 of the field."""
    slopes = q @ chirp.axes
    values, errors = np.zeros(len(q), np.complex128), np.zeros(len(q))
    for element in radiator.elements:
        edges, middle = _edges_of(element.outline, chirp.axes)
        for shift, weight in zip(element.shifts @ chirp.axes, element.weights, strict=True):
            place = shift + middle
            own = slopes - chirp.curvature * place
            turns = (place * (0.5 * chirp.curvature * place - slopes)).sum(axis=1)
            factor = weight * waves_of_turns(turns / chirp.wavelength)
            for amplitude, kappa in zip(element.amplitudes, element.frequencies, strict=True):
                wave = kappa @ chirp.axes
                found, error = _along_edges(edges, chirp, own - chirp.wavelength * wave, tolerance)
                whole = amplitude * waves_of_turns(wave @ middle)
                values += factor * whole * found
                errors += abs(weight * whole) * error
    return values, errors


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


def _along_edges(
    edges: Floats, chirp: Chirp, q: Floats, tolerance: float
) -> tuple[Complex, Floats]:
    """The integral over one outline, with the chirp's phase counted from its middle."""
    values, errors = np.zeros(len(q), np.complex128), np.zeros(len(q))
    for begin, extent in edges:
        check_not_stopped()
        if extent[1] == 0:
            continue
        count = _pieces(begin, extent, chirp, q)
        for k in range(count):
            start = begin + extent * (k / count)
            _add_piece(start, extent / count, chirp, q, tolerance, values, errors)
    return values, errors


def _turns(begin: Floats, extent: Floats, chirp: Chirp, q: Floats) -> Floats:
    """Bound on the turns of phase along an edge, (n,): of both chirps, and of that of x_2."""
    most = np.zeros(len(q))
    for end in (begin, begin + extent):
        first, second = ((chirp.curvature * end - q) * (extent / chirp.wavelength)).T
        most = np.maximum(most, np.maximum(abs(first + second), abs(second)))
    return most


def _pieces(begin: Floats, extent: Floats, chirp: Chirp, q: Floats) -> int:
    """In how many pieces an edge is summed up."""
    turns = float(_turns(begin, extent, chirp, q).max(initial=0.0))
    if not turns <= _TURNS * _MOST_PIECES:
        raise ArgumentError(
            f"expected a system with up to {_TURNS * _MOST_PIECES:.3g} turns of phase along an "
            f"edge, got {turns:.3g}; take points nearer to the light, or a plane farther from a "
            "line in which the source is imaged"
        )
    return max(1, math.ceil(turns / _TURNS))


def _add_piece(
    begin: Floats, extent: Floats, chirp: Chirp, q: Floats, tolerance: float,
    values: Complex, errors: Floats,
) -> None:  # fmt: skip
    turns = _turns(begin, extent, chirp, q)
    digits = math.log(1 / tolerance) + _MARGIN
    needed, _ = nodes_needed(
        _OPS, np.full(len(q), digits), np.full(len(q), _NO_SINGULARITY), math.pi * turns
    )
    rules = rule_of(_OPS, needed).astype(np.intp)
    (s1, s2), wavelength = chirp.curvature.tolist(), chirp.wavelength
    for number in np.unique(rules):
        at, weights = gauss_rules()[number].T[:2]
        t = 0.5 + 0.5 * at
        x1, x2 = (begin[k] + t * extent[k] for k in range(2))
        mine = np.flatnonzero(rules == number)
        step = max(1, _BLOCK // len(t))
        for some in (mine[low : low + step] for low in range(0, len(mine), step)):
            q1, q2 = (q[some, k, None] for k in range(2))
            value = chirp_integral(x1, s1 / wavelength, q1 / wavelength)
            value *= waves_of_turns(x2 * (0.5 * s2 * x2 - q2) / wavelength)
            value *= 0.5 * extent[1]
            values[some] += value @ weights
            # of an entire integrand the error is known beforehand, but for rounding
            size = abs(value) @ weights
            errors[some] += size * (0.25 * tolerance + _ULP * (4.0 + turns[some]))
