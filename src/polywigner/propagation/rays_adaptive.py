"""Irradiance by Wigner rays: rules refined to a tolerance, drawn places, and derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import (
    ArgumentError,
    require,
)
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_count, checked_generator, checked_wavelength
from polywigner.illumination import Array
from polywigner.illumination.obliquities import checked_obliquity, fields_of, weighted_sources
from polywigner.illumination.support import mutual_support
from polywigner.kernels import kernel_for
from polywigner.propagation import arrangement
from polywigner.propagation.arrangement import Rule, Triangles
from polywigner.propagation.places import checked_points
from polywigner.propagation.rays import FACTORS, Rays
from polywigner.radiometry.directions import checked_source
from polywigner.transforms import Differentiable, sample_automean, traced_sources, wigner

Values = NDArray[np.float64]

# Nodes along a side beyond those that the phase needs, rule after rule. Two for the first: on cells
# far smaller than a wavelength W is a quadratic, which it integrates exactly.
_LEVELS = (2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 28.0)
# If there are so many cells, each is small: the sum with one node in each is worth a try.
_MANY_CELLS = 500
# Pairs of a point and a cell whose distances are found at a time.
_PLACES_AT_ONCE = 1 << 20
# A rule of more nodes than this is not tried: 64 MiB of them.
_MOST_NODES = 1 << 22
# Points with a phase rate within this fraction of 1/wavelength share their rules.
_RATE_STEP = 0.25
# Points whose error is so much smaller than allowed are not computed again.
_SETTLED = 0.03
# Where there are too many kinks to find, cells are refined where they matter, up to so many, judged
# by some of the points.
_MOST_CELLS, _PROBES = 1 << 14, 12
# Cells that are divided in one step hold this share of the error of all.
_SHARE = 0.8


@dataclass
class Estimate:
    """Irradiances (n,), estimates of their errors (n,), and whether all are as small as allowed."""

    values: Values
    errors: Values
    is_met: bool = True


def by_gauss(
    source: Aperture | Array, rays: Rays, points: Values, tolerance: float, floor: Values
) -> Estimate:
    """Irradiance at points (n, 3) to ``tolerance`` of itself, or of ``floor`` (n,) if larger."""
    result = Estimate(np.zeros(len(points)), np.full(len(points), np.inf))
    steps = np.ceil(phase_rates(source, rays.wavelength, points, rays.curved) * rays.wavelength
                    / _RATE_STEP)  # fmt: skip
    for step in np.unique(steps):
        rate, group = float(step) * _RATE_STEP / rays.wavelength, np.flatnonzero(steps == step)
        cells = _cells(source, rays, points[group], tolerance, floor[group], rate)
        part = _raised(cells, rays, rate, points[group], tolerance, floor[group])
        result.values[group], result.errors[group] = part.values, part.errors
        result.is_met &= part.is_met
    return result


def _raised(
    cells: Triangles, rays: Rays, rate: float, points: Values, tolerance: float, floor: Values
) -> Estimate:
    """Rule after rule on the same cells, until all points are settled."""
    result = Estimate(np.zeros(len(points)), np.full(len(points), np.inf), is_met=False)
    open_ = np.arange(len(points))
    before: Values | None = None
    _check_nodes(cells, rate, rays.wavelength)
    for extra in (1.0, *_LEVELS) if len(cells) > _MANY_CELLS else _LEVELS:
        if before is not None and arrangement.node_count(cells, rate, extra) > _MOST_NODES:
            break
        rule = arrangement.gauss_rule(cells, rate, extra)
        values = rays.irradiance(rule, points[open_])
        result.values[open_] = values
        if before is None:
            before = values
            continue
        errors = np.abs(values - before)
        errors[_are_unseen(cells, rate, extra, points[open_])] = np.inf
        result.errors[open_] = errors
        allowed = tolerance * np.maximum(np.abs(values), floor[open_])
        if (errors <= allowed).all():
            result.is_met = True
            break
        kept = errors > _SETTLED * allowed
        open_, before = open_[kept], values[kept]
    return result


def _are_unseen(cells: Triangles, rate: float, extra: float, points: Values) -> NDArray[np.bool_]:
    """Points so near to the cells that their rays pass between the nodes of a rule, (n,).

    The integrand has singularities at complex places as far from the real ones as the point is from
    the source: at a distance d, nodes h apart err by a share of exp(-2 pi d/h). Where that is more
    than 1/e, two rules may agree because neither of them sees anything.
    """
    nearest = arrangement.spacings(cells, rate, extra) / (2 * np.pi)
    low, high = cells.min(axis=1), cells.max(axis=1)
    unseen = points[:, 2] < nearest.max()
    candidates = np.flatnonzero(unseen)
    step = max(1, _PLACES_AT_ONCE // len(cells))
    for start in range(0, len(candidates), step):
        some = candidates[start : start + step]
        place = points[some, None]
        aside = place[..., :2] - np.clip(place[..., :2], low, high)
        gap = np.sqrt((aside**2).sum(axis=-1) + place[..., 2] ** 2)
        unseen[some] = (gap < nearest).any(axis=1)
    return unseen


def _check_nodes(cells: Triangles, rate: float, wavelength: float) -> None:
    count = arrangement.node_count(cells, rate, _LEVELS[0])
    if not count <= _MOST_NODES:
        across = float(np.ptp(cells.reshape(-1, 2), axis=0).max()) / wavelength
        raise ArgumentError(
            f"expected a source of fewer wavelengths for Wigner rays to these points, got one of "
            f"{across:.3g} across, for which {count:.2g} places on it would have to be summed up; "
            'use method="rayleigh-sommerfeld-1", which is exact, and check the unit of the '
            "wavelength"
        )


def phase_rates(
    source: Aperture | Array, wavelength: float, points: Values, curved: Sequence[float] = ()
) -> Values:
    """Largest |nu - kappa| of the rays to each point, in cycles per metre, kappa of any wave."""
    xmin, ymin, xmax, ymax = source.bounds
    corners = np.array([(x, y) for x in (xmin, xmax) for y in (ymin, ymax)])
    rays = points[:, None, :2] - corners
    length = np.sqrt((rays**2).sum(axis=-1) + points[:, None, 2] ** 2)
    nu = rays / (wavelength * length[..., None])
    bent = 0.0
    if curved:
        q = np.array([curved[:2], curved[1:3]])
        nu = nu - (corners - np.array(curved[3:])) @ q
        bent = float(np.linalg.norm(q, 2) * np.hypot(xmax - xmin, ymax - ymin))
    still = np.zeros((1, 2))
    waves = [still if field is None else field.frequencies for field in fields_of(source)]
    result = np.zeros(len(points))
    for kappa in np.unique(np.concatenate(waves), axis=0):
        result = np.maximum(result, np.linalg.norm(nu - kappa, axis=-1).max(axis=1))
    return result + bent


def _cells(
    source: Aperture | Array,
    rays: Rays,
    points: Values,
    tolerance: float,
    floor: Values,
    rate: float,
) -> Triangles:
    """Triangles without kinks inside; of too many kinks, triangles so small that they do not tell.

    W has a continuous gradient across most kinks, so that what a cell with one in it errs by falls
    as the fourth power of its size.
    """
    if arrangement.has_few_kinks(source):
        return arrangement.smooth_triangles(source)
    cells = arrangement.triangulated(list(mutual_support(source).polygons.geoms))
    _check_nodes(cells, rate, rays.wavelength)
    chosen = np.unique(np.linspace(0, len(points) - 1, _PROBES).astype(int))
    probes, allowed = points[chosen], tolerance * floor[chosen]
    while len(cells) < _MOST_CELLS:
        # the first and the third rule that `_raised` takes
        coarse, fine = (_on_cells(cells, rays, rate, probes, _LEVELS[k]) for k in (0, 2))
        enough = np.maximum(allowed, tolerance * np.abs(fine.sum(axis=0)))
        shares = (np.abs(fine - coarse) / enough).max(axis=1)
        if float(shares.sum()) <= 1.0:
            break
        order = np.argsort(-shares)
        needed = np.searchsorted(np.cumsum(shares[order]), _SHARE * shares.sum()) + 1
        divided = np.zeros(len(cells), dtype=bool)
        divided[order[:needed]] = True
        cells = np.concatenate([cells[~divided], arrangement.quartered(cells[divided])])
    return cells


def _on_cells(cells: Triangles, rays: Rays, rate: float, points: Values, extra: float) -> Values:
    """Integrals over each cell at each point, (cells, points)."""
    parts = []
    sizes = np.linalg.norm(cells - np.roll(cells, 1, axis=1), axis=-1).max(axis=1)
    step = max(1, int(2**21 / (len(points) * (extra + 3.5 * rate * sizes.max()) ** 2)))
    for start in range(0, len(cells), step):
        nodes, weights, owners = arrangement.rule_by_triangles(
            cells[start : start + step], rate, extra
        )
        values = rays.integrand(nodes, points) * weights
        sums = np.zeros((min(step, len(cells) - start), len(points)))
        np.add.at(sums, owners, values.T)
        parts.append(sums)
    return np.concatenate(parts)


Sampling = Literal["gauss", "sobol", "monte-carlo"]


# Independent batches, from whose scatter the error is estimated, to a fifth of itself.
_BATCHES = 16
# To begin with, and the most that a tolerance brings: minutes for a plane of 256 x 256 points.
_FIRST_SAMPLES, _MOST_SAMPLES = 1 << 14, 1 << 18

Draw = Callable[[int], Values]
"""Count n -> numbers (n, 2) in [0, 1), others at each call."""


def by_samples(
    source: Aperture | Array,
    rays: Rays,
    points: Values,
    sampling: str,
    samples: Any,
    seed: Any,
    allowed: Callable[[Values, NDArray[np.intp]], Values],
) -> Estimate:
    """Irradiance at points (n, 3) as the mean over 16 batches of drawn places.

    The estimate of the error is the standard deviation of that mean. Without a number of
    ``samples`` they are doubled, up to 2^18, until it is at most ``allowed``: (values, numbers of
    points) -> errors allowed.
    """
    fixed = samples is not None
    count = checked_count(samples, "samples", _BATCHES) if fixed else _FIRST_SAMPLES
    generator, size, drawn = checked_generator(seed), -(-count // _BATCHES), 0
    draws: list[Draw] = [lambda size: generator.random((size, 2))] * _BATCHES
    if sampling == "sobol":
        draws = [_sobol_draw(2, generator) for _ in range(_BATCHES)]
    sums = np.zeros((_BATCHES, len(points)))
    result = Estimate(np.zeros(len(points)), np.full(len(points), np.inf))
    open_ = np.arange(len(points))
    while True:
        for batch, draw in zip(sums, draws, strict=True):
            places, density = sample_automean(source, draw(size), engine=rays.engine)
            batch[open_] += rays.irradiance((places, 1.0 / density), points[open_])
        drawn += len(places)
        means = sums[:, open_] / drawn
        result.values[open_] = means.mean(axis=0)
        result.errors[open_] = np.std(means, axis=0, ddof=1) / math.sqrt(_BATCHES)
        # As of rules, see rays_adaptive: places are drawn one to this square, on the average.
        spacing = math.sqrt(float(np.mean(1.0 / density)) / (drawn * _BATCHES))
        unseen = gaps(source, points[open_]) < spacing / (2 * math.pi)
        result.errors[open_[unseen]] = np.inf
        missed = result.errors[open_] > allowed(result.values[open_], open_)
        result.is_met = not (unseen if fixed else missed).any()
        if fixed or result.is_met or 2 * drawn * _BATCHES > _MOST_SAMPLES:
            return result
        open_, size = open_[missed], drawn


def gaps(source: Aperture | Array, points: Values) -> Values:
    """Distances of points (n, 3) from the source's bounds, (n,)."""
    xmin, ymin, xmax, ymax = source.bounds
    aside = points[:, :2] - np.clip(points[:, :2], (xmin, ymin), (xmax, ymax))
    result: Values = np.sqrt((aside**2).sum(axis=-1) + points[:, 2] ** 2)
    return result


