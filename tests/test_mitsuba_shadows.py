"""Shadows of opaque sources in the light of other sources."""

import warnings
from functools import cache
from typing import Any

import drjit as dr
import numpy as np
import pytest

import polywigner as pw
import polywigner.mitsuba as pwm
from mitsuba_scenes import (
    MILLIMETRE,
    WAVELENGTH,
    camera,
    light,
    pose,
    rectangle,
    scene_of,
    use,
)
from polywigner.mitsuba.scenes.rendering import default_integrator

pytestmark = pytest.mark.drjit

HEIGHT = 10 * WAVELENGTH / MILLIMETRE
SEEDS, SAMPLES = 8, 256
# Limit of the mean of 16 squared t values with 14 degrees of freedom. The expectation of this mean
# is 1.2 and its standard deviation is 0.5, so the limit is four standard deviations above the
# expectation.
LARGEST_MEAN_SQUARE = 3.2


def floor(lights):
    """Return a floor at z = HEIGHT (mm) below sources at z <= 0, and a camera."""
    return scene_of(
        sensor=camera((30, 0, 0), (0, 0, HEIGHT), 4) | {"sampler": {"type": "independent"}},
        floor=rectangle((0, 0, HEIGHT), (1, 0, 0), 180, 60),
        **lights,
    )


def rear(**more):
    return {"rear": light(to_world=pose((0.0, 0.0, -10.0)), **more)}


def front(**more):
    """Return the larger source, between the rear source and the floor."""
    source = pw.shapes.square(0.012)
    return {"front": light(source, to_world=pose((0.0, 0.0, -3.0)), **more)}


def mean_and_variance(scene, integrator, seed=0):
    """Return mean and variance of the pixels over SEEDS runs."""
    runs = [pwm.render(scene, integrator, SAMPLES, seed + k) for k in range(SEEDS)]
    return np.mean(runs, axis=0), np.var(runs, axis=0, ddof=1) / SEEDS


@cache
def alone():
    """Return the sum of the light of single sources."""
    mi = use("llvm_ad_mono")
    direct = mi.load_dict({"type": "direct"})
    first = mean_and_variance(floor(rear()), direct, 0)
    second = mean_and_variance(floor(front()), direct, 100)
    return first[0] + second[0], first[1] + second[1]


INTEGRATORS: list[Any] = [("direct", None), ("path", 4)]
SLOW = pytest.param("prbvolpath", 2, marks=pytest.mark.slow)


@pytest.mark.parametrize(("name", "depth"), [*INTEGRATORS, ("volpath", 2), SLOW])
def test_sources_without_a_surface_light_a_floor_as_each_alone(name, depth, llvm):
    mi = use("llvm_ad_mono")
    entry: dict[str, Any] = {"type": name}
    if depth is not None:
        entry |= {"max_depth": depth, "rr_depth": 100}
    both = floor(rear(visible=False) | front(visible=False))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mean, own = mean_and_variance(both, mi.load_dict(entry), 1000)
    expected, variance = alone()
    assert np.mean((mean - expected) ** 2 / (variance + own)) < LARGEST_MEAN_SQUARE


@pytest.mark.parametrize(("name", "depth"), INTEGRATORS)
def test_surfaces_cast_shadows_on_each_other_s_light_and_a_warning_says_so(name, depth, llvm):
    mi = use("llvm_ad_mono")
    integrator = mi.load_dict({"type": name} | ({} if depth is None else {"max_depth": depth}))
    dark = front(power=1e-15)
    with pytest.warns(
        RuntimeWarning, match="may cast a shadow of another source.*'volpath'.*visible=False"
    ):
        seen = pwm.render(floor(rear() | dark), integrator, 16 * SAMPLES)
    expected = alone()[0].mean()
    # Paths of four vertices include the passage through a surface.
    assert (seen.mean() > 0.1 * expected) == (depth == 4)


def test_a_scene_that_names_no_integrator_gets_one_that_makes_no_shadows():
    mi = use("scalar_rgb")
    beside = {"front": light(to_world=pose((12.0, 0.0, -10.0)))}
    behind = {"front": light(to_world=pose((0.0, 0.0, -20.0), about_x=np.pi))}
    lamp = {"lamp": {"type": "point", "position": [0.0, 0.0, -20.0]}}
    sky = {"sky": {"type": "constant"}}
    opaque = {"bsdf": {"type": "diffuse"}}
    for lights, expected in (
        (rear(), "path"),
        (rear() | beside, "path"),
        (rear() | behind, "path"),
        (rear() | sky, "path"),
        (rear() | front(visible=False), "path"),
        (rear() | front(**opaque), "path"),  # these shadows are correct
        (rear() | front(), "volpath"),
        (rear(visible=False) | front(), "volpath"),
        (rear() | lamp, "volpath"),
    ):
        assert default_integrator(mi.load_dict({"type": "scene", **lights})) == expected


def test_a_source_without_a_surface_is_met_by_no_ray_and_moves():
    mi = use("scalar_rgb")
    scene = mi.load_dict({"type": "scene", **rear(visible=False)})
    ray = mi.Ray3f(mi.Point3f(0.1, 0.2, 0.0), mi.Vector3f(0.0, 0.0, -1.0))
    params = mi.traverse(scene)
    for place in (-10.0, 40.0):
        params["rear.emitter.to_world"] = mi.Transform4f(mi.Matrix4f(pose((0.0, 0.0, place))))
        params.update()
        assert not np.any(np.array(scene.ray_intersect(ray).is_valid()))
        assert not np.any(np.array(scene.ray_test(ray)))
        it = dr.zeros(mi.Interaction3f)
        it.p = mi.Point3f(0.0, 0.0, place + 20.0)
        ds, weight = scene.sample_emitter_direction(it, mi.Point2f(0.3, 0.6), True)
        # Visibility rays end before the source, by up to 0.1 % of the distance.
        assert np.array(ds.p, dtype=float).ravel()[2] == pytest.approx(place, abs=0.02)
        assert np.array(weight).ravel()[0] != 0
