"""The ``wigner_receiver`` sensor: the power that a coherent aperture receives of a scene.

A radiance L that arrives at the receiver's plane adds, in the receiver's own frame and with
N the power that the field u which it would send radiates, or int |u|^2,

    P = (1/N) int int g W(x, s_par / lambda) L(x, s) dx ds                   (estimator ``wigner``)

and, of the same power by reciprocity, from points y of surfaces at the distance r from x,

    P = (lambda^2/N) int r^2 |U(y)|^2 L ds, the mean over x by |u|^2           (estimator ``exact``)

with U the field that the receiver would send to y. Rays that meet nothing weigh by the far
pattern: that of a point far out. docs/receivers.md has the limits.

Rays start at positions relative to the middle of the source: see module `emitter`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution import without_collection
from polywigner.geometry import Aperture
from polywigner.mitsuba.plugins.diffraction import cast_shadows
from polywigner.mitsuba.plugins.exact import ExactEstimator
from polywigner.mitsuba.plugins.parameters import ESTIMATORS, read_receiver, rigid_pose, values_of
from polywigner.mitsuba.plugins.placement import Frame, reach_of
from polywigner.mitsuba.plugins.polarisation import Polariser, polarised_spec
from polywigner.mitsuba.plugins.registration import RECEIVER_NAME, add_plugin, nested_properties
from polywigner.mitsuba.plugins.sampling import Tabulated, opaque
from polywigner.mitsuba.plugins.sources import SourceSpec, emissions
from polywigner.mitsuba.plugins.wigner import WignerRadiance
from polywigner.mitsuba.scenes.surfaces import ROUNDING, largest, matrix_of, sorted_sensors
from polywigner.source import Array
from polywigner.source.obliquities import irradiance_factor
from polywigner.transforms import fourier


def distance_to_surface(m: Any, scene: Any, ray: Any, far: Any, active: Any) -> Any:
    """The distance along a ray to the first surface that is not ``null``; ``far`` if none."""
    direction = m.Vector3f(ray.d)
    state = (m.Point3f(ray.o), m.Float(0.0), m.Bool(active))

    def body(place: Any, distance: Any, going: Any) -> Any:
        found, is_null = _next(m, scene, m.Ray3f(place, direction), far, going)
        found = dr.select(is_null, found + _step(m, place + direction * found), found)
        return m.Point3f(place + direction * found), distance + found, going & is_null

    if dr.is_jit_v(m.Float):
        return dr.while_loop(state, lambda *state: state[2], body, mode="symbolic")[1]
    while state[2]:
        state = body(*state)
    return state[1]


def _step(m: Any, point: Any) -> Any:
    """Distance behind a surface at which Mitsuba's own rays start again."""
    return (1.0 + largest(point)) * float(m.math.RayEpsilon)


def _next(m: Any, scene: Any, ray: Any, far: Any, active: Any) -> tuple[Any, Any]:
    """Distance to the next surface, and whether that is ``null``."""
    surface = scene.ray_intersect_preliminary(ray, False, active)
    is_hit = surface.is_valid()
    found = dr.select(is_hit, surface.t, far)
    bsdf = surface.shape.bsdf() if dr.is_jit_v(m.Float) or is_hit else None
    if bsdf is None:
        return found, False
    kind = bsdf.flags() & int(mi.BSDFFlags.All)  # one with an opacity does not only let pass
    return found, is_hit & (kind == int(mi.BSDFFlags.Null))


# Places of the table in a lobe, which is wavelength/size wide in direction cosines.
_IN_LOBE = 4
_FEWEST, _MOST = 32, 1024
# Along each side, so that no narrow beam passes between places of the largest table.
_MOST_WITHIN = 4
# Shares of the samples: in proportion to the far pattern, which far surfaces are seen by; to its
# root, for W and what is near; and everywhere in front.
_SHARES = (0.4, 0.4, 0.2)
# Cosine at the horizon, whose square is still a normal number of float32.
_GRAZING = 1e-9


def directions_of(
    m: Any,
    fields: list[Aperture | Array],
    wavelength: float,
    obliquity: str,
    coherence_width: float = math.inf,
) -> Tabulated:
    """A sampler of (alpha, psi) where the far pattern g |F|^2 is, and with a share everywhere."""
    low, high = np.reshape(fields[0].bounds, (2, 2))
    lobes = _IN_LOBE * (high - low) / wavelength
    # powers of two: as a literal, every new size would compile the render kernel again
    wanted = 2.0 ** np.ceil(np.log2(lobes * [2.0, math.pi]))
    counts = np.clip(wanted, _FEWEST, _MOST).astype(int)
    within = int(np.clip(np.ceil((wanted / counts).max()), 1, _MOST_WITHIN))
    pattern = _mean_pattern(fields, wavelength, obliquity, counts, within)
    spread = wavelength / (2 * math.pi * coherence_width)
    if spread > 0:
        pattern = _blurred(pattern, spread * counts / np.array([2.0, math.pi]))
    kinds = (pattern, np.sqrt(pattern), np.ones_like(pattern))
    density = sum(share * kind / kind.mean() for share, kind in zip(_SHARES, kinds, strict=True))
    return Tabulated(m, density, np.array([-1.0, -math.pi / 2]), np.array([2.0, math.pi]))