def _sobol_draw(columns: int, generator: np.random.Generator) -> Draw:
    """Draw numbers (n, columns) in [0, 1) of a Sobol sequence, n rounded up to a power of two."""
    library = require("scipy.stats.qmc", "arrays", "has quasi-random numbers (Sobol)")
    sequence = library.Sobol(columns, scramble=True, seed=generator)
    # The largest of the numbers that scrambling makes may round to 1.
    return lambda size: np.minimum(sequence.random_base2(math.ceil(math.log2(size))), 1 - 2.0**-53)


def sobol_numbers(size: int, columns: int, generator: np.random.Generator) -> Values:
    """The first numbers (size, columns) in [0, 1) of a Sobol sequence, scrambled anew."""
    return _sobol_draw(columns, generator)(size)[:size]


# Nodes beyond those that the phase needs, rule after rule, of sums that Dr.Jit differentiates. They
# have no derivatives: W vanishes on the rim of the region in which they lie, and is continuous.
_TRACED_LEVELS = (4.0, 8.0, 15.0, 28.0)
# 400 MiB for each array of float64.
_MOST_RAYS = 50_000_000


def traced_irradiance(
    source: Any, points: Any, wavelength: Any, obliquity: Any, tolerance: float, order: int
) -> Any:
    """As :func:`polywigner.irradiance` by rays, by Dr.Jit.

    To third order Dr.Jit differentiates the moments (T1), along frequencies alone, in which they
    are smooth. Raises ArgumentError for fields whose waves leave at different angles with an
    obliquity that tells, for vertices then, and for more rays than fit into memory.
    """
    traced = source if isinstance(source, Differentiable) else Differentiable(source)
    checked_source(traced.source)
    if order == 3 and traced.vertices is not None:
        raise ArgumentError(
            "expected order=1 with differentiable vertices, got order=3, whose rays have "
            "derivatives in points, wavelength, weights and amplitudes; leave vertices out"
        )
    name = checked_obliquity(obliquity, order)
    parameters = [(name, getattr(traced, name)) for name in ("vertices", "weights", "amplitudes")]
    float_type = execution.float_of(
        ("points", points),
        ("wavelength", wavelength),
        *((name, parameter.first) for name, parameter in parameters if parameter is not None),
    )
    places = checked_points(execution.values_of(points, 3)).reshape(-1, 3)
    length = execution.values_of(wavelength, 1)
    if isinstance(length, np.ndarray):
        if length.size != 1:
            raise ArgumentError(f"expected one wavelength, got {length.size}")
        length = length.item()
    length = checked_wavelength(length)
    terms = weighted_sources(traced.source, name, length, order)
    if len(terms) > 1 or terms[0][0] is not traced.source:
        raise ArgumentError(
            f"expected a field whose waves leave at one angle for obliquity={name!r} with "
            'derivatives; use "rayleigh-sommerfeld-1"'
        )
    forms = terms[0][1]
    rays = Rays(terms, length, order, "auto", True)
    rule = _rule(rays, traced.source, places, tolerance)
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
        return FACTORS[order](c, inverse, length, forms)

    values = execution.ray_sum(functions, rule, points, wavelength, factors, float_type)
    fields = traced.weights or traced.amplitudes
    if order == 1 or fields is None:
        return values
    return execution.with_slopes(
        values, (fields.first, fields.second), lambda: _field_slopes(rays, traced, rule, places)
    )


