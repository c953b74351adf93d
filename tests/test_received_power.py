"""Received power against couplings, image sources, and quadrature over a floor."""

import json
import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import (
    HANDED,
    MIRROR,
    SQUARE,
    WAVELENGTH,
    emitter,
    facing,
    receiver,
    rectangle,
    scene_of,
    shifted,
)
from mitsuba_scenes import coupled as amplitude_between
from polywigner.errors import ArgumentError, QuantityError, SceneError

pytestmark = [pytest.mark.drjit, pytest.mark.usefixtures("few_rays")]
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

# Relative error of the poses of a scene, which are in single precision.
SINGLE = 2e-6
# Relative error of 1024 rays between evenly distributed points of both apertures.
RAYS = 0.02


def turned(angle, pose):
    """Return a pose rotated about its y axis."""
    c, s = math.cos(angle), math.sin(angle)
    turn = np.eye(4)
    turn[0, 0], turn[0, 2], turn[2, 0], turn[2, 2] = c, s, -s, c
    return pose @ turn


def plate(x, y, z, axis, angle, **bsdf):
    """Return a plate of 2 m x 2 m."""
    return rectangle((x, y, z), axis, angle, bsdf=bsdf)


def power_of(spp=16, seed=0, **parts):
    return pm.received_power(scene_of(**parts), spp=spp, seed=seed)


def coupled(one, pose, other, other_pose):
    """Return |b|^2 of two placed sources."""
    return abs(amplitude_between(one, pose, other, other_pose, WAVELENGTH)) ** 2


def test_in_empty_space_a_link_is_its_coupling(plain):
    pose = turned(0.3, facing(0.2, x=0.03, y=-0.02))
    result = power_of(tx=emitter(HANDED), rx=receiver(SQUARE, pose))
    assert float(result) == pytest.approx(coupled(HANDED, np.eye(4), SQUARE, pose), rel=SINGLE)
    assert result.scattered == 0 and result.standard_error == 0
    assert result.notes == ()
    (part,) = result.contributions
    assert part.name == "tx" and part.paths[0].mirrors == () and part.paths[0].transmission == 1


def test_partly_coherent_light_of_a_band_is_received_as_the_mean_of_its_waves(plain):
    """The power is the blurred intensity over the emitted power, times the effective area."""
    square, far, band = pw.shapes.square(6e-3), 20.0, 2e9
    partly = square.partially_coherent(12e-3)
    result = power_of(tx=emitter(partly, bandwidth=band), rx=receiver(square, facing(far)))
    how = {"method": "rayleigh-sommerfeld-1", "bandwidth": band}
    density = pw.irradiance(partly, (0.0, 0.0, far), WAVELENGTH, **how)
    density /= pw.radiated_power(partly, WAVELENGTH)
    area = square.area**2 / pw.radiated_power(square, WAVELENGTH)
    assert float(result) == pytest.approx(density * area, rel=1e-3)


def test_a_plate_before_half_of_the_aperture_takes_half_of_the_light(plain, many_rays):
    black = plate(1.0, 0, 2e-3, [0, 0, 1], 0, type="diffuse", reflectance=0.0)
    result = power_of(tx=emitter(), rx=receiver(pose=facing(1.0)), half=black)
    whole = coupled(SQUARE, np.eye(4), SQUARE, facing(1.0))
    assert float(result) == pytest.approx(whole / 2, rel=RAYS)
    assert "passes the obstacles" in result.notes[0]


def test_a_link_without_direct_light_has_a_note(plain):
    wall, behind = {"wall": plate(0, 0, 0.5, [0, 1, 0], 180)}, "in the plane of the other"
    for pose, parts, reason in (
        (facing(1.0), wall, "obstacles block it"),
        (shifted(0.05), {}, behind),
        (shifted(0, 0, 1.0), {}, behind),
    ):
        result = power_of(tx=emitter(), rx=receiver(pose=pose), **parts)
        assert float(result) == 0 and result.dbm is None
        assert reason in result.notes[0] and "none" in str(result)


def test_surfaces_of_sources_and_null_surfaces_are_no_obstacles(plain):
    between = {
        "third": emitter(SQUARE, shifted(0, 0, 0.5)),
        "bound": plate(0, 0, 0.3, [0, 0, 1], 0, type="null"),
        "veil": plate(0, 0, 0.4, [0, 0, 1], 0, type="mask", opacity=0.25, b={"type": "diffuse"}),
    }
    result = power_of(tx=emitter(), rx=receiver(pose=facing(1.0)), **between)
    part = next(part for part in result.contributions if part.name == "tx")
    expected = 0.75 * coupled(SQUARE, np.eye(4), SQUARE, facing(1.0))
    assert part.direct == pytest.approx(expected, rel=SINGLE)


