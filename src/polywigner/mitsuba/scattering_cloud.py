"""Clouds of events with what they bring to a receiver, in batches of rays, and cut to fewer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.mitsuba.scattering_events import Events, Motion, events_of
from polywigner.mitsuba.scattering_steps import Paths
from polywigner.mitsuba.unseen import wigner_emitters

__all__ = ["BATCHES", "Cloud", "cloud_of"]

Floats = NDArray[np.float64]

# Their spread tells the standard error to 18 %.
BATCHES = 16
# Rays in flight, with some hundred bytes each.
_WAVEFRONT = 2**17


@dataclass(frozen=True, eq=False)
class Cloud:
    """Events and what they bring."""

    events: Events
    power: Floats
    """W, of each."""
    intensity: Floats
    """W/sr, towards the receiver."""
    standard_error: float
    """W, of the sum of powers."""

    def thinned(self, count: int, rng: np.random.Generator, for_elements: bool) -> Cloud:
        """At most ``count`` of the events, with values that stand for all.

        An event is kept with a probability in proportion to its power, at most 1, and its values
        are divided by that. ``for_elements``: in proportion to the mean of its shares of all power
        and all intensity, so that what elements of an array receive does not rest on a few events
        in the nulls of the whole. Systematic sampling along the paths keeps their distribution.
        Source: W. G. Madow, Ann. Math. Stat. 20 (1949) 333.
        """
        if len(self.power) <= count:
            return self
        measure = np.abs(self.power) / np.abs(self.power).sum()
        if for_elements:
            measure += np.abs(self.intensity) / np.abs(self.intensity).sum()
        shares = _shares(measure, count)
        order = np.argsort(self.events.length, kind="stable")
        steps = np.floor(np.cumsum(shares[order]) + rng.random())
        chosen = np.sort(order[np.diff(steps, prepend=0.0) > 0])
        kept = shares[chosen]
        power, intensity = self.power[chosen] / kept, self.intensity[chosen] / kept
        return Cloud(
            self.events.part(chosen),
            power,
            intensity,
            math.hypot(self.standard_error, _thinning_error(power, kept)),
        )


def cloud_of(
    scene: Any,
    sensor: Any,
    count: int,
    depth: int,
    rng: np.random.Generator,
    motion: Motion | None,
) -> Cloud:
    """The events of ``count`` rays or a few more, in a scene whose sources are unseen."""
    size = -(-count // BATCHES)
    parts = [_batch(scene, sensor, size, depth, rng, motion) for _ in range(BATCHES)]
    sums = [float(power.sum()) for _, power, _ in parts]
    events, power, intensity = zip(*parts, strict=True)
    return Cloud(
        Events.joined(list(events)),
        np.concatenate(power) / BATCHES,
        np.concatenate(intensity) / BATCHES,
        float(np.std(sums, ddof=1) / math.sqrt(BATCHES)),
    )


def _batch(
    scene: Any, sensor: Any, count: int, depth: int, rng: Any, motion: Motion | None
) -> tuple[Events, Floats, Floats]:
    """Events with power and intensity that estimate the whole."""
    meets_lights = len(wigner_emitters(scene)) < len(scene.emitters())
    unit = sensor.spec.scene_unit
    draws = _evenly(count, rng)
    parts = []
    for start in range(0, count, _WAVEFRONT):
        own = draws[start : start + _WAVEFRONT]
        paths, watts, solid_angle = _paths(sensor, own)
        for events in events_of(scene, paths, rng, own[:, 4:], depth - 1, meets_lights, motion):
            value = events.radiance * (solid_angle / count)[events.ray]
            power = value * watts[events.ray]
            if not np.isfinite(power).all():
                raise SceneError(
                    "expected radiance that is finite, got some from the scene that is not; "
                    "check its materials"
                )
            parts.append((events, power, value * (unit * events.distance) ** 2))
    found = Events.joined([events for events, _, _ in parts])
    power, intensity = (np.concatenate([part[k] for part in parts]) for k in (1, 2))
    return found, power, intensity


def _paths(sensor: Any, draws: Floats) -> tuple[Any, Floats, Floats]:
    """Paths that leave a receiver; W per radiance and solid angle; the solid angle of each."""
    if not dr.is_jit_v(mi.Float):
        looks = [_looking(sensor, row) for row in draws.tolist()]
        paths, watts, densities = zip(*looks, strict=True)
        return list(paths), np.array(watts), 1.0 / np.array(densities)
    one, watts, density = _looking(sensor, [mi.Float(column.tolist()) for column in draws.T])
    dr.eval(one, watts, density)
    found = [np.array(value, np.float64) for value in (watts, density)]
    return one, found[0], 1.0 / found[1]


def _looking(sensor: Any, draws: Any) -> tuple[Any, Any, Any]:
    angles, density = sensor.directions.sample(mi.Point2f(draws[0], draws[1]))
    ray, watts, share = sensor.look_along(angles, 0.0, draws[4], mi.Point2f(draws[2], draws[3]))
    return Paths.along(mi.Ray3f(ray), share, 0.0 * density), watts, density


def _evenly(count: int, rng: np.random.Generator) -> Floats:
    """(count, 6) points that fill the unit cube evenly, shifted at random.

    Source: M. Roberts, "The unreasonable effectiveness of quasirandom sequences" (2018).
    """
    root = 1.0969815577985598  # of x^7 = x + 1
    steps = root ** -np.arange(1.0, 7.0)
    points = (rng.random(6) + np.arange(count)[:, None] * steps) % 1.0
    return np.asarray(np.minimum(points, np.nextafter(np.float32(1.0), np.float32(0.0))))


def _shares(measure: Floats, count: int) -> Floats:
    """Probabilities, in proportion to a measure but at most 1, that add up to ``count``."""
    ordered = np.sort(measure)
    rest = np.cumsum(ordered)
    # with the k largest kept for certain, the others share count - k
    certain = np.arange(count)
    left = rest[len(rest) - 1 - certain]
    scale = (count - certain) / np.where(left > 0.0, left, 1.0)
    fits = scale * ordered[len(ordered) - 1 - certain] <= 1.0
    return np.asarray(np.clip(measure * scale[np.argmax(fits)], 0.0, 1.0))


def _thinning_error(power: Floats, shares: Floats) -> float:
    """W, of sums over events that were kept with these probabilities: Hajek's approximation."""
    away = 1.0 - shares
    if not away.any():
        return 0.0
    middle = float((away * power).sum() / away.sum())
    return math.sqrt(float((away * (power - middle) ** 2).sum()))