def _mean_pattern(
    sources: list[Any], wavelength: float, obliquity: str, counts: Any, within: int
) -> npt.NDArray[np.float64]:
    """g |F|^2 at the points of a grid, the mean over so many places a side around each."""
    steps = np.array([2.0, math.pi]) / counts
    shifts = (np.arange(within) + 0.5) / within - 0.5
    total: Any = 0.0
    fields = [field for source in sources for field in emissions(source, wavelength, obliquity)]
    for shift_x in shifts:
        for shift_y in shifts:
            axes = [
                (np.arange(n + 1) + shift) * step - n * step / 2
                for n, shift, step in zip(counts, (shift_x, shift_y), steps, strict=True)
            ]
            alpha, psi = np.clip(axes[0], -1.0, 1.0), axes[1][:, None]
            rho = np.sqrt(1.0 - alpha * alpha)
            cosine = np.maximum(rho * np.cos(psi), 0.0)
            nu = np.stack(np.broadcast_arrays(alpha, rho * np.sin(psi)), axis=-1) / wavelength
            for field, forms in fields:
                factor = irradiance_factor(forms, cosine)
                total = total + np.abs(fourier(field, nu)) ** 2 * factor
    return np.maximum(np.asarray(total), 0.0)


def _blurred(values: npt.NDArray[np.float64], steps: Any) -> npt.NDArray[np.float64]:
    """Values, rows along y, blurred by a normal density of so many steps along x and y."""
    for axis, width in ((1, steps[0]), (0, steps[1])):
        half = min(values.shape[axis] - 1, math.ceil(4 * width))
        weights = np.exp(-0.5 * (np.arange(-half, half + 1) / width) ** 2)
        moved = np.moveaxis(values, axis, -1)
        rows = [np.convolve(row, weights / weights.sum(), mode="same") for row in moved]
        values = np.moveaxis(np.array(rows)[..., : moved.shape[-1]], -1, axis)
    return values


def direction_of(m: Any, angles: Any) -> Any:
    """The unit vector of (alpha, psi), in front of the receiver."""
    rho = _root(1.0 - angles.x * angles.x)
    sine, cosine = dr.sincos(angles.y)
    return m.Vector3f(angles.x, rho * sine, dr.abs(rho * cosine) + _GRAZING)


def in_pixel(m: Any, place: Any, size: tuple[int, int]) -> tuple[Any, Any]:
    """(alpha, psi) uniform in the directions of a pixel, and their solid angle."""
    width, height = size
    alpha = place.x * (2.0 / width) - 1.0
    row = dr.floor(place.y)
    rho = _root(1.0 - alpha * alpha)
    inverse = 1.0 / dr.select(rho > 0.0, rho, 1.0)
    low, high = (
        dr.asin(dr.clip(((row + k) * (2.0 / height) - 1.0) * inverse, -1.0, 1.0)) for k in (0, 1)
    )
    psi = low + (high - low) * (place.y - row)
    return m.Point2f(alpha, psi), (high - low) * (2.0 / width)


def _root(value: Any) -> Any:
    return dr.sqrt(dr.select(value > 0.0, value, 0.0))


# To a point that stands for a direction: reaches squared over wavelengths, or reaches.
_FAR = 1e4
# Surfaces behind which rays of a receiver with diffraction look, at most: each halves the rays.
_MOST_PASSED = 4


