"""The emitter inside a ``wigner`` shape: the Wigner radiance of a source, for Mitsuba.

    L(x, s) = (power/N) W(x, s_par/lambda)/lambda^2 h(theta),    N = int g |F|^2 dOmega/lambda^2

in the source's own frame, for directions s on its +z side and zero on the other. N is the power
that the unscaled field radiates, a number of the host or, with derivatives, a traced sum over
directions; h = g/cos(theta). W comes from the same kernel as :func:`polywigner.wigner`, traced into
Mitsuba's render kernel: that of apertures with any field, of arrays of any elements, or of equal
elements on a lattice. Where h differs from wave to wave, h W is a sum of such terms (module
`obliquity`).

Positions are relative to the middle of the source. They are drawn, and directions formed, in the
source's frame: the reference point is brought there first. An aperture of some millimetres may then
stand a hundred metres from the origin of the world, where single precision resolves hundredths of a
millimetre, without losing its pattern. Rays that hit the mesh by chance carry their position as
texture coordinates, for the same reason.
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
from polywigner.mitsuba.plugins.emissions import depends_on_wavelength
from polywigner.mitsuba.plugins.exact_field import ExactEstimator
from polywigner.mitsuba.plugins.polariser import Polariser, polarised_spec
from polywigner.mitsuba.plugins.registration import (
    VariantPlugin,
    add_plugin,
    nested_properties,
    variant_class,
)
from polywigner.mitsuba.plugins.samplers import Frame, opaque, single, spectrum
from polywigner.mitsuba.plugins.source_parameters import (
    EMITTER,
    SAMPLINGS,
    SourceParameters,
    read_parameters,
    rigid_pose,
    scene_entry,
    values_of,
)
from polywigner.mitsuba.plugins.wigner import TracedSource, Wave, WignerEstimator, WignerRadiance
from polywigner.mitsuba.scenes.surfaces import PLACE_ERROR, ROUNDING, matrix_of, shadow_end
from polywigner.quantities import parse_frequency
from polywigner.radiometry.directions import directions_and_weights, largest_lag
from polywigner.source import Array
from polywigner.source.obliquities import DEFAULT

Floats = npt.NDArray[np.float64]

ESTIMATORS: dict[str, type[WignerEstimator | ExactEstimator]] = {
    "wigner": WignerEstimator,
    "exact": ExactEstimator,
}

# Stands for an infinite density; its square, and products with radiances, fit into float32.
_OVERWHELMING = 1e12


class WignerEmitter(VariantPlugin):
    """Emitter of a ``wigner`` shape, which makes it; not a plugin by itself."""

    get_shape: Callable[[], Any]
    """Method of Mitsuba's base class."""
    is_wigner = True

    def __init__(self, spec: SourceParameters, id: str = "") -> None:
        m = self.m
        props = mi.Properties("wigner_emitter")
        props.set_id(id)
        props["sampling_weight"] = spec.sampling_weight
        self.base.__init__(self, props)
        flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying
        if not spec.visible:  # or the particle tracer would show it to the camera
            flags |= mi.EmitterFlags.DeltaPosition
        self.m_flags = flags
        self.wavelength = self._adjustable(spec.wavelength)
        self.power = self._adjustable(spec.power)
        self.to_world = m.Transform4f(m.Matrix4f(spec.pose))
        # a literal is folded into loops, which Dr.Jit cannot record for a single sample then
        self._dark = opaque(m, 0.0)
        self.polariser = Polariser(m, spec.polarisation)
        self._set_source(spec, spec.wavelength)
        self._update()

    def _adjustable(self, value: float) -> Drjit:
        """Return a number that Mitsuba's ``traverse`` can change in place."""
        return dr.opaque(self.m.Float, value) if self.jit else dr.scalar.ArrayXf(value)

    def _set_source(self, spec: SourceParameters, wavelength: float) -> None:
        """Set all that depends on the source."""
        self.spec = spec
        self._is_dispersive = depends_on_wavelength(spec.source, spec.obliquity)
        self._radiance = WignerRadiance(self.m, spec, wavelength)
        self.estimator = ESTIMATORS[spec.estimator](self.m, spec, wavelength, self._radiance)
        self._traced = TracedSource(self.m, spec)

    # ---- what a user may change ----------------------------------------------------------

    def traverse(self, callback: Any) -> None:
        """``wavelength`` (m), ``power`` (W), ``to_world`` (rigid); vertices and weights."""
        # Waves of other directions are other constants of the kernel.
        constant = self._is_dispersive or self.estimator.is_constant
        flag = "NonDifferentiable" if constant else "Differentiable"
        callback.put("wavelength", self.wavelength, getattr(mi.ParamFlags, flag))
        callback.put("power", self.power, mi.ParamFlags.Differentiable)
        # With `direct` alone: other integrators do not move the samples with the aperture, so
        # their gradients lack the change of the receiver's cosine (docs/gradients.md).
        callback.put("to_world", self.to_world, mi.ParamFlags.Differentiable)
        if self._traced.vertices is not None:
            callback.put("vertices", self._traced.vertices, mi.ParamFlags.Differentiable)
        if self._traced.weights is not None:
            callback.put("weights", self._traced.weights, mi.ParamFlags.Differentiable)

    @property
    def vertices(self) -> Drjit:
        """x and y of each vertex (m), as a scene's parameters have them; else SceneError."""
        return self._exposed(self._traced.vertices)

    @property
    def weights(self) -> Drjit:
        """Real and imaginary part of each weight, as a scene's parameters; else SceneError."""
        return self._exposed(self._traced.weights)

    def _exposed(self, values: Any) -> Drjit:
        if values is None:
            reason = self._traced.why_not or "an array"
            raise SceneError(f"expected, for parameters with derivatives, {reason}")
        return values

    def parameters_changed(self, keys: list[str]) -> None:
        """Use new values; a new pose moves the mesh as well."""
        if "wavelength" in keys or "power" in keys:
            self._check_numbers()
        shape = self.get_shape() if self.spec.visible else None
        if "vertices" in keys or "weights" in keys:
            self._reshape(shape)
        if "wavelength" in keys and (self._is_dispersive or self.estimator.is_constant):
            traced = self._traced
            self._set_source(self.spec, single(self.wavelength, "wavelength"))
            self._traced = traced
        self._update()
        if "to_world" in keys and shape is not None:
            move(shape, rigid_pose(matrix_of(self.to_world)), self.spec)
        elif "parent" in keys and shape is not None:
            check_place(shape, matrix_of(self.to_world), self.spec)

    def _reshape(self, shape: Any) -> None:
        """Use new vertices and weights, and give the mesh the region that radiates now."""
        source = self._traced.changed()
        if source is None:
            return
        traced, wavelength = self._traced, single(self.wavelength, "wavelength")
        self._set_source(self.spec.with_source(source, wavelength), wavelength)
        # the user's arrays, and their derivatives
        self._traced.vertices, self._traced.weights = traced.vertices, traced.weights
        if shape is not None:
            cover(shape, rigid_pose(matrix_of(self.to_world)), self.spec)

    def _check_numbers(self) -> None:
        wavelength = single(self.wavelength, "wavelength")
        power = single(self.power, "power")
        if not wavelength > 0:
            raise SceneError(f"expected a wavelength above zero, got {wavelength:.6g} m")
        if not power >= 0:
            raise SceneError(f"expected a power of zero or more, got {power:.6g} W")
        self.spec = replace(self.spec, norm=self.spec.norm_at(wavelength))

    def _update(self) -> None:
        # Opaque: as literals, every new value would compile the render kernel again.
        if self.jit:
            dr.make_opaque(self.wavelength, self.power)
        self.frame = Frame(self.m, self.to_world, self.spec.centre)
        self.stand_at(float(np.abs(matrix_of(self.to_world)).max()))
        self._norm = self._traced_norm() if self.is_followed() else opaque(self.m, self.spec.norm)

    def stand_at(self, reach: float) -> None:
        """Set the ``reach`` of the source in its scene; see module `surfaces`."""
        self._reach = opaque(self.m, reach)

    def is_followed(self) -> bool:
        """Whether the wavelength, vertices or weights have derivatives."""
        return self.jit and (self._traced.is_followed() or dr.grad_enabled(self.wavelength))

    def _traced_norm(self) -> Drjit:
        """N with derivatives; its value is the host's."""
        wavelength = single(self.wavelength, "wavelength")
        source = self.spec.at_origin
        lag = largest_lag(source)
        blocks = [np.column_stack(both) for both in directions_and_weights(lag, wavelength)]
        nodes = np.concatenate(blocks)
        waves = self.spec.mixture.nodes(source, wavelength)
        both = np.concatenate(
            [np.repeat(nodes, len(waves), axis=0), np.tile(waves, (len(nodes), 1))], axis=1
        )
        x, y, z, solid_angle, shift, tilt_x, tilt_y, share = map(self.m.Float, both.T.tolist())
        inverse = 1.0 / self.wavelength + shift
        wave = Wave(inverse, self.m.Vector2f(tilt_x, tilt_y))
        own = self._traced.intensity if self._follows() else None
        intensity = self._radiance.integral(self.m.Vector3f(x, y, z), wave, own) * inverse * inverse
        if self.spec.has_several:
            intensity = intensity.x
        total = dr.sum(intensity * z * solid_angle * share)
        return self.spec.norm * (total / dr.detach(total))

    # ---- the radiance --------------------------------------------------------------------

    def wave(self, x: Any, place: Any) -> Wave:
        """The wave of the sample at x (2D) for a receiver at a point, or into a direction."""
        return self._radiance.waves.wave(1.0 / self._value(self.wavelength), x, place)

    def _value(self, number: Any) -> Drjit:
        return number if self.jit else number[0]

    def radiance(self, x: Any, direction: Any, wave: Wave) -> Drjit:
        """L at positions x (2D) and directions (3D unit vectors) of the aperture's frame."""
        own = self._traced.wigner if self._follows() else None
        return self._scale(wave.inverse) * self._radiance.at(x, direction, wave, own)

    def watts_per_norm(self) -> Drjit:
        """Radiated over the power of the field as it is."""
        return self._value(self.power) / self._norm

    def intensity(self, direction: Any, wave: Wave) -> Drjit:
        """The integral of L over positions: radiance times area."""
        own = self._traced.intensity if self._follows() else None
        in_scene = self._scale(wave.inverse) / self.spec.scene_unit**2
        return in_scene * self._radiance.integral(direction, wave, own)

    def _follows(self) -> bool:
        """Whether the radiance has derivatives in vertices or weights."""
        return self.jit and self._traced.is_followed() and self._radiance.is_single

    def _scale(self, inverse: Any) -> Drjit:
        return self._value(self.power) * (inverse * inverse / self._norm)

    def eval(self, si: Any, active: Any = True) -> Drjit:
        if not self.spec.visible:  # or unseen for a while, with a surface of its own
            return spectrum(self.m, self._dark, active)
        along = si.to_world(si.wi)
        direction = self.frame.to_own(along)
        found = self.radiance(si.uv, direction, self.wave(si.uv, direction))
        return self.polariser.sent(found, direction, self.frame, active, along)

    # ---- sampling for receivers ----------------------------------------------------------

    def sample_direction(
        self, it: Any, sample: Any, active: Any = True
    ) -> tuple[mi.DirectionSample3f, Drjit]:
        x, per_area = self.estimator.draw(sample)
        direction, distance = self.seen_from(it, x)
        ds = self.m.DirectionSample3f()
        self._place(ds, x, it.time)
        ds.d = -self.frame.to_scene(direction)
        ds.dist = distance
        ds.pdf = self._density(direction.z, distance, per_area)
        if self.spec.diffraction:  # what is in the way is in the weight
            away = (1.0 + dr.max(dr.abs(it.p))) * (2.0 * self.m.math.RayEpsilon)
            ds.p = it.p + ds.d * away
        else:
            ds.p = shadow_end(it, ds.p, self.frame.axes[2], self._reach)
        ds.emitter = self.m.EmitterPtr(self) if self.jit else self
        found = self.estimator.lit(self, it, x, per_area)
        return ds, self.polariser.sent(found, direction, self.frame, active)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Drjit:
        cosine = -dr.dot(ds.d, self.frame.axes[2])
        return self._density(cosine, ds.dist, self.estimator.density(ds.uv))

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Drjit:
        direction, distance = self.seen_from(it, ds.uv)
        per_area = self.estimator.density(ds.uv)
        density = self._density(direction.z, distance, per_area)
        found = self.estimator.lit(self, it, ds.uv, per_area) * density
        return self.polariser.sent(found, direction, self.frame, active)

    def _density(self, cosine: Any, distance: Any, per_area: Any) -> Drjit:
        """Per solid angle; overwhelming where no light comes by rays that meet the source.

        Integrators weigh samples of a light against such rays by the squares of densities. A
        light that has no surface is met by none. Exact light must not be counted twice; mirrors
        take no samples of lights, and show the radiance. As a `delta` light, for which there is
        no weighing, it would be too bright in ``direct`` with several samples of lights.
        """
        front = cosine > 0.0
        density = self.m.Float(_OVERWHELMING)
        if per_area is not None and self.spec.visible:
            density = per_area * (distance * distance) / dr.select(front, cosine, 1.0)
        return dr.select(front, density, 0.0)

    def seen_from(self, it: Any, x: Any) -> tuple[Drjit, Drjit]:
        """Unit vector, in the frame, from x to the point ``it``; and the distance."""
        r = self.frame.to_own(it.p - self.frame.origin) - self.m.Vector3f(x.x, x.y, 0.0)
        distance = dr.norm(r)
        return r / distance, distance

    def _place(self, sample: Any, x: Any, time: Any) -> None:
        """Fill in the numbers that all samples of the position x share."""
        sample.p = self.frame.point(x)
        sample.n = self.m.Normal3f(self.frame.axes[2])
        sample.uv = x
        sample.time = self.m.Float(time)
        sample.delta = self.m.Bool(False)

    # ---- sampling of the emitted field ---------------------------------------------------

    def sample_position(
        self, time: Any, sample: Any, active: Any = True
    ) -> tuple[mi.PositionSample3f, Drjit]:
        ps = self.m.PositionSample3f()
        x, per_area = self._radiance.positions.sample(sample)
        self._place(ps, x, time)
        ps.pdf = self.m.Float(per_area)
        return ps, dr.select(active, self.m.Float(1.0 / per_area), 0.0)

    def pdf_position(self, ps: Any, active: Any = True) -> Drjit:
        return dr.select(active, self.m.Float(self._radiance.positions.density(ps.uv)), 0.0)

    def sample_ray(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
    ) -> tuple[mi.Ray3f, Drjit]:
        """Position as for receivers, direction by cosine: the weight's mean is the power."""
        ps, share = self.sample_position(time, sample2, active)
        direction = self.m.warp.square_to_cosine_hemisphere(sample3)
        wavelengths, density = _optical_wavelengths(self.m, sample1)
        si = self.m.SurfaceInteraction3f(ps, wavelengths)
        si.time = time
        found = self.radiance(ps.uv, direction, self.wave(ps.uv, direction))
        weight = self.polariser.sent(found * share * dr.pi, direction, self.frame, active)
        start = ps.p + self.frame.axes[2] * (ROUNDING * self._reach)
        return self.m.Ray3f(start, self.frame.to_scene(direction), time, wavelengths), (
            weight * density
        )

    def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> Drjit:
        """For the particle tracer alone, which passes the direction in scene coordinates."""
        wavelengths, density = _optical_wavelengths(self.m, sample)
        direction = self.frame.to_own(si.wi)
        radiance = self.radiance(si.uv, direction, self.wave(si.uv, direction))
        return wavelengths, self.polariser.sent(radiance, direction, self.frame, active) * density

    def bbox(self) -> mi.BoundingBox3f:
        return self.get_shape().bbox()

    def to_string(self) -> str:
        return (
            f"WignerEmitter[\n  wavelength = {self.wavelength},\n  power = {self.power},\n"
            f"  obliquity = {self.spec.obliquity},\n  source = {self.spec.source!r}\n]"
        )


