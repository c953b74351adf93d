"""Receivers in scenes: XML, films, poses, what is refused, and how the scene reaches them."""

import gc
import warnings
import weakref

import numpy as np
import pytest

import polywigner.mitsuba as pwm
from mitsuba_scenes import MILLIMETRE, MONO, SQUARE, WAVELENGTH, pose, use
from polywigner.errors import PolywignerError, SceneError

pytestmark = pytest.mark.drjit

SKY = {"type": "constant", "radiance": {"type": "spectrum", "value": 1.0}}
FILM = (
    '<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/>'
    '<rfilter type="box"/></film>'
)
SOURCE = '<string name="aperture" value="square.wkt"/>'
FREQUENCY = '<string name="frequency" value="94 GHz"/>'


def scene_with(**more):
    """A receiver under a sky of radiance 1."""
    receiver = pwm.receiver(SQUARE, WAVELENGTH, scene_unit=MILLIMETRE, **more)
    return {"type": "scene", "integrator": {"type": "path"}, "receiver": receiver, "sky": SKY}


def loaded(folder, inside):
    (folder / "square.wkt").write_text("POLYGON((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
    (folder / "scene.xml").write_text(
        f'<scene version="3.0.0"><sensor type="wigner_receiver">{inside}</sensor>'
        '<emitter type="constant"/></scene>'
    )
    return pwm.load_scene(folder / "scene.xml")


def test_a_receiver_in_xml_has_the_parameters_of_its_source_and_of_its_noise(tmp_path):
    use("scalar_rgb")
    texts = {
        "array": "2 x 3, 12 mm",
        "taper": "cosine",
        "window": "hamming",
        "steering": "20 deg, 90 deg",
        "obliquity": "kirchhoff",
        "estimator": "wigner",
        "sampling": "marginal",
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
    assert (spec.obliquity, spec.estimator, spec.sampling) == ("kirchhoff", "wigner", "marginal")
    assert (spec.scene_unit, spec.pose[0, 3]) == (1e-3, 7.0)
    assert spec.normalise == "aperture"


def test_defaults_are_exact_light_and_no_noise(tmp_path):
    use("scalar_rgb")
    sensor = loaded(tmp_path, SOURCE + FREQUENCY + FILM).sensors()[0]
    spec = sensor.spec
    assert (spec.estimator, spec.obliquity, spec.scene_unit) == (
        "exact",
        "rayleigh-sommerfeld-1",
        1,
    )
    assert tuple(spec.noise.values()) == (None, None, None)
    assert spec.normalise == "radiated"
    assert tuple(sensor.film().size()) == (1, 1)


GAUSS = FILM.replace('<rfilter type="box"/>', "")
WRONG = {
    "no film": (SOURCE + FREQUENCY, "expected a film in the wigner_receiver sensor, got none"),
    "another filter": (SOURCE + FREQUENCY + GAUSS, "a box filter.*got GaussianFilter"),
    "no frequency": (SOURCE + FILM, "a frequency or a wavelength of the wigner_receiver sensor"),
    "no source": (FREQUENCY + FILM, "the parameter 'aperture' of a wigner_receiver sensor"),
    "a power": (
        SOURCE + FREQUENCY + FILM + '<string name="power" value="1 W"/>',
        "expected the parameters aperture.* of a wigner_receiver sensor, got 'power'",
    ),
    "a temperature in another unit": (
        SOURCE + FREQUENCY + FILM + '<string name="temperature" value="20 C"/>',
        "temperature of the wigner_receiver sensor.*use one of the units K, mK",
    ),
    "another count of power": (
        SOURCE + FREQUENCY + FILM + '<string name="normalise" value="gain"/>',
        'expected normalise to be "radiated" or "aperture", got .gain.',
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_a_receiver_lacks_or_cannot_take_is_one_line(tmp_path, wrong):
    use("scalar_rgb")
    inside, reason = WRONG[wrong]
    with pytest.raises(PolywignerError, match=reason) as caught:
        loaded(tmp_path, inside)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"film": (0, 3)}, "whole numbers from 1"),
        ({"film": 3}, r"a film of \(columns, rows\)"),
        ({"film": {"width": 3}}, "the film as a dictionary with its type"),
        ({"noise_figure": -1.0}, "0 dB or more"),
        ({"temperature": 0.0}, "above zero"),
        ({"bandwidth": "1 s"}, "frequency"),
        ({"estimator": "rays"}, "an estimator"),
        ({"obliquity": "paper"}, "boundary condition"),
        ({"to_world": np.diag([2.0, 1.0, 1.0, 1.0])}, "to_world"),
    ],
)
def test_python_says_what_is_wrong_before_a_scene_is_loaded(more, reason):
    use("scalar_rgb")
    with pytest.raises(PolywignerError, match=reason):
        scene_with(**more)


