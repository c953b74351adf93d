"""The light that comes from an emitter to a receiver straight, or by flat mirrors alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from polywigner.mitsuba.links import coupled_share, facing_parts
from polywigner.mitsuba.mirrors import Mirror, chains_of, mirrors_of
from polywigner.mitsuba.placed_sources import PlacedSource
from polywigner.mitsuba.received import DirectPath
from polywigner.mitsuba.visibility import passing_share

__all__ = ["DirectLight", "direct_light"]


@dataclass(frozen=True)
class DirectLight:
    """Ways of light, and what is to be said of them."""

    paths: tuple[DirectPath, ...] = ()
    notes: tuple[str, ...] = field(default=())


def direct_light(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    mirrors: list[Mirror],
    reflections: int,
) -> DirectLight:
    """Paths that bring power, in a scene whose sources are unseen.

    Raises SceneError for links and numbers of mirrors that are too much work.
    """
    paths, notes = [], []
    link = f"from {emitter.name!r} to {receiver.name!r}"
    for chain in [(), *chains_of(mirrors, reflections)]:
        way = link + "".join(f" by {mirror.name!r}" for mirror in chain)
        found, reason = _path(scene, emitter, receiver, chain)
        if found is not None:
            paths.append(found)
        # most chains of mirrors lead nowhere
        if reason and (found is not None or not chain):
            notes.append(f"{way}: {reason}")
    return DirectLight(tuple(paths), tuple(notes))


def _path(
    scene: Any, emitter: PlacedSource, receiver: PlacedSource, chain: tuple[Mirror, ...]
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
        return None, "no direct light; obstacles block it"
    coupling = coupled_share(parts)
    path = DirectPath(
        tuple(mirror.name for mirror in chain),
        emitter.power * coupling * passing,
        coupling,
        passing,
        _arrival(parts.emitter, parts.receiver),
    )
    return path, " and ".join(_doubts(parts.share, passing, chain))


def _arrival(emitter: PlacedSource, receiver: PlacedSource) -> tuple[float, float]:
    """Direction cosines of the emitter's middle, in the receiver's frame."""
    ends = [place.points(_middle(place.source)[None])[0] for place in (emitter, receiver)]
    way = receiver.pose[:3, :3].T @ (ends[0] - ends[1])
    alpha, beta, _ = (way / np.linalg.norm(way)).tolist()
    return alpha, beta


def _middle(source: Any) -> Any:
    return np.reshape(source.bounds, (2, 2)).mean(axis=0)


def _doubts(facing: float, passing: float, chain: tuple[Mirror, ...]) -> list[str]:
    doubts = []
    if facing < 1:
        doubts.append("a part lies behind the plane of the other source and is left out")
    if passing < 1 and not chain:
        doubts.append(
            f"{passing:.1%} of direct light passes obstacles, by rays, without diffraction"
        )
    return doubts


def smooth_notes(mirrors: list[Mirror], others: list[str], reflections: int) -> list[str]:
    """What is to be said of smooth surfaces in a scene."""
    notes = []
    if others:
        notes.append(
            f"light by {', '.join(others)}, smooth but no flat mirror, is left out of direct light"
        )
    if mirrors or others:
        limit = (
            f"of more than {reflections} reflections, and " if reflections else "by mirrors, and "
        )
        notes.append(
            f"left out: light {limit}from mirrors to rough surfaces; mirrors have no edge waves"
        )
    return notes


def mirrors_in(scene: Any, unit: float, reflections: int) -> tuple[list[Mirror], list[str]]:
    """Mirrors to reckon with, and what is to be said of smooth surfaces."""
    mirrors, others = mirrors_of(scene, unit)
    return (mirrors if reflections else []), smooth_notes(mirrors, others, reflections)