def _optical_wavelengths(m: Any, sample: Any) -> tuple[Drjit, Drjit]:
    """Wavelengths of the renderer's own colour spectrum and their inverse density.

    Only spectral variants have any. They stand for colours, not for the wave of the aperture,
    whose radiance is the same at each.
    """
    zero = dr.zeros(m.Ray3f).wavelengths
    if dr.size_v(type(zero)) == 0:
        return zero, 1.0
    shifts = [sample + i / len(zero) for i in range(len(zero))]
    return m.sample_uniform_spectrum(type(zero)(*(shift - dr.floor(shift) for shift in shifts)))


# ---- the mesh -----------------------------------------------------------------------------------


def move(shape: Any, pose: Floats, spec: SourceParameters) -> None:
    """Move the mesh to a pose; its texture coordinates are relative to the source's centre."""
    params = mi.traverse(shape)
    local = np.asarray(params["vertex_texcoords"], dtype=np.float64).reshape(-1, 2)
    params["vertex_positions"] = _in_scene(local, pose, spec.centre).ravel().tolist()
    params.update()


def cover(shape: Any, pose: Floats, spec: SourceParameters) -> None:
    """Give the mesh the shape of the region that radiates."""
    points, triangles = triangulate(spec.region.support)
    params = mi.traverse(shape)
    # Lists in all variants: Dr.Jit does not copy the memory of NumPy arrays, whose alignment enters
    # the kernels, and it ends the process if a scene is freed while a function is recorded.
    params["vertex_texcoords"] = (points / spec.scene_unit).ravel().tolist()
    params["faces"] = triangles.ravel().tolist()
    params.update()
    move(shape, pose, spec)


