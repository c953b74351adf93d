"""Where the mesh of a source is: on its plane, in the pose of its emitter."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.geometry import Aperture, Wavefront, triangulate
from polywigner.mitsuba.plugins.parameters import rigid_pose
from polywigner.mitsuba.plugins.sources import PLAIN, Complexes, Mixture
from polywigner.mitsuba.scenes.surfaces import matrix_of, reach_at
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.reception.norms import NORMALISATIONS
from polywigner.source import Array
from polywigner.source.polarisation import Stokes, stokes_fields
from polywigner.source.support import mirrored_source
from polywigner.transforms.wavefronts import flat_of

# The pose is held in single precision: its rotation and translation round by 6e-8 of the largest
# coordinate each, the positions once more.
PLACE_ERROR = 5e-7


class Frame:
    """A rigid frame of one variant's arrays, its origin in the middle of a source."""

    def __init__(self, m: Any, to_world: Any, centre: npt.NDArray[np.float64]) -> None:
        matrix = to_world.matrix
        columns = [m.Vector3f(*(matrix[row, col] for row in range(3))) for col in range(4)]
        cx, cy = centre.tolist()
        self._m = m
        self.axes = columns[:3]
        self.origin = m.Point3f(columns[0] * cx + columns[1] * cy + columns[3])
        # as literals, every new pose would compile the render kernel again
        if dr.is_jit_v(m.Float):
            dr.make_opaque(self.axes, self.origin)

    def to_own(self, v: Any) -> Any:
        """A vector of the scene in this frame."""
        return self._m.Vector3f(*(dr.dot(axis, v) for axis in self.axes))

    def to_scene(self, v: Any) -> Any:
        """A vector of this frame in the scene."""
        ex, ey, ez = self.axes
        return ex * v.x + ey * v.y + ez * v.z

    def point(self, x: Any) -> Any:
        """The point of the scene at a position in the plane."""
        ex, ey, _ = self.axes
        return self.origin + ex * x.x + ey * x.y


def world_positions(
    points: npt.NDArray[np.float64],
    pose: npt.NDArray[np.float64],
    centre: npt.NDArray[np.float64],
) -> npt.NDArray[np.float32]:
    """Points (n, 2) of the source's plane relative to its centre (2,), in the scene (n, 3)."""
    return ((points + centre) @ pose[:3, :2].T + pose[:3, 3]).astype(np.float32)


def move(shape: Any, pose: Any, centre: npt.NDArray[np.float64]) -> None:
    """Put the mesh where the emitter is; its texture coordinates are relative to the centre."""
    params = mi.traverse(shape)
    local = np.asarray(params["vertex_texcoords"], dtype=np.float64).reshape(-1, 2)
    params["vertex_positions"] = world_positions(local, pose, centre).ravel().tolist()
    params.update()


def cover(
    shape: Any,
    support: Aperture,
    pose: npt.NDArray[np.float64],
    centre: npt.NDArray[np.float64],
    unit: float,
) -> None:
    """Give the mesh the shape of a region in m, relative to a centre in units of ``unit``."""
    points, triangles = triangulate(support)
    points = points / unit
    params = mi.traverse(shape)
    # Lists, in all variants: of NumPy's memory, whose alignment enters the kernels, Dr.Jit makes no
    # copy, and it ends the process if a scene with some is freed while a function is recorded.
    params["vertex_positions"] = world_positions(points, pose, centre).ravel().tolist()
    params["vertex_texcoords"] = points.ravel().tolist()
    params["faces"] = triangles.ravel().tolist()
    params.update()


def hide(shape: Any) -> None:
    """Leave no surface that a ray could meet: each triangle has a single corner."""
    params = mi.traverse(shape)
    params["faces"] = [0] * len(params["faces"])
    params.update()


