"""Power at ``wigner_receiver`` against quadrature and the radar equation."""

import gc
import weakref

import mitsuba as mi
import numpy as np
import pytest

import polywigner as pw
import polywigner.mitsuba as pwm
from cli_scenes import scene, written
from mitsuba_scenes import MILLIMETRE, SQUARE, WAVELENGTH, pose, use
from polywigner.errors import PolywignerError, SceneError

pytestmark = pytest.mark.drjit

# Number of renders that are averaged, and limit in standard errors, which is exceeded once in some
# thousand cases (Student's t with 7 degrees of freedom).
RENDERS, ERRORS = 8, 5.0
# Accuracy of |U|^2 relative to its peak.
EXACT = 3e-4
# Relative near-field error for fog at 1.6 to 2.4 times 2 D^2/wavelength. The measured error is 0.5
# %.
FOG = 0.01

SITES = 0.6 * WAVELENGTH * (np.argwhere(np.ones((4, 4))) - 1.5)
STEERED = pw.phased_array(
    pw.shapes.square(0.5 * WAVELENGTH), SITES, np.exp(2j * np.pi * SITES @ [0.3, 0.2] / WAVELENGTH)
)
SKY = {"type": "constant", "radiance": {"type": "spectrum", "value": 1.0}}


def read(scene, samples):
    """Return the mean power of some renders, and its standard error."""
    loaded = mi.load_dict(scene)
    spp = samples // RENDERS
    values = [pwm.render(loaded, spp=spp, seed=k).sum() for k in range(RENDERS)]
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(RENDERS))


def furnace(source=SQUARE, **more):
    """Return a receiver under a sky of radiance 1."""
    receiver = pwm.receiver(source, WAVELENGTH, scene_unit=MILLIMETRE, **more)
    return {"type": "scene", "integrator": {"type": "path"}, "receiver": receiver, "sky": SKY}


@pytest.mark.parametrize("estimator", ["exact", "wigner"])
def test_scalar_variants_read_the_same(estimator):
    use("scalar_rgb")
    power, error = read(furnace(estimator=estimator), 1 << 9)
    expected = WAVELENGTH**2
    assert abs(power - expected) < ERRORS * error + EXACT * expected
    assert error < 0.2 * expected


