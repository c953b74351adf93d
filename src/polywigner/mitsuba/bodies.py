"""Conducting bodies beside a scene, and the ways of light by them and by flat mirrors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, PolywignerError, SceneError
from polywigner.geometry.arguments import checked_count
from polywigner.geometry.shapes import square
from polywigner.mitsuba.mirrors import Mirror
from polywigner.mitsuba.placement import PlacedSource
from polywigner.reception.norms import NORMALISATIONS
from polywigner.scattering.antennas import Antenna
from polywigner.scattering.cross_sections import MOST_BOUNCES
from polywigner.scattering.facets import Facets, facets_of
from polywigner.scattering.interreflections import lights_itself

Floats = NDArray[np.float64]

# Error of an echo relative to that of all lit parts in phase, far below physical optics' own.
OF_ECHO = 1e-3
# Ways that are tried: some milliseconds each.
_MOST_WAYS = 5000


@dataclass(frozen=True, eq=False)
class Body:
    """A perfect conductor in the scene's frame, in m."""

    name: str
    facets: Facets
    bounces: int
    """Reflections on it that count."""

    def standing_in(self, image: PlacedSource, like: PlacedSource) -> PlacedSource:
        """A square in the middle that looks at the image of a source, for rays between both."""
        z = image.middle - self.facets.middle
        z /= np.linalg.norm(z)
        x = np.cross(np.eye(3)[np.abs(z).argmin()], z)
        x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3] = np.stack([x, np.cross(z, x), z, self.facets.middle], axis=-1)
        return replace(like, source=square(self.facets.size / 2), pose=pose)

    def antenna(self, image: PlacedSource, wavelength: float) -> Antenna:
        """The image of a source beside the body."""
        pose: Floats = np.asarray(np.linalg.inv(image.pose), np.float64)
        pose[:3, 3] += pose[:3, :3] @ self.facets.middle
        condition: Any = image.obliquity
        return Antenna(
            image.source, pose, wavelength, NORMALISATIONS[0], 0.1 * OF_ECHO, condition=condition
        )

    def is_in_front(self, image: PlacedSource) -> bool:
        """Whether all of it is in front of the plane of the image of a source."""
        corners = self.facets.corners + self.facets.middle
        return bool(((corners - image.pose[:3, 3]) @ image.normal > 0.0).all())

    def doubts(self, wavelength: float, ways: list[Floats]) -> list[str]:
        """Notes on the ways (n, 3) of light from both ends to the body."""
        last = [way[-1] - way[-2] for way in ways]
        near, far = min(map(np.linalg.norm, last)), 2 * self.facets.size**2 / wavelength
        notes = []
        if self.facets.least_face < wavelength:
            notes.append(f"a face of {self.name!r} is smaller than a square wavelength")
        if self.bounces == 1 and lights_itself(self.facets, np.array(last)):
            notes.append(
                f"faces of {self.name!r} light each other: later reflections are left out; give it "
                "as a pair (body, 3)"
            )
        if self.bounces > 1 and near < far:
            notes.append(
                f"{self.name!r} is nearer than 2 D^2/lambda, {far:.3g} m: its second and third "
                "reflections count as those of plane waves"
            )
        return notes


@dataclass(frozen=True)
class Echo:
    """A way by a body, with mirrors in the order of light before it and after it."""

    before: tuple[Mirror, ...]
    body: Body
    after: tuple[Mirror, ...]

    @property
    def names(self) -> tuple[str, ...]:
        before, after = (
            tuple(mirror.name for mirror in part) for part in (self.before, self.after)
        )
        return (*before, self.body.name, *after)

    @property
    def place(self) -> Floats:
        """The body's middle as the receiver sees it, (3,)."""
        place = self.body.facets.middle
        for mirror in self.after:
            place = mirror.image_of(place)
        return place


def checked_bodies(bodies: Any) -> tuple[Body, ...]:
    """Bodies by their names, each alone or with the number of its reflections."""
    if bodies is None:
        return ()
    if not isinstance(bodies, Mapping) or not all(isinstance(name, str) for name in bodies):
        raise ArgumentError(
            "expected bodies as a dict of bodies by their names, each one of pw.rcs or a pair of "
            f"it and a number of reflections, got {bodies!r:.100}"
        )
    return tuple(_body(name, given) for name, given in bodies.items())


def _body(name: str, given: Any) -> Body:
    if not name.strip():
        raise ArgumentError("expected names of bodies with letters, got an empty one; name it")
    bounces = 1
    if isinstance(given, tuple) and len(given) == 2 and isinstance(given[1], int | np.integer):
        given, bounces = given
    try:
        found = facets_of(given)
        return Body(name, found, checked_count(bounces, "reflections", 1, MOST_BOUNCES))
    except PolywignerError as error:
        raise ArgumentError(f"the body {name!r}: {error}") from None


def echoes_of(bodies: Sequence[Body], mirrors: Sequence[Mirror], reflections: int) -> list[Echo]:
    """Ways by one body, with at most one of the mirrors before it and one after it."""
    for name in {body.name for body in bodies} & {mirror.name for mirror in mirrors}:
        raise SceneError(
            f"expected bodies with other names than mirrors, got {name!r} for both; rename the body"
        )
    single = [(), *((mirror,) for mirror in mirrors[: len(mirrors) if reflections else 0])]
    pairs = [pair for pair in product(single, single) if sum(map(len, pair)) <= reflections]
    if len(bodies) * len(pairs) > _MOST_WAYS:
        raise SceneError(
            f"expected at most {_MOST_WAYS} ways by bodies and flat mirrors, got "
            f"{len(bodies) * len(pairs)}; ask for fewer reflections, or make small mirrors rough"
        )
    return [Echo(before, body, after) for body in bodies for before, after in pairs]