def test_of_a_source_that_reaches_behind_the_other_the_part_in_front_counts(plain):
    # The receiver's plane contains the centre of the emitter; x > 0 is in front.
    pose = turned(math.pi / 2, shifted(0, 0, 0.1))
    result = power_of(tx=emitter(SQUARE), rx=receiver(SQUARE, pose))
    half = SQUARE & pw.shapes.rectangle(10e-3, 10e-3).moved((5e-3, 0))
    least = pose.copy()
    least[0, 3] = -1e-9  # the edge of the emitter is in the receiver's plane
    radiated = [pw.radiated_power(source, WAVELENGTH) for source in (half, SQUARE)]
    expected = coupled(half, np.eye(4), SQUARE, least) * radiated[0] / radiated[1]
    assert float(result) == pytest.approx(expected, rel=1e-3)
    assert "not included" in result.notes[0]


FOG = {"type": "homogeneous", "sigma_t": 2.0, "albedo": 0.5}


def test_fog_takes_its_share_off_direct_light(plain):
    """The transmission follows Beer's law for a slab, and for fog around the sensor."""
    slab = {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().translate([0, 0, 0.5]).scale([1, 1, 0.2]),
        "bsdf": {"type": "null"},
        "interior": FOG,
    }
    whole = coupled(SQUARE, np.eye(4), SQUARE, facing(1.0))
    rx = receiver(pose=facing(1.0), estimator="wigner")
    through = power_of(tx=emitter(), rx=rx, slab=slab)
    assert through.direct == pytest.approx(whole * math.exp(-2.0 * 0.4), rel=1e-3)
    slab["to_world"] = mi.ScalarTransform4f().translate([0, 0, 1.0]).scale([1, 1, 0.5])
    inside = power_of(tx=emitter(), rx={**rx, "medium": FOG}, slab=slab)
    assert inside.direct == pytest.approx(whole * math.exp(-2.0 * 0.5), rel=1e-3)


def test_a_perfect_mirror_shows_the_mirrored_source(plain):
    """The mirror image of the receiver receives the same power."""
    pose = turned(-0.4, facing(1.0, x=0.02, y=0.01))
    result = power_of(
        tx=emitter(HANDED),
        rx=receiver(HANDED, pose),
        m=plate(0.2, 0, 0.5, [0, 1, 0], -90, **MIRROR),
    )
    paths = {path.mirrors: path for path in result.contributions[0].paths}
    field = HANDED.illumination
    flipped = pw.Aperture([ring * [-1, 1] for ring in HANDED.rings]).with_illumination(
        pw.Illumination(field.amplitudes, field.frequencies * [-1, 1])
    )
    across = np.diag([-1.0, 1.0, 1.0, 1.0])
    image = across @ pose @ across  # mirrored at the plane x = 0.2
    image[0, 3] += 0.4
    expected = coupled(HANDED, np.eye(4), flipped, image)
    assert paths["m",].power == pytest.approx(expected, rel=1e-4)  # position of the plate
    assert paths["m",].transmission == pytest.approx(1.0, rel=SINGLE)
    assert result.direct == pytest.approx(paths[()].power + paths["m",].power)


def test_mirrors_are_found_by_their_smooth_plane_faces(plain):
    others = {
        "ball": {"type": "sphere", "center": [0, 5, 0], "bsdf": MIRROR},
        "rough": plate(0, 0, 9, [0, 0, 1], 0, type="roughconductor"),
        "disk": {
            "type": "disk",
            "to_world": mi.ScalarTransform4f().translate([0.3, 0, 0.5]).rotate([0, 1, 0], -90),
            "bsdf": {"type": "twosided", "bsdf": MIRROR},
        },
    }
    scene = scene_of(tx=emitter(), rx=receiver(pose=facing(1.0)), **others)
    result = pm.received_power(scene, spp=16, reflections=1)
    assert {path.mirrors for path in result.contributions[0].paths} == {(), ("disk",)}
    assert any("ball" in note for note in result.notes)
    alone = pm.received_power(scene, spp=16, reflections=0)
    assert len(alone.contributions[0].paths) == 1


def scene_with_floor(**more):
    """Return a scene with a floor 0.1 m below both ends."""
    return scene_of(
        tx=emitter(HANDED, estimator="exact"),
        rx=receiver(SQUARE, facing(0.5)),
        floor=plate(0, -0.1, 0.25, [1, 0, 0], -90),
        **more,
    )


