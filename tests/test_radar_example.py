"""The maps of the radar example against geometry."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw

pytestmark = [pytest.mark.drjit, pytest.mark.llvm, pytest.mark.slow]
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

SCRIPT = Path(__file__).parents[1] / "examples" / "radar_77ghz" / "radar.py"


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("radar_example", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    mi.set_variant("llvm_ad_mono")
    return module


@pytest.fixture(scope="module")
def cube(example):
    return example.data_cube(draws=4)


def test_the_car_is_at_its_range_and_rate(example, cube):
    image = pw.radar.range_doppler(cube).mean(("draw", "receiver", "emitter"))
    moving = image.where(np.abs(image["range_rate"]) > 2, 0.0)
    peak = moving.isel(moving.argmax(...))
    distance, rate = example.CAR  # front of the car, off the axis
    assert abs(float(peak["range"]) - distance) <= 0.5
    assert abs(float(peak["range_rate"]) - rate) <= 0.51


def test_posts_are_at_their_ranges_and_directions(example, cube):
    image = pw.radar.range_angle(cube).mean("draw")
    for post in example.POSTS:
        distance, cosine = example.position_of(post)
        near = image.sel(
            range=slice(distance - 1, distance + 1),
            direction_cosine=slice(cosine - 0.05, cosine + 0.05),
        )
        peak = near.isel(near.argmax(...))
        assert abs(float(peak["range"]) - distance) <= 0.5
        assert abs(float(peak["direction_cosine"]) - cosine) <= 0.03
