"""Light that reaches a receiver by surfaces: where it saw each, and how long the path is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.mitsuba.scattering_steps import SAMPLES, Steps

__all__ = ["Events", "Motion", "events_of"]

Floats = NDArray[np.float64]

# A path that passes more null surfaces is lost; Mitsuba's rays are as patient.
_MOST_STEPS = 1024


@dataclass(frozen=True)
class Motion:
    """Velocities in scene units per second, by the numbers of shapes and lights that have one."""

    shapes: dict[int, Floats]
    lights: dict[int, Floats]
    receiver: Floats


@dataclass(frozen=True, eq=False)
class Events:
    """Light found along paths, (n, ...) each; lengths in scene units."""

    ray: NDArray[np.int64]
    """Number of the ray that left the receiver."""
    radiance: Floats
    """Along that ray."""
    place: Floats
    """(n, 3): of the first surface."""
    normal: Floats
    """(n, 3)."""
    shape: NDArray[np.int64]
    """Number of the first surface's shape."""
    distance: Floats
    """To the first surface."""
    length: Floats
    """Of the whole path."""
    rate: Floats
    """By which the path grows, per second."""
    bounces: NDArray[np.int64]
    light: NDArray[np.int64]
    """Number of the light."""

    @classmethod
    def joined(cls, parts: list[Events]) -> Events:
        """All events of the parts, of which there is one at least."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))

    def part(self, chosen: Any) -> Events:
        """Those of a mask, or of numbers."""
        return Events(*(getattr(self, f.name)[chosen] for f in fields(self)))


def events_of(
    scene: Any,
    paths: Any,
    rng: np.random.Generator,
    first: Floats,
    most_bounces: int,
    meets_lights: bool,
    motion: Motion | None,
) -> Iterator[Events]:
    """The events of paths, step by step.

    ``paths`` : all in one, or a list of single ones in a scalar variant. ``first`` : (n, 2)
    uniform numbers for the lights at the first surface.
    """
    state = _start(len(first))  # what the next event of each ray will say
    speeds = np.tile(np.zeros(3) if motion is None else motion.receiver, (len(first), 1))
    yield state.part(slice(0))
    for alive, found in _walk(paths, rng, first, Steps(scene, most_bounces, meets_lights)):
        here = _arrived(state.part(alive), found)
        before = speeds[alive]
        own = before
        if motion is not None:
            own = _looked_up(motion.shapes, found["shape"])
            here = replace(here, rate=here.rate + _dot(own - before, found["d"]))
        yield from _lights(here, found, own, motion)
        bounced = found["is_bounce"]
        # null surfaces leave path and first surface open
        kept = state.part(alive)
        kept = replace(kept, length=here.length)
        new = Events(
            *(
                np.where(_along(bounced, a), a, b)
                for a, b in zip(_values(here), _values(kept), strict=True)
            )
        )
        new = replace(new, bounces=kept.bounces + bounced)
        for old, value in zip(_values(state), _values(new), strict=True):
            old[alive] = value
        speeds[alive] = np.where(bounced[:, None], own, before)


def _start(count: int) -> Events:
    zero, none = np.zeros(count), np.zeros(count, np.int64)
    return Events(
        np.arange(count), zero, np.zeros((count, 3)), np.zeros((count, 3)), none.copy(),
        zero.copy(), zero.copy(), zero.copy(), none.copy(), none.copy(),
    )  # fmt: skip


def _arrived(state: Events, found: dict[str, Any]) -> Events:
    """At the next surface, which is the first one of paths without a bounce."""
    length = state.length + np.where(found["is_met"], found["t"], 0.0)
    is_first = state.bounces == 0
    # to the side that the receiver looks at
    facing = -np.sign(_dot(found["n"], found["d"]))[:, None]
    return replace(
        state,
        length=length,
        place=np.where(is_first[:, None], found["p"], state.place),
        normal=np.where(is_first[:, None], facing * found["n"], state.normal),
        shape=np.where(is_first, found["shape"], state.shape),
        distance=np.where(is_first, length, state.distance),
    )


def _lights(
    here: Events, found: dict[str, Any], own: Floats, motion: Motion | None
) -> Iterator[Events]:
    """Events at the surfaces that paths have come to."""
    lit = found["sampled"] != 0.0
    if lit.any():
        way = np.where(found["is_far"], np.inf, found["to_light"])
        rate = here.rate
        if motion is not None:
            apart = _looked_up(motion.lights, found["light"]) - own
            rate = rate + np.where(found["is_far"], 0.0, _dot(apart, found["light_d"]))
        event = replace(
            here,
            radiance=found["sampled"],
            length=here.length + way,
            rate=rate,
            bounces=here.bounces + 1,
            light=found["light"],
        )
        yield event.part(lit)
    if "met" in found:
        far = found["is_met_far"]
        # what is seen of a sky has no place
        met = (found["met"] != 0.0) & ~(far & (here.bounces == 0))
        length = np.where(far, np.inf, here.length)
        light = replace(here, radiance=found["met"], length=length, light=found["met_light"])
        yield light.part(met)


def _walk(
    paths: Any, rng: np.random.Generator, first: Floats, steps: Steps
) -> Iterator[tuple[Any, dict[str, Any]]]:
    """(numbers of rays, what they found) of each step."""
    count = len(first)
    alive = np.arange(count)
    for number in range(_MOST_STEPS):
        draws = rng.random((count, SAMPLES))
        if number == 0:
            draws[:, :2] = first
        draws = np.minimum(draws, np.nextafter(np.float32(1.0), np.float32(0.0)))
        if dr.is_jit_v(mi.Float):
            paths, found = steps(paths, [mi.Float(column.tolist()) for column in draws.T])
            dr.eval(paths, found)
            yield alive, {name: _column(value, count) for name, value in found.items()}
            if not dr.any(paths.active):
                return
        else:
            pairs = [
                steps(paths[k], row) for k, row in zip(alive, draws[alive].tolist(), strict=True)
            ]
            yield alive, _columns([found for _, found in pairs])
            for k, (path, _) in zip(alive, pairs, strict=True):
                paths[k] = path
            alive = alive[[path.active for path, _ in pairs]]
            if not len(alive):
                return


def _column(value: Any, count: int) -> NDArray[Any]:
    """(n,) or (n, 3) of one of Mitsuba's arrays."""
    array = np.array(value)
    if array.dtype.kind == "f":
        array = array.astype(np.float64)
    elif array.dtype.kind in "iu":
        array = array.astype(np.int64)
    array = array.T
    return np.broadcast_to(array, (count, *array.shape[1:]))


def _columns(found: list[dict[str, Any]]) -> dict[str, NDArray[Any]]:
    """The columns of rows, in which what is not there is zero."""
    names = {name: value for row in found for name, value in row.items()}
    return {
        name: np.array([np.array(row.get(name, np.zeros_like(value))) for row in found])
        for name, value in names.items()
    }


def _looked_up(table: dict[int, Floats], numbers: NDArray[np.int64]) -> Floats:
    result = np.zeros((len(numbers), 3))
    for number, velocity in table.items():
        result[numbers == number] = velocity
    return result


def _values(events: Events) -> list[NDArray[Any]]:
    return [getattr(events, f.name) for f in fields(events)]


def _along(mask: NDArray[np.bool_], values: NDArray[Any]) -> NDArray[np.bool_]:
    return mask[:, None] if values.ndim == 2 else mask


def _dot(one: Floats, other: Floats) -> Floats:
    return np.einsum("ij,ij->i", one, other)
