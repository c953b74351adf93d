"""Range profiles against received power, quadrature over surfaces, and path lengths."""

import importlib.util
import math
import sys

import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import (
    METAL,
    SQUARE,
    WAVELENGTH,
    lit,
    nodes,
    receiver,
    rectangle,
    scene_of,
)
from mitsuba_scenes import emitter as visible_emitter
from polywigner.errors import ArgumentError, EngineError, MissingExtraError, SceneError

# The test does not use importorskip, because importing mitransient requires a variant.
HAS_RADAR = importlib.util.find_spec("mitransient") is not None
pytestmark = [
    pytest.mark.drjit,
    pytest.mark.llvm,
    pytest.mark.skipif(not HAS_RADAR, reason="mitransient is not installed"),
]
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

from polywigner.mitsuba.radar.range_film import require_transients  # noqa: E402

LARGE = pw.shapes.square(100e-3)
REFLECTANCE = 0.5  # Mitsuba's default

# Relative error of Mitsuba's film, which adds some thousand samples per pixel in single precision.
STEADY = 1e-6
# Limit in standard errors, which are known to 18 %.
SIGMAS = 5.0
# Error of the fourth-power law [dB].
LAW = 0.05


@pytest.fixture(autouse=True)
def mono():
    mi.set_variant("llvm_ad_mono")


def emitter(**options):
    return visible_emitter(visible=False, **options)


def at(x, z, turn=180.0):
    """Return a pose at (x, z), rotated about y by degrees; 180 points back along -z."""
    return mi.ScalarTransform4f().translate([x, 0.0, z]).rotate([0, 1, 0], turn)


def plate(half, pose):
    return {"type": "rectangle", "to_world": pose.scale([half, half, 1.0])}


@pytest.mark.usefixtures("few_batches")
def test_a_plate_falls_into_its_bin_and_bins_add_up_to_the_scattered_power():
    scene = scene_of(
        tx=emitter(),
        rx=receiver(estimator="wigner", bandwidth=1e9, temperature=290.0),
        plate=plate(2.0, at(0.0, 37.5)),
        near=plate(0.2, at(0.5, 3.0)),
        far=plate(50.0, at(0.0, 80.0)),
    )
    edges = np.linspace(35.0, 40.0, 11)
    result = pm.range_profile(scene, edges, spp=16384, seed=4)
    steady = pm.received_power(scene, spp=16384, seed=4)
    assert result["power"].dims == ("range",) and result["power"].attrs["units"] == "W"
    np.testing.assert_allclose(result["range"].values, edges[:-1] + 0.25)
    # A bin begins at 37.5 m on the axis; the corners of the plate are 0.1 m farther.
    np.testing.assert_array_equal(np.flatnonzero(result["power"].values), [5])
    assert float(result["before"].values) > 0 and float(result["after"].values) > 0
    total = result["power"].values.sum() + result["before"].values + result["after"].values
    np.testing.assert_allclose(total, steady.scattered, rtol=STEADY)
    np.testing.assert_allclose(result["scattered"].values, total, rtol=1e-12)
    np.testing.assert_allclose(result["scattered_error"].values, steady.standard_error, rtol=1e-4)
    assert float(result["noise_power"].values) == steady.noise_power
    np.testing.assert_allclose(result["resolution"].values, 0.149896229)


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ([1.0], "2 to"),
        ([0.0, 2.0, 1.0], "ascending"),
        ([-1.0, 1.0], "ascending edges"),
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
    with pytest.raises(MissingExtraError, match=r"mitransient.*\[radar\]"):
        pm.range_profile(None, [0.0, 1.0])


def test_what_has_no_path_lengths_is_refused():
    scene = scene_of(tx=emitter(), rx=receiver(), plate=plate(1.0, at(0.0, 5.0)))
    require_transients()
    with pytest.raises(SceneError, match="requires an integrator"):
        pm.range_profile(scene, [0.0, 9.0], integrator="depth", spp=16)
    fog = {"type": "heterogeneous", "albedo": 0.5, "sigma_t": {"type": "gridvolume"}}
    fog["sigma_t"]["grid"] = mi.VolumeGrid(np.ones((2, 2, 2, 1), np.float32))
    cube = {"type": "cube", "bsdf": {"type": "null"}, "interior": fog}
    cube["to_world"] = mi.ScalarTransform4f().translate([0.0, 0.0, 20.0])
    scene = scene_of(tx=emitter(), rx=receiver(), fog=cube)
    with pytest.raises(SceneError, match="homogeneous fog"):
        pm.range_profile(scene, [0.0, 9.0], integrator="volpath", spp=16)
    sky = {"type": "directional", "direction": [0.0, 0.0, 1.0]}
    with pytest.raises(SceneError, match="light at infinity"):
        pm.range_profile(scene_of(tx=emitter(), rx=receiver(), sky=sky), [0.0, 9.0], spp=16)
    mi.set_variant("scalar_rgb")
    with pytest.raises(EngineError, match="scalar_rgb"):
        pm.range_profile(scene, [0.0, 1.0])


