"""The coupling of an emitter and a receiver in a scene, as far as they are in front of each other.

Exact, by :func:`polywigner.coupling`, where nothing is in between. Neither source radiates
backwards. Of one that reaches behind the plane of the other only the part in front counts, as
behind an opaque screen without edges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import PolywignerError, SceneError
from polywigner.geometry import Aperture, Wavefront
from polywigner.illumination import Array
from polywigner.illumination.obliquities import CONDITIONS
from polywigner.mitsuba.placed_sources import PlacedSource
from polywigner.mitsuba.placement import PLACE_ERROR
from polywigner.mitsuba.radiator import norm_of
from polywigner.reception import coupling
from polywigner.transforms.phase_space import energy_of

__all__ = ["FacingParts", "coupled_share", "facing_parts"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FacingParts:
    """What each of two sources has in front of the other's plane."""

    emitter: PlacedSource
    receiver: PlacedSource
    share: float
    """Of int |u|^2 of both, the product: 1 where all faces all."""


def facing_parts(emitter: PlacedSource, receiver: PlacedSource) -> FacingParts | None:
    """The parts that face each other; None where there are none, as in one plane."""
    sizes = [
        max(float(np.abs(values).max()) for values in (placed.pose[:3, 3], placed.source.bounds))
        for placed in (emitter, receiver)
    ]
    rounding = PLACE_ERROR * max(sizes)
    parts, share = [], 1.0
    for one, other in ((emitter, receiver), (receiver, emitter)):
        pose = one.pose_of(other)
        part = _part_in_front(one.source, pose[:3, 2], pose[:3, 3], rounding)
        if part is None:
            return None
        if part is not one.source:
            share *= energy_of(part) / energy_of(one.source)
        parts.append(replace(one, source=part))
    return FacingParts(parts[0], parts[1], share)


def coupled_share(parts: FacingParts, tolerance: float) -> float:
    """Received over radiated power with nothing in between, as the receiver counts it.

    Of partly coherent sources and of a band of frequencies its mean.

    Raises SceneError where the link is too much work, or too near, and where it has no boundary
    condition at both ends.
    """
    emitter, receiver = parts.emitter, parts.receiver
    link = f"the link from emitter {emitter.name!r} to receiver {receiver.name!r}"
    _check_obliquity(link, emitter.obliquity, receiver.obliquity)
    pose = emitter.pose_of(receiver)
    method: Any = emitter.obliquity
    share = 0.0
    # mixtures take no slopes, by which the fields of links and of patterns differ in scale
    is_plain = emitter.mixture.is_plain and receiver.mixture.is_plain
    counted: Any = "radiated" if is_plain else "aperture"
    try:
        for sent, wavelength, weight in emitter.mixture.parts(emitter.source, emitter.wavelength):
            for taken, _, other in receiver.mixture.parts(receiver.source, wavelength):
                b = coupling(sent, taken, pose, wavelength, method, tolerance, normalise=counted)
                share += weight * other * abs(b) ** 2
    except PolywignerError as error:
        raise SceneError(f"{link}: {error}") from None
    for placed in (emitter, receiver):
        mine = norm_of(placed.source, placed.wavelength, method, normalise=counted)
        share *= mine / placed.norm
    return float(share)


def _check_obliquity(link: str, one: str, other: str) -> None:
    if one != other:
        raise SceneError(
            f"{link}: expected one obliquity, got {one!r} and {other!r}; a link has one boundary "
            "condition at both ends: give both the same"
        )
    if one not in CONDITIONS:
        raise SceneError(
            f'{link}: expected a boundary condition as obliquity, got "paper", of which there are '
            'no links; use "rayleigh-sommerfeld-1"'
        )


def _part_in_front(source: Any, normal: Floats, place: Floats, rounding: float) -> Any:
    """The part of a source in z = 0 in front of the plane through ``place``; itself if that is all.

    ``rounding``: heights of no account, in m.
    """
    if isinstance(source, Wavefront):
        flat = _part_in_front(source.source, normal, place, rounding)
        if flat is None or flat is source.source:
            return None if flat is None else source
        return source.on(flat)
    elements = source.elements_in_plane
    parts = [_cut(element, normal, float(normal @ place) + rounding) for element in elements]
    if all(part is element for part, element in zip(parts, elements, strict=True)):
        return source
    weights = source.weights if isinstance(source, Array) else np.ones(1)
    kept = [(part, w) for part, w in zip(parts, weights, strict=True) if part is not None]
    return Array([part for part, _ in kept], [w for _, w in kept]) if kept else None


def _cut(element: Aperture, normal: Floats, least: float) -> Aperture | None:
    """Where ``normal`` . x > ``least``; the very element where that is everywhere."""
    corners = np.concatenate(element.rings)
    heights = corners @ normal[:2] - least
    if (heights > 0).all():
        return element
    if not (heights > 0).any():
        return None
    slope = float(np.hypot(*normal[:2]))
    ahead = normal[:2] / slope
    beside = np.array([-ahead[1], ahead[0]])
    far = 2 * (element.diameter + float(np.abs(heights).max()) / slope)
    foot = element.centre - ahead * (float(element.centre @ normal[:2]) - least) / slope
    box = [foot + beside * far * s + ahead * far * a for s, a in ((1, 0), (-1, 0), (-1, 1), (1, 1))]
    found = shapely.intersection(element.polygons, shapely.Polygon(box))
    polygons = [part for part in shapely.get_parts(found) if part.area > 0]
    if not polygons:
        return None
    return Aperture(shapely.MultiPolygon(polygons)).with_illumination(element.illumination)
