"""Range profiles against received powers, quadratures over surfaces, and lengths by hand."""

import importlib.util
import math
import os
import sys

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, EngineError, MissingExtraError, SceneError

# not importorskip: it can be imported while a variant is set alone
HAS_RADAR = importlib.util.find_spec("mitransient") is not None
pytestmark = [
    pytest.mark.drjit,
    pytest.mark.llvm,
    pytest.mark.skipif(not HAS_RADAR, reason="mitransient is not installed"),
]
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

from polywigner.mitsuba.range_film import require_transients  # noqa: E402

WAVELENGTH = 3.19e-3
SQUARE = pw.shapes.square(10e-3)
LARGE = pw.shapes.square(100e-3)
REFLECTANCE = 0.5  # Mitsuba's own

# A film of Mitsuba adds some thousand samples of a pixel in single precision.
STEADY = 1e-6
# Means of noise, in standard errors that are themselves known to 18 %.
SIGMAS = 5.0
# dB, of the law of the fourth power.
LAW = 0.05


@pytest.fixture(autouse=True)
def mono():
    mi.set_variant("llvm_ad_mono")


def emitter(**options):
    return pm.aperture(SQUARE, WAVELENGTH, power=1.0, visible=False, **options)


def receiver(source=SQUARE, **options):
    return pm.receiver(source, WAVELENGTH, **options)


def at(x, z, turn=180.0):
    """Turned about y by degrees, then moved; 180 looks back along -z."""
    return mi.ScalarTransform4f().translate([x, 0.0, z]).rotate([0, 1, 0], turn)


def plate(half, pose):
    return {"type": "rectangle", "to_world": pose.scale([half, half, 1.0])}


def scene_of(**parts):
    return mi.load_dict({"type": "scene", **parts})


def nodes(half, pose, count=10):
    """Points (n, 3) of a square plate, its normal, and areas (n,)."""
    x, weight = np.polynomial.legendre.leggauss(count)
    u, v = np.meshgrid(half * x, half * x)
    own = np.stack([u, v, 0 * u, 1 + 0 * u], axis=-1).reshape(-1, 4)
    matrix = np.array(pose.matrix)
    return (own @ matrix.T)[:, :3], matrix[:3, 2], half**2 * np.outer(weight, weight).ravel()


def lit(source, points, normal):
    """W/m^2 on a surface by a source of 1 W at the origin, or a receiver's weight there."""
    away = points / np.linalg.norm(points, axis=1)[:, None]
    density = pw.irradiance(source, points, WAVELENGTH, method="rayleigh-sommerfeld-1")
    return density / pw.radiated_power(source, WAVELENGTH) * (-away @ normal)


def gain(source):
    """Directivity along z."""
    pattern = pw.radiation_pattern(source, WAVELENGTH, 0.0, 0.0)
    return float(10 ** (pattern.attrs["largest_directivity"] / 10))


def test_a_plate_falls_into_its_bin_and_bins_add_up_to_the_scattered_power():
    scene = scene_of(
        tx=emitter(),
        rx=receiver(estimator="wigner", bandwidth=1e9, temperature=290.0),
        plate=plate(2.0, at(0.0, 37.5)),
        near=plate(0.2, at(0.5, 3.0)),
        far=plate(50.0, at(0.0, 80.0)),
    )
    edges = np.linspace(35.0, 40.0, 11)
    found = pm.range_profile(scene, edges, spp=16384, seed=4)
    steady = pm.received_power(scene, spp=16384, seed=4)
    assert found["power"].dims == ("range",) and found["power"].attrs["units"] == "W"
    np.testing.assert_allclose(found["range"].values, edges[:-1] + 0.25)
    # 37.5 m on the axis is where a bin begins; the plate's corners are farther by 0.1 m
    np.testing.assert_array_equal(np.flatnonzero(found["power"].values), [5])
    assert float(found["before"].values) > 0 and float(found["after"].values) > 0
    total = found["power"].values.sum() + found["before"].values + found["after"].values
    np.testing.assert_allclose(total, steady.scattered, rtol=STEADY)
    np.testing.assert_allclose(found["scattered"].values, total, rtol=1e-12)
    np.testing.assert_allclose(found["scattered_error"].values, steady.standard_error, rtol=1e-4)
    np.testing.assert_allclose(found["emitter_power"].values[0], found["power"].values)
    assert float(found["noise_power"].values) == steady.noise_power
    np.testing.assert_allclose(found["resolution"].values, 0.149896229)
    assert "MI_DEFAULT_VARIANT" not in os.environ


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ("far", "numbers in m"),
        ([1.0], "at least two"),
        (np.arange(2**20 + 2), "at most 1048577"),
        ([0.0, 2.0, 1.0], "rise"),
        ([-1.0, 1.0], "rise from zero"),
        ([0.0, 1e39], "finite"),
        ([100.0, 100.0 + 1e-7], "single precision"),
    ],
)
def test_edges_that_do_not_rise_are_refused(ranges, message):
    with pytest.raises(ArgumentError, match=message):
        pm.range_profile(None, ranges)