@pytest.mark.slow
@pytest.mark.usefixtures("few_batches")
def test_a_small_patch_far_away_sends_what_quadrature_finds():
    half, distance = 0.25, 200.0
    pose = at(0.0, distance)
    scene = scene_of(tx=emitter(estimator="exact"), rx=receiver(LARGE), plate=plate(half, pose))
    # The path has the range of the centre of a bin, because paths in single precision could fall on
    # both sides of an edge.
    result = pm.range_profile(scene, np.arange(0.25, 250.5, 0.5), spp=2**22, seed=1)
    points, normal, areas = nodes(half, pose)
    radiance = REFLECTANCE / math.pi * lit(SQUARE, points, normal)
    expected = WAVELENGTH**2 * np.sum(areas * radiance * lit(LARGE, points, normal))
    power = result["power"].values
    assert result["range"].values[np.argmax(power)] == distance
    assert abs(10 * math.log10(power.max() / expected)) < LAW


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
    result = pm.range_profile(scene, edges, spp=2**20, seed=2)
    is_ghost = result["range"].values > 11.1
    (a, normal_a, areas_a), (b, normal_b, areas_b) = (nodes(half, pose, 12) for pose in poses)
    # The paths lead from the transmitter via both plates to the receiver, in both orders.
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
    ghost = np.where(is_ghost, result["power"].values, 0.0)
    error = math.hypot(*result["standard_error"].values[is_ghost])
    assert abs(ghost.sum() - power.sum()) < SIGMAS * error
    mean = np.average(result["range"].values, weights=ghost)
    assert abs(mean - np.average(ranges, weights=power)) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["wigner", "exact"])
@pytest.mark.usefixtures("few_batches")
def test_paths_end_at_places_of_the_receiver_not_at_its_middle(estimator):
    """An obstacle in front of one end of a wide receiver, away from its origin."""
    wide, wavelength, end, z = pw.shapes.rectangle(1.0, 0.05).moved([1.25, 0.0]), 0.02, 0.85, 2.0
    scene = scene_of(
        tx=pm.aperture(
            SQUARE, wavelength, power=1.0, estimator="exact", to_world=at(end, 0.0, 0.0)
        ),
        rx=pm.receiver(wide, wavelength, estimator=estimator),
        plate=plate(0.05, at(end, z)),
    )
    result = pm.range_profile(scene, np.linspace(1.9, 2.3, 201), spp=2**18, seed=1)
    power = result["power"].values
    # Signed rays start where waves do; exact weights are equal at all points.
    assert math.hypot(z, 1.25 - end) - z > 0.038  # error of paths to the centre
    if estimator == "wigner":
        assert abs(np.average(result["range"].values, weights=power) - z) < 0.006
    else:
        seen = result["range"].values[power > 0]
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
    result = pm.range_profile(scene, edges, spp=2**17, seed=1)
    power, error = result["power"].values, result["standard_error"].values
    # The expected profile is that of single scattering of a narrow beam, exp(-2 sigma (r - 10))/r^2
    # dr.
    r = np.linspace(10.0, 20.0, 5001)
    density = np.exp(-0.1 * (r - 10.0)) / r**2
    shape = np.add.reduceat(density[:-1], np.arange(0, 5000, 1000))
    scale = power.sum() / shape.sum()
    assert np.all(np.abs(power - scale * shape) < SIGMAS * error)
    assert float(result["before"].values) == 0.0


def path_of(result, emitter, mirrors=""):
    """Return range and power of a path of direct light."""
    here = result["emitter"].values == emitter, result["mirrors"].values == mirrors
    ranges, powers = (
        result[name].values[here[0]][:, here[1]].ravel() for name in ("path_range", "path_power")
    )
    return float(ranges[0]), float(powers[0])


def with_echoes(**more):
    """Return a scene of a radar, a metal plate, a white plate, a distant source and a lamp."""
    return scene_of(
        tx=emitter(),
        far=emitter(pose=at(0.3, 50.0)),
        rx=receiver(pose=at(0.1, 0.0, 0.0)),
        mirror={**plate(2.0, at(0.0, 20.0)), "bsdf": METAL},
        white=plate(1.0, at(3.0, 12.0)),
        lamp={"type": "point", "position": [0.0, 0.2, 8.0]},
        **more,
    )


