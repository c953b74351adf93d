"""The radar's maps in the example against geometry, its draws of speckle against range profiles."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

pytestmark = [pytest.mark.drjit, pytest.mark.llvm, pytest.mark.slow]
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

SCRIPT = Path(__file__).parents[1] / "examples" / "radar_77ghz" / "radar.py"

# Speckle of a bin: the mean of n draws of an exponential distribution is off by 1/sqrt(n).
SIGMAS = 5.0
# Bins down to this of the peak; below are few scatterers.
WEAK = 1e-3


@pytest.fixture(scope="module")
def radar():
    spec = importlib.util.spec_from_file_location("radar", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    mi.set_variant("llvm_ad_mono")
    return module


@pytest.fixture(scope="module")
def scene(radar):
    return pm.load_scene(SCRIPT.with_name("radar.xml"), "llvm_ad_mono", merge=False)


@pytest.fixture(scope="module")
def cloud(radar, scene):
    return radar.cloud_of(scene, 20_000)


@pytest.fixture(scope="module")
def responses(radar, cloud):
    return pm.element_responses(cloud, radar.array())


def test_the_car_is_where_and_as_fast_as_it_is(radar, cloud, responses):
    rng = np.random.default_rng(1)
    signal = radar.beat_signal(cloud, responses, radar.speckle(responses.shape[1], rng))
    picture = radar.range_doppler(signal)
    picture[np.abs(radar.SPEEDS) < 2] = 0.0
    row, column = np.unravel_index(picture.argmax(), picture.shape)
    # its front stands at x = 18 m, beside the axis
    assert abs(radar.RANGES[column] - 18.0) <= 0.5
    assert abs(radar.SPEEDS[row] - radar.CAR_SPEED) <= radar.SPEEDS[1] - radar.SPEEDS[0]


def test_the_mean_of_draws_is_the_range_profile(radar, scene, cloud, responses):
    if importlib.util.find_spec("mitransient") is None:  # importing it sets a default variant
        pytest.skip("mitransient is not installed")
    mean = radar.mean_profile(cloud, responses, np.random.default_rng(2))
    edges = np.arange(0.0, 46.0, 0.05)
    profile = pm.range_profile(scene, edges, spp=1 << 20)
    expected = radar.expected_profile(profile["range"].values, profile["scattered_power"].values)
    strong = expected > WEAK * expected.max()
    off = (mean / expected - 1)[strong] * np.sqrt(radar.DRAWS)
    assert np.abs(off).max() < SIGMAS
    assert off.std() < 1.5  # neighbouring bins share draws
    # A few strong bins make up the sum, which 200 draws have to 3 or 4 percent, 3,200 to 1.
    others = (
        radar.mean_profile(cloud, responses, np.random.default_rng(seed)) for seed in range(3, 18)
    )
    total = np.mean([mean.sum(), *(other.sum() for other in others)])
    assert total == pytest.approx(float(profile["scattered"].values), rel=0.03)
