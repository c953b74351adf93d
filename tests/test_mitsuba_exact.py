"""The estimator ``exact`` of the emitter."""

import gc
from functools import cache

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import polywigner as pw
import polywigner.mitsuba as pwm
from mitsuba_scenes import (
    MILLIMETRE,
    MONO,
    SPECTRAL,
    SQUARE,
    WAVELENGTH,
    WHITE,
    camera,
    draws,
    emitter_of,
    evaluated,
    light,
    pose,
    rectangle,
    scene_of,
    use,
    vectors,
)
from polywigner.errors import SceneError
from polywigner.mitsuba.plugins.exact_field import ExactField

pytestmark = pytest.mark.drjit

L_SHAPE = pw.Aperture(MILLIMETRE * np.array([[0, 0], [10, 0], [10, 4], [4, 4], [4, 10], [0, 10]]))
RING = pw.shapes.ring(0.006, 0.004, n=12)
HORN = pw.shapes.rectangle(12e-3, 8e-3).with_illumination(pw.cosine_taper(12e-3))
PATCH = pw.shapes.square(0.5 * WAVELENGTH)
SITES = 0.6 * WAVELENGTH * (np.argwhere(np.ones((4, 4))) - 1.5)
FOCUS = np.exp(-2j * np.pi * np.hypot(np.linalg.norm(SITES, axis=1), 0.02) / WAVELENGTH)
FOCUSED = pw.phased_array(PATCH, SITES, FOCUS)
LARGER = pw.arrays.grid_positions(12, 9, 0.6 * WAVELENGTH)
BEAM = (0.4, 0.1)
OBLIQUE = pw.arrays.steering_weights(LARGER, BEAM, WAVELENGTH)
SPARSE = pw.phased_array(
    PATCH, 60 * WAVELENGTH * np.array([[0, 0], [1, 0.2], [0.3, 1]]), [1, 1j, -0.5]
)
DIFFERENT = pw.Array([PATCH, pw.shapes.square(0.01).moved((0.012, 0.001))], [1, 0.5j])
SOURCES = {
    "L": L_SHAPE,
    "chevrons": pw.shapes.chevron_pair(0.01, 0.01, 0.004),
    "horn": HORN,
    "focused array": FOCUSED,
    "steered array": pw.phased_array(PATCH, LARGER, OBLIQUE),
    "sparse array": SPARSE,
    "different elements": DIFFERENT,
}

# Accuracy that the documentation states, relative to the peak of the irradiance.
ERROR = 1e-4
# Error due to positions in single precision, which move fringes.
PLACES = 3e-4
# Error of a render with equal samples: the size of a pixel.
PIXEL = 1e-3
# Error of stratified samples. There are 64 x 64 strata with one sample each, and a shadow edge
# crosses 64 of them.
STRATA = 1 / 64


def received(mi, emitter, points, seed=1):
    """Return the power density (n,) in W/m^2 at points in mm, by one sample each."""
    it = mi.Interaction3f()
    samples = np.random.default_rng(seed).uniform(size=(len(points), 2))
    if mi.variant().startswith("scalar"):
        result = []
        for point, sample in zip(points, samples, strict=True):
            it.p = mi.Point3f(*point.tolist())
            _, weight = emitter.sample_direction(it, mi.Point2f(*sample.tolist()), True)
            result.append(np.array(weight).ravel()[0])
        return np.array(result)
    it.p = vectors(mi, "Point", points)
    _, weight = emitter.sample_direction(it, vectors(mi, "Point", samples), True)
    return np.atleast_2d(np.array(weight, dtype=float))[0]


def floor_points(height, count=200):
    """Return points on a floor around the axis and in the beam of OBLIQUE, in m."""
    wide = 2 * max(height, 0.01)
    points = np.random.default_rng(4).uniform(-wide, wide, (count, 3))
    points[0, :2] = 0.0
    points[1, :2] = height * np.array(BEAM) / np.sqrt(1 - np.sum(np.square(BEAM)))
    points[:, 2] = height
    return points


# Heights below, just above and far above the smallest distance at which equivalent sources are
# used.
HEIGHTS = (0.2 * WAVELENGTH, 2 * WAVELENGTH, 3.01 * WAVELENGTH, 0.05, 0.3, 5.0)


METHODS = ("rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff")