@pytest.mark.usefixtures("few_batches")
def test_direct_light_and_echoes_of_mirrors_fall_into_the_bins_of_their_paths():
    edges = np.arange(0.0, 30.5, 0.5)
    scene = with_echoes()
    result = pm.range_profile(scene, edges, spp=2048, seed=1)
    steady = pm.received_power(scene, spp=2048, seed=1)
    parts = {part.name: part for part in steady.contributions}
    # The metal plate hides the distant source.
    echo, lamp = np.array([0.1, 0.0, 40.0]), np.array([-0.1, 0.2, 8.0])
    behind = np.array([-0.1, 0.2, 32.0])
    cases = [
        ("tx", "mirror", echo, parts["tx"].paths),
        ("other lights", "lamp", lamp, parts["other lights"].paths),
        ("other lights", "lamp, mirror", behind, parts["other lights"].paths),
    ]
    bins = {}
    for name, mirrors, place, paths in cases:
        length, power = path_of(result, name, mirrors)
        assert 2 * length == pytest.approx(np.linalg.norm(place), rel=1e-5)
        assert power > 0.0 and power in [path.power for path in paths]
        bins[int(np.searchsorted(edges, length, side="right")) - 1] = power
    pose = np.diag([-1.0, 1.0, -1.0, 1.0])
    pose[:3, 3] = 0.1, 0.0, 40.0
    expected = abs(complex(pw.coupling(SQUARE, SQUARE, pose, WAVELENGTH))) ** 2
    assert path_of(result, "tx", "mirror")[1] == pytest.approx(expected, rel=1e-4)
    direct = result["direct_power"].values
    np.testing.assert_array_equal(np.flatnonzero(direct), sorted(bins))
    np.testing.assert_allclose([direct[k] for k in sorted(bins)], [bins[k] for k in sorted(bins)])
    # The sums equal the received power, also for each emitter.
    np.testing.assert_allclose(result["direct"].values, steady.direct, rtol=1e-12)
    np.testing.assert_allclose(
        result["power"].values, direct + result["scattered_power"].values, rtol=1e-12
    )
    total = result["power"].values.sum() + float(result["before"] + result["after"])
    np.testing.assert_allclose(total, float(steady), rtol=STEADY)
    for number, name in enumerate(result["emitter"].values):
        own = result["emitter_power"].values[number].sum()
        np.testing.assert_allclose(own, parts[str(name)].power, rtol=1e-4, atol=1e-15)
    assert int(result["power"].values.argmax()) == 8  # the lamp at 4 m


@pytest.mark.usefixtures("few_batches")
def test_a_link_is_at_half_of_its_length():
    """The test uses the line of sight from another source, beyond all bins and within the bins."""
    scene = scene_of(tx=emitter(pose=at(0.3, 9.0)), rx=receiver())
    power = pm.received_power(scene, spp=16).direct
    result = pm.range_profile(scene, [0.0, 4.0, 5.0], spp=16)
    assert result["direct_power"].values == pytest.approx([0.0, power])
    assert path_of(result, "tx")[0] == pytest.approx(math.hypot(0.3, 9.0) / 2, rel=1e-6)
    for edges, name in (([0.0, 2.0, 4.0], "after"), ([5.0, 5.5, 6.0], "before")):
        result = pm.range_profile(scene, edges, spp=16)
        assert float(result[name]) == pytest.approx(power) and not result["power"].values.any()


@pytest.mark.usefixtures("few_batches")
def test_bodies_and_paths_that_interfere_have_a_range():
    body = {"plate": pw.shapes.square(0.1).placed(np.array(at(0.0, 6.0).matrix))}
    scene = scene_of(tx=emitter(), rx=receiver(pose=at(0.05, 0.0, 0.0)))
    result = pm.range_profile(scene, np.arange(0.0, 8.0, 0.5), spp=16, coherent=True, bodies=body)
    steady = pm.received_power(scene, spp=16, coherent=True, bodies=body)
    assert result["mirrors"].values.tolist() == ["plate"]
    assert np.flatnonzero(result["direct_power"].values).tolist() == [12]
    assert result["direct_power"].values[12] == pytest.approx(steady.direct, rel=1e-9)
    with pytest.raises(ArgumentError, match="bodies= requires coherent=True"):
        pm.range_profile(scene, [0.0, 8.0], spp=16, bodies=body)


@pytest.mark.usefixtures("few_batches")
def test_paths_of_one_bin_interfere_and_those_of_two_do_not():
    floor = rectangle((0, -0.2, 4.0), (1, 0, 0), -90, 8.0, METAL)
    scene = scene_of(tx=emitter(pose=at(0.0, 8.0)), rx=receiver(), floor=floor)
    steady = pm.received_power(scene, spp=16, coherent=True)
    paths = steady.contributions[0].paths
    assert len(paths) == 2
    one = pm.range_profile(scene, [3.0, 5.0, 6.0], spp=16, coherent=True)
    assert one["direct_power"].values == pytest.approx([steady.direct, 0.0])
    middle = (paths[0].length + paths[1].length) / 4
    two = pm.range_profile(scene, [3.0, middle, 5.0], spp=16, coherent=True)
    assert two["direct_power"].values == pytest.approx([path.power for path in paths])
