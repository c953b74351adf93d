"""The shape ``wigner``, whose emitter radiates the Wigner radiance of a source.

The radiance L at the point x in the direction s, in the source's frame, is

    L(x, s) = (power/N) W(x, s_par/lambda)/lambda^2 h(theta),    N = int g |F|^2 dOmega/lambda^2

for directions on the +z side of the source. W is the Wigner function of the source field u, F the
Fourier transform of u, g the obliquity factor, theta the polar angle of s, and h = g/cos(theta). N
is the power that the unscaled field radiates.

Positions, including texture coordinates, are relative to the centre of the source, because single
precision does not resolve small apertures far from the origin of the scene.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import SceneError
from polywigner.execution import Drjit
from polywigner.geometry import Aperture, triangulate
from polywigner.geometry.arguments import takes_frequency
from polywigner.mitsuba.plugins.exact_field import ExactEstimator
from polywigner.mitsuba.plugins.mixtures import depends_on_wavelength
from polywigner.mitsuba.plugins.polariser import Polariser, polarised_spec
from polywigner.mitsuba.plugins.registration import (
    VariantPlugin,
    add_plugin,
    nested_properties,
    set_mesh,
    variant_class,
)
from polywigner.mitsuba.plugins.samplers import Frame, opaque, single_number, spectrum
from polywigner.mitsuba.plugins.source_parameters import (
    EMITTER,
    SourceParameters,
    read_parameters,
    rigid_pose,
    scene_entry,
    values_of,
)
from polywigner.mitsuba.plugins.wigner import TracedSource, Wave, WignerEstimator, WignerRadiance
from polywigner.mitsuba.scenes.surfaces import PLACE_ERROR, matrix_of, shadow_end, vertices_of
from polywigner.numerics import Floats
from polywigner.radiometry.directions import directions_and_weights, largest_lag
from polywigner.source import Array
from polywigner.source.obliquities import DEFAULT

ESTIMATORS: dict[str, type[WignerEstimator | ExactEstimator]] = {
    "wigner": WignerEstimator,
    "exact": ExactEstimator,
}

# Finite stand-in for an infinite probability density [1/sr]; its square is finite in float32.
_INFINITE_DENSITY = 1e12


class WignerEmitter(VariantPlugin):
    """Emitter of a ``wigner`` shape, created by the shape."""

    get_shape: Callable[[], Any]
    is_wigner = True

    def __init__(self, spec: SourceParameters, id: str = "") -> None:
        m = self.m
        props = mi.Properties("wigner_emitter")
        props.set_id(id)
        self.base.__init__(self, props)
        self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying
        self.wavelength = self.adjustable(spec.wavelength)
        self.power = self.adjustable(spec.power)
        self.to_world = m.Transform4f(m.Matrix4f(spec.pose))
        # Dr.Jit cannot record a loop over a single sample if the loop contains literals.
        self._dark = opaque(m, 0.0)
        self.polariser = Polariser(m, spec.polarisation)
        self._set_source(spec, spec.wavelength)
        self._update()

    def adjustable(self, value: float) -> Drjit:
        """Return a parameter whose value can change without recompiling kernels."""
        return dr.opaque(self.m.Float, value) if self.jit else dr.scalar.ArrayXf(value)

    def _set_source(self, spec: SourceParameters, wavelength: float) -> None:
        """Set the source of the emitter, and the objects that compute its light."""
        self.spec = spec
        self._radiance = WignerRadiance(self.m, spec, wavelength)
        self.estimator = ESTIMATORS[spec.estimator](self.m, spec, wavelength, self._radiance)
        self._traced = TracedSource(self.m, spec)
        self._is_constant = self.estimator.is_constant or depends_on_wavelength(
            spec.source, spec.obliquity
        )
        """Whether the kernel is compiled for a fixed wavelength."""

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Register the wavelength, the power, the rigid pose, the vertices and the weights."""
        differentiable, constant = mi.ParamFlags.Differentiable, mi.ParamFlags.NonDifferentiable
        callback.put(
            "wavelength", self.wavelength, constant if self._is_constant else differentiable
        )
        callback.put("power", self.power, differentiable)
        # Only the integrator `direct` returns complete gradients with respect to the pose
        # (docs/gradients.md).
        callback.put("to_world", self.to_world, differentiable)
        if self._traced.vertices is not None:
            callback.put("vertices", self._traced.vertices, differentiable)
        if self._traced.weights is not None:
            callback.put("weights", self._traced.weights, differentiable)

    def parameters_changed(self, keys: list[str]) -> None:
        """Apply changed parameters; a new pose also moves the mesh."""
        if "wavelength" in keys or "power" in keys:
            self._set_norm()
        shape = self.get_shape() if self.spec.visible else None
        wavelength, traced = single_number(self.wavelength, "wavelength"), self._traced
        source = traced.changed() if "vertices" in keys or "weights" in keys else None
        if source is not None:
            self._set_source(self.spec.with_source(source, wavelength), wavelength)
            # Only the user's arrays have derivatives, so the new object refers to these arrays.
            self._traced.vertices, self._traced.weights = traced.vertices, traced.weights
            if shape is not None:
                cover_outline(shape, rigid_pose(matrix_of(self.to_world)), self.spec)
        elif "wavelength" in keys and self._is_constant:
            self._set_source(self.spec, wavelength)
            self._traced = traced
        self._update()
        if "to_world" in keys and shape is not None:
            move_mesh(shape, rigid_pose(matrix_of(self.to_world)), self.spec)
        elif "parent" in keys and shape is not None:
            check_mesh_position(shape, np.array(matrix_of(self.to_world)), self.spec)

    def _set_norm(self) -> None:
        """Set the norm of the source; raise SceneError for an invalid wavelength or power."""
        wavelength = single_number(self.wavelength, "wavelength")
        power = single_number(self.power, "power")
        if not wavelength > 0:
            raise SceneError(f"wavelength must be above zero, got {wavelength:.6g} m")
        if not power >= 0:
            raise SceneError(f"power must be zero or more, got {power:.6g} W")
        self.spec = replace(self.spec, norm=self.spec.norm_at(wavelength))

    def _update(self) -> None:
        """Update the frame, and the norm that kernels use, after a change of parameters."""
        # Each new literal value would recompile the render kernel.
        if self.jit:
            dr.make_opaque(self.wavelength, self.power)
        self.frame = Frame(self.m, self.to_world, self.spec.centre)
        self.stand_at(float(np.abs(matrix_of(self.to_world)).max()))
        has_gradients = self.has_gradients()
        self._norm = self._traced_norm() if has_gradients else opaque(self.m, self.spec.norm)

    def stand_at(self, extent: float) -> None:
        """Set the largest scene coordinate of the source and of adjacent surfaces, in scene units.

        The distance between the ends of shadow rays and surfaces is proportional to this
        coordinate.
        """
        self._extent = opaque(self.m, extent)

    def has_gradients(self) -> bool:
        """Return whether derivatives are enabled for wavelength, vertices or weights."""
        return self.jit and (self._traced.has_gradients() or dr.grad_enabled(self.wavelength))

    def _traced_norm(self) -> Drjit:
        """Return the power of the unscaled field in W, with derivatives for Dr.Jit."""
        wavelength = single_number(self.wavelength, "wavelength")
        source = self.spec.at_origin
        blocks = directions_and_weights(largest_lag(source), wavelength)
        nodes = np.concatenate([np.column_stack(block) for block in blocks])
        waves = self.spec.mixture.nodes(source, wavelength)
        pairs = [np.repeat(nodes, len(waves), axis=0), np.tile(waves, (len(nodes), 1))]
        columns = np.concatenate(pairs, axis=1).T.tolist()
        x, y, z, solid_angle, shift, tilt_x, tilt_y, weight = map(self.m.Float, columns)
        inverse = 1.0 / self.wavelength + shift
        wave = Wave(inverse, self.m.Vector2f(tilt_x, tilt_y))
        direction = self.m.Vector3f(x, y, z)
        traced = self._traced.intensity if self._is_differentiable() else None
        value = self._radiance.integral(direction, wave, traced)
        if self.spec.has_several:
            value = value.x
        total = dr.sum(value * inverse * inverse * z * solid_angle * weight)
        return self.spec.norm * (total / dr.detach(total))

    def wave(self, x: mi.Point2f, end: mi.Point3f) -> Wave:
        """Return the wave of a sample from the position ``x`` to the point or direction ``end``."""
        return self._radiance.waves.wave(1.0 / self._kernel_value(self.wavelength), x, end)

    def _kernel_value(self, number: Drjit) -> Drjit:
        """Return an adjustable parameter as a number of the variant."""
        return number if self.jit else number[0]

    def radiance(self, x: mi.Point2f, direction: mi.Vector3f, wave: Wave) -> Drjit:
        """Return the radiance in W/(m^2 sr) at positions x in directions (unit vectors).

        Positions and directions are in the source's frame, and positions are in scene units. For
        elements with several polarisations, the result is a Stokes vector.
        """
        traced = self._traced.wigner if self._is_differentiable() else None
        scale = self._kernel_value(self.power) * (wave.inverse * wave.inverse / self._norm)
        return scale * self._radiance.at(x, direction, wave, traced)

    def power_scale(self) -> Drjit:
        """Return the ratio of the specified radiated power to the power of the unscaled field.

        The unscaled field has |u|^2 in W/m^2.
        """
        return self._kernel_value(self.power) / self._norm

    def _is_differentiable(self) -> bool:
        """Return whether the radiance is computed with derivatives in vertices or weights."""
        return self.jit and self._traced.has_gradients() and len(self._radiance.terms) == 1

    def eval(self, si: mi.SurfaceInteraction3f, active: Drjit = True) -> Drjit:
        """Return the spectrum that the source's surface emits towards the ray, for Mitsuba."""
        if not self.spec.visible:
            return spectrum(self.m, self._dark, active)
        along = si.to_world(si.wi)
        direction = self.frame.to_local(along)
        value = self.radiance(si.uv, direction, self.wave(si.uv, direction))
        return self.polariser.sent(value, direction, self.frame, active, along)

    def sample_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: Drjit = True
    ) -> tuple[mi.DirectionSample3f, Drjit]:
        """Sample a position on the source as seen from a point, for Mitsuba.

        Return the position with its density per solid angle, and the spectrum divided by this
        density.
        """
        x = self.estimator.draw(sample)
        direction, distance = self.direction_to(it, x)
        ds = self.m.DirectionSample3f()
        ds.p = self.frame.point(x)
        ds.n = self.m.Normal3f(self.frame.axes[2])
        ds.uv = x
        ds.time = self.m.Float(it.time)
        ds.delta = self.m.Bool(False)
        ds.d = -self.frame.to_scene(direction)
        ds.dist = distance
        ds.pdf = self._density(direction.z, distance)
        # The estimator accounts for obstacles, so the shadow ray must not meet them.
        if self.spec.diffraction:
            away = (1.0 + dr.max(dr.abs(it.p))) * (2.0 * self.m.math.RayEpsilon)
            ds.p = it.p + ds.d * away
        else:
            ds.p = shadow_end(it, ds.p, self.frame.axes[2], self._extent)
        ds.emitter = self.m.EmitterPtr(self) if self.jit else self
        value = self.estimator.irradiance(self, it, x)
        return ds, self.polariser.sent(value, direction, self.frame, active)

    def pdf_direction(
        self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: Drjit = True
    ) -> Drjit:
        """Return the density per solid angle of a sampled direction, for Mitsuba."""
        return self._density(-dr.dot(ds.d, self.frame.axes[2]), ds.dist)

    def eval_direction(
        self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: Drjit = True
    ) -> Drjit:
        """Return the spectrum that arrives from a sampled position, for Mitsuba."""
        direction, distance = self.direction_to(it, ds.uv)
        value = self.estimator.irradiance(self, it, ds.uv) * self._density(direction.z, distance)
        return self.polariser.sent(value, direction, self.frame, active)

    def _density(self, cosine: Drjit, distance: Drjit) -> Drjit:
        """Return the probability density of samples per solid angle.

        ``cosine`` is the cosine of the angle at the source. A very large density represents the
        infinite density of sources that rays cannot hit, and of the estimator ``exact``. The flag
        ``delta`` is not used, because it makes the image of Mitsuba's ``direct`` too bright with
        several emitter samples.
        """
        front = cosine > 0.0
        density = self.m.Float(_INFINITE_DENSITY)
        per_area = self.estimator.density
        if per_area is not None and self.spec.visible:
            density = per_area * (distance * distance) / dr.select(front, cosine, 1.0)
        return dr.select(front, density, 0.0)

    def direction_to(self, it: mi.Interaction3f, x: mi.Point2f) -> tuple[mi.Vector3f, Drjit]:
        """Return the unit vector from x to the point ``it`` of the scene, and their distance.

        The vector is in the source's frame. The position ``x`` is relative to the source's centre,
        and all lengths are in scene units.
        """
        r = self.frame.to_local(it.p - self.frame.origin) - self.m.Vector3f(x.x, x.y, 0.0)
        distance = dr.norm(r)
        return r / distance, distance


