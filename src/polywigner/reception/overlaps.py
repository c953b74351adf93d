"""Links as overlaps of two Wigner functions, along rays between parallel planes. Source: (RX5)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.illumination.obliquities import fields_of
from polywigner.propagation.arrangement import has_few_kinks, smooth_triangles
from polywigner.propagation.rays_rules import gauss_rule, node_count
from polywigner.transforms import wigner
from polywigner.transforms.phase_space import energy_of

__all__ = ["overlap"]

Floats = NDArray[np.float64]

# How far planes may lean, as the sine of the angle: what rounding does to poses.
_PARALLEL = 1e-9
# Nodes along a side of a cell beyond those of the phase, rule after rule.
_LEVELS = (2.0, 3.0, 5.0, 7.0, 10.0, 14.0)
# Pairs of places: a minute's work; and at a time.
_MOST_PAIRS, _BLOCK = 1 << 24, 1 << 18


def overlap(
    sources: tuple[Any, ...], poses: Floats, wavelength: float, tolerance: float, floor: float
) -> tuple[Floats, Floats, Floats]:
    """|b|^2 of poses (n, 4, 4), errors and what was allowed, (n,) each.

    Raises ArgumentError for planes that are not parallel, and too many pairs of places.
    """
    values, errors, limits = (np.empty(len(poses)) for _ in range(3))
    for source in sources:
        if not has_few_kinks(source):
            raise ArgumentError(
                'expected sources of few edges with "wigner", got one whose Wigner function has '
                'more kinks than can be found; use "rayleigh-sommerfeld-1"'
            )
    norm = math.prod(map(energy_of, sources))
    for k, pose in enumerate(poses):
        lean = float(np.hypot(*pose[:2, 2]))
        if lean > _PARALLEL:
            raise ArgumentError(
                'expected parallel planes with "wigner", where the overlap along rays is exact to '
                f"Fresnel's approximation, got some at {math.degrees(math.asin(lean)):.3g} "
                'degrees; use "rayleigh-sommerfeld-1"'
            )
        values[k], errors[k] = _adapted(sources, pose, wavelength, tolerance, floor, norm)
        limits[k] = tolerance * max(abs(values[k]), floor**2)
    return values, errors, limits


def _adapted(
    sources: tuple[Any, ...],
    pose: Floats,
    wavelength: float,
    tolerance: float,
    floor: float,
    norm: float,
) -> tuple[float, float]:
    """Rule after rule on both sources until the overlap does not change."""
    spread = wavelength * float(pose[2, 3])
    rate = _rate(sources, pose, spread)
    before = math.nan
    error = math.inf
    for extra in _LEVELS:
        count = math.prod(node_count(smooth_triangles(s), rate, extra) for s in sources)
        if count > _MOST_PAIRS:
            if math.isnan(before):
                raise ArgumentError(
                    f'expected fewer places for "wigner", got {count:.2g} pairs of them; use '
                    '"rayleigh-sommerfeld-1", which sums up fields instead'
                )
            break
        rules = [gauss_rule(smooth_triangles(source), rate, extra) for source in sources]
        value = _summed(sources, rules, pose, spread) / (norm * spread**2)
        error, before = abs(value - before), value
        if error <= tolerance * max(abs(value), floor**2):
            break
    return before, error if math.isfinite(error) else math.inf


def _rate(sources: tuple[Aperture | Array, ...], pose: Floats, spread: float) -> float:
    """Largest |nu - kappa| of rays between both sources, in cycles per metre."""
    corners = []
    for source in sources:
        xmin, ymin, xmax, ymax = source.bounds
        corners.append(np.array([(x, y) for x in (xmin, xmax) for y in (ymin, ymax)]))
    there = corners[1] @ pose[:2, :2].T + pose[:2, 3]
    nu = ((there[:, None] - corners[0]) / spread).reshape(-1, 2)
    found = 0.0
    for source, seen in zip(sources, (nu, -nu @ pose[:2, :2]), strict=True):
        for field in fields_of(source):
            waves = np.zeros((1, 2)) if field is None else field.frequencies
            found = max(found, float(np.linalg.norm(seen[:, None] - waves, axis=-1).max()))
    return found


def _summed(
    sources: tuple[Any, ...], rules: list[tuple[Floats, Floats]], pose: Floats, spread: float
) -> float:
    """int int W_t(x, nu) W_r(y, -nu turned) dx dy with nu = (y' - x)/(wavelength z)."""
    (x, x_weights), (y, y_weights) = rules
    turn = pose[:2, :2]
    there = y @ turn.T + pose[:2, 3]
    total = 0.0
    step = max(1, _BLOCK // len(y))
    for start in range(0, len(x), step):
        some = slice(start, start + step)
        nu = (there[None] - x[some, None]) / spread
        sent = wigner(sources[0], x[some, None], nu)
        taken = wigner(sources[1], y[None], -nu @ turn)
        total += float(x_weights[some] @ (sent * taken) @ y_weights)
    return total
