"""The light that comes from an emitter to a receiver straight, or by flat mirrors alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import PolywignerError, SceneError
from polywigner.geometry import Aperture, Wavefront
from polywigner.mitsuba.plugins.emissions import norm_of
from polywigner.mitsuba.plugins.placement import PLACE_ERROR, PlacedSource
from polywigner.mitsuba.receive.delta_lights import delta_paths
from polywigner.mitsuba.receive.passing import diffracted_share, passing_share
from polywigner.mitsuba.receive.received import DirectPath
from polywigner.mitsuba.scenes.reflectors import MOST_FACES, Mirror, chains_of, smooth_shapes
from polywigner.mitsuba.scenes.surfaces import bounds_of, meshes_in
from polywigner.reception import coupling
from polywigner.source import Array
from polywigner.source.obliquities import CONDITIONS
from polywigner.transforms.phase_space import energy_of

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FacingParts:
    """Parts of two sources in front of each other's plane."""

    emitter: PlacedSource
    receiver: PlacedSource
    share: float
    """Product of the shares of int |u|^2 that face each other: 1 where all faces all."""


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
    """Received over radiated power with nothing in between, as the receiver counts it."""
    emitter, receiver = parts.emitter, parts.receiver
    link = f"the link from emitter {emitter.name!r} to receiver {receiver.name!r}"
    check_obliquity(link, emitter.obliquity, receiver.obliquity)
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


def check_obliquity(link: str, one: str, other: str) -> None:
    """Raise SceneError for a link without one boundary condition at both ends."""
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
    """The part of a source in z = 0 before of the plane through ``place``."""
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


Way = tuple[Mirror, ...]

UNSEEN = "no line-of-sight path: one end lies in the plane of the other or behind it"
BEHIND = "the part of one end behind the plane of the other is left out"
BLOCKED = "no line-of-sight path: obstacles block it (ray test, without diffraction)"


@dataclass(frozen=True)
class DirectLight:
    """Direct ways of light, and notes on them."""

    paths: tuple[DirectPath, ...] = ()
    notes: tuple[str, ...] = field(default=())
    interfering: float | None = None
    """W of all paths as they interfere; None: their powers add."""

    @property
    def power(self) -> float:
        """W."""
        if self.interfering is not None:
            return self.interfering
        return math.fsum(path.power for path in self.paths)


def direct_light(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    ways: list[Way],
    tolerance: float,
) -> DirectLight:
    """Paths that bring power, in a scene whose sources are unseen."""
    paths, notes = [], []
    share: Callable[..., Floats] = passing_share
    if emitter.diffraction or receiver.diffraction:
        unit = receiver.scene_unit
        meshes = [(p * unit, f) for p, f in meshes_in(scene, receiver.wavelength / unit)]
        share = partial(diffracted_share, meshes)
    link = f"from {emitter.name!r} to {receiver.name!r}"
    for chain in ways:
        way = link + "".join(f" by {mirror.name!r}" for mirror in chain)
        found, reason = _path(scene, emitter, receiver, chain, tolerance, share)
        if found is not None:
            paths.append(found)
        # most chains of mirrors lead nowhere
        if reason and (found is not None or not chain):
            notes.append(f"{way}: {reason}")
    if paths and paths[0].mirrors:
        notes[0] += "; its direct power arrives by reflections"
    return DirectLight(tuple(paths), tuple(notes))


def light_of_points(scene: Any, receiver: PlacedSource, ways: list[Way]) -> DirectLight:
    """Direct light of point, spot, projector and directional lights."""
    paths, notes = delta_paths(scene, receiver, ways), []
    if paths and receiver.diffraction:
        notes.append(
            f"obstacles shadow the direct light of {paths[0].light!r} by rays, without diffraction"
        )
    return DirectLight(tuple(paths), tuple(notes))


