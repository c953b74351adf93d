"""Powers that ``wigner_receiver`` reads of scenes, against quadrature and the radar equation."""

import mitsuba as mi
import numpy as np
import pytest

import polywigner as pw
import polywigner.mitsuba as pwm
from mitsuba_scenes import MILLIMETRE, MONO, SQUARE, WAVELENGTH, pose, scene_of, use

pytestmark = pytest.mark.drjit

# Of the mean of this many renders; a mean is 5 of its standard errors off once in some thousand
# times (Student, 7 degrees of freedom), and the seeds are fixed.
RENDERS, ERRORS = 8, 5.0
# |U|^2 is good to 1e-4 of its peak.
EXACT = 3e-4
# What fog at 1.6 to 2.4 times 2 D^2/wavelength does not know of the near field (measured: 0.5 %).
FOG = 0.01

HORN = pw.shapes.rectangle(12e-3, 8e-3).with_illumination(pw.cosine_taper(12e-3))
SITES = 0.6 * WAVELENGTH * (np.argwhere(np.ones((4, 4))) - 1.5)
STEERED = pw.phased_array(
    pw.shapes.square(0.5 * WAVELENGTH), SITES, np.exp(2j * np.pi * SITES @ [0.3, 0.2] / WAVELENGTH)
)
SKY = {"type": "constant", "radiance": {"type": "spectrum", "value": 1.0}}
OBLIQUITIES = ("rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2")


def read(scene, samples):
    """The mean power of some renders, and its standard error."""
    loaded = mi.load_dict(scene)
    spp = samples // RENDERS
    values = [pwm.render(loaded, spp=spp, seed=k).sum() for k in range(RENDERS)]
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(RENDERS))


def furnace(source, **more):
    """A receiver under a sky of radiance 1."""
    receiver = pwm.receiver(source, WAVELENGTH, scene_unit=MILLIMETRE, **more)
    return {"type": "scene", "integrator": {"type": "path"}, "receiver": receiver, "sky": SKY}


def check_furnace(power, error, expected=WAVELENGTH**2):
    """A furnace of radiance L gives lambda^2 L to any receiver: one mode."""
    assert abs(power - expected) < ERRORS * error + EXACT * expected
    assert error < 0.02 * expected


@pytest.mark.parametrize("estimator", ["exact", "wigner"])
@pytest.mark.parametrize("obliquity", OBLIQUITIES)
@pytest.mark.llvm
def test_a_radiance_from_everywhere_reads_one_mode_of_it(obliquity, estimator):
    use("llvm_ad_mono")
    check_furnace(*read(furnace(SQUARE, obliquity=obliquity, estimator=estimator), 1 << 17))


@pytest.mark.parametrize("estimator", ["exact", "wigner"])
@pytest.mark.llvm
def test_as_aperture_power_a_receiver_reads_the_share_that_it_radiates(estimator):
    use("llvm_ad_mono")
    share = pw.radiated_power(HORN, WAVELENGTH) / np.real(pw.lag_marginal(HORN, (0.0, 0.0)))
    assert share < 0.95
    found = read(furnace(HORN, estimator=estimator, normalise="aperture"), 1 << 17)
    check_furnace(*found, WAVELENGTH**2 * share)


@pytest.mark.parametrize("estimator", ["exact", "wigner"])
def test_scalar_variants_read_the_same(estimator):
    use("scalar_rgb")
    power, error = read(furnace(SQUARE, estimator=estimator), 1 << 9)
    expected = WAVELENGTH**2
    assert abs(power - expected) < ERRORS * error + EXACT * expected
    assert error < 0.2 * expected


@pytest.mark.parametrize(
    ("name", "samples", "model"),
    [
        ("floor, monostatic, exact", 1 << 15, EXACT),
        ("floor, tilted receiver, exact", 1 << 15, EXACT),
        ("floor, tilted receiver, wigner", 1 << 16, EXACT),
        ("floor, monostatic, 20 mm away, exact", 1 << 16, EXACT),
        ("floor, behind a half-plane, exact", 1 << 16, EXACT),
        ("floor, through fog, exact", 1 << 16, EXACT),
        ("fog, scattered once, exact", 1 << 16, FOG),
        pytest.param("fog, scattered once, wigner", 1 << 17, EXACT, marks=pytest.mark.slow),
        ("furnace, sphere of 20 mm, rayleigh-sommerfeld-1, exact", 1 << 16, EXACT),
        ("radar, Lambertian plate, exact", 1 << 18, EXACT),
        ("radar, Lambertian sphere, exact", 1 << 18, EXACT),
    ],
)
@pytest.mark.llvm
@pytest.mark.slow
def test_scenes_read_what_quadrature_finds(name, samples, model):
    """The scenes of benchmarks/receive_scene.py."""
    use("llvm_ad_mono")
    import receive_scene

    case = receive_scene.cases()[name]
    power, error = read(case.scene(), samples)
    expected = case.power()
    assert abs(power - expected) < ERRORS * error + model * expected
    assert error < 0.03 * expected


