"""Scatterers: their sum against received power, and their paths against geometry."""

import csv
import math

import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import rectangle, shifted, spectrum
from polywigner.errors import ArgumentError, SceneError

pytestmark = pytest.mark.drjit
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

WAVELENGTH = 3.19e-3
SQUARE = pw.shapes.square(3e-3)


@pytest.fixture(autouse=True)
def mono(llvm):
    mi.set_variant("llvm_ad_mono")


# Limit in standard errors, which are known to 18 %.
SIGMAS = 5.0
# Error of positions, which are in single precision, and of rays, which start slightly off surfaces.
SINGLE = 1e-5


def rough(albedo):
    return {"type": "diffuse", "reflectance": spectrum(albedo)}


def plate(place, axis, angle, size, **bsdf):
    """Return a plate with its normal along z, rotated and moved."""
    return rectangle(place, axis, angle, size, bsdf or rough(0.5))


def scene_of(estimator="exact", depth=2, source=SQUARE, **things):
    """Return a scene of a transmitter that points along z and a receiver next to it."""
    entries = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth},
        "tx": pm.aperture(SQUARE, WAVELENGTH, power=1.0, estimator=estimator),
        "rx": pm.receiver(source, WAVELENGTH, to_world=shifted(0.1), estimator=estimator),
    }
    return mi.load_dict(entries | things, optimize=False)


def on_floor(estimator="wigner", **things):
    """Return the scene with a floor ahead."""
    return scene_of(estimator, floor=plate([0, 0, 1.0], [1, 0, 0], 180, 2.0), **things)


def in_corner(depth=3):
    """Return the scene with a floor ahead and a wall next to it."""
    return on_floor(depth=depth, wall=plate([0.5, 0, 0], [0, 1, 0], -90, 2.0, **rough(0.8)))


def path_length(place):
    """Return path lengths from the transmitter via points (n, 3) to the receiver."""
    return np.linalg.norm(place, axis=1) + np.linalg.norm(place - [0.1, 0, 0], axis=1)


def apart(cloud, expected, error=0.0):
    """Return the difference between two powers in standard errors."""
    power = float(cloud["power"].values.sum())
    return abs(power - expected) / math.hypot(cloud.attrs["standard_error"], error)


@pytest.mark.parametrize("estimator", [pytest.param("exact", marks=pytest.mark.slow), "wigner"])
def test_powers_add_up_to_the_received_power(estimator):
    scene = on_floor(estimator)
    result = pm.received_power(scene, spp=128)
    cloud = pm.scatterers(scene, 100, rays=256)
    assert len(cloud["power"].values) == 100
    assert apart(cloud, result.scattered, result.standard_error) < SIGMAS
    assert cloud.attrs["standard_error"] < 0.25 * result.scattered
    if estimator == "exact":
        assert (cloud["power"].values > 0).all()


@pytest.mark.usefixtures("few_batches")
def test_one_seed_gives_one_cloud():
    scene = on_floor()
    first, again, other = (pm.scatterers(scene, 50, seed=s, rays=256) for s in (3, 3, 4))
    for name in first.data_vars:
        assert np.array_equal(first[name].values, again[name].values), name
    assert not np.array_equal(first["power"].values, other["power"].values)


@pytest.mark.usefixtures("few_batches")
def test_places_and_paths_are_those_of_the_geometry():
    cloud = pm.scatterers(on_floor("exact"), 60, rays=128)
    place = cloud["position"].values
    assert np.allclose(place[:, 2], 1.0, atol=SINGLE)
    assert np.allclose(cloud["normal"].values, [0, 0, -1], atol=SINGLE)
    assert set(cloud["shape"].values) == {"floor"} and set(cloud["emitter"].values) == {"tx"}
    assert set(cloud["bounces"].values) == {1}
    # The tolerance allows for the size of both apertures, which are 3 mm wide.
    assert np.abs(cloud["path_length"].values - path_length(place)).max() < 4.3e-3


def test_a_null_surface_is_no_scatterer_and_lets_paths_pass():
    veil = plate([0, 0, 0.4], [1, 0, 0], 180, 3.0, type="null")
    open_cloud = pm.scatterers(on_floor(), 400, rays=128)
    behind = pm.scatterers(on_floor(veil=veil), 400, rays=128)
    assert set(behind["shape"].values) == {"floor"} and set(behind["bounces"].values) == {1}
    power, error = float(open_cloud["power"].values.sum()), open_cloud.attrs["standard_error"]
    assert apart(behind, power, error) < SIGMAS and error < 0.2 * power
    # Equal rays, with new samples of lights at their ends.
    lengths = path_length(behind["position"].values)
    assert np.abs(behind["path_length"].values - lengths).max() < 4.3e-3


@pytest.mark.usefixtures("few_batches")
def test_a_path_of_two_bounces_stands_where_the_receiver_sees_it():
    scene = in_corner()
    cloud = pm.scatterers(scene, 4000, rays=256)
    twice = cloud["bounces"].values == 2
    assert twice.any() and set(np.unique(cloud["bounces"].values)) == {1, 2}
    place = cloud["position"].values
    on_wall = cloud["shape"].values == "wall"
    assert np.allclose(place[on_wall, 0], 0.5, atol=SINGLE)
    straight = path_length(place)
    # A path via a second surface is longer.
    assert (cloud["path_length"].values > straight - 4.3e-3).all()
    assert (cloud["path_length"].values[twice] > straight[twice] + 1e-4).mean() > 0.95