def check_place(shape: Any, pose: Any, spec: SourceParameters) -> None:
    """Raise SceneError if a user has moved the mesh but not the emitter."""
    params = mi.traverse(shape)
    local, actual = (
        np.asarray(dr.detach(params[name]), dtype=np.float64).reshape(-1, count)
        for name, count in (("vertex_texcoords", 2), ("vertex_positions", 3))
    )
    expected = _in_scene(local, np.asarray(pose), spec.centre)
    allowed = PLACE_ERROR * max(np.abs(local).max(), np.abs(expected).max())
    if not np.abs(actual - expected).max() <= allowed:
        raise SceneError(
            "expected the mesh of a wigner shape to stay where its to_world puts it, got other "
            "vertex_positions; change emitter.to_world, which moves mesh and light"
        )


def _in_scene(points: Floats, pose: Floats, centre: Floats) -> Floats:
    """Points (n, 2) relative to the source's centre (2,) in the scene, (n, 3)."""
    result: Floats = (points + centre) @ pose[:3, :2].T + pose[:3, 3]
    return result


def checked_parameters(
    values: Mapping[str, Any], plugin: str, variant: str | None = None
) -> SourceParameters:
    """Return the checked parameters of a shape or sensor, from Mitsuba or from Python.

    ``variant``: for which they get the default polarisation; None: for an entry of any.
    """
    spec = read_parameters(values, plugin)
    ESTIMATORS[spec.estimator].check(spec)
    return spec if variant is None else polarised_spec(variant, spec, plugin)