@pytest.mark.parametrize(
    ("name", "method"), [(name, METHODS[k % 3]) for k, name in enumerate(SOURCES)]
)
def test_the_density_of_power_is_the_square_of_the_exact_field_near_and_far(name, method, llvm):
    mi = use("llvm_ad_mono")
    source = SOURCES[name]
    field = ExactField(mi, source, WAVELENGTH, method)
    points = np.concatenate([floor_points(height, 80) for height in HEIGHTS])
    seen = np.array(field.intensity(vectors(mi, "Point", points), 1.0), dtype=float)
    single = points.astype(np.float32).astype(float)
    exact = pw.irradiance(source, single, WAVELENGTH, method=method)
    seen, exact = (v.reshape(len(HEIGHTS), -1) for v in (seen, exact))
    assert (np.abs(seen - exact).max(axis=1) < ERROR * exact.max(axis=1)).all()


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO, SPECTRAL])
def test_light_is_the_squared_field_of_the_radiated_power_in_any_pose_and_variant(variant):
    mi = use(variant)
    count = 3 if variant == "scalar_rgb" else 200
    source = FOCUSED if variant.endswith("rgb") else HORN
    placed = pose((3.0, -2.0, 1.0), about_x=0.4)
    entry = light(source, to_world=placed, estimator="exact", power=2.0)
    local = np.concatenate([floor_points(h, count) for h in (0.03, 0.3)])
    points = local / MILLIMETRE @ placed[:3, :3].T + placed[:3, 3]
    seen = received(mi, emitter_of(entry), points)
    exact = pw.irradiance(source, local, WAVELENGTH, method="rayleigh-sommerfeld-1")
    exact *= 2 / pw.radiated_power(source, WAVELENGTH)
    seen, exact = seen.reshape(2, -1), exact.reshape(2, -1)
    assert (np.abs(seen - exact).max(axis=1) < PLACES * exact.max(axis=1)).all()


def spot(entry, integrator, height, more=None, spp=4, tilt=0.0):
    """Return the irradiance on the axis of a white floor with a tilt in degrees."""
    scene = scene_of(
        sensor=camera((0, 0, height - 2), (0, 0, height), 1, 0.005)
        | {"sampler": {"type": "multijitter"}},
        floor=rectangle((0, 0, height), (1, 0, 0), 180 - tilt, 4 * height, WHITE),
        light=entry,
        **(more or {}),
    )
    image = pwm.render(scene, mi.load_dict(integrator), spp=spp)
    return float(np.pi * image[0, 0, 0])


# Distance in mm from which the cosine varies by 2e-4 over the source.
FAR = 250.0


@cache
def on_axis(height):
    """Return |U|^2 of the square at a height in mm."""
    place = (0.0, 0.0, height * MILLIMETRE)
    return float(pw.irradiance(SQUARE, place, WAVELENGTH, method="rayleigh-sommerfeld-1"))


DIRECT = {"type": "direct", "emitter_samples": 4, "bsdf_samples": 2}


@pytest.mark.parametrize(
    ("variant", "integrator", "visible"),
    [
        ("scalar_rgb", DIRECT, True),
        ("scalar_rgb", DIRECT, False),
        ("scalar_rgb", {"type": "volpathmis", "max_depth": 3}, True),
        pytest.param("llvm_ad_mono", {"type": "prb", "max_depth": 3}, True, marks=pytest.mark.llvm),
    ],
)
def test_no_integrator_counts_the_light_twice(variant, integrator, visible):
    use(variant)
    seen = spot(light(estimator="exact", visible=visible), integrator, FAR)
    assert seen == pytest.approx(on_axis(FAR), rel=PIXEL)


@pytest.mark.parametrize("tilt", [-30.0, 60.0])
def test_a_surface_receives_the_squared_field_times_its_own_cosine(tilt):
    use("scalar_rgb")
    seen = spot(light(estimator="exact"), {"type": "path", "max_depth": 2}, FAR, spp=64, tilt=tilt)
    assert seen == pytest.approx(on_axis(FAR) * np.cos(np.radians(tilt)), rel=PIXEL)


def test_near_by_the_cosine_is_the_mean_over_the_places_of_the_source(llvm):
    use("llvm_ad_mono")
    seen = spot(light(estimator="exact"), {"type": "path", "max_depth": 2}, 8.0, spp=4096)
    x, y = np.meshgrid(*2 * [10 * (np.arange(400) + 0.5) / 400 - 5])
    assert seen == pytest.approx(on_axis(8.0) * np.mean(8 / np.hypot(8, np.hypot(x, y))), rel=PIXEL)


def test_behind_an_obstacle_the_seen_share_of_the_squared_field_counts(llvm):
    """A screen at half the distance hides all points beyond 3 mm from the centre, or none."""
    mi = use("llvm_ad_mono")
    height = 30.0

    def behind(edge):
        move = mi.ScalarTransform4f().translate([50.0 + edge, 0, height / 2])
        screen = {"type": "rectangle", "to_world": move.scale([50, 50, 1])}
        entry = light(HORN, estimator="exact")
        more = {"screen": screen}
        seen = spot(entry, {"type": "path", "max_depth": 2}, height, more, spp=4096)
        gc.collect()  # the next scene has the same kernels
        return seen

    # Integral of cos^2 over 12 mm from -6 to -3 mm: u + sin(2 pi u)/(2 pi) from -1/2 to -1/4.
    share = 0.25 - 1 / (2 * np.pi)
    assert behind(-1.5) / behind(150.0) == pytest.approx(share, abs=STRATA)