@pytest.mark.usefixtures("few_batches")
def test_the_second_bounce_needs_its_depth():
    scene = in_corner(-1)
    assert set(pm.scatterers(scene, 400, rays=64, max_depth=2)["bounces"].values) == {1}
    assert len(pm.scatterers(scene, 400, rays=64, max_depth=1)["power"].values) == 0
    assert pm.scatterers(scene, 4000, rays=64)["bounces"].values.max() > 3


@pytest.mark.usefixtures("few_batches")
def test_paths_grow_as_geometry_says():
    speeds = {"floor": (1.0, 2.0, 3.0), "tx": (0.5, 0.0, -1.0), "rx": (0.0, -2.0, 0.25)}
    cloud = pm.scatterers(on_floor(), 100, rays=64, velocities=speeds)
    place = cloud["position"].values
    assert np.array_equal(cloud["velocity"].values, np.tile([1.0, 2.0, 3.0], (len(place), 1)))

    def lengths(t):
        y = place + t * np.array(speeds["floor"])
        ends = [t * np.array(speeds["tx"]), [0.1, 0, 0] + t * np.array(speeds["rx"])]
        return sum(np.linalg.norm(y - end, axis=1) for end in ends)

    rate = (lengths(1e-4) - lengths(-1e-4)) / 2e-4
    # Directions have the spread of apertures of 3 mm at 1 m.
    assert np.abs(cloud["path_rate"].values - rate).max() < 3e-3 * 2 * 4


@pytest.mark.usefixtures("few_batches")
def test_a_mirror_that_comes_nearer_shifts_the_path_by_twice_its_speed():
    """Only the mirror moves; the rough floor is behind the receiver."""
    mirror = plate([0, 0, 1.0], [1, 0, 0], 180, 2.0, type="conductor", material="none")
    back = plate([0, 0, -0.5], [1, 0, 0], 0, 2.0)
    lamp = {"type": "point", "position": [0, 0, -0.1], "intensity": spectrum(1.0)}
    scene = scene_of("wigner", 3, mirror=mirror, back=back, lamp=lamp)
    cloud = pm.scatterers(scene, 400, rays=128, velocities={"mirror": (5.0, 7.0, -1.0)})
    by_mirror = (cloud["emitter"].values == "lamp") & (cloud["bounces"].values == 2)
    assert by_mirror.any() and set(cloud["shape"].values[by_mirror]) == {"mirror"}
    # The y and x components of the velocity are along the path, which returns at the angle theta.
    down = cloud["position"].values[by_mirror] - [0.1, 0, 0]
    cosine = down[:, 2] / np.linalg.norm(down, axis=1)
    assert np.allclose(cloud["path_rate"].values[by_mirror], -2 * cosine, atol=0.01)


@pytest.mark.usefixtures("few_batches")
def test_files_hold_the_cloud_and_other_files_and_data_are_refused(tmp_path):
    scene = in_corner()
    cloud = pm.scatterers(scene, 20, rays=64, velocities={"wall": (1, 0, 0)})
    pm.write_scatterers(cloud, tmp_path / "cloud.csv")
    with (tmp_path / "cloud.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 20
    for name in ("power", "path_length", "path_rate"):
        assert [float(row[name]) for row in rows] == cloud[name].values.tolist()
    assert [float(row["position_z"]) for row in rows] == cloud["position"].values[:, 2].tolist()
    assert [row["shape"] for row in rows] == cloud["shape"].values.tolist()

    assert [path.name for path in tmp_path.iterdir()] == ["cloud.csv"]
    with pytest.raises(ArgumentError, match=r"expected a file with the suffix \.csv, \.nc"):
        pm.write_scatterers(cloud, tmp_path / "cloud.ply")
    with pytest.raises(ArgumentError, match=r"the result of .*scatterers"):
        pm.write_scatterers({"power": 1}, tmp_path / "other.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["cloud.csv"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 0}, "count to be a whole number from 1"),
        ({"count": 10, "seed": -1}, "seed to be a whole number"),
        ({"count": 10, "receiver": "nobody"}, "receiver to be one of"),
        (
            {"count": 10, "velocities": {"flor": (1, 0, 0)}},
            "'flor'; the ids are 'floor', 'rx', 'tx'",
        ),
        ({"count": 10, "velocities": {"floor": (1, 0)}}, "three numbers in m/s"),
    ],
)
def test_arguments_out_of_range_are_refused(options, message):
    scene = on_floor()
    with pytest.raises(ArgumentError, match=message):
        pm.scatterers(scene, **options)


@pytest.mark.usefixtures("few_batches")
def test_fog_and_darkness_are_refused_and_emptiness_is_not():
    fog = {"type": "homogeneous", "sigma_t": 0.1}
    box = {"type": "cube", "bsdf": {"type": "null"}, "interior": fog}
    with pytest.raises(SceneError, match="scene with fog"):
        pm.scatterers(scene_of("wigner", box=box), 10)
    dark = mi.load_dict({"type": "scene", "rx": pm.receiver(SQUARE, WAVELENGTH)})
    with pytest.raises(SceneError, match="no emitters"):
        pm.scatterers(dark, 10)
    empty = pm.scatterers(scene_of("wigner"), 10, rays=32)
    assert len(empty["power"].values) == 0 and empty.attrs["standard_error"] == 0
