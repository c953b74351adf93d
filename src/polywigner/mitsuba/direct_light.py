"""The light that comes from an emitter to a receiver straight, or by flat mirrors alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from polywigner.mitsuba.links import coupled_share, facing_parts
from polywigner.mitsuba.mirrors import Mirror, chains_of, mirrors_of
from polywigner.mitsuba.placed_sources import PlacedSource
from polywigner.mitsuba.received import DirectPath
from polywigner.mitsuba.visibility import passing_share

__all__ = ["DirectLight", "direct_light", "mirrors_in", "ways_of"]


Way = tuple[Mirror, ...]


@dataclass(frozen=True)
class DirectLight:
    """Ways of light, and what is to be said of them."""

    paths: tuple[DirectPath, ...] = ()
    notes: tuple[str, ...] = field(default=())


def direct_light(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    ways: list[Way],
    tolerance: float,
) -> DirectLight:
    """Paths that bring power, in a scene whose sources are unseen.

    Raises SceneError for links that are too much work.
    """
    paths, notes = [], []
    link = f"from {emitter.name!r} to {receiver.name!r}"
    for chain in ways:
        way = link + "".join(f" by {mirror.name!r}" for mirror in chain)
        found, reason = _path(scene, emitter, receiver, chain, tolerance)
        if found is not None:
            paths.append(found)
        # most chains of mirrors lead nowhere
        if reason and (found is not None or not chain):
            notes.append(f"{way}: {reason}")
    return DirectLight(tuple(paths), tuple(notes))


def _path(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    chain: Way,
    tolerance: float,
) -> tuple[DirectPath | None, str]:
    image = emitter
    for mirror in chain:
        image = image.mirrored(mirror.normal, mirror.offset)
    parts = facing_parts(image, receiver)
    if parts is None:
        return None, "no direct light; one lies in the plane of the other, or behind it"
    # rays leave the emitter itself, from the part whose image faces the receiver
    facing = parts.emitter
    for mirror in reversed(chain):
        facing = facing.mirrored(mirror.normal, mirror.offset)
    passing = passing_share(scene, facing, parts.receiver, chain)
    if passing == 0:
        return None, "no direct light; obstacles block it, by rays, without diffraction"
    coupling = coupled_share(parts, tolerance)
    path = DirectPath(
        tuple(mirror.name for mirror in chain),
        emitter.power * coupling * passing,
        coupling,
        passing,
        _arrival(parts.emitter, parts.receiver),
    )
    doubts = _doubts(parts.share, passing, chain)
    doubts += _narrow(chain, parts.emitter, parts.receiver)
    return path, " and ".join(doubts)


def _arrival(emitter: PlacedSource, receiver: PlacedSource) -> tuple[float, float]:
    """Direction cosines of the emitter's middle, in the receiver's frame."""
    way = receiver.pose[:3, :3].T @ _between(emitter, receiver)
    alpha, beta, _ = (way / np.linalg.norm(way)).tolist()
    return alpha, beta


def _between(emitter: PlacedSource, receiver: PlacedSource) -> Any:
    """(3,) in m, from the receiver's middle to the emitter's."""
    middles = [
        place.points(np.reshape(place.source.bounds, (2, 2)).mean(axis=0)[None])[0]
        for place in (emitter, receiver)
    ]
    return middles[0] - middles[1]


def _doubts(facing: float, passing: float, chain: Way) -> list[str]:
    doubts = []
    if facing < 1:
        doubts.append("a part lies behind the plane of the other source and is left out")
    if passing < 1 and not chain:
        doubts.append(
            f"{passing:.1%} of direct light passes obstacles, by rays, without diffraction"
        )
    return doubts


def _narrow(chain: Way, image: PlacedSource, receiver: PlacedSource) -> list[str]:
    """Of mirrors so small that edges shape what they send, and rays do not know it."""
    zone = math.sqrt(receiver.wavelength * float(np.linalg.norm(_between(image, receiver))))
    unit = receiver.scene_unit
    return [
        f"{mirror.name!r} is narrower than a Fresnel zone of {zone:.3g} m: it sends less than "
        "counted here by rays"
        for mirror in chain
        if _width(mirror) * unit < zone
    ]


def _width(mirror: Mirror) -> float:
    """At most the side of a square of the mirror's diagonal, in scene units."""
    box = mirror.shape.bbox()
    return math.dist(box.min, box.max) / math.sqrt(2)


def ways_of(mirrors: list[Mirror], reflections: int) -> list[Way]:
    """The straight way, and those by up to so many mirrors; SceneError for too many of them."""
    return [(), *chains_of(mirrors, reflections)]


def mirrors_in(scene: Any, unit: float, reflections: int) -> tuple[list[Mirror], list[str]]:
    """The flat mirrors of a scene, and what is to be said of its smooth surfaces."""
    mirrors, others = mirrors_of(scene, unit)
    notes = []
    if others:
        notes.append(
            f"light by {', '.join(others)}, smooth but no flat mirror, is left out of direct light"
        )
    if mirrors:
        plural = "" if reflections == 1 else "s"
        limit = f"more than {reflections} reflection{plural}" if reflections else "flat mirrors"
        notes.append(
            f"left out: direct light by {limit}, light from mirrors to rough surfaces, and waves "
            "from the edges of mirrors"
        )
    return mirrors, notes