def _field_slopes(rays: Rays, traced: Differentiable, rule: Rule, points: Values) -> Any:
    """Derivatives in real and imaginary parts of all weights or amplitudes, (n, k) each."""
    numbers = traced_sources.fields_of(traced)
    step = float(np.abs(numbers).max()) or 1.0
    (_, forms), *_ = rays.sources

    def along(change: Any) -> Values:
        ends = (
            replace(rays, sources=[(traced_sources.with_fields(traced, numbers + c), forms)])
            for c in (change, -change)
        )
        above, below = (own.irradiance(rule, points) for own in ends)
        return (above - below) / (2 * step)

    units = step * np.eye(len(numbers))
    return tuple(np.stack([along(f * unit) for unit in units], axis=1) for f in (1.0, 1j))


def _rule(rays: Rays, source: Any, points: Any, tolerance: float) -> Rule:
    """Return a rule whose irradiance differs from the previous one's within the tolerance."""
    cells = arrangement.smooth_triangles(source)
    if not len(points):
        return arrangement.gauss_rule(cells, 0.0, _TRACED_LEVELS[0])
    rate = float(phase_rates(source, rays.wavelength, points).max())
    before = rays.irradiance(arrangement.gauss_rule(cells, rate, _TRACED_LEVELS[0]), points)
    for level in _TRACED_LEVELS[1:]:
        values = rays.irradiance(arrangement.gauss_rule(cells, rate, level), points)
        if (np.abs(values - before) <= tolerance * np.abs(values).max()).all():
            return arrangement.gauss_rule(cells, rate, level)
        before = values
    return arrangement.gauss_rule(cells, rate, _TRACED_LEVELS[-1])