def move_mesh(shape: mi.Mesh, pose: Floats, spec: SourceParameters) -> None:
    """Move the mesh of a source to a pose."""
    set_mesh(shape, vertex_positions=_vertices_at(shape, pose, spec))


def cover_outline(shape: mi.Mesh, pose: Floats, spec: SourceParameters) -> None:
    """Set the triangles of a mesh so that they cover the radiating region at a pose."""
    points, triangles = triangulate(spec.outline)
    set_mesh(shape, vertex_texcoords=points, faces=triangles)
    move_mesh(shape, pose, spec)


def check_mesh_position(shape: mi.Mesh, pose: Floats, spec: SourceParameters) -> None:
    """Raise SceneError if a user has moved the mesh of a source but not its emitter."""
    expected = _vertices_at(shape, pose, spec)
    error = np.abs(vertices_of(shape) - expected).max()
    if not error <= PLACE_ERROR * np.abs(expected).max():
        raise SceneError(
            "the vertex_positions of a wigner shape were moved away from the pose of its "
            "emitter; change emitter.to_world instead, which moves both the mesh and the emitter"
        )


def _vertices_at(shape: mi.Mesh, pose: Floats, spec: SourceParameters) -> Floats:
    """Return the vertices (n, 3) of a source's mesh at a pose, from its texture coordinates."""
    local = np.array(dr.detach(mi.traverse(shape)["vertex_texcoords"]), np.float64)
    return np.asarray((local.reshape(-1, 2) + spec.centre) @ pose[:3, :2].T + pose[:3, 3])


