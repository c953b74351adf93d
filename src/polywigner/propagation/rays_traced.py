"""Irradiance by Wigner rays with derivatives in points, wavelength, and numbers of the source.

The places that rays come from are a rule's for the source and the points as they are now. They need
no derivatives: W vanishes on the rim of the region in which the rule's nodes lie, and is continuous
in it, so that the integral of its derivative is the derivative of its integral.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from polywigner import engines
from polywigner.errors import ArgumentError
from polywigner.propagation.arrangement import smooth_triangles
from polywigner.propagation.obliquities import checked_obliquity, weighted_sources
from polywigner.propagation.places import checked_points, checked_wavelength
from polywigner.propagation.ray_kernels import leading_factor
from polywigner.propagation.rays import Rays
from polywigner.propagation.rays_adaptive import phase_rates
from polywigner.propagation.rays_rules import Rule, gauss_rule
from polywigner.transforms import Differentiable, wigner

__all__ = ["traced_irradiance"]

# Nodes beyond those that the phase needs, rule after rule.
_LEVELS = (4.0, 8.0, 15.0, 28.0)
# 400 MiB for each array of float64.
_MOST_RAYS = 50_000_000


def traced_irradiance(
    source: Any, points: Any, wavelength: Any, obliquity: Any, tolerance: float
) -> Any:
    """As :func:`polywigner.irradiance` by rays of the first order, by Dr.Jit.

    Raises ArgumentError for fields whose waves leave at different angles with an obliquity that
    tells, and for more rays than fit into memory.
    """
    traced = source if isinstance(source, Differentiable) else Differentiable(source)
    name = checked_obliquity(obliquity, 1)
    float_type = engines.float_of(("points", points), ("wavelength", wavelength), *_arrays(traced))
    places = checked_points(engines.values_of(points, 3)).reshape(-1, 3)
    length = _checked_length(engines.values_of(wavelength, 1))
    terms = weighted_sources(traced.source, name, length, 1)
    if len(terms) > 1 or terms[0][0] is not traced.source:
        raise ArgumentError(
            f"expected a field whose waves leave at one angle for obliquity={name!r} with "
            'derivatives; use "rayleigh-sommerfeld-1"'
        )
    forms = terms[0][1]
    rule = _rule(Rays(terms, length, 1, "auto", True), traced.source, places, tolerance)
    if len(rule[1]) * len(places) > _MOST_RAYS:
        raise ArgumentError(
            f"expected at most {_MOST_RAYS} rays at a time, got {len(rule[1])} from each of "
            f"{len(places)} points; take fewer points"
        )
    return engines.ray_sum(
        lambda x, nu: wigner(traced, x, nu),
        rule,
        points,
        wavelength,
        lambda c, inverse, length: leading_factor(c, inverse, length, forms),
        float_type,
    )


def _checked_length(wavelength: Any) -> float:
    if isinstance(wavelength, np.ndarray):
        if wavelength.size != 1:
            raise ArgumentError(f"expected one wavelength, got {wavelength.size}")
        wavelength = wavelength.item()
    return checked_wavelength(wavelength)


def _arrays(traced: Differentiable) -> list[tuple[str, Any]]:
    names = ("vertices", "weights", "amplitudes")
    found = [(name, getattr(traced, name)) for name in names]
    return [(name, parameter.first) for name, parameter in found if parameter is not None]


def _rule(rays: Rays, source: Any, points: Any, tolerance: float) -> Rule:
    """A rule whose irradiance differs from that of the one before by no more than that."""
    cells = smooth_triangles(source)
    if not len(points):
        return gauss_rule(cells, 0.0, _LEVELS[0])
    rate = float(phase_rates(source, rays.wavelength, points).max())
    before = rays.irradiance(gauss_rule(cells, rate, _LEVELS[0]), points)
    for level in _LEVELS[1:]:
        values = rays.irradiance(gauss_rule(cells, rate, level), points)
        if (np.abs(values - before) <= tolerance * np.abs(values).max()).all():
            return gauss_rule(cells, rate, level)
        before = values
    return gauss_rule(cells, rate, _LEVELS[-1])