def test_frequency_stands_for_wavelength_and_texts_for_numbers():
    use("scalar_rgb")
    entry = pwm.receiver(SQUARE, frequency=94e9, bandwidth="2 MHz", noise_figure="6 dB")
    assert entry["wavelength"] == WAVELENGTH
    assert (entry["bandwidth"], entry["noise_figure"]) == (2e6, 6.0)
    assert "temperature" not in entry


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
def test_equal_receivers_are_two(variant):
    mi = use(variant)
    scene = scene_with()
    loaded = mi.load_dict({**scene, "other": dict(scene["receiver"])})
    assert len(loaded.sensors()) == 2


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
def test_mitsubas_own_render_needs_the_scene_handed_over(variant):
    mi = use(variant)
    scene = mi.load_dict(scene_with())
    with pytest.raises((SceneError, RuntimeError)) as caught:
        mi.render(scene, spp=16)
    reason = str(caught.value.__cause__ or caught.value)  # Dr.Jit says only that something failed
    assert "expected the scene of the wigner_receiver" in reason
    assert "polywigner.mitsuba.receiving" in reason
    with pwm.receiving(scene):
        image = np.array(mi.render(scene, spp=16, seed=1))
    assert image.shape == (1, 1, 1)
    assert scene.sensors()[0].scene is None
    assert np.allclose(image, pwm.render(scene, spp=16, seed=1), rtol=1)  # other seeds


@pytest.mark.llvm
def test_signed_weights_need_no_scene():
    mi = use("llvm_ad_mono")
    scene = mi.load_dict(scene_with(estimator="wigner"))
    assert np.array(mi.render(scene, spp=256)).item() > 0


@pytest.mark.llvm
def test_a_render_leaves_film_and_receiver_as_they_were_even_if_it_fails():
    mi = use("llvm_ad_mono")
    scene = mi.load_dict(scene_with(film=(3, 2)))
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
    scene = mi.load_dict(scene_with())
    pwm.render(scene, spp=16)
    spec = weakref.ref(scene.sensors()[0].spec)
    del scene
    gc.collect()
    assert spec() is None


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
def test_a_receiver_moves_with_its_to_world(variant):
    """Turned away from a sky of half a sphere it reads nothing."""
    mi = use(variant)
    lamp = {"type": "area", "radiance": {"type": "spectrum", "value": 1.0}}
    turn = mi.ScalarTransform4f().translate([0, 0, 50]).rotate([1, 0, 0], 180).scale(1e4)
    scene = scene_with(estimator="wigner")
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


@pytest.mark.parametrize(("start", "warned"), [(20.0, True), (150.0, False)])
def test_fog_in_the_near_zone_is_warned_of(start, warned):
    """2 D^2/wavelength is 125 mm from the 10 mm square."""
    mi = use("scalar_rgb")
    fog = {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().translate([0, 0, start + 50]).scale(50),
        "bsdf": {"type": "null"},
        "interior": {"type": "homogeneous", "albedo": 0.5, "sigma_t": 1e-3},
    }
    for estimator in ("exact", "wigner"):
        scene = mi.load_dict({**scene_with(estimator=estimator), "fog": fog})
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            pwm.render(scene, integrator="volpath", spp=1)
        found = [str(w.message) for w in caught if "near zone" in str(w.message)]
        assert len(found) == (warned and estimator == "exact")