def test_rays_and_what_a_camera_sees_are_those_of_the_wigner_radiance(llvm):
    mi = use("llvm_ad_mono")
    x, direction = draws(50, 0.004)
    emitters = [emitter_of(light(estimator=name)) for name in ("wigner", "exact")]
    seen = [evaluated(mi, emitter, x / MILLIMETRE, direction) for emitter in emitters]
    assert np.array_equal(*seen)


def test_wavelength_and_power_can_be_changed(llvm):
    mi = use("llvm_ad_mono")
    scene = scene_of(light=light(estimator="exact"))
    emitter = scene.emitters()[0]
    points = np.array([[3.0, 2.0, 40.0], [20.0, 0.0, 40.0]])
    params = mi.traverse(scene)
    params["light.emitter.wavelength"] = 2e-3
    params["light.emitter.power"] = 3.0
    params.update()
    seen = received(mi, emitter, points)
    exact = pw.irradiance(SQUARE, points * MILLIMETRE, 2e-3, method="rayleigh-sommerfeld-1")
    assert seen == pytest.approx(exact * 3 / pw.radiated_power(SQUARE, 2e-3), rel=PLACES)
    params["light.emitter.power"] = 0.0
    params.update()
    assert not received(mi, emitter, points).any()


def test_derivatives_are_those_in_the_power_and_others_are_refused(llvm):
    mi = use("llvm_ad_mono")
    scene = scene_of(light=light(estimator="exact", power=2.0))
    emitter, params = scene.emitters()[0], mi.traverse(scene)
    it = mi.Interaction3f()
    it.p = mi.Point3f(4.0, 6.0, 25.0)
    sample = mi.Point2f(0.3, 0.6)
    dr.enable_grad(emitter.power)
    _, weight = emitter.sample_direction(it, sample, True)
    dr.backward(weight.x)
    assert dr.grad(emitter.power)[0] == pytest.approx(dr.detach(weight.x)[0] / 2, rel=1e-5)
    dr.disable_grad(emitter.power)
    for value in (emitter.wavelength, params["light.emitter.vertices"], it.p):
        dr.enable_grad(value)
        with pytest.raises(
            SceneError,
            match=r'derivatives are available only .*use the estimator "wigner"',
        ):
            emitter.sample_direction(it, sample, True)
        dr.disable_grad(value)


def test_curved_waves_are_exact_near_and_far(llvm):
    mi = use("llvm_ad_mono")
    source = L_SHAPE.curved((0.03, -0.05), WAVELENGTH, (1e-3, 0.0))
    emitter = emitter_of(light(source, estimator="exact", power=1.0))
    points = np.concatenate([floor_points(height, 12) for height in HEIGHTS])
    seen = received(mi, emitter, points / MILLIMETRE) * emitter.spec.norm
    single = (points / MILLIMETRE).astype(np.float32) * MILLIMETRE
    exact = pw.irradiance(source, single, WAVELENGTH, METHODS[0], tolerance=1e-5)
    seen, exact = (v.reshape(len(HEIGHTS), -1) for v in (seen, exact))
    assert (np.abs(seen - exact).max(axis=1) < ERROR * exact.max(axis=1)).all()


# Limit in standard errors of 2^14 samples, exceeded once in ten thousand cases.
SPREADS = 4.0
CHEVRON = pw.shapes.chevron(5e-3, 5e-3, 2e-3)


@pytest.mark.parametrize(
    ("source", "how"),
    [(CHEVRON.partially_coherent(5e-3), {}), (pw.shapes.square(5e-3), {"bandwidth": 6e9})],
    ids=["partially coherent", "of a band"],
)
def test_far_away_signed_radiance_has_the_mean_of_the_exact_fields(source, how, llvm):
    mi = use("llvm_ad_mono")
    emitter = emitter_of(light(source, power=1.0, **how))
    for place in ([0.0, 0.0, 5e3], [6e2, -3e2, 4e3]):
        seen = received(mi, emitter, np.tile(place, (1 << 14, 1)))
        point = np.multiply(place, MILLIMETRE)
        exact = pw.irradiance(source, point, WAVELENGTH, METHODS[0], **how) / emitter.spec.norm
        # A surface has the cosine of a receiver in addition.
        error = seen.std() / np.sqrt(len(seen))
        assert abs(seen.mean() - exact) < SPREADS * error + PIXEL * exact
        assert error < 0.05 * exact