def checked_parameters(
    values: Mapping[str, Any], plugin: str, variant: str | None = None
) -> SourceParameters:
    """Check the parameters of a source or receiver, from Mitsuba or from Python.

    ``variant`` determines the default polarisation. The variant is None for entries that any
    variant may load.
    """
    spec = read_parameters(values, plugin)
    ESTIMATORS[spec.estimator].check(spec)
    return spec if variant is None else polarised_spec(variant, spec, plugin)


def _build(variant: str, props: mi.Properties) -> mi.Mesh:
    """Create the mesh of a ``wigner`` shape with its emitter, from the properties of the shape."""
    spec = checked_parameters(values_of(props), EMITTER, variant)
    m = getattr(mi, variant)
    points, triangles = triangulate(spec.outline)
    inner = nested_properties(EMITTER, props)
    if not any(isinstance(value, m.BSDF) for _, value in props.objects()):
        inner["bsdf"] = mi.load_dict({"type": "null"})
    emitter = variant_class(WignerEmitter, "Emitter", variant)(spec, id=f"{props.id()}_emitter")
    inner["emitter"] = emitter
    name, sizes = props.id() or EMITTER, (len(points), len(triangles))
    mesh = m.Mesh(name, *sizes, props=inner, has_vertex_texcoords=True)
    cover_outline(mesh, spec.pose, spec)
    if not spec.visible:  # Rays cannot hit triangles of zero area.
        set_mesh(mesh, faces=np.zeros_like(triangles))
    return mesh