@pytest.mark.parametrize(
    ("name", "samples", "model"),
    [
        ("floor, tilted receiver, exact", 1 << 15, EXACT),
        ("floor, tilted receiver, wigner", 1 << 16, EXACT),
        ("floor, behind a half-plane, exact", 1 << 16, EXACT),
        ("floor, through fog, exact", 1 << 16, EXACT),
        ("fog, scattered once, exact", 1 << 16, FOG),
        pytest.param("fog, scattered once, wigner", 1 << 17, EXACT, marks=pytest.mark.slow),
        ("furnace, sphere of 20 mm, rayleigh-sommerfeld-1, exact", 1 << 16, EXACT),
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


@pytest.mark.parametrize("axis", [0, 1])
def test_a_steered_receiver_weighs_the_side_that_it_points_to(axis):
    use("scalar_rgb")
    powers = []
    for side in (1.0, -1.0):
        x, y = 3000.0 * np.array([0.3, 0.2]) * np.where(np.arange(2) == axis, side, 1.0)
        to_world = mi.ScalarTransform4f().look_at([x, y, 2800.0], [0, 0, 0], [0, 1, 0])
        lamp = {"type": "rectangle", "to_world": to_world.scale(400.0)}
        lamp["emitter"] = {"type": "area", "radiance": SKY["radiance"]}
        made = furnace(STEERED, estimator="exact") | {"sky": lamp}
        powers.append(pwm.render(mi.load_dict(made), spp=256, seed=1).sum())
    assert powers[0] > 3 * powers[1]


def test_the_reference_is_the_radar_equation_far_away():
    """The cross section is 4 rho A cos^2 of a Lambertian plate, or 8/3 pi a^2 rho of a sphere."""
    use("scalar_rgb")
    import receive_scene

    for _, expected, power in receive_scene.targets(300.0):
        assert abs(power / expected - 1) < 3 * receive_scene.TARGET / 300.0


@pytest.mark.parametrize("estimator", ["exact", "wigner"])
@pytest.mark.llvm
def test_a_map_of_directions_adds_up_to_the_power(estimator):
    use("llvm_ad_mono")
    total, error = read(furnace(STEERED, estimator=estimator), 1 << 16)
    mapped, map_error = read(furnace(STEERED, estimator=estimator, film=(6, 5)), 1 << 12)
    assert abs(total - mapped) < ERRORS * np.hypot(error, map_error) + EXACT * total
    assert np.hypot(error, map_error) < 0.05 * total


@pytest.mark.llvm
def test_null_surfaces_are_not_the_first():
    """Two null surfaces at 10 mm do not change the weight of the sky."""
    mi = use("llvm_ad_mono")
    transform = mi.ScalarTransform4f().translate([0, 0, 10]).scale(1e5)
    veil = {"type": "rectangle", "to_world": transform, "bsdf": {"type": "null"}}
    bare = {**furnace(film=(8, 8)), "integrator": {"type": "volpath", "max_depth": 6}}
    veiled = {**bare, "veil": veil, "other": veil}
    one, other = (pwm.render(mi.load_dict(scene), spp=64, seed=1) for scene in (bare, veiled))
    assert np.allclose(one, other, rtol=1e-3, atol=1e-4 * one.max())
    assert one.sum() > 0


@pytest.mark.llvm
def test_large_numbers_of_samples_are_not_rounded_away():
    """The test adds many samples of nearly equal weights."""
    mi = use("llvm_ad_mono")
    speck = pw.shapes.square(1e-3 * WAVELENGTH)
    name = "rayleigh-sommerfeld-2"
    scene = mi.load_dict(furnace(speck, obliquity=name, estimator="exact"))
    result = float(pwm.render(scene, spp=1 << 20)[0, 0, 0])
    assert abs(result / WAVELENGTH**2 - 1) < EXACT


FILM = (
    '<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/>'
    '<rfilter type="box"/></film>'
)
SOURCE = '<string name="aperture" value="square.wkt"/>'
FREQUENCY = '<string name="frequency" value="94 GHz"/>'


def loaded(folder, inside):
    sensor = f'<sensor type="wigner_receiver">{inside}</sensor>'
    return pwm.load_scene(written(folder, scene(sensor, '<emitter type="constant"/>')))


def test_a_receiver_in_xml_has_the_parameters_of_source_and_noise_or_their_defaults(tmp_path):
    use("scalar_rgb")
    texts = {
        "array": "2 x 3, 12 mm",
        "obliquity": "kirchhoff",
        "estimator": "wigner",
        "scene_unit": "mm",
        "bandwidth": "1 GHz",
        "temperature": "290 K",
        "noise_figure": "3 dB",
        "normalise": "aperture",
    }
    inside = "".join(f'<string name="{name}" value="{text}"/>' for name, text in texts.items())
    turn = '<transform name="to_world"><translate x="7"/></transform>'
    sensor = loaded(tmp_path, SOURCE + FREQUENCY + inside + turn + FILM).sensors()[0]
    spec = sensor.spec
    assert sensor.is_wigner_receiver
    assert len(spec.source.elements_in_plane) == 6
    assert spec.wavelength == WAVELENGTH
    assert tuple(spec.noise.values()) == (1e9, 290.0, 3.0)
    assert (spec.obliquity, spec.estimator) == ("kirchhoff", "wigner")
    assert (spec.scene_unit, spec.pose[0, 3]) == (1e-3, 7.0)
    assert spec.normalise == "aperture"
    sensor = loaded(tmp_path, SOURCE + FREQUENCY + FILM).sensors()[0]
    spec = sensor.spec
    assert (spec.estimator, spec.normalise, spec.scene_unit) == ("exact", "radiated", 1)
    assert spec.obliquity == "rayleigh-sommerfeld-1"
    assert tuple(spec.noise.values()) == (None, None, None)


GAUSS = FILM.replace('<rfilter type="box"/>', "")
WRONG = {
    "no film": (SOURCE + FREQUENCY, "the wigner_receiver sensor has no film"),
    "another filter": (SOURCE + FREQUENCY + GAUSS, "a box filter.*got GaussianFilter"),
    "no source": (FREQUENCY + FILM, "expected exactly one of aperture, source"),
    "a power": (
        SOURCE + FREQUENCY + FILM + '<string name="power" value="1 W"/>',
        "the wigner_receiver sensor has no parameter 'power'; its parameters are aperture",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_a_receiver_lacks_or_cannot_take_is_one_line(tmp_path, wrong):
    use("scalar_rgb")
    inside, reason = WRONG[wrong]
    with pytest.raises(PolywignerError, match=reason) as caught:
        loaded(tmp_path, inside)
    assert "\n" not in str(caught.value)


def test_frequency_stands_for_wavelength_and_texts_for_numbers():
    use("scalar_rgb")
    entry = pwm.receiver(SQUARE, frequency=94e9, bandwidth="2 MHz", noise_figure="6 dB")
    assert entry["wavelength"] == WAVELENGTH
    assert (entry["bandwidth"], entry["noise_figure"]) == (2e6, 6.0)
    assert "temperature" not in entry


def test_mitsubas_own_render_needs_the_scene_handed_over():
    use("scalar_rgb")
    scene = mi.load_dict(furnace())
    with pytest.raises((SceneError, RuntimeError)) as caught:
        mi.render(scene, spp=16)
    reason = str(caught.value.__cause__ or caught.value)  # Dr.Jit reports no reason
    assert "requires its scene" in reason
    assert "polywigner.mitsuba.receiving" in reason
    with pwm.receiving(scene):
        image = np.array(mi.render(scene, spp=16, seed=1))
    assert image.shape == (1, 1, 1)
    assert scene.sensors()[0].scene is None
    assert np.allclose(image, pwm.render(scene, spp=16, seed=1), rtol=1)  # other seeds
    signed = mi.load_dict(furnace(estimator="wigner"))  # requires no scene
    assert np.array(mi.render(signed, spp=64)).item() != 0


@pytest.mark.llvm
def test_a_render_leaves_film_and_receiver_as_they_were_even_if_it_fails():
    mi = use("llvm_ad_mono")
    scene = mi.load_dict(furnace(film=(3, 2)))
    sensor = scene.sensors()[0]

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pwm.render(scene, spp=1 << 14, progress=stop)
    assert tuple(sensor.film().size()) == tuple(sensor.film().crop_size()) == (3, 2)
    assert sensor.scene is None
    assert pwm.render(scene, spp=1 << 14).shape == (2, 3, 1)


@pytest.mark.llvm
def test_a_rendered_scene_is_freed():
    mi = use("llvm_ad_mono")
    scene = mi.load_dict(furnace())
    pwm.render(scene, spp=16)
    spec = weakref.ref(scene.sensors()[0].spec)
    del scene
    gc.collect()
    assert spec() is None


def test_a_receiver_moves_with_its_to_world():
    """A receiver that faces away from a hemispherical sky receives nothing."""
    use("scalar_rgb")
    lamp = {"type": "area", "radiance": {"type": "spectrum", "value": 1.0}}
    turn = mi.ScalarTransform4f().translate([0, 0, 50]).rotate([1, 0, 0], 180).scale(1e4)
    scene = furnace(estimator="wigner")
    scene["sky"] = {"type": "rectangle", "to_world": turn, "emitter": lamp}
    loaded = mi.load_dict(scene)
    assert pwm.render(loaded, spp=256).item() > 0
    params = mi.traverse(loaded)
    params["receiver.to_world"] = mi.Transform4f(mi.Matrix4f(pose((0, 0, 3), np.pi)))
    params.update()
    assert pwm.render(loaded, spp=256).item() == 0
    assert loaded.sensors()[0].spec.pose[2, 3] == 3
    params["receiver.to_world"] = mi.Transform4f(mi.Matrix4f(np.diag([2.0, 1.0, 1.0, 1.0])))
    with pytest.raises(SceneError, match="to_world"):
        params.update()
