"""Irradiance by Wigner rays with derivatives in points, wavelength, and numbers of the source.

To third order Dr.Jit differentiates the moments (T1), along frequencies alone, in which they are
smooth.

The places that rays come from are a rule's for the source and the points as they are now. They need
no derivatives: W vanishes on the rim of the region in which the rule's nodes lie, and is continuous
in it, so that the integral of its derivative is the derivative of its integral.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_wavelength
from polywigner.illumination.obliquities import checked_obliquity, weighted_sources
from polywigner.kernels import kernel_for
from polywigner.propagation.arrangement import Rule, gauss_rule, smooth_triangles
from polywigner.propagation.places import checked_points
from polywigner.propagation.rays import Rays, ray_factors
from polywigner.propagation.rays_adaptive import phase_rates
from polywigner.radiometry.directions import checked_source
from polywigner.transforms import Differentiable, wigner
from polywigner.transforms.traced_sources import fields_of, with_fields

Values = NDArray[np.float64]

# Nodes beyond those that the phase needs, rule after rule.
_LEVELS = (4.0, 8.0, 15.0, 28.0)
# 400 MiB for each array of float64.
_MOST_RAYS = 50_000_000


def traced_irradiance(
    source: Any, points: Any, wavelength: Any, obliquity: Any, tolerance: float, order: int
) -> Any:
    """As :func:`polywigner.irradiance` by rays, by Dr.Jit.

    Raises ArgumentError for fields whose waves leave at different angles with an obliquity that
    tells, for vertices in rays of the third order, and for more rays than fit into memory.
    """
    traced = source if isinstance(source, Differentiable) else Differentiable(source)
    checked_source(traced.source)
    if order == 3 and traced.vertices is not None:
        raise ArgumentError(
            "expected order=1 with differentiable vertices, got order=3, whose rays have "
            "derivatives in points, wavelength, weights and amplitudes; leave vertices out"
        )
    name = checked_obliquity(obliquity, order)
    float_type = execution.float_of(
        ("points", points), ("wavelength", wavelength), *_arrays(traced)
    )
    places = checked_points(execution.values_of(points, 3)).reshape(-1, 3)
    length = _checked_length(execution.values_of(wavelength, 1))
    terms = weighted_sources(traced.source, name, length, order)
    if len(terms) > 1 or terms[0][0] is not traced.source:
        raise ArgumentError(
            f"expected a field whose waves leave at one angle for obliquity={name!r} with "
            'derivatives; use "rayleigh-sommerfeld-1"'
        )
    forms = terms[0][1]
    rule = _rule(Rays(terms, length, order, "auto", True), traced.source, places, tolerance)
    if len(rule[1]) * len(places) > _MOST_RAYS:
        raise ArgumentError(
            f"expected at most {_MOST_RAYS} rays at a time, got {len(rule[1])} from each of "
            f"{len(places)} points; take fewer points"
        )

    def functions(x: Any, nu: Any) -> tuple[Any, ...]:
        if order == 1:
            return (wigner(traced, x, nu),)
        return execution.traced_sums(kernel_for("lag moments", traced.source), traced.source, x, nu)

    def factors(c: Any, inverse: Any, length: Any) -> tuple[Any, ...]:
        return ray_factors(order)(c, inverse, length, forms)

    values = execution.ray_sum(functions, rule, points, wavelength, factors, float_type)
    fields = traced.weights or traced.amplitudes
    if order == 1 or fields is None:
        return values
    rays = Rays(terms, length, order, "auto", True)
    return execution.with_slopes(
        values, (fields.first, fields.second), lambda: _field_slopes(rays, traced, rule, places)
    )


def _checked_length(wavelength: Any) -> float:
    if isinstance(wavelength, np.ndarray):
        if wavelength.size != 1:
            raise ArgumentError(f"expected one wavelength, got {wavelength.size}")
        wavelength = wavelength.item()
    return checked_wavelength(wavelength)


def _field_slopes(rays: Rays, traced: Differentiable, rule: Rule, points: Values) -> Any:
    """Derivatives in real and imaginary parts of all weights or amplitudes, (n, k) each.

    The irradiance is a quadratic form in them: differences over any step are exact.
    """
    numbers = fields_of(traced)
    step = float(np.abs(numbers).max()) or 1.0
    (_, forms), *_ = rays.sources

    def along(change: Any) -> Values:
        ends = (
            replace(rays, sources=[(with_fields(traced, numbers + c), forms)])
            for c in (change, -change)
        )
        above, below = (own.irradiance(rule, points) for own in ends)
        return (above - below) / (2 * step)

    units = step * np.eye(len(numbers))
    return tuple(np.stack([along(f * unit) for unit in units], axis=1) for f in (1.0, 1j))


def _arrays(traced: Differentiable) -> list[tuple[str, Any]]:
    names = ("vertices", "weights", "amplitudes")
    found = [(name, getattr(traced, name)) for name in names]
    return [(name, parameter.first) for name, parameter in found if parameter is not None]


def _rule(rays: Rays, source: Any, points: Any, tolerance: float) -> Rule:
    """Return a rule whose irradiance differs from the previous one's within the tolerance."""
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