def check_place(shape: Any, pose: Any, centre: npt.NDArray[np.float64]) -> None:
    """Raise SceneError where somebody has moved the mesh but not the emitter."""
    params = mi.traverse(shape)
    local, seen = (
        np.asarray(dr.detach(params[name]), dtype=np.float64).reshape(-1, count)
        for name, count in (("vertex_texcoords", 2), ("vertex_positions", 3))
    )
    expected = world_positions(local, np.asarray(pose), centre)
    allowed = PLACE_ERROR * max(np.abs(local).max(), np.abs(expected).max())
    if not np.abs(seen - expected).max() <= allowed:
        raise SceneError(
            "expected the mesh of a wigner shape to stay where its to_world puts it, got other "
            "vertex_positions; change emitter.to_world, which moves mesh and light"
        )


def reach_of(scene: Any, plugin: Any) -> float:
    """The ``reach`` of a source or receiver in its scene; see module `surfaces`."""
    return _placed(plugin, "").touching(scene).reach / plugin.spec.scene_unit


Floats = NDArray[np.float64]

# Parameters are held in single precision.
_ROUNDING = 1e-6
_MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class PlacedSource:
    """A source with its pose in space, in metres."""

    name: str
    source: Aperture | Array
    pose: Floats
    """(4, 4): of the source's frame in the scene's, the translation in m."""
    wavelength: float
    obliquity: str
    scene_unit: float
    norm: float
    """Power in W that the field as it is counts, all of the source: radiated, or int |u|^2."""
    power: float = 0.0
    """Radiated, in W."""
    mixture: Mixture = PLAIN
    """Mixture of its light."""
    diffraction: bool = False
    """Whether shadows on its way diffract."""
    medium: Any = None
    """Fog that the source stands in, as the sensor says; None: none."""
    polarisation: Complexes | None = None
    """As of :class:`SourceSpec`."""
    states_polarisation: bool = False
    """As of :class:`SourceSpec`."""
    normalise: str = NORMALISATIONS[0]
    """Power that ``norm`` stands for."""
    reach: float = 0.0
    """Largest coordinate of the flat surfaces that touch it, in m; see module `surfaces`."""

    @property
    def fields(self) -> list[tuple[Any, Stokes]]:
        """Scalar sources, and the Stokes numbers by which their light adds up to the source's."""
        if self.polarisation is None:
            return [(self.source, (1.0, 0.0, 0.0, 0.0))]
        return stokes_fields(self.source, self.polarisation)

    def mirrored(self, normal: Floats, offset: float) -> PlacedSource:
        """Its image behind the plane of the points p with ``normal`` . p = ``offset``, in m."""
        reflection = np.eye(4)
        reflection[:3, :3] -= 2 * np.outer(normal, normal)
        reflection[:3, 3] = 2 * offset * normal
        pose = reflection @ self.pose @ _MIRROR
        flat = mirrored_source(flat_of(self.source))
        if not isinstance(self.source, Wavefront):
            return replace(self, source=flat, pose=pose)
        sign = np.array([-1.0, 1.0])  # x changes its sign
        wave = self.source
        mirrored = wave._with(
            source=flat, curvature=wave.curvature * np.outer(sign, sign), centre=wave.centre * sign
        )
        return replace(self, source=mirrored, pose=pose)

    def image(self, chain: Iterable[Any]) -> PlacedSource:
        """Its image in mirrors, each with a ``normal`` and an ``offset``, in the light's order."""
        image = self
        for mirror in chain:
            image = image.mirrored(mirror.normal, mirror.offset)
        return image

    def points(self, places: Floats) -> Floats:
        """Places (n, 2) of its plane in space, (n, 3) in m."""
        result: Floats = places @ self.pose[:3, :2].T + self.pose[:3, 3]
        return result

    def touching(self, scene: Any) -> PlacedSource:
        """Itself, with the ``reach`` of surfaces of a scene."""
        low, high = np.reshape(self.source.bounds, (2, 2))
        corners = [[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])]
        reach = reach_at(scene, self.points(np.array(corners)) / self.scene_unit)
        return replace(self, reach=reach * self.scene_unit)

    @property
    def middle(self) -> Floats:
        """(3,) in m, of the source's bounds."""
        result: Floats = self.points(np.reshape(self.source.bounds, (2, 2)).mean(axis=0)[None])[0]
        return result

    @property
    def normal(self) -> Floats:
        """(3,): where it radiates, or receives from."""
        return self.pose[:3, 2]

    def cosines_to(self, point: Floats) -> tuple[float, float]:
        """Direction cosines from the middle to a point (3,) in m, in the source's frame."""
        away = self.pose[:3, :3].T @ (point - self.middle)
        alpha, beta, _ = (away / np.linalg.norm(away)).tolist()
        return alpha, beta

    def pose_of(self, other: PlacedSource) -> Floats:
        """(4, 4), in m: of the other's frame in this one's."""
        result = np.eye(4)
        result[:3, :3] = self.pose[:3, :3].T @ other.pose[:3, :3]
        result[:3, 3] = self.pose[:3, :3].T @ (other.pose[:3, 3] - self.pose[:3, 3])
        return result


