"""Derivatives of renders in the parameters of a source, against differences of renders."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import CHEVRON, floor_scene, light, use
from polywigner.errors import GeometryError, SceneError

pytestmark = pytest.mark.llvm

PAIR = pw.Array(
    [pw.shapes.square(4e-3).moved((-3e-3, 0)), pw.shapes.square(4e-3).moved((3e-3, 1e-3))],
    [1, 0.5 + 0.5j],
)
DIRECT = {"type": "direct", "bsdf_samples": 0, "emitter_samples": 1}
PRB = {"type": "prb", "max_depth": 2}
# Error of differences with steps of 1e-2 in float32, for renders with the same samples.
DIFFERENCES = 5e-3
# Limit in standard errors of the mean of the renders.
DEVIATIONS = 4.5


def _scene(source, integrator, **how):
    scene = floor_scene({"aperture": light(source, **how)}, integrator, columns=5)
    return scene, mi.traverse(scene)


def _weighted(image):
    """Return a sum over pixels with different weights."""
    weight = 1.0 + 0.3 * np.arange(np.prod(image.shape)) % 1.7
    return dr.sum(image.array * type(image.array)(weight.astype(np.float32)))


def _in_the_middle(image):
    """Return the brightest pixel."""
    count = len(image.array)
    return dr.gather(type(image.array), image.array, dr.uint32_array_t(image.array)(count // 2))


PARTLY = PAIR.partially_coherent(3e-3)
STEPS = {"wavelength": 1e-5, "vertices": 4e-4, "weights": 1e-2}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "source", "integrator", "how"),
    [
        *((name, PAIR, PRB, {}) for name in STEPS),
        ("wavelength", PARTLY, PRB, {}),
        ("wavelength", CHEVRON, DIRECT, {"obliquity": "kirchhoff"}),
        ("weights", PAIR, DIRECT, {}),
    ],
)
def test_gradients_at_a_fixed_radiated_power_are_those_of_differences(
    name, source, integrator, how, llvm
):
    """The derivative includes the radiated power N of the unscaled field.

    Differences are noisy, because samples depend on the outline.
    """
    mi = use("llvm_ad_mono")
    scene, params = _scene(source, integrator, **how)
    key, seeds, step = f"aperture.emitter.{name}", 4, STEPS[name]
    values = np.array(params[key], dtype=np.float64)
    change = {
        "wavelength": np.ones(1),
        "vertices": values / np.abs(values).max(),
        "weights": np.resize([0.7, -0.4, 0.5, 0.9], len(values)),
    }[name]
    samples = 4096 if name == "vertices" else 256
    measure = _weighted if name == "weights" else _in_the_middle
    gradients, differences, of_norm = [], [], 0.0
    for seed in range(1, seeds + 1):
        params[key] = mi.Float(values.tolist())
        dr.enable_grad(params[key])
        params.update()
        value = measure(mi.render(scene, params, spp=samples, seed=9, seed_grad=seed))
        dr.backward(value)
        gradients.append(np.array(dr.grad(params[key])) @ change)
        ends, norms = [], []
        for sign in (1, -1):
            params[key] = mi.Float((values + sign * step * change).tolist())
            params.update()
            ends.append(float(measure(mi.render(scene, spp=samples, seed=seed))[0]))
            norms.append(scene.emitters()[0].spec.norm)
        differences.append((ends[0] - ends[1]) / (2 * step))
        of_norm = float(value[0]) * (norms[0] - norms[1]) / (step * sum(norms))
    error = np.std(np.subtract(gradients, differences), ddof=1) / np.sqrt(seeds)
    allowed = DEVIATIONS * error + DIFFERENCES * abs(of_norm)
    assert abs(np.mean(gradients) - np.mean(differences)) < allowed
    assert allowed < abs(of_norm) / 3  # larger than the noise


def test_gradients_in_the_pose_are_those_of_differences(llvm):
    mi = use("llvm_ad_mono")
    scene, params = _scene(CHEVRON, DIRECT)

    def render(shift, tilt, seed=2):
        pose = mi.Transform4f().translate([shift, 0.5, -1.0]).rotate([1, 0, 0], tilt)
        params["aperture.emitter.to_world"] = pose
        params.update()
        return _weighted(mi.render(scene, params, spp=256, seed=seed, seed_grad=5 - seed))

    numbers = [mi.Float(0.3), mi.Float(5.0)]
    dr.enable_grad(numbers)
    dr.backward(render(*numbers, seed=3))
    got = [float(dr.grad(number)[0]) for number in numbers]
    for k, step in enumerate((0.02, 0.1)):
        ends = [
            float(render(*(mi.Float(v + s * step * (j == k)) for j, v in enumerate((0.3, 5.0))))[0])
            for s in (1, -1)
        ]
        expected = (ends[0] - ends[1]) / (2 * step)
        assert abs(got[k] - expected) < DIFFERENCES * abs(expected)


@pytest.mark.slow
def test_new_vertices_give_the_picture_and_the_mesh_of_a_new_scene(llvm):
    mi = use("llvm_ad_mono")
    scene, params = _scene(CHEVRON, PRB)
    smaller = np.concatenate(pw.shapes.chevron(8e-3, 9e-3, 3e-3).rings).astype(np.float32)
    params["aperture.emitter.vertices"] = mi.Float(smaller.ravel().tolist())
    params.update()
    fresh, _ = _scene(pw.Aperture(smaller.astype(np.float64)), PRB)
    power = mi.traverse(fresh)["aperture.emitter.power"]
    params["aperture.emitter.power"] = power
    params.update()
    images = [np.array(mi.render(s, spp=64, seed=3)) for s in (scene, fresh)]
    assert np.abs(images[0] - images[1]).max() < 1e-4 * np.abs(images[1]).max()
    assert np.allclose(scene.bbox().max, fresh.bbox().max)


def test_vertices_that_cross_and_numbers_that_are_missing_are_refused(llvm):
    mi = use("llvm_ad_mono")
    _, params = _scene(CHEVRON, PRB)
    key = "aperture.emitter.vertices"
    corners = np.array(params[key]).reshape(-1, 2)
    params[key] = mi.Float(corners[[3, 1, 2, 0, *range(4, len(corners))]].ravel().tolist())
    with pytest.raises(GeometryError, match=r"crosses itself|orientation of the outline"):
        params.update()
    params[key] = mi.Float([0.0, 1.0])
    with pytest.raises(SceneError, match="two for each"):
        params.update()