def test_power_over_an_aperture_is_that_in_front_times_the_share_that_is_radiated(plain):
    """Direct and scattered power of the same samples, for receiver and emitter."""
    more = {"obliquity": "kirchhoff"}
    floor = plate(0, -0.1, 0.25, [1, 0, 0], -90)

    def result(options, **of):
        tx = pm.aperture(SQUARE, WAVELENGTH, **of, **more)
        rx = receiver(HANDED, facing(0.5), estimator="wigner", **more, **options)
        return power_of(tx=tx, rx=rx, floor=floor)

    front = result({}, power=1.0)
    energy = pw.lag_marginal(HANDED, (0.0, 0.0)).real
    for other, source, own in (
        (result({"normalise": "aperture"}, power=1.0), HANDED, energy),
        (result({}, aperture_power=1.0), SQUARE, SQUARE.area),
    ):
        share = pw.radiated_power(source, WAVELENGTH, "kirchhoff") / own
        assert share < 0.95
        assert other.direct == pytest.approx(share * front.direct, rel=SINGLE)
        assert other.scattered == pytest.approx(share * front.scattered, rel=SINGLE)


@pytest.mark.slow
def test_the_stated_error_is_that_of_repetitions(plain):
    """The variance over 40 seeds divided by the stated variance has a chi-squared distribution."""
    scene = scene_of(
        tx=emitter(), rx=receiver(estimator="wigner"), floor=plate(0, 0, 0.3, [1, 0, 0], 180)
    )
    result = [pm.received_power(scene, spp=32, seed=seed) for seed in range(40)]
    spread = np.var([each.scattered for each in result], ddof=1)
    stated = np.mean([each.standard_error**2 for each in result])
    # A chi-squared value with 39 degrees of freedom, divided by 39, is between 0.43 and 1.87 in 999
    # of 1000 cases.
    assert 0.43 < spread / stated < 1.87


def test_the_seed_decides_the_scattered_part_alone(plain):
    scene = scene_with_floor()
    one, same, other = (pm.received_power(scene, spp=16, seed=seed) for seed in (1, 1, 2))
    assert one == same
    assert one.scattered != other.scattered and one.direct == other.direct
    assert one.samples == 16 and pm.received_power(scene, spp=17).samples == 32


def state_of(scene):
    sources = [e for e in scene.emitters() if hasattr(e, "spec")]
    places = [np.array(mi.traverse(e.get_shape())["vertex_positions"]).tolist() for e in sources]
    return [*places, *(e.spec for e in sources), *(np.ravel(e.power).tolist() for e in sources)]


def test_the_scene_is_as_before_whatever_ends_the_work(plain):
    scene = scene_with_floor(second=emitter(SQUARE, shifted(0.05)))
    before = state_of(scene)

    def stop(done, total):
        assert 1 <= done <= total == 32
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pm.received_power(scene, spp=16, progress=stop)
    assert state_of(scene) == before


def test_parameters_that_were_changed_count_as_they_are_now(plain):
    scene = scene_of(tx=emitter(), rx=receiver(pose=facing(1.0)))
    params = mi.traverse(scene)
    params["tx.emitter.power"] = 2.0
    params["tx.emitter.to_world"] = mi.Transform4f().translate([0.05, 0, 0])
    params.update()
    expected = 2 * coupled(SQUARE, shifted(0.05), SQUARE, facing(1.0))
    assert float(pm.received_power(scene, spp=16)) == pytest.approx(expected, rel=SINGLE)


def test_noise_is_boltzmanns_constant_times_temperature_bandwidth_and_figure(plain):
    pose = facing(1.0)
    scene = scene_of(tx=emitter(), rx=receiver(pose=pose, temperature=290.0, bandwidth=1.0))
    result = pm.received_power(scene, spp=16)
    assert 10 * math.log10(result.noise_power / 1e-3) == pytest.approx(-173.975, abs=1e-3)
    louder = pm.received_power(scene, spp=16, bandwidth="1 MHz", noise_figure=3.0)
    assert louder.noise_power == pytest.approx(result.noise_power * 1e6 * 10**0.3, abs=0)
    assert louder.snr == pytest.approx(float(louder) / louder.noise_power)
    assert pm.received_power(scene_of(tx=emitter(), rx=receiver(pose=pose)), spp=16).snr is None