def test_the_reference_is_the_radar_equation_far_away():
    """Cross sections 4 rho A cos^2 of a Lambertian plate and 8/3 pi a^2 rho of a sphere."""
    use("scalar_rgb")
    import receive_scene

    for _, expected, power in receive_scene.targets(300.0):
        assert abs(power / expected - 1) < 3 * receive_scene.TARGET / 300.0


@pytest.mark.llvm
def test_powers_of_two_transmitters_add():
    use("llvm_ad_mono")
    import receive_scene as rs

    ends = [rs.SENDS, rs.End(0.008, rs.pose((-0.15, 0.0, 0.0), (-0.15, 0.0, 1.0)))]
    lights = [rs.sender(end) for end in ends]
    parts = [[lights[0]], [lights[1]], lights]
    (one, a), (other, b), (both, c) = (
        read(rs.scene_of(rs.reader(rs.BESIDE), rs.plate(*rs.FLOOR), *own), 1 << 16) for own in parts
    )
    assert abs(one + other - both) < ERRORS * np.sqrt(a * a + b * b + c * c)
    assert min(one, other) > 0.05 * both


@pytest.mark.parametrize("estimator", ["exact", "wigner"])
@pytest.mark.llvm
def test_a_map_of_directions_adds_up_to_the_power(estimator):
    use("llvm_ad_mono")
    total, error = read(furnace(STEERED, estimator=estimator), 1 << 16)
    mapped, map_error = read(furnace(STEERED, estimator=estimator, film=(6, 5)), 1 << 12)
    assert abs(total - mapped) < ERRORS * np.hypot(error, map_error) + EXACT * total
    assert np.hypot(error, map_error) < 0.05 * total


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
def test_columns_of_a_map_run_along_x_and_rows_along_y(variant):
    """Light from a small sphere in the direction (0.6, -0.4) of a receiver that is turned."""
    use(variant)
    turned = pose((1.0, 2.0, 3.0), about_x=0.7)
    direction = np.array([0.6, -0.4, np.sqrt(1 - 0.6**2 - 0.4**2)])
    centre = turned[:3, :3] @ (200 * direction) + turned[:3, 3]
    lamp = {"type": "area", "radiance": {"type": "spectrum", "value": 1.0}}
    scene = scene_of(
        integrator={"type": "path"},
        receiver=pwm.receiver(
            SQUARE, WAVELENGTH, turned, estimator="wigner", film=(10, 10), scene_unit=MILLIMETRE
        ),
        lamp={"type": "sphere", "center": centre.tolist(), "radius": 30.0, "emitter": lamp},
    )
    image = pwm.render(scene, spp=16)[..., 0]
    # alpha = 0.6 is the border of columns 7 and 8, beta = -0.4 that of rows 2 and 3
    assert np.abs(image[2:4, 7:9]).min() > 0
    image[2:4, 7:9] = 0
    assert not image.any()


@pytest.mark.llvm
def test_null_surfaces_are_not_the_first():
    """Two veils 10 mm away, where the field is another: the sky behind weighs as without them."""
    mi = use("llvm_ad_mono")
    transform = mi.ScalarTransform4f().translate([0, 0, 10]).scale(1e5)
    veil = {"type": "rectangle", "to_world": transform, "bsdf": {"type": "null"}}
    bare = {**furnace(SQUARE, film=(8, 8)), "integrator": {"type": "volpath", "max_depth": 6}}
    veiled = {**bare, "veil": veil, "other": veil}
    one, other = (pwm.render(mi.load_dict(scene), spp=64, seed=1) for scene in (bare, veiled))
    assert np.allclose(one, other, rtol=1e-3, atol=1e-4 * one.max())
    assert one.sum() > 0


@pytest.mark.llvm
def test_large_numbers_of_samples_are_not_rounded_away():
    """Each sample of a patch that receives nearly alike from everywhere weighs nearly the same."""
    mi = use("llvm_ad_mono")
    speck = pw.shapes.square(1e-3 * WAVELENGTH)
    name = "rayleigh-sommerfeld-2"
    scene = mi.load_dict(furnace(speck, obliquity=name, estimator="exact"))
    found = float(pwm.render(scene, spp=1 << 20)[0, 0, 0])
    assert abs(found / WAVELENGTH**2 - 1) < EXACT
