"""The sensor ``wigner_receiver``, which measures the power that a coherent aperture receives.

The radiance L at the point x from the direction s, in the receiver's frame, contributes the power

    P = (1/N) int int g W(x, s_par / lambda) L(x, s) dx ds                   (estimator ``wigner``)

where W is the Wigner function of the field u that the receiver would transmit, g the obliquity
factor, and N the power that this field would radiate, or the integral of |u|^2. By reciprocity, the
same power is an integral over surface points y at the distance r from x,

    P = (lambda^2/N) int r^2 |U(y)|^2 L ds                                   (estimator ``exact``)

averaged over x with the density |u|^2, where U is the field that the receiver would transmit to y.
Positions are relative to the centre of the receiver, as in the module `emitter`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution import Drjit
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_count, takes_frequency
from polywigner.mitsuba.plugins.emitter import ESTIMATORS, checked_parameters
from polywigner.mitsuba.plugins.polariser import Polariser
from polywigner.mitsuba.plugins.registration import (
    VariantPlugin,
    add_plugin,
    nested_properties,
    variant_class,
)
from polywigner.mitsuba.plugins.samplers import Frame, directions_of, opaque
from polywigner.mitsuba.plugins.source_parameters import (
    RECEIVER,
    RECEIVER_ESTIMATOR,
    SourceParameters,
    rigid_pose,
    scene_entry,
    values_of,
)
from polywigner.mitsuba.plugins.wigner import WignerRadiance
from polywigner.mitsuba.scenes.surfaces import ROUNDING, largest_coordinate, matrix_of
from polywigner.quantities import parse_noise
from polywigner.reception.couplings import NORMALISATIONS
from polywigner.source import Array
from polywigner.source.obliquities import DEFAULT


def distance_to_surface(m: Any, scene: mi.Scene, ray: mi.Ray3f, far: Drjit, active: Drjit) -> Drjit:
    """Return the distance along a ray to the first surface that is not a null surface.

    The distance is in scene units. If a ray meets no such surface, the distance is at least
    ``far``.
    """
    direction = m.Vector3f(ray.d)
    state = (m.Point3f(ray.o), m.Float(0.0), m.Bool(active))

    def body(start: Drjit, distance: Drjit, going: Drjit) -> tuple[Drjit, Drjit, Drjit]:
        """Move rays to the next surface, and add the lengths of their steps."""
        surface = scene.ray_intersect_preliminary(m.Ray3f(start, direction), False, going)
        is_hit = surface.is_valid()
        length, is_null = dr.select(is_hit, surface.t, far), False
        bsdf = surface.shape.bsdf() if dr.is_jit_v(m.Float) or is_hit else None
        if bsdf is not None:
            kind = bsdf.flags() & int(mi.BSDFFlags.All)
            is_null = is_hit & (kind == int(mi.BSDFFlags.Null))
        step = length + _spawn_offset(m, start + direction * length)
        length = dr.select(is_null, step, length)
        return m.Point3f(start + direction * length), distance + length, going & is_null

    mode = "symbolic" if dr.is_jit_v(m.Float) else "scalar"
    return dr.while_loop(state, lambda *state: state[2], body, mode=mode)[1]


def _spawn_offset(m: Any, point: mi.Point3f) -> Drjit:
    """Return the distance between a surface and the start of a ray that Mitsuba spawns there."""
    return (1.0 + largest_coordinate(point)) * float(m.math.RayEpsilon)


def direction_of(m: Any, angles: mi.Point2f) -> mi.Vector3f:
    """Convert the angles (alpha, psi) to a unit vector in the frame of the receiver.

    alpha is the direction cosine along x, and psi the angle in rad about the x axis, zero along +z
    and positive towards +y.
    """
    rho = _root_of_positive(1.0 - angles.x * angles.x)
    sine, cosine = dr.sincos(angles.y)
    return m.Vector3f(angles.x, rho * sine, dr.abs(rho * cosine) + _GRAZING)


def angles_in_pixel(m: Any, point: mi.Point2f, size: tuple[int, int]) -> tuple[mi.Point2f, Drjit]:
    """Map a film position in pixels to angles (alpha, psi) and the solid angle of its pixel.

    ``size`` is the number of columns and rows. Uniformly distributed points within a pixel are
    mapped to angles that are uniformly distributed in solid angle.
    """
    width, height = size
    alpha = point.x * (2.0 / width) - 1.0
    row = dr.floor(point.y)
    rho = _root_of_positive(1.0 - alpha * alpha)
    inverse = 1.0 / dr.select(rho > 0.0, rho, 1.0)
    low, high = (
        dr.asin(dr.clip(((row + k) * (2.0 / height) - 1.0) * inverse, -1.0, 1.0)) for k in (0, 1)
    )
    psi = low + (high - low) * (point.y - row)
    return m.Point2f(alpha, psi), (high - low) * (2.0 / width)


def _root_of_positive(value: Drjit) -> Drjit:
    """Return the square root of a number, or 0 if the number is negative."""
    return dr.sqrt(dr.select(value > 0.0, value, 0.0))


# Smallest cosine of a direction; its square is a normal number in float32.
_GRAZING = 1e-9
# Distance of points that represent directions, in units of max(R^2/wavelength, R) for a receiver of
# radius R.
_FAR = 1e4
# Largest number of surfaces between a receiver with diffraction and the start of a ray.
_MOST_PASSED = 4


class WignerReceiver(VariantPlugin):
    """Sensor whose film contains the received power in W (docs/received_power.md)."""

    film: Callable[[], Any]
    sample_wavelengths: Callable[..., Any]
    is_wigner_receiver = True

    def __init__(self, spec: SourceParameters, props: mi.Properties) -> None:
        m = self.m
        self.base.__init__(self, props)
        self.m_needs_sample_3 = True
        self.spec = spec
        self.scene: Any = None  # Set by `scene_known` during renders.
        self.fineness = 1
        self.to_world = m.Transform4f(m.Matrix4f(spec.pose))
        self._set_pose()
        source, wavelength = spec.at_origin, spec.wavelength
        radiance = WignerRadiance(m, spec, wavelength)
        bounds = spec.fields_of(source)[0][0].bounds
        self.directions = directions_of(m, radiance.terms, bounds, wavelength)
        self.polariser = Polariser(m, spec.polarisation)
        self.estimator = ESTIMATORS[spec.estimator](m, spec, wavelength, radiance)
        radius = float(np.hypot(*np.abs(np.reshape(source.bounds, (2, 2))).max(axis=0)))
        far = _FAR * radius * max(radius / wavelength, 1.0)
        self._far = opaque(m, far / spec.scene_unit)

    def _set_pose(self) -> None:
        """Set the frame of the receiver after a change of its pose."""
        self._frame = Frame(self.m, self.to_world, self.spec.centre)
        self.stand_at(float(np.abs(self.spec.pose[:3]).max()))

    def stand_at(self, extent: float) -> None:
        """Set the largest coordinate of the receiver and of adjacent surfaces, in scene units.

        The distance between the receiver and the starts of rays is proportional to this coordinate.
        """
        self._ray_offset = opaque(self.m, ROUNDING * extent)

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Register the film, the sampler and the rigid pose as parameters."""
        self.base.traverse(self, callback)
        callback.put("to_world", self.to_world, mi.ParamFlags.NonDifferentiable)

    def parameters_changed(self, keys: list[str]) -> None:
        """Apply a changed pose."""
        self.base.parameters_changed(self, keys)
        if "to_world" in keys:
            self.spec = replace(self.spec, pose=rigid_pose(matrix_of(self.to_world)))
            self._set_pose()

    def sample_ray_differential(
        self, time: Drjit, sample1: Drjit, sample2: Drjit, sample3: Drjit, active: Drjit = True
    ) -> tuple[mi.RayDifferential3f, Drjit]:
        """Return a random ray and its spectral weight, for Mitsuba."""
        angles, solid_angle = self._film_angles(sample2)
        ray, weight, colours = self.ray_along(angles, time, sample1, sample3, active)
        return ray, self.spectral_weight(colours, weight * solid_angle, angles, active)

    def sample_ray(
        self, time: Drjit, sample1: Drjit, sample2: Drjit, sample3: Drjit, active: Drjit = True
    ) -> tuple[mi.Ray3f, Drjit]:
        """Return a random ray without differentials and its spectral weight, for Mitsuba."""
        ray, weight = self.sample_ray_differential(time, sample1, sample2, sample3, active)
        return self.m.Ray3f(ray), weight

    def spectral_weight(
        self, colours: Drjit, weight: Drjit, angles: mi.Point2f, active: Drjit = True
    ) -> Drjit:
        """Return the weight of a ray as a spectrum or as a row of a Mueller matrix."""
        direction = direction_of(self.m, angles)
        return colours * self.polariser.received(weight, direction, self._frame, active)

    def ray_along(
        self, angles: Drjit, time: Drjit, sample1: Drjit, sample3: Drjit, active: Drjit = True
    ) -> tuple[mi.RayDifferential3f, Drjit, Drjit]:
        """Return a ray with the angles (alpha, psi), its weight, and the weight of its wavelengths.

        The weight times a radiance and a solid angle is a power in W. ``sample1`` selects the
        wavelengths, and ``sample3`` selects the position on the receiver.
        """
        direction = direction_of(self.m, angles)
        ray = self.m.RayDifferential3f()
        ray.time = time
        ray.d = self._frame.to_scene(direction)
        ray.maxt = self.m.Float(float(np.finfo(np.float32).max))
        coins = 0.0
        if self.spec.diffraction:
            sample3, coins = self.m.Point2f(sample3), sample3.y * (1 << _MOST_PASSED)
            sample3.y = coins - dr.floor(coins)
        x = self.estimator.draw(sample3)
        ray.o = self._frame.point(x) + self.ray_offset
        weight: Drjit = 1.0
        if self.spec.diffraction:
            weight = self._pass_surfaces(ray, self.m.UInt32(coins), active)
        end = self._end_of_ray(ray, x, direction, active) if self.estimator.needs_distance else ()
        weight = weight * self.estimator.received(x, direction, *end)
        zero = dr.zeros(self.m.SurfaceInteraction3f)
        ray.wavelengths, colours = self.sample_wavelengths(zero, sample1, active)
        return ray, weight, colours

    def _film_angles(self, sample: mi.Point2f) -> tuple[mi.Point2f, Drjit]:
        """Map a sample of the unit square to angles (alpha, psi) and its pixel's solid angle."""
        film, fine = self.film(), self.fineness
        width, height = (int(n) // fine for n in film.size())
        if width * height == 1:
            angles, density = self.directions.sample(sample)
            return angles, 1.0 / density
        corner, size = film.crop_offset(), film.crop_size()
        point = self.m.Point2f(
            (sample.x * int(size[0]) + int(corner[0])) / fine,
            (sample.y * int(size[1]) + int(corner[1])) / fine,
        )
        return angles_in_pixel(self.m, point, (width, height))

    @property
    def ray_offset(self) -> mi.Vector3f:
        """Vector in scene units from the receiver to the start of a ray in front of it."""
        return self._frame.axes[2] * self._ray_offset

    def _pass_surfaces(self, ray: mi.RayDifferential3f, coins: Drjit, active: Drjit) -> Drjit:
        """Move a ray's start past a random number of surfaces; return a factor for its weight.

        Bit k of ``coins`` decides whether the ray passes surface k.
        """
        scene, going, weight = self._required_scene(), self.m.Bool(active), self.m.Float(1.0)
        for number in range(_MOST_PASSED + 1):
            distance = distance_to_surface(self.m, scene, ray, self._far, going)
            is_met = going & (distance < self._far)
            # Sky radiation reaches only rays that pass no surface.
            if number:
                weight = dr.select(going & (is_met ^ self.m.Bool(True)), 0.0, weight)
            if number == _MOST_PASSED:
                break
            passes = is_met & ((coins & self.m.UInt32(1 << number)) != self.m.UInt32(0))
            weight = dr.select(is_met, 2.0 * weight, weight)
            ahead = ray.d * (distance + _spawn_offset(self.m, ray.o + ray.d * distance))
            ray.o = self.m.Point3f(dr.select(passes, ray.o + ahead, ray.o))
            going = passes
        return weight

    def _required_scene(self) -> mi.Scene:
        """Return the scene; raise SceneError if it has not been passed to the receiver."""
        if self.scene is None:
            raise SceneError(
                f'the wigner_receiver with the estimator "{self.spec.estimator}" requires its '
                "scene, which Mitsuba does not pass; render with polywigner.mitsuba.render, or "
                'within `with polywigner.mitsuba.receiving(scene)`, or use the estimator "wigner"'
            )
        return self.scene

    def _end_of_ray(
        self, ray: mi.RayDifferential3f, x: mi.Point2f, direction: mi.Vector3f, active: Drjit
    ) -> tuple[mi.Point3f, Drjit]:
        """Return the point where a ray meets a surface, and the length of the ray, in scene units.

        The point is in the frame of the receiver. Rays that meet no surface end at a distant point.
        """
        distance = distance_to_surface(self.m, self._required_scene(), ray, self._far, active)
        if self.spec.diffraction:
            end = self._frame.to_local(ray.o + ray.d * distance - self._frame.origin)
            point = self.m.Point3f(end)
            return point, dr.norm(point - self.m.Point3f(x.x, x.y, 0.0))
        along = direction * distance
        return self.m.Point3f(x.x + along.x, x.y + along.y, self._ray_offset + along.z), distance


def _check_film(values: dict[str, Any]) -> None:
    """Raise SceneError unless a receiver has a film with a box filter."""
    objects = (value for value in values.values() if isinstance(value, mi.Object))
    films = [
        value for value in objects if hasattr(value, "rfilter") and hasattr(value, "crop_size")
    ]
    if not films:
        raise SceneError(
            "the wigner_receiver sensor has no film; add a film of 1 x 1 pixel: <film "
            'type="hdrfilm"> with width 1, height 1 and <rfilter type="box"/>'
        )
    name = films[0].rfilter().class_name()
    if name != "BoxFilter":
        raise SceneError(
            f"the film of the wigner_receiver sensor must have a box filter, got {name}; add "
            '<rfilter type="box"/> to the film, because other filters distribute a sample to '
            "several pixels"
        )


def _build(variant: str, props: mi.Properties) -> mi.Sensor:
    """Create a ``wigner_receiver`` sensor for a variant of Mitsuba from Mitsuba's properties."""
    values = values_of(props)
    spec = checked_parameters(values, RECEIVER, variant)
    _check_film(values)
    return receiver_class(variant)(spec, nested_properties(RECEIVER, props))


def receiver_class(variant: str) -> type[WignerReceiver]:
    """Return the class of the sensor for a variant of Mitsuba."""
    return variant_class(WignerReceiver, "Sensor", variant)


add_plugin("sensor", RECEIVER, _build)


@takes_frequency
def receiver(
    source: Aperture | Array | npt.ArrayLike,
    wavelength: float,
    to_world: Any = None,
    obliquity: str = DEFAULT,
    estimator: str = RECEIVER_ESTIMATOR,
    film: tuple[int, int] | Mapping[str, Any] | None = None,
    bandwidth: float | None = None,
    temperature: float | None = None,
    noise_figure: float | None = None,
    scene_unit: float = 1.0,
    normalise: str = NORMALISATIONS[0],
    diffraction: bool = False,
    polarisation: Any = None,
) -> dict[str, Any]:
    """Return a receiving aperture or array as an entry of a dictionary for ``mi.load_dict``.

    Parameters
    ----------
    source : Aperture, Array or array_like
        Source whose field the receiver would transmit, as in :func:`polywigner.mitsuba.aperture`.
    wavelength : float
        Wavelength in metres.
    to_world : array_like, shape (4, 4), or Mitsuba transform, optional
        Rigid pose. The receiver lies in the plane z = 0 of its frame and faces +z. Default: the
        identity.
    obliquity : str, default "rayleigh-sommerfeld-1"
        Diffraction integral of the field that the receiver would transmit.
    estimator : str, default "exact"
        Method that computes the weight of a ray (docs/received_power.md). ``exact``: the exact
        irradiance that the receiver would cause at the point where the ray hits a surface, which is
        never negative. ``wigner``: the signed radiance that the receiver would transmit along the
        ray.
    film : (int, int) or mapping, optional
        Size (n, m) of a map of received power over direction. The map has n columns and m rows over
        the direction cosines from -1 to 1 along the receiver's x and y axes. The sum of all pixels
        is the received power in W. A mapping is the dictionary entry of a film with a box filter.
        Default: one pixel, which contains the received power.
    bandwidth, temperature, noise_figure : float or str, optional
        Noise parameters of the receiver in Hz, K and dB, or strings such as "1 GHz", "290 K" and "3
        dB". These parameters do not change the received power.
    scene_unit : float, default 1.0
        Length of one unit of the scene, and of the translation of ``to_world``, in metres.
    normalise : str, default "radiated"
        Definition of the antenna gain (docs/received_power.md). ``radiated``: the gain is the
        directivity, so any receiver receives the power lambda^2 L from a sky of radiance L.
        ``aperture``: the gain is relative to the integral of |u|^2, and is lower than the
        directivity by the fraction of the power in evanescent waves.
    diffraction : bool, default False
        Whether the edges of opaque surfaces in the scene diffract incoming radiation
        (docs/shadows.md). Diffraction requires the estimator ``exact``.
    polarisation : str or array_like, optional
        Polarisation of the wave that the receiver would transmit, as in
        :func:`polywigner.mitsuba.aperture`. The receiver absorbs all power of a wave with this
        polarisation, no power of a wave with the orthogonal polarisation, and half the power of
        unpolarised radiation. With "unpolarised", it absorbs all polarisations. Default: "y"
        (docs/polarisation.md).

    Returns
    -------
    dict
        Dictionary entry of the sensor, with the sampler ``multijitter``. It contains a key of
        :func:`register_source`, so only the process that created the entry can load it. Render the
        scene with :func:`polywigner.mitsuba.render`, which passes the scene to the estimator
        ``exact``.

    Raises
    ------
    ArgumentError, GeometryError, QuantityError, SceneError
        If an argument is invalid.
    """
    entry = scene_entry(
        RECEIVER,
        source,
        to_world,
        polarisation,
        wavelength=wavelength,
        scene_unit=scene_unit,
        obliquity=obliquity,
        estimator=estimator,
        diffraction=diffraction,
        normalise=normalise,
        film=_film_entry(film),
        sampler={"type": "multijitter"},
        **parse_noise(bandwidth, temperature, noise_figure),
    )
    checked_parameters(entry, RECEIVER)
    return entry


def film_of(width: int, height: int) -> dict[str, Any]:
    """Return the dictionary entry of a luminance film with a box filter."""
    return {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "pixel_format": "luminance",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }


def _film_entry(film: tuple[int, int] | Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the dictionary entry of a film from the argument ``film`` of `receiver`."""
    if isinstance(film, Mapping):
        return dict(film)
    pixels = np.array((1, 1) if film is None else film)
    if pixels.shape != (2,):
        raise ArgumentError(f"expected film to be a pair (columns, rows), got {film!r}")
    return film_of(*(checked_count(size, "each size in film", 1) for size in pixels.tolist()))