def test_a_result_tells_itself_as_text_and_numbers(plain):
    result = power_of(tx=emitter(), rx=receiver(pose=facing(1.0), temperature=290, bandwidth=1e9))
    record = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert record["power_w"] == float(result) and record["power_dbm"] == result.dbm
    assert record["emitters"][0]["paths"][0]["mirrors"] == []
    assert 10 * math.log10(float(result) / 1e-3) == pytest.approx(result.dbm)
    lines = str(result).splitlines()
    assert lines[0].split()[:2] == ["receiver", "rx"] and lines[1].split()[0] == "tx"
    assert "signal-to-noise" in lines[-1]


def test_a_power_below_zero_has_no_decibels():
    part = pm.Contribution("tx", 0.0, -1e-9, 1e-9)
    result = pm.ReceivedPower("rx", WAVELENGTH, (part,), 1e-9, 16, 0, 1.0, 290.0)
    assert result.dbm is None and result.to_dict()["power_dbm"] is None
    assert "below zero" in str(result) and result.snr < 0


def test_several_receivers_are_named_or_all_taken(plain):
    scene = scene_of(tx=emitter(), near=receiver(pose=facing(0.5)), far=receiver(pose=facing(1.0)))
    both = pm.received_powers(scene, spp=16)
    names = [each.receiver for each in both]
    assert sorted(names) == ["far", "near"]
    for number, name in enumerate(names):
        assert pm.received_power(scene, spp=16, receiver=name) == both[number]
        assert pm.received_power(scene, spp=16, receiver=number) == both[number]
    for wrong in (None, 2, -1, "other", True, 0.5):
        with pytest.raises(ArgumentError, match=r"'(near|far)'"):
            pm.received_power(scene, spp=16, receiver=wrong)


def with_other(**changed):
    options: dict[str, Any] = {"wavelength": WAVELENGTH, "to_world": facing(1.0), **changed}
    return lambda: scene_of(tx=emitter(), rx=pm.receiver(SQUARE, **options))


def with_integrator(name):
    ends = {"tx": emitter(), "rx": receiver(pose=facing(1.0))}
    return lambda: scene_of(**ends, integrator={"type": name})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: scene_of(tx=emitter()), "the scene has no receiver"),
        (lambda: scene_of(rx=receiver()), "the scene has no emitters"),
        (
            with_other(wavelength=4e-3),
            "wavelengths of emitter 'tx' and receiver 'rx' must be equal",
        ),
        (with_other(obliquity="kirchhoff"), "obliquity must be the same"),
        (with_other(scene_unit=1e-3, to_world=facing(1e3)), "scene_unit of .* must be equal"),
        *(
            (with_integrator(name), "integrator that computes the radiance along rays")
            for name in ("depth", "ptracer")
        ),
    ],
)
def test_a_scene_without_a_link_is_refused(plain, make, message):
    with pytest.raises(SceneError, match=message) as raised:
        pm.received_power(make(), spp=16)
    assert "\n" not in str(raised.value)


def test_emitters_within_the_bandwidth_are_received_at_their_wavelength(plain):
    frequency = 299_792_458.0 / WAVELENGTH
    scene = with_other(wavelength=299_792_458.0 / (frequency + 0.4e9), bandwidth=1e9)()
    expected = coupled(SQUARE, np.eye(4), SQUARE, facing(1.0))
    assert float(pm.received_power(scene, spp=16)) == pytest.approx(expected, rel=SINGLE)
    with pytest.raises(SceneError, match="within a band of"):
        pm.received_power(scene, spp=16, bandwidth=0.5e9)


@pytest.mark.parametrize(
    "wrong", [{"spp": 0}, {"seed": -1}, {"reflections": 4}, {"temperature": "hot"}], ids=str
)
def test_an_argument_out_of_range_is_refused(plain, wrong):
    scene = scene_of(tx=emitter(), rx=receiver(pose=facing(1.0)))
    with pytest.raises((ArgumentError, QuantityError), match="expected"):
        pm.received_power(scene, **wrong)


@pytest.mark.usefixtures("plain")
@pytest.mark.parametrize(("size", "is_narrow"), [(0.02, True), (1.0, False)])
def test_a_mirror_narrower_than_a_fresnel_zone_is_pointed_out(size, is_narrow):
    mirror = plate(0.5, 0.0, 0.5, [0, 1, 0], -90, **MIRROR)
    mirror["to_world"] = mirror["to_world"].scale(size)
    result = power_of(tx=emitter(), rx=receiver(pose=facing(1.0)), glass=mirror)
    narrow = [note for note in result.notes if "'glass' is narrower than a Fresnel zone" in note]
    assert len(narrow) == is_narrow