def _path(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    chain: Way,
    tolerance: float,
    share: Callable[..., Floats],
) -> tuple[DirectPath | None, str]:
    image = emitter.image(chain)
    parts = facing_parts(image, receiver)
    if parts is None:
        return None, UNSEEN
    # rays leave the emitter itself, from the part whose image faces the receiver
    facing = parts.emitter.image(chain[::-1])
    matrix = share(scene, facing, parts.receiver, chain)
    passing = float(matrix[0, 0])
    if passing == 0:
        return None, BLOCKED
    coupling, matched = _coupled(image, receiver, matrix, tolerance)
    path = DirectPath(
        tuple(mirror.name for mirror in chain),
        emitter.power * coupling * passing * matched,
        coupling,
        passing,
        parts.receiver.cosines_to(parts.emitter.middle),
        matched,
        length=float(np.linalg.norm(image.middle - receiver.middle)),
    )
    doubts = _doubts(parts.share, passing if share is passing_share else 1.0, chain)
    doubts += narrow(chain, parts.emitter, parts.receiver)
    return path, " and ".join(doubts)


def _coupled(
    image: PlacedSource, receiver: PlacedSource, passing: Floats, tolerance: float
) -> tuple[float, float]:
    """|b|^2 with nothing in between whatever the polarisation; the share of it that is received."""
    size = len(passing)
    terms = []
    for sent, leaves in image.fields:
        for taken, wanted in receiver.fields:
            parts = facing_parts(replace(image, source=sent), replace(receiver, source=taken))
            assert parts is not None  # as of the whole sources
            share = coupled_share(parts, tolerance)
            row, column = (np.array(stokes[:size]) for stokes in (wanted, leaves))
            weight = 1.0 if receiver.polarisation is None else 0.5
            received = weight * float(row @ passing @ column)
            terms.append((leaves[0] * wanted[0] * share, received * share))
    whole, received = (math.fsum(column) for column in zip(*terms, strict=True))
    share = received / (whole * float(passing[0, 0])) if whole > 0 else 0.0
    return whole, max(share, 0.0)  # rounding of crossed ends


def _doubts(facing: float, passing: float, chain: Way) -> list[str]:
    doubts = []
    if facing < 1:
        doubts.append(BEHIND)
    if passing < 1 and not chain:
        doubts.append(
            f"{passing:.1%} of the line-of-sight power passes obstacles (ray test, without "
            "diffraction)"
        )
    return doubts


def narrow(chain: Way, image: PlacedSource, receiver: PlacedSource) -> list[str]:
    """Return notes on mirrors so narrow that diffraction at their edges matters."""
    zone = math.sqrt(receiver.wavelength * float(np.linalg.norm(image.middle - receiver.middle)))
    unit = receiver.scene_unit
    return [
        f"{mirror.name!r} is narrower than a Fresnel zone of {zone:.3g} m: diffraction at its "
        "edges changes its reflection, which is that of rays here"
        for mirror in chain
        if _width(mirror) * unit < zone
    ]


def _width(mirror: Mirror) -> float:
    """At most the side of a square of the mirror's diagonal, in scene units."""
    return math.dist(*bounds_of(mirror.shape)) / math.sqrt(2)


def ways_of(mirrors: list[Mirror], reflections: int) -> list[Way]:
    """The straight way, and those by up to so many mirrors; SceneError for too many of them."""
    return [(), *chains_of(mirrors, reflections)]


def mirrors_in(scene: Any, unit: float, reflections: int) -> tuple[list[Mirror], list[str]]:
    """Return the flat mirrors of a scene, and notes on the paths that are not included."""
    smooth = smooth_shapes(scene, unit)
    curved, refracting, unnamed = (
        ", ".join(map(repr, names)) for names in (smooth.curved, smooth.refracting, smooth.unnamed)
    )
    notes = []
    if curved:
        notes.append(
            f"not included: reflection from {curved}, curved or of more than {MOST_FACES} planes"
        )
    if refracting:
        notes.append(f"not included: refracted transmission through {refracting}")
    if smooth.mirrors:
        plural = "" if reflections == 1 else "s"
        limit = f"paths with more than {reflections} reflection{plural}"
        notes.append(
            f"not included: {limit if reflections else 'reflections from flat mirrors'}, light "
            "from mirrors to rough surfaces, and diffraction at the edges of mirrors"
        )
    if unnamed:
        notes.append(
            f"{unnamed} has no id, as after Mitsuba merges shapes with equal BSDFs; load the scene "
            "with polywigner.mitsuba.load_scene to keep ids"
        )
    return smooth.mirrors, notes