add_plugin("shape", EMITTER, _build)


@takes_frequency
def aperture(
    source: Aperture | Array | npt.ArrayLike,
    wavelength: float,
    to_world: Any = None,
    obliquity: str = DEFAULT,
    power: float | str | None = None,
    bsdf: Mapping[str, Any] | None = None,
    scene_unit: float = 1.0,
    visible: bool = True,
    estimator: str = "wigner",
    bandwidth: float | str | None = None,
    aperture_power: float | str | None = None,
    diffraction: bool = False,
    polarisation: Any = None,
) -> dict[str, Any]:
    """Return a coherent aperture or array as an entry of a dictionary for ``mi.load_dict``.

    Parameters
    ----------
    source : Aperture, Array or array_like
        Aperture with its field, or an outline as for `Aperture`, or an Array of apertures in the
        plane z = 0. Coordinates are in metres.
    wavelength : float
        Wavelength in metres.
    to_world : array_like, shape (4, 4), or Mitsuba transform, optional
        Rigid pose. The aperture lies in the plane z = 0 of its frame and radiates to +z. Default:
        the identity.
    obliquity : str, default "rayleigh-sommerfeld-1"
        Diffraction integral for the irradiance |U|^2 on surfaces: a boundary condition of
        :func:`polywigner.amplitude`, or ``paper`` for the radiance W/lambda^2 of the paper.
    power : float or str, optional
        Power radiated into the front hemisphere, as defined by :func:`polywigner.radiated_power`,
        in watts or as a string such as "10 dBm". Default: the power of the unscaled field, with
        |u|^2 in W/m^2.
    bsdf : mapping, optional
        Dictionary entry of the BSDF of the source's surface. Default: ``null``, which transmits
        light. With the integrators ``direct``, ``path`` and ``prb``, a surface of this type still
        blocks light from sources behind it; see docs/plugin.md.
    scene_unit : float, default 1.0
        Length of one unit of the scene, and of the translation of ``to_world``, in metres. Use 1e-3
        (millimetres) if receivers are within centimetres of the aperture.
    visible : bool, default True
        Whether the source has a surface. Without a surface, the source illuminates the scene and
        casts no shadow, but cameras, mirrors and irradiance meters do not see it.
    estimator : str, default "wigner"
        Method that computes the light of the source at an illuminated point. ``wigner``: the signed
        radiance of a random point of the source. ``exact``: the exact irradiance |U|^2, with an
        error of 1e-4 of its peak at any distance. The result has no noise if the entire source is
        visible from the point (docs/plugin.md).
    bandwidth : float or str, optional
        Bandwidth of the radiation (not of noise) in Hz or as a string such as "4 GHz". A bandwidth
        requires the estimator ``wigner``. Each sample has one frequency of the band
        (docs/coherence.md). Default: a single wavelength.
    aperture_power : float or str, optional
        Integral of |u|^2 over the source in watts or as a string, instead of ``power``. Small
        sources radiate only a small fraction of this power, because most of their field is
        evanescent.
    diffraction : bool, default False
        Whether the edges of opaque surfaces in the scene diffract the light, like the edges of
        black bodies. Diffraction requires the estimator ``exact``. Diffraction is computed for one
        edge at a time (docs/shadows.md).
    polarisation : str or array_like, optional
        Polarisation of the field in Mitsuba's polarised variants. It is "x", "y", "right", "left",
        an angle from x towards y such as "45 deg", "unpolarised", or a Jones vector of shape (2,)
        along the source's x and y axes. For an Array, it may also be a list or an array of shape
        (n, 2) with one polarisation for each element. Default: "y" (docs/polarisation.md).

    Returns
    -------
    dict
        Dictionary entry of the shape. It contains a key of :func:`register_source`, so only the
        process that created the entry can load it. In an unpolarised variant, an entry with a
        polarisation raises a SceneError.

    Raises
    ------
    ArgumentError, GeometryError, QuantityError, SceneError
        If an argument is invalid.
    """
    entry = scene_entry(
        EMITTER,
        source,
        to_world,
        polarisation,
        wavelength=wavelength,
        scene_unit=scene_unit,
        obliquity=obliquity,
        estimator=estimator,
        diffraction=diffraction,
        visible=visible,
        power=power,
        aperture_power=aperture_power,
        bandwidth=bandwidth,
        bsdf=None if bsdf is None else dict(bsdf),
    )
    checked_parameters(entry, EMITTER)
    return entry
