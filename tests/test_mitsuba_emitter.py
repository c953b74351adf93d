"""Radiance, sampling and power of the emitter."""

import drjit as dr
import numpy as np
import pytest
import shapely

import polywigner as pw
import polywigner.mitsuba as pwm
from mitsuba_scenes import (
    CHEVRON,
    MILLIMETRE,
    RADIANCE_ERROR,
    SPECTRAL,
    SQUARE,
    WAVELENGTH,
    draws,
    emitter_of,
    evaluated,
    light,
    pose,
    scene_of,
    uniform,
    use,
    vectors,
)
from polywigner.geometry.convex import trapezoids
from polywigner.mitsuba.plugins.samplers import Positions

pytestmark = pytest.mark.drjit

# Factor h(theta) = g/cos(theta) of the radiance, for each obliquity.
FACTORS = {
    "rayleigh-sommerfeld-1": lambda c: c,
    "kirchhoff": lambda c: ((1 + c) / 2) ** 2 / c,
    "rayleigh-sommerfeld-2": lambda c: 1 / c,
    "paper": lambda c: np.ones_like(c),
}


@pytest.mark.parametrize("obliquity", FACTORS)
def test_the_radiance_times_the_cosine_is_the_wigner_function_times_the_obliquity(obliquity):
    mi = use("scalar_rgb")
    x, direction = draws(20, 0.004)
    seen = evaluated(mi, emitter_of(light(obliquity=obliquity)), x / MILLIMETRE, direction)
    factor = FACTORS[obliquity](direction[:, 2:])
    plain = pw.wigner(SQUARE, x, direction[:, :2] / WAVELENGTH)[:, None] / WAVELENGTH**2
    assert np.abs(seen / factor - plain).max() < RADIANCE_ERROR * np.abs(plain).max()


@pytest.mark.parametrize("estimator", ["wigner", "exact"])
def test_nothing_is_radiated_to_the_back(estimator):
    mi = use("scalar_rgb")
    x, direction = draws(10, 0.004)
    emitter = emitter_of(light(estimator=estimator))
    assert not evaluated(mi, emitter, x / MILLIMETRE, direction * [1, 1, -1]).any()
    behind = mi.Interaction3f()
    behind.p = mi.Point3f(1.0, 2.0, -5.0)
    ds, weight = emitter.sample_direction(behind, mi.Point2f(0.3, 0.6), True)
    assert not np.any(np.array(weight))
    assert not np.any(np.array(ds.pdf))


def test_powers_scale_the_radiance_from_the_radiated_power_or_the_area():
    """An unscaled field of 1 W/m^2 has both powers."""
    mi = use("scalar_rgb")
    x, direction = draws(10, 0.004)
    default = evaluated(mi, emitter_of(light()), x / MILLIMETRE, direction)
    radiated = pw.radiated_power(SQUARE, WAVELENGTH)
    for name, own in (("power", radiated), ("aperture_power", SQUARE.area)):
        twelve = evaluated(mi, emitter_of(light(**{name: 12.0})), x / MILLIMETRE, direction)
        assert np.allclose(twelve, default * 12 / own, rtol=1e-5)


@pytest.mark.parametrize(
    ("variant", "how"),
    [
        ("scalar_rgb", {}),
        ("scalar_rgb", {"estimator": "exact"}),
        pytest.param("llvm_ad_mono", {}, marks=pytest.mark.llvm),
        # Channels share the density of positions.
        pytest.param(*SPECTRAL.values, {}, marks=SPECTRAL.marks),
    ],
)
def test_sampled_directions_agree_with_density_and_evaluation(variant, how):
    mi = use(variant)
    emitter = emitter_of(light(CHEVRON, to_world=pose((3.0, -2.0, 1.0), about_x=0.3), **how))
    it = mi.Interaction3f()
    it.p, it.n = mi.Point3f(4.0, 6.0, 25.0), mi.Normal3f(0.1, 0.2, -0.97)
    draws = np.random.default_rng(1).uniform(size=(20, 2))
    for sample in draws if variant == "scalar_rgb" else [draws]:
        ds, weight = emitter.sample_direction(it, vectors(mi, "Point", sample), True)
        density = np.array(emitter.pdf_direction(it, ds, True), dtype=float)
        radiance = np.array(emitter.eval_direction(it, ds, True), dtype=float)
        assert density == pytest.approx(np.array(ds.pdf, dtype=float), rel=1e-5)
        assert np.array(weight, dtype=float) * density == pytest.approx(radiance, rel=1e-4)
        ray = it.spawn_ray_to(ds.p)  # shadow ray of Mitsuba's integrators
        end = np.array(ray.o + ray.d * ray.maxt)
        expected = np.array(it.p + ds.d * ds.dist)
        assert end == pytest.approx(expected.reshape(end.shape), abs=1e-4)


@pytest.mark.slow
def test_sampled_directions_follow_their_density_by_chi_square(llvm):
    mi = use("llvm_ad_mono")
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    entry = light(CHEVRON, to_world=pose(about_x=0.4))
    scene = scene_of(aperture=entry)
    emitter = scene.emitters()[0]
    it = mi.Interaction3f()
    it.p = mi.Point3f(2.0, -1.0, 6.0)

    def density(direction):
        si = scene.ray_intersect(mi.Ray3f(it.p, direction))
        ds = mi.DirectionSample3f(scene, si, it)
        return dr.select(si.is_valid(), emitter.pdf_direction(it, ds, True), 0.0)

    test = ChiSquareTest(
        domain=SphericalDomain(),
        sample_func=lambda sample: emitter.sample_direction(it, sample, True)[0].d,
        pdf_func=density,
        sample_count=1_000_000,
        res=51,
        ires=64,  # the density is discontinuous at the edges
    )
    assert test.run(), test.messages