def is_source(emitter: Any) -> bool:
    """Whether an emitter is one of a ``wigner`` shape."""
    return getattr(type(emitter), "is_wigner", False)


def placed_emitter(emitter: Any, number: int) -> PlacedSource:
    """A wigner emitter; ``number`` names one without an id."""
    name = emitter.get_shape().id() or f"emitter {number}"
    return replace(_placed(emitter, name), power=_single(emitter.power, emitter.spec.power))


def placed_receiver(sensor: Any, number: int) -> PlacedSource:
    """A wigner receiver; ``number`` names one without an id."""
    placed = _placed(sensor, sensor.id() or f"receiver {number}")
    return replace(placed, medium=sensor.get_medium())


def check_match(
    emitter: PlacedSource, receiver: PlacedSource, bandwidth: float | None = None
) -> None:
    """Raise SceneError for an emitter that the receiver cannot receive, or in other units."""
    both = f"of emitter {emitter.name!r} and receiver {receiver.name!r}"
    frequencies = [SPEED_OF_LIGHT / each.wavelength for each in (emitter, receiver)]
    apart = abs(frequencies[0] - frequencies[1])
    if apart > max((bandwidth or 0.0) / 2, _ROUNDING * frequencies[1]):
        band = "" if bandwidth is None else f", {bandwidth:.6g} Hz wide"
        raise SceneError(
            f"expected one wavelength {both}{band}, got {emitter.wavelength:.6g} m, {apart:.6g} Hz "
            "off the receiver's; give both one frequency, or the receiver a bandwidth of twice that"
        )
    check_unit(emitter, receiver)


def check_unit(emitter: PlacedSource, receiver: PlacedSource) -> None:
    """Raise SceneError for two ends in other units."""
    if emitter.scene_unit != receiver.scene_unit:
        both = f"of emitter {emitter.name!r} and receiver {receiver.name!r}"
        raise SceneError(
            f"expected one scene_unit {both}, got {emitter.scene_unit:g} m and "
            f"{receiver.scene_unit:g} m; a scene has one unit"
        )


def _placed(plugin: Any, name: str) -> PlacedSource:
    spec = plugin.spec
    matrix = np.array(matrix_of(plugin.to_world)) if hasattr(plugin, "to_world") else spec.pose
    # those of the scene in double precision, unless somebody has changed them
    same = np.array_equal(matrix.astype(np.float32), spec.pose.astype(np.float32))
    pose = np.array(spec.pose if same else rigid_pose(matrix))
    pose[:3, 3] *= spec.scene_unit
    wavelength = _single(getattr(plugin, "wavelength", spec.wavelength), spec.wavelength)
    shared = (f.name for f in fields(PlacedSource) if hasattr(spec, f.name))
    own = {field: getattr(spec, field) for field in shared}
    return PlacedSource(**own | {"name": name, "pose": pose, "wavelength": wavelength})


def _single(value: Any, known: float) -> float:
    found = float(np.asarray(value, dtype=np.float64).ravel()[0])
    return known if np.float32(found) == np.float32(known) else found