def test_without_mitransient_the_extra_is_named(monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "mitransient"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mitransient", None)
    with pytest.raises(MissingExtraError, match=r"radar"):
        pm.range_profile(None, [0.0, 1.0])


def test_what_has_no_path_lengths_is_refused():
    scene = scene_of(tx=emitter(), rx=receiver(), plate=plate(1.0, at(0.0, 5.0)))
    require_transients()
    with pytest.raises(SceneError, match="expected an integrator"):
        pm.range_profile(scene, [0.0, 9.0], integrator="depth", spp=16)
    with pytest.raises(SceneError, match="camera_unwarp"):
        unwarped = mi.load_dict({"type": "transient_path", "camera_unwarp": True})
        pm.range_profile(scene, [0.0, 9.0], integrator=unwarped, spp=16)
    with pytest.raises(SceneError, match="sensor of its own"):
        pm.range_profile(scene, [0.0, 9.0], integrator="transient_nlos_path", spp=16)
    fog = {"type": "heterogeneous", "albedo": 0.5, "sigma_t": {"type": "gridvolume"}}
    fog["sigma_t"]["grid"] = mi.VolumeGrid(np.ones((2, 2, 2, 1), np.float32))
    cube = {"type": "cube", "bsdf": {"type": "null"}, "interior": fog}
    cube["to_world"] = mi.ScalarTransform4f().translate([0.0, 0.0, 20.0])
    scene = scene_of(tx=emitter(), rx=receiver(), fog=cube)
    with pytest.raises(SceneError, match="even fog"):
        pm.range_profile(scene, [0.0, 9.0], integrator="volpath", spp=16)
    sky = {"type": "directional", "direction": [0.0, 0.0, 1.0]}
    with pytest.raises(SceneError, match="infinitely far"):
        pm.range_profile(scene_of(tx=emitter(), rx=receiver(), sky=sky), [0.0, 9.0], spp=16)
    mi.set_variant("llvm_ad_rgb")
    with pytest.raises(SceneError, match="scene of the variant that is set, llvm_ad_rgb"):
        pm.range_profile(scene, [0.0, 9.0], spp=16)
    mi.set_variant("scalar_rgb")
    with pytest.raises(EngineError, match="scalar_rgb"):
        pm.range_profile(scene, [0.0, 1.0])


@pytest.mark.slow
@pytest.mark.parametrize("distance", [20.0, 200.0])
def test_a_small_patch_falls_off_as_the_fourth_power_of_its_range(distance):
    half, pose = 0.25, at(0.0, distance)
    scene = scene_of(tx=emitter(estimator="exact"), rx=receiver(LARGE), plate=plate(half, pose))
    # amid a bin: single precision leaves paths on both sides of an edge
    found = pm.range_profile(scene, np.arange(0.25, 250.5, 0.5), spp=2**22, seed=1)
    points, normal, areas = nodes(half, pose)
    radiance = REFLECTANCE / math.pi * lit(SQUARE, points, normal)
    expected = WAVELENGTH**2 * np.sum(areas * radiance * lit(LARGE, points, normal))
    power = found["power"].values
    assert found["range"].values[np.argmax(power)] == distance
    assert abs(10 * math.log10(power.max() / expected)) < LAW
    # with the pattern of both taken off: that of points on the axis
    axis = np.array([[0.0, 0.0, distance]])
    on_axis = (lit(SQUARE, axis, normal) * lit(LARGE, axis, normal)).item() * areas.sum()
    pattern = expected / (WAVELENGTH**2 * REFLECTANCE / math.pi * on_axis)
    both = gain(SQUARE) * gain(LARGE) * WAVELENGTH**2 / (4 * math.pi) ** 2
    law = both * areas.sum() * REFLECTANCE / math.pi
    assert abs(10 * math.log10(power.max() / pattern * distance**4 / law)) < LAW


@pytest.mark.slow
def test_two_bounces_in_a_dihedral_are_a_ghost_behind_it():
    estimator = "exact"
    half, aside, depth = 0.7, 2.0, 10.0
    poses = at(-aside, depth, 135.0), at(aside, depth, -135.0)
    scene = scene_of(
        tx=emitter(estimator=estimator),
        rx=receiver(estimator=estimator),
        left=plate(half, poses[0]),
        right=plate(half, poses[1]),
        integrator={"type": "path", "max_depth": 3},
    )
    edges = np.linspace(9.0, 14.0, 101)
    found = pm.range_profile(scene, edges, spp=2**20, seed=2)
    is_ghost = found["range"].values > 11.1
    (a, normal_a, areas_a), (b, normal_b, areas_b) = (nodes(half, pose, 12) for pose in poses)
    # from the transmitter to b, to a, to the receiver; and once more the other way round
    between = a[:, None] - b
    apart = np.linalg.norm(between, axis=-1)
    cosines = -(between @ normal_a) * (between @ normal_b) / apart**2
    transfer = (REFLECTANCE / math.pi) ** 2 * cosines / apart**2
    pairs = WAVELENGTH**2 * np.outer(
        areas_a * lit(SQUARE, a, normal_a), areas_b * lit(SQUARE, b, normal_b)
    )
    power = 2 * pairs * transfer
    ranges = (np.linalg.norm(a, axis=1)[:, None] + apart + np.linalg.norm(b, axis=1)) / 2
    single = math.hypot(aside, depth)
    assert abs(np.average(ranges, weights=power) - (single + aside)) < 0.2
    ghost = np.where(is_ghost, found["power"].values, 0.0)
    error = math.hypot(*found["standard_error"].values[is_ghost])
    assert abs(ghost.sum() - power.sum()) < SIGMAS * error
    mean = np.average(found["range"].values, weights=ghost)
    assert abs(mean - np.average(ranges, weights=power)) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["wigner", "exact"])
