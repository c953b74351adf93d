"""Small and hidden objects in scenes, against quadrature of fields."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import WHITE, lit, nodes, rectangle, shifted

pytestmark = pytest.mark.drjit
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

WAVELENGTH = 3.9e-3
HORN, PATCH = pw.shapes.square(20e-3), pw.shapes.square(2e-3)
TX, RX = np.array([-0.02, 0.0, 0.0]), np.array([0.02, 0.0, 0.0])

# Limit in standard errors of 16 batches, exceeded once in 100 tests.
ERRORS = 3.0
# Allowed bias. Exact light has errors of 1e-4 of its peak at both ends.
BIAS = 1e-3
# Number of samples, and noise for a plate of 0.1 m at 10 m. Without importance sampling, 2^14
# samples have an error of 90 %.
SAMPLES, NOISE = 1 << 14, 2e-2


def plate(place: Any, half: float, turn: float = 180.0) -> dict[str, Any]:
    """Return a white plate with its normal along z, rotated about x by degrees."""
    return rectangle(place, (1, 0, 0), turn, half, WHITE)


def scene_of(estimator: str = "exact", **things: Any) -> Any:
    entries = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "tx": pm.aperture(
            HORN, WAVELENGTH, shifted(*TX), power=1.0, estimator="exact", visible=False
        ),
        "rx": pm.receiver(PATCH, WAVELENGTH, to_world=shifted(*RX), estimator=estimator),
    }
    return mi.load_dict(entries | things)


def quadrature(place: Any, half: float, turn: float = 180.0, count: int = 40) -> float:
    """Return the power via a plate, lambda^2 int |U_t|^2 |U_r|^2 cos cos dA/pi."""
    points, normal, areas = nodes(half, rectangle(place, (1, 0, 0), turn)["to_world"], count)
    product = WAVELENGTH**2 / np.pi * areas
    for source, start in ((HORN, TX), (PATCH, RX)):
        product = product * lit(source, points - start, normal, WAVELENGTH)
    return float(product.sum())


SMALL, BEHIND = ((0.0, 0.0, 10.0), 0.05), ((0.0, 0.0, 12.0), 0.05)
ABOVE, FLOOR = ((1.0, 0.8, 9.0), 0.05), ((0.0, -1.0, 8.0), 4.0, -90.0)


@pytest.fixture
def compiled() -> None:
    mi.set_variant("llvm_ad_mono")


def check(power: float, error: float, expected: float, noise: float = NOISE) -> None:
    assert abs(power - expected) < ERRORS * error + BIAS * expected
    assert error < noise * expected


@pytest.mark.llvm
@pytest.mark.parametrize(
    ("things", "seen"),
    [
        pytest.param([SMALL, BEHIND], [SMALL], id="hidden"),
        pytest.param([ABOVE], [ABOVE], id="off the beam", marks=pytest.mark.slow),
        pytest.param([ABOVE, FLOOR], [ABOVE, FLOOR], id="floor", marks=pytest.mark.slow),
    ],
)
def test_small_plates_send_what_quadrature_finds(
    compiled: None, things: list[Any], seen: list[Any]
) -> None:
    scene = scene_of(**{f"plate {k}": plate(*thing) for k, thing in enumerate(things)})
    result = pm.received_power(scene, spp=SAMPLES)
    expected = sum(quadrature(*thing) for thing in seen)
    check(result.scattered, result.standard_error, expected)


def test_rays_of_the_wigner_function_find_a_small_plate_and_the_receiver_is_as_before(
    plain: None,
) -> None:
    scene = scene_of("wigner", plate=plate(*SMALL))
    (sensor,) = scene.sensors()
    before = sensor.directions
    result = pm.received_power(scene, spp=1 << 8)
    check(result.scattered, result.standard_error, quadrature(*SMALL), 0.2)
    assert sensor.directions is before


@pytest.mark.llvm
@pytest.mark.slow
def test_ranges_and_scatterers_find_a_small_plate(compiled: None) -> None:
    scene, expected = scene_of(plate=plate(*SMALL)), quadrature(*SMALL)
    cloud = pm.scatterers(scene, 2000, rays=SAMPLES)
    check(float(cloud.power.sum()), cloud.attrs["standard_error"], expected, 0.02)
    if importlib.util.find_spec("mitransient") is not None:
        profile = pm.range_profile(scene, [0.0, 9.9, 10.1, 20.0], spp=SAMPLES)
        power, error = (profile[name].values for name in ("power", "standard_error"))
        check(power[1], error[1], expected)
        assert power[0] == power[2] == 0.0