@cache
def receiver_class(variant: str) -> Any:
    """The sensor's class for one Mitsuba variant; the same class on every call."""
    m = getattr(mi, variant)

    base: Any = m.Sensor

    class WignerReceiver(base):
        """Reads watts; docs/receivers.md."""

        is_wigner_receiver = True

        def __init__(self, spec: SourceSpec, props: Any) -> None:
            super().__init__(props)
            self.m_needs_sample_3 = True
            self.spec = spec
            self.scene: Any = None  # while it is rendered, see `receiving`
            self.fineness = 1  # pixels of the film for one of the map, see module `films`
            self.to_world = m.Transform4f(m.Matrix4f(spec.pose))
            self._place()
            source, wavelength = spec.centred.at_origin, spec.wavelength
            width = spec.mixture.coherence_width
            fields = [field for field, _ in spec.fields(source)]
            self.directions = directions_of(m, fields, wavelength, spec.obliquity, width)
            self.polariser = Polariser(m, spec.polarisation)
            own = WignerRadiance(m, spec, wavelength)
            self.estimator = ESTIMATORS[spec.estimator](m, spec, wavelength, own)
            reach = float(np.hypot(*np.abs(np.reshape(source.bounds, (2, 2))).max(axis=0)))
            far = _FAR * reach * max(reach / wavelength, 1.0)
            self._far = opaque(m, far / spec.scene_unit)

        def _place(self) -> None:
            pose = self.spec.pose
            self._frame = Frame(m, self.to_world, self.spec.centred.centre / self.spec.scene_unit)
            self.stand_at(float(np.abs(pose[:3]).max()))

        def stand_at(self, reach: float) -> None:
            """Take over the ``reach`` of its place in a scene; see module `surfaces`.

            Rays start a little in front, for the receiver may stand on a surface.
            """
            self._lift = opaque(m, ROUNDING * reach)

        # ---- what a user may change ----------------------------------------------------------

        def traverse(self, callback: Any) -> None:
            """Film and sampler, as all sensors have them, and ``to_world`` (rigid)."""
            super().traverse(callback)
            callback.put("to_world", self.to_world, mi.ParamFlags.NonDifferentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            """Take over a new pose."""
            super().parameters_changed(keys)
            if "to_world" in keys:
                self.spec = replace(self.spec, pose=rigid_pose(matrix_of(self.to_world)))
                self._place()

        # ---- rays ----------------------------------------------------------------------------

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> Any:
            angles, solid_angle = self._looks(sample2)
            ray, weight, share = self.look_along(angles, time, sample1, sample3, active)
            return ray, self.weigh(share, weight * solid_angle, angles, active)

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> Any:
            ray, weight = self.sample_ray_differential(time, sample1, sample2, sample3, active)
            return m.Ray3f(ray), weight

        def weigh(self, colours: Any, weight: Any, angles: Any, active: Any = True) -> Any:
            """The weight of a ray as a spectrum, in the receiver's polarisation if it has one."""
            direction = direction_of(m, angles)
            return colours * self.polariser.taken(weight, direction, self._frame, active)

        def look_along(
            self, angles: Any, time: Any, sample1: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any, Any]:
            """A ray, its W per radiance and solid angle, and the same for colours."""
            direction = direction_of(m, angles)
            ray = m.RayDifferential3f()
            ray.time = time
            ray.d = self._frame.to_scene(direction)
            ray.maxt = m.Float(float(np.finfo(np.float32).max))
            coins = 0.0
            if self.spec.diffraction:
                sample3, coins = m.Point2f(sample3), sample3.y * (1 << _MOST_PASSED)
                sample3.y = coins - dr.floor(coins)
            x, per_area = self.estimator.draw(sample3)
            ray.o = self._frame.point(x) + self.lift
            share: Any = 1.0
            if self.spec.diffraction:
                share = self._pass_surfaces(ray, m.UInt32(coins), active)
            met = self._met(ray, x, direction, active) if self.estimator.needs_distance else ()
            weight = share * self.estimator.received(x, direction, per_area, *met)
            zero = dr.zeros(m.SurfaceInteraction3f)
            ray.wavelengths, colours = self.sample_wavelengths(zero, sample1, active)
            return ray, weight, colours

        def _looks(self, sample: Any) -> tuple[Any, Any]:
            """Angles of a direction for a place on the film, and the solid angle it stands for."""
            film = self.film()
            fine = self.fineness
            width, height = (int(n) // fine for n in film.size())
            if width * height == 1:
                angles, density = self.directions.sample(sample)
                return angles, 1.0 / density
            corner, size = film.crop_offset(), film.crop_size()
            place = m.Point2f(
                (sample.x * int(size[0]) + int(corner[0])) / fine,
                (sample.y * int(size[1]) + int(corner[1])) / fine,
            )
            return in_pixel(m, place, (width, height))

        @property
        def lift(self) -> Any:
            """From a place on the receiver to where its ray starts."""
            return self._frame.axes[2] * self._lift

        def _pass_surfaces(self, ray: Any, coins: Any, active: Any) -> Any:
            """Start a ray behind some of the surfaces on its way: their light comes over edges."""
            scene, going, weight = self._told(), m.Bool(active), m.Float(1.0)
            for number in range(_MOST_PASSED + 1):
                distance = distance_to_surface(m, scene, ray, self._far, going)
                is_met = going & (distance < self._far)
                if number:  # behind the last surface is no light that others do not see
                    weight = dr.select(going & (is_met ^ m.Bool(True)), 0.0, weight)
                if number == _MOST_PASSED:
                    break
                passes = is_met & ((coins & m.UInt32(1 << number)) != m.UInt32(0))
                weight = dr.select(is_met, 2.0 * weight, weight)
                ahead = ray.d * (distance + _step(m, ray.o + ray.d * distance))
                ray.o = m.Point3f(dr.select(passes, ray.o + ahead, ray.o))
                going = passes
            return weight

        def _told(self) -> Any:
            if self.scene is None:
                raise SceneError(
                    "expected the scene of the wigner_receiver for its estimator "
                    f'"{self.spec.estimator}", got none from Mitsuba; render with '
                    "polywigner.mitsuba.render, or within `with "
                    'polywigner.mitsuba.receiving(scene)`, or use the estimator "wigner"'
                )
            return self.scene

        def _met(self, ray: Any, x: Any, direction: Any, active: Any) -> tuple[Any, Any]:
            """The place of the surface that a ray meets, or one far out, and its distance."""
            scene = self._told()
            distance = distance_to_surface(m, scene, ray, self._far, active)
            if self.spec.diffraction:  # rays may start behind surfaces
                place = m.Point3f(self._frame.to_own(ray.o + ray.d * distance - self._frame.origin))
                return place, dr.norm(place - m.Point3f(x.x, x.y, 0.0))
            along = direction * distance
            point = m.Point3f(x.x + along.x, x.y + along.y, self._lift + along.z)
            return point, distance

        def bbox(self) -> Any:
            # scalar variants have one kind
            box = getattr(m, "ScalarBoundingBox3f", m.BoundingBox3f)
            return box(self.spec.pose[:3, 3].tolist())

        def to_string(self) -> str:
            spec = self.spec
            return (
                f"WignerReceiver[\n  wavelength = {spec.wavelength},\n"
                f"  estimator = {spec.estimator},\n  obliquity = {spec.obliquity},\n"
                f"  source = {spec.source!r},\n  film = {self.film()}\n]"
            )

    return WignerReceiver


def is_receiver(sensor: Any) -> bool:
    """Whether a sensor is a ``wigner_receiver``."""
    return getattr(type(sensor), "is_wigner_receiver", False)


def sensors_of(scene: Any) -> list[Any]:
    """The sensors of a scene; ArgumentError for anything else."""
    if not hasattr(scene, "sensors"):
        raise ArgumentError(
            f"expected a mi.Scene, got {type(scene).__name__}; make one with "
            "polywigner.mitsuba.load_scene or mi.load_dict"
        )
    return list(scene.sensors())


def receivers_of(scene: Any) -> list[tuple[int, Any]]:
    """Return the receivers of a scene, sorted by id, with their Mitsuba indices among its sensors.

    Raises SceneError for a scene without a receiver.
    """
    sensors_of(scene)
    found = [(k, sensor) for k, sensor in sorted_sensors(scene) if is_receiver(sensor)]
    if not found:
        raise SceneError(
            "expected a scene with a receiver, got one without; add a <sensor "
            'type="wigner_receiver">, or polywigner.mitsuba.receiver(...)'
        )
    return found


@contextmanager
def scene_known(scene: Any) -> Iterator[None]:
    """Within, receivers and sources whose light diffracts know their scene."""
    cast_shadows(scene)
    with ExitStack() as stack:
        # a scene that is freed while Dr.Jit records a kernel ends the process
        stack.enter_context(without_collection())
        stack.callback(setattr, ExactEstimator, "tells", ExactEstimator.tells)
        ExactEstimator.tells = True
        for plugin in (*scene.emitters(), *scene.sensors()):
            if hasattr(plugin, "stand_at"):
                plugin.stand_at(reach_of(scene, plugin))
        for sensor in filter(is_receiver, scene.sensors()):
            stack.callback(setattr, sensor, "scene", sensor.scene)
            sensor.scene = scene
        yield


def _check_film(values: dict[str, Any]) -> None:
    """SceneError without a film, in whose place Mitsuba takes one of 768 x 576 pixels."""
    objects = (value for value in values.values() if isinstance(value, mi.Object))
    films = [each for each in objects if hasattr(each, "rfilter") and hasattr(each, "crop_size")]
    if not films:
        raise SceneError(
            "expected a film in the wigner_receiver sensor, got none; give it one of 1 x 1 pixel: "
            '<film type="hdrfilm"> with width 1, height 1 and <rfilter type="box"/>'
        )
    name = films[0].rfilter().class_name()
    if name != "BoxFilter":
        raise SceneError(
            f"expected a film with a box filter in the wigner_receiver sensor, got {name}; give "
            'the film <rfilter type="box"/>: other filters share samples among pixels'
        )


def _build(variant: str, props: Any) -> Any:
    """The sensor for the parameters of one ``wigner_receiver`` element."""
    values = values_of(props)
    spec = read_receiver(values)
    spec = polarised_spec(variant, spec, "wigner_receiver sensor")
    _check_film(values)
    return receiver_class(variant)(spec, nested_properties(RECEIVER_NAME, props))


add_plugin("sensor", RECEIVER_NAME, _build)