def test_paths_end_at_places_of_the_receiver_not_at_its_middle(estimator):
    """Of what stands before one end of a receiver that is wide and aside of its own origin."""
    wide, wavelength, end, z = pw.shapes.rectangle(1.0, 0.05).moved([1.25, 0.0]), 0.02, 0.85, 2.0
    scene = scene_of(
        tx=pm.aperture(
            SQUARE, wavelength, power=1.0, estimator="exact", to_world=at(end, 0.0, 0.0)
        ),
        rx=pm.receiver(wide, wavelength, estimator=estimator),
        plate=plate(0.05, at(end, z)),
    )
    found = pm.range_profile(scene, np.linspace(1.9, 2.3, 201), spp=2**18, seed=1)
    power = found["power"].values
    # signed rays come from where waves come from; exact weights are those of all places alike
    assert math.hypot(z, 1.25 - end) - z > 0.038  # what the middle would make of it
    if estimator == "wigner":
        assert abs(np.average(found["range"].values, weights=power) - z) < 0.006
    else:
        seen = found["range"].values[power > 0]
        farthest = (z + math.hypot(z, 1.75 - end)) / 2
        assert abs(seen.min() - z) < 0.006 and abs(seen.max() - farthest) < 0.02


@pytest.mark.slow
def test_fog_spreads_over_its_depth():
    fog = {"type": "homogeneous", "albedo": 0.9, "sigma_t": 0.05}
    cube = {"type": "cube", "bsdf": {"type": "null"}, "interior": fog}
    cube["to_world"] = mi.ScalarTransform4f().translate([0.0, 0.0, 15.0]).scale([20.0, 20.0, 5.0])
    scene = scene_of(
        tx=emitter(), rx=receiver(LARGE, estimator="wigner"), fog=cube,
        integrator={"type": "volpath", "max_depth": 2},
    )  # fmt: skip
    edges = np.linspace(10.0, 20.0, 6)
    found = pm.range_profile(scene, edges, spp=2**17, seed=1)
    power, error = found["power"].values, found["standard_error"].values
    # one scattering: exp(-2 sigma (r - 10))/r^2 dr, for the receiver's beam is narrow
    r = np.linspace(10.0, 20.0, 5001)
    density = np.exp(-0.1 * (r - 10.0)) / r**2
    shape = np.add.reduceat(density[:-1], np.arange(0, 5000, 1000))
    scale = power.sum() / shape.sum()
    assert np.all(np.abs(power - scale * shape) < SIGMAS * error)
    assert float(found["before"].values) == 0.0