def test_positions_have_the_density_of_the_automean():
    use("scalar_rgb")
    emitter = emitter_of(light(CHEVRON))
    area = pw.automean(CHEVRON).area / MILLIMETRE**2
    assert emitter.estimator.density == pytest.approx(1 / area, rel=1e-6)
    assert np.array(emitter.get_shape().surface_area()).item() == pytest.approx(area, rel=1e-5)


def test_an_aperture_far_from_the_origin_keeps_its_pattern(llvm):
    mi = use("llvm_ad_mono")
    source, distance = CHEVRON, 0.5
    origin = np.array([80.0, -50.0, 40.0])  # metres: single precision resolves 8 micrometres
    placed = pose(origin, about_x=0.7)
    emitter = emitter_of(pwm.aperture(source, WAVELENGTH, scene_unit=1.0, to_world=placed))
    frame = placed[:3, :3]
    _, direction = draws(2000, 0.0, seed=5)
    # The positions of receivers have rounding errors in single precision.
    points = (origin + distance * direction @ frame.T).astype(np.float32).astype(float)
    it = mi.Interaction3f()
    it.p = vectors(mi, "Point", points)
    ds, weight = emitter.sample_direction(it, uniform(mi, 2000, 2, seed=6), True)
    seen = np.array(weight, dtype=float).ravel() * np.array(ds.pdf, dtype=float).ravel()
    local = (points - origin.astype(np.float32)) @ frame
    x = np.array(ds.uv, dtype=float).T
    r = local - np.pad(x, ((0, 0), (0, 1)))
    nu = r[:, :2] / np.linalg.norm(r, axis=-1, keepdims=True) / WAVELENGTH
    cosine = r[:, 2] / np.linalg.norm(r, axis=-1)
    expected = pw.wigner(source, x, nu) * cosine / WAVELENGTH**2  # Rayleigh-Sommerfeld I
    scale = 4 * source.area / WAVELENGTH**2
    assert np.abs(seen - expected).max() < RADIANCE_ERROR * scale


def test_identical_apertures_and_receivers_stay_apart():
    mi = use("scalar_rgb")
    entries = {f"aperture{k}": light() for k in range(3)}
    receivers = {f"receiver{k}": pwm.receiver(SQUARE, WAVELENGTH) for k in range(2)}
    scene = mi.load_dict({"type": "scene", **entries, **receivers})
    assert (len(scene.emitters()), len(scene.sensors())) == (3, 2)


TURN = np.array([[0.8, -0.6], [0.6, 0.8]])
APERTURES = {
    "square": pw.shapes.square(0.01),
    "turned square": pw.Aperture(pw.shapes.square(0.01).rings[0] @ TURN.T),
    "chevron": pw.shapes.chevron(0.01, 0.01, 0.004),
    "automean of two chevrons": pw.automean(pw.shapes.chevron_pair(0.01, 0.01, 0.004)),
    "ring": pw.shapes.ring(0.006, 0.004, n=16),
    "touching squares": pw.Aperture(
        [[[0, 0], [1, 0], [1, 1], [0, 1]], [[1, 1], [2, 1], [2, 2], [1, 2]]]
    ),
}

# Error of float32 tables, and of a few hundred cumulated areas.
ROUNDING = 1e-5
# Number of midpoints along each axis of a grid, and error of quadratic functions on this grid,
# about (1/200)^2.
GRID, GRID_ERROR = 200, 2e-3


def moments(aperture):
    """Return the exact means of x, y, x^2, xy and y^2 from triangles."""
    vertices, triangles = pw.geometry.triangulate(aperture)
    corners = vertices[triangles]
    edges = corners[:, 1:] - corners[:, :1]
    areas = np.abs(np.linalg.det(edges)) / 2
    middles = (corners + np.roll(corners, 1, axis=1)) / 2  # exact for quadratic functions
    x, y = middles[..., 0], middles[..., 1]
    values = np.stack([x, y, x * x, x * y, y * y])
    return (values.mean(axis=2) * areas).sum(axis=1) / areas.sum()


def mapped_grid(mi, positions):
    """Return the images (n, 2) of the midpoints of a grid on the unit square."""
    middles = (np.arange(GRID) + 0.5) / GRID
    u, v = (axis.ravel().tolist() for axis in np.meshgrid(middles, middles, indexing="ij"))
    return np.array(positions.sample(mi.Point2f(mi.Float(u), mi.Float(v))), dtype=float).T


@pytest.mark.llvm
@pytest.mark.parametrize("name", APERTURES)
def test_positions_are_uniform_in_the_aperture(name):
    mi, aperture = use("llvm_ad_mono"), APERTURES[name]
    points = mapped_grid(mi, Positions(mi, trapezoids(aperture.rings)))
    size = aperture.diameter
    grown = aperture.polygons.buffer(ROUNDING * size)
    assert shapely.contains_xy(grown, *points.T).all()
    x, y = points.T
    sampled = np.array([f.mean() for f in (x, y, x * x, x * y, y * y)])
    scale = np.array([size, size, size**2, size**2, size**2])
    assert np.abs((sampled - moments(aperture)) / scale).max() < GRID_ERROR
