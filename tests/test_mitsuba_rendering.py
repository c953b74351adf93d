"""Rendered floors against the diffraction integral, for integrators and variants."""

from functools import cache

import drjit as dr
import numpy as np
import pytest

import polywigner as pw
import polywigner.mitsuba as pwm
from mitsuba_scenes import (
    CHEVRON,
    MILLIMETRE,
    SQUARE,
    WAVELENGTH,
    camera,
    floor_scene,
    light,
    pose,
    use,
)
from polywigner.errors import ArgumentError, SceneError

pytestmark = pytest.mark.drjit

COLUMNS = 101
# Limit of the mean squared t value. Its expectation for 8 seeds is 7/5, and the average over 101
# nearly uncorrelated pixels is below this limit.
LARGEST_MEAN_SQUARE = 2.2


@cache
def line(source, distance):
    """Return the expected pixels of a line through the axis at ``distance`` wavelengths."""
    import render_reference as reference

    z = distance * WAVELENGTH
    points = reference.pixel_points(COLUMNS, 2 * z, z)
    return reference.mean_over_pixels(reference.wigner_floor(source, points, WAVELENGTH))


def irradiance(image):
    """Return the irradiance of a white floor in ascending x."""
    return np.pi * image[0, ::-1, 0].astype(float)


@pytest.mark.parametrize(
    ("source", "distance", "sampler"),
    [
        pytest.param(SQUARE, 2, "independent", marks=pytest.mark.slow),
        (CHEVRON, 10, "multijitter"),
        pytest.param(CHEVRON, 50, "multijitter", marks=pytest.mark.slow),
    ],
)
def test_a_floor_shows_the_diffraction_integral_times_its_cosine_without_bias(
    source, distance, sampler, llvm
):
    use("llvm_ad_mono")
    scene = floor_scene(
        {"aperture": light(source)},
        distance=distance * WAVELENGTH / MILLIMETRE,
        columns=COLUMNS,
        rows=1,
        sampler=sampler,
    )
    expected = line(source, distance)
    runs = [irradiance(pwm.render(scene, spp=1024, seed=seed)) for seed in range(8)]
    mean, error = np.mean(runs, axis=0), np.std(runs, axis=0, ddof=1) / np.sqrt(len(runs))
    assert np.mean(((mean - expected) / error) ** 2) < LARGEST_MEAN_SQUARE
    assert np.abs(mean - expected).mean() < 0.01 * expected.max()


def test_an_aperture_that_is_looked_at_shows_its_negative_radiance(llvm):
    mi = use("llvm_ad_mono")
    # At 100 diameters, all pixels see the aperture in the direction (0.6, 0, 0.8).
    seen = camera((600, 0, 800), (0, 0, 0), 64) | {"fov": 0.7, "near_clip": 1.0}
    background = {"type": "constant", "radiance": {"type": "spectrum", "value": 1e-9}}
    scene = mi.load_dict(
        {"type": "scene", "sensor": seen, "aperture": light(), "background": background}
    )
    image = pwm.render(scene, "path", spp=16, seed=1)[..., 0]
    centre = np.linspace(-0.0045, 0.0045, 100)
    x = np.stack(np.meshgrid(centre, centre), axis=-1)
    density = 0.8 * pw.wigner(SQUARE, x, np.array([0.6, 0.0]) / WAVELENGTH) / WAVELENGTH**2
    # Pixels of a fiftieth of the aperture flatten the peaks.
    assert density.min() < 0
    assert 0.8 < image.min() / density.min() < 1.05
    assert 0.8 < image.max() / density.max() < 1.05


def heavy_kernels(render, samples):
    """Return the kernels with at least one thread per sample."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        np.array(render())
        history = dr.kernel_history([dr.KernelType.JIT])
    return [kernel for kernel in history if kernel["size"] >= samples]


def test_a_render_is_one_kernel_whatever_shines_in_the_scene(llvm):
    mi = use("llvm_ad_mono")
    lights = {
        "a": light(to_world=pose((20.0, 0.0, 0.0))),
        "b": light(to_world=pose((-20.0, 0.0, 0.0))),
        "c": light(CHEVRON, 1.1 * WAVELENGTH, power=1.0),
    }
    scene = floor_scene(lights, columns=16)
    kernels = heavy_kernels(lambda: mi.render(scene, spp=64, seed=1), 16 * 16 * 64)
    assert len(kernels) == 1


def test_new_parameters_give_the_picture_of_a_new_scene_from_the_same_kernel(llvm):
    mi = use("llvm_ad_mono")
    placed = pose((20.0, 30.0, -1.0), about_x=0.2)
    scene = floor_scene({"aperture": light()}, columns=8)
    mi.render(scene, spp=16)
    params = mi.traverse(scene)
    params["aperture.emitter.wavelength"] = 0.9 * WAVELENGTH
    params["aperture.emitter.power"] = 2e-4
    params["aperture.emitter.to_world"] = mi.Transform4f(mi.Matrix4f(placed))
    params.update()
    changed: list[np.ndarray] = []
    (kernel,) = heavy_kernels(
        lambda: changed.append(np.array(mi.render(scene, spp=16, seed=2))), 8 * 8 * 16
    )
    assert kernel["cache_hit"]
    fresh = floor_scene(
        {"aperture": light(SQUARE, 0.9 * WAVELENGTH, power=2e-4, to_world=placed)}, columns=8
    )
    expected = np.array(mi.render(fresh, spp=16, seed=2))
    assert np.abs(changed[0] - expected).max() < 1e-5 * expected.max()
    box, fresh_box = scene.bbox(), fresh.bbox()
    assert np.allclose(box.min, fresh_box.min)
    assert np.allclose(box.max, fresh_box.max)


def test_the_same_seed_gives_the_same_image_and_another_seed_another(llvm):
    use("llvm_ad_mono")
    scene = floor_scene({"aperture": light()}, columns=8)
    steps: list[tuple[int, int]] = []
    first = pwm.render(scene, spp=64, seed=3, progress=lambda *step: steps.append(step))
    assert first.dtype == np.float32
    assert first.shape == (8, 8, 1)
    assert steps[-1][0] == steps[-1][1]
    assert np.array_equal(first, pwm.render(scene, spp=64, seed=3))
    assert not np.array_equal(first, pwm.render(scene, spp=64, seed=4))


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"spp": 0}, ArgumentError, "spp to be a whole number from 1"),
        ({"sensor": 1}, ArgumentError, "sensor to be a whole number from 0 to 0"),
        ({"integrator": "no_such_integrator"}, SceneError, "no_such_integrator"),
        ({"seed": -1}, ArgumentError, "seed to be a whole number from 0 to"),
        ({"scene": None}, ArgumentError, r"expected scene to be a mi\.Scene, got NoneType"),
        ({"integrator": 5}, ArgumentError, "expected integrator to be an integrator object"),
    ],
)
def test_bad_requests_are_refused(arguments, error, words):
    use("scalar_rgb")
    with pytest.raises(error, match=words):
        pwm.render(**{"scene": floor_scene({"aperture": light()}, columns=2)} | arguments)