def _build(variant: str, props: Any) -> mi.Mesh:
    """Return the mesh for the parameters of one ``wigner`` element."""
    spec = checked_parameters(values_of(props), EMITTER, variant)
    m = getattr(mi, variant)
    points, triangles = triangulate(spec.region.support)
    inner = nested_properties(EMITTER, props)
    if not any(isinstance(value, m.BSDF) for _, value in props.objects()):
        inner["bsdf"] = mi.load_dict({"type": "null"})
    emitter = variant_class(WignerEmitter, "Emitter", variant)(spec, id=f"{props.id()}_emitter")
    inner["emitter"] = emitter
    name, sizes = props.id() or EMITTER, (len(points), len(triangles))
    mesh = m.Mesh(name, *sizes, props=inner, has_vertex_texcoords=True)
    cover(mesh, spec.pose, spec)
    if not spec.visible:  # triangles of a single corner, which no ray meets
        params = mi.traverse(mesh)
        params["faces"] = [0] * len(params["faces"])
        params.update()
    return mesh


add_plugin("shape", EMITTER, _build)

# Flags of an entry are Python's own, also if NumPy's were passed.
_FLAGS = ("diffraction", "antithetic", "control_variate", "visible", "sampling_weight")


@takes_frequency
def aperture(
    source: Aperture | Array | npt.ArrayLike,
    wavelength: float,
    to_world: Any = None,
    obliquity: str = DEFAULT,
    power: float | str | None = None,
    bsdf: Mapping[str, Any] | None = None,
    scene_unit: float = 1.0,
    sampling_weight: float = 1.0,
    antithetic: bool = False,
    sampling: str = SAMPLINGS[0],
    control_variate: bool = False,
    visible: bool = True,
    estimator: str = "wigner",
    bandwidth: float | str | None = None,
    aperture_power: float | str | None = None,
    diffraction: bool = False,
    polarisation: Any = None,
) -> dict[str, Any]:
    """A coherent aperture or array as an entry of a dictionary for ``mi.load_dict``.

    Parameters
    ----------
    source: an Aperture with its field, or what makes one; or an Array of apertures in the plane
        z = 0. Coordinates in metres.
    wavelength: metres.
    to_world: rigid pose, as a (4, 4) matrix or a Mitsuba transform; the aperture lies in the plane
        z = 0 of its own frame and radiates to +z. Default: none.
    obliquity: the diffraction integral whose |U|^2, times its own cosine, a surface receives:
        a boundary condition of :func:`polywigner.amplitude`; or ``paper``, the paper's radiance
        W/lambda^2.
    power: watts or a text such as "10 dBm", radiated through the hemisphere in front, as
        :func:`polywigner.radiated_power` counts it. Default: what the field radiates as it is,
        with |u|^2 in W/m^2.
    bsdf: entry of the surface that radiates. Default: ``null``, which light passes through, but
        not with ``direct``, ``path`` and ``prb`` when they sample a light behind: docs/plugin.md.
    scene_unit: metres in one unit of the scene and of ``to_world``'s translation. Use 1e-3 and
        millimetres when receivers stand within centimetres of the aperture.
    sampling_weight: relative number of samples spent on this source.
    antithetic: a sample of an array on a lattice stands for nine midpoints of elements, which
        cancel off its beams; clears noise beside steered beams, docs/plugin.md.
    sampling: density of samples in the region that radiates: ``uniform``; ``marginal``, in
        proportion to the position marginal; or ``root-marginal``, to its root. Unbiased all.
    control_variate: less noise on diffuse surfaces that see all of the source, bias where they see
        a part of it or gloss: docs/plugin.md.
    visible: False leaves the surface out: it lights the scene as before and stands in no other
        light, but no camera, mirror or irradiance meter sees it.
    aperture_power: in place of power, watts or a text: the integral of |u|^2 over the source, of
        which small sources radiate little; the rest is evanescent.
    estimator: ``wigner``: points are lit by signed radiance from a random place of the source.
        ``exact``: by their exact irradiance |U|^2, to 1e-4 of its peak at any distance, with no
        noise where all of the source is seen; docs/plugin.md.
    bandwidth: of the light about its frequency, not of noise, in Hz or a text such as "4 GHz"; each
        sample is of one frequency of the band, docs/coherence.md. Default: one wavelength.
    diffraction: with the estimator ``exact``: shadows of the scene's opaque surfaces diffract, one
        edge at a time, as of black bodies; docs/shadows.md.
    polarisation: of the field, in Mitsuba's polarised variants: "x", "y", "right", "left", a slant
        from x towards y such as "45 deg", or a Jones vector (2,) along the source's x and y; of an
        array also one for each element, (n, 2) or a list; or "unpolarised". Default: "y";
        docs/polarisation.md.

    The entry holds a key, see :func:`register_source`: load it in the process that made it. With a
    polarisation, loading it in a variant that is not polarised raises a SceneError.

    Raises
    ------
    ArgumentError, GeometryError, QuantityError, SceneError for an unusable argument.
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
        sampling=sampling,
        diffraction=diffraction,
        antithetic=antithetic,
        control_variate=control_variate,
        visible=visible,
        sampling_weight=sampling_weight,
        power=power,
        aperture_power=aperture_power,
        bandwidth=None if bandwidth is None else parse_frequency(bandwidth),
        bsdf=None if bsdf is None else dict(bsdf),
    )
    spec = checked_parameters(entry, EMITTER)
    entry |= {name: getattr(spec, name) for name in _FLAGS}
    if entry.pop("aperture_power", None) is not None:
        entry["power"] = spec.power
    return entry
