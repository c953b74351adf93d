"""Interfering paths against couplings, Fresnel's formulas, image sources and reciprocity."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import (
    BLACK,
    HANDED,
    METAL,
    SQUARE,
    WAVELENGTH,
    coupled,
    emitter,
    looking,
    receiver,
    rectangle,
    scene_of,
)
from polywigner.errors import ArgumentError, PolywignerError, SceneError

pytestmark = [pytest.mark.drjit, pytest.mark.usefixtures("few_rays")]
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

FREQUENCY = 94e9
# A source of a hundredth of a wavelength is isotropic with "rayleigh-sommerfeld-2".
DOT = pw.shapes.square(0.01 * WAVELENGTH)
ALL_SIDES: dict[str, Any] = {"obliquity": "rayleigh-sommerfeld-2"}

# Rounding error in double precision for phases of 1e5 cycles.
ROUNDING = 1e-9
# Rounding error of Mitsuba's transmission and reflectances, which are in single precision.
SINGLE = 1e-6
# Phase error due to poses in single precision at 2 m [rad].
PLACES = 3e-4
# Error of an average over 1024 rays between evenly distributed points of both apertures.
RAYS = 0.01
# Tolerance of couplings and of their interpolation over a band.
BAND = 3e-6

SLOW = pytest.mark.slow


@pytest.fixture
def stokes() -> None:
    mi.set_variant("scalar_spectral_polarized")


def floor(size: float = 10.0, **bsdf: Any) -> dict[str, Any]:
    """Return a square in z = 0 with its normal upwards."""
    return rectangle((0, 0, 0), (1, 0, 0), 0, size, bsdf or METAL)


def flipped(source: Any = HANDED) -> Any:
    """Return u(x, -y)."""
    field = source.illumination
    outline = pw.Aperture([ring * [1, -1] for ring in source.rings])
    waves = pw.Illumination(field.amplitudes, field.frequencies * [1, -1])
    return outline.with_illumination(waves)


def below(pose: np.ndarray) -> np.ndarray:
    """Return the pose of the flipped source, mirrored at z = 0."""
    return np.diag([1.0, 1.0, -1.0, 1.0]) @ pose @ np.diag([1.0, -1.0, 1.0, 1.0])


def path_amplitude(result: Any, *mirrors: str) -> complex:
    """Return the amplitude of a path of the first pair of ends, or zero without the path."""
    here = result["mirrors"].values == ", ".join(mirrors)
    return complex(result["amplitude"].values[0, 0, 0, here].sum())


def chains_of(result: Any) -> list[list[str]]:
    """Return the names of the mirrors of each path."""
    return [names.split(", ") if names else [] for names in result["mirrors"].values]


ONE, OTHER = looking((0, 0, 0.5), (1, 0, 0)), looking((2, 0, 0.5), (-1, 0, 0))


@pytest.mark.parametrize("distance", [1.0, pytest.param(100.0, marks=SLOW)])
@pytest.mark.parametrize(("polarisation", "metal"), [("y", 1.0), ("x", -1.0)])
def test_two_rays_over_metal_are_two_couplings(
    plain: None, distance: float, polarisation: str, metal: float
) -> None:
    """Reflection changes the sign of E across the plane of incidence."""
    one, other = looking((0, 0, 0.75), (1, 0, 0)), looking((distance, 0, 0.5), (-1, 0, 0))
    scene = scene_of(tx=emitter(HANDED, one), rx=receiver(SQUARE, other), floor=floor(2 * distance))
    result = pm.channel(scene, polarisation=polarisation)
    direct = coupled(HANDED, one, SQUARE, other)
    image = coupled(flipped(), below(one), SQUARE, other)
    facing = {"x": -1.0, "y": 1.0}[polarisation]
    assert complex(result.h[0, 0, 0]) == pytest.approx(
        facing * (direct + metal * image), rel=ROUNDING
    )
    lengths = np.hypot(distance, [0.25, 1.25])
    middles = result.delay.values[0, 0] * pw.SPEED_OF_LIGHT
    assert middles == pytest.approx(lengths, abs=2 * HANDED.diameter)


BREWSTER = math.atan(1.5)
GLASS = {"int_ior": 1.5, "ext_ior": 1.0}
CONDUCTOR = {"type": "conductor", "eta": 2.25, "k": 0.75}
GREY = {**CONDUCTOR, "specular_reflectance": 0.25}


@pytest.mark.parametrize(
    ("bsdf", "permittivity", "share", "angle"),
    [
        pytest.param({"type": "dielectric", **GLASS}, 2.25, 1.0, BREWSTER, marks=SLOW),
        pytest.param({"type": "plastic", **GLASS}, 2.25, 1.0, 1.4, marks=SLOW),
        (CONDUCTOR, (2.25 + 0.75j) ** 2, 1.0, 1.4),
        pytest.param(GREY, (2.25 + 0.75j) ** 2, 0.5, 1.0, marks=SLOW),
    ],
)
def test_a_floor_reflects_both_polarisations_as_fresnel_says(
    plain: None, bsdf: dict[str, Any], permittivity: complex, share: float, angle: float
) -> None:
    """Emitter and receiver point at the point of reflection, 1 m away."""
    cosine, sine = np.cos(angle), np.sin(angle)
    one = looking((-sine, 0, cosine), (sine, 0, -cosine))
    other = looking((sine, 0, cosine), (-sine, 0, -cosine))
    straight = coupled(SQUARE, ONE, SQUARE, OTHER)
    root = np.sqrt(permittivity - sine**2)
    across = (cosine - root) / (cosine + root)
    along = (permittivity * cosine - root) / (permittivity * cosine + root)
    scene = scene_of(tx=emitter(pose=one), rx=receiver(pose=other), floor=floor(**bsdf))
    for polarisation, expected in (("x", -across), ("y", along)):
        result = path_amplitude(pm.channel(scene, polarisation=polarisation), "floor")
        assert abs(result / straight) == pytest.approx(abs(share * expected), abs=SINGLE)
        assert result / straight == pytest.approx(share * expected, abs=PLACES)


def test_metal_turns_a_right_handed_wave_into_a_left_handed_one(stokes: None) -> None:
    """Reflection at metal reverses the handedness."""
    up = (1, 0, 0)
    one, other = looking((0, -0.05, 2), (0, 0, -1), up), looking((0, 0.05, 2), (0, 0, -1), up)
    ends = {"back": other, "facing": looking((0, -0.05, 0.5), (0, 0, 1), up)}
    receivers = {
        f"{taken} {name}": receiver(pose=pose, polarisation=taken)
        for taken in ("right", "left")
        for name, pose in ends.items()
    }
    scene = scene_of(tx=emitter(pose=one), floor=floor(), **receivers)
    result = np.abs(pm.channel(scene, polarisation="right").amplitude)
    size = {name: float(result.sel(receiver=name).max()) for name in receivers}
    assert size["right back"] < 0.01 * size["left back"]  # 3 degrees from the normal
    assert size["left facing"] < 1e-9 * size["right facing"]


def corner(**bsdf: Any) -> dict[str, Any]:
    """Return three walls in the coordinate planes, with normals towards positive coordinates."""
    turns = {"x": ((0, 1, 0), 90), "y": ((1, 0, 0), -90), "z": ((1, 0, 0), 0)}
    return {k: rectangle((0, 0, 0), *turn, 5.0, bsdf or METAL) for k, turn in turns.items()}


@SLOW
def test_a_corner_of_three_mirrors_returns_the_source_turned_inside_out(plain: None) -> None:
    """Three reflections at right angles preserve E."""
    place = np.array([1.1, 0.9, 1.3])
    one = looking(place, -place)
    other = looking(np.add(place, (0.02, -0.03, 0.01)), -place)
    scene = scene_of(tx=emitter(HANDED, one), rx=receiver(SQUARE, other), **corner())
    result = pm.channel(scene, reflections=3, polarisation=ELLIPTIC)
    total = sum(path_amplitude(result, *chain) for chain in chains_of(result) if len(chain) == 3)
    image = np.diag([-1.0, -1.0, -1.0, 1.0]) @ one @ np.diag([1.0, -1.0, 1.0, 1.0])
    b = coupled(flipped(), image, SQUARE, other)
    # Both ends point at the corner, so the polarisation factor is e.e, without a conjugate.
    expected = b * complex(np.sum(np.square(ELLIPTIC)) / np.vdot(ELLIPTIC, ELLIPTIC))
    assert total == pytest.approx(expected, rel=0.01, abs=0.01 * abs(b))


ELLIPTIC = np.array([1.0, 0.3 - 0.8j])


def between_glass_and_metal(is_back: bool = False, polarisation: Any = None) -> Any:
    """Return handed sources in general poses, over a floor of glass and next to a metal wall."""
    one = HANDED, looking((0.1, 0.2, 0.5), (1, 0.1, -0.2), (0.2, 0, 1))
    other = SQUARE, looking((1.5, 0.4, 0.7), (-1, 0.2, -0.1), (0, 0.3, 1))
    sent, taken = (other, one) if is_back else (one, other)
    metal = {"type": "twosided", "b": CONDUCTOR}
    return scene_of(
        tx=emitter(*sent, polarisation=polarisation),
        rx=receiver(*taken, polarisation=polarisation),
        floor=floor(type="dielectric", int_ior=2.0),
        wall=rectangle((0.8, -0.5, 0.0), (1, 0, 0), -90, 5.0, metal),
    )


@SLOW
def test_exchange_of_both_ends_changes_nothing(plain: None) -> None:
    scenes = between_glass_and_metal(), between_glass_and_metal(is_back=True)
    result = [pm.channel(scene, [FREQUENCY], polarisation=ELLIPTIC) for scene in scenes]
    assert len(result[0]["path"]) == 4
    assert complex(result[0].h[0, 0, 0]) == pytest.approx(complex(result[1].h[0, 0, 0]), rel=1e-6)
    for chain in chains_of(result[0]):
        assert path_amplitude(result[0], *chain) == pytest.approx(
            path_amplitude(result[1], *chain[::-1]), rel=1e-6
        )


@SLOW
def test_sources_in_polarised_variants_have_the_channel_of_the_others(plain: None) -> None:
    """The Mueller matrices of two mirrors do not commute."""
    expected = pm.channel(between_glass_and_metal(), [FREQUENCY], polarisation=ELLIPTIC)
    mi.set_variant("scalar_spectral_polarized")
    result = pm.channel(between_glass_and_metal(polarisation=ELLIPTIC), [FREQUENCY])
    assert len(result["path"]) == 4
    for chain in chains_of(result):
        assert path_amplitude(result, *chain) == pytest.approx(
            path_amplitude(expected, *chain), rel=SINGLE
        )


def screen(x: float, low: float, high: float, **bsdf: Any) -> dict[str, Any]:
    """Return a screen across the line of sight between two heights."""
    to_world = (
        mi.ScalarTransform4f()
        .translate([x, 0, (low + high) / 2])
        .rotate([0, 1, 0], 90)
        .scale([(high - low) / 2, 5.0, 1.0])
    )
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf or BLACK}


def test_a_wall_in_the_line_of_sight_leaves_the_path_by_the_floor(plain: None) -> None:
    scene = between(ONE, OTHER, floor=floor(), wall=screen(1.0, 0.3, 2.0))
    result = pm.channel(scene)
    assert result["mirrors"].values.tolist() == ["floor"]
    assert complex(result.h[0, 0, 0]) == path_amplitude(result, "floor") != 0
    assert any("obstacles block it" in note for note in result.attrs["notes"])


def test_half_of_an_aperture_behind_a_plate_sends_half_of_the_amplitude(
    plain: None, many_rays: None
) -> None:
    """Half of the amplitude is a quarter of the power, in contrast to half of the rays."""
    scene = between(ONE, OTHER, plate=screen(4e-3, 0.0, 0.5))
    half = SQUARE & pw.shapes.rectangle(20e-3, 10e-3).moved((0.0, 5e-3))
    share = pw.radiated_power(half, WAVELENGTH) / pw.radiated_power(SQUARE, WAVELENGTH)
    expected = coupled(half, ONE, SQUARE, OTHER) * math.sqrt(share)
    assert complex(pm.channel(scene).h[0, 0, 0]) == pytest.approx(expected, rel=RAYS)


@SLOW
def test_fog_and_veils_take_the_root_of_their_share(plain: None) -> None:
    slab = {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().translate([1.0, 0, 0.5]).scale([0.2, 1, 1]),
        "bsdf": {"type": "null"},
        "interior": {"type": "homogeneous", "sigma_t": 2.0, "albedo": 0.5},
    }
    veil = screen(0.5, 0.0, 1.0, type="mask", opacity=0.36, b=BLACK)
    scene = between(ONE, OTHER, slab=slab, veil=veil)
    whole = coupled(SQUARE, ONE, SQUARE, OTHER)
    expected = whole * math.exp(-0.5 * 2.0 * 0.4) * 0.8
    assert complex(pm.channel(scene).h[0, 0, 0]) == pytest.approx(expected, rel=1e-3)


def test_over_a_knife_edge_half_of_the_amplitude_arrives_with_its_phase(plain: None) -> None:
    scene = scene_of(
        tx=emitter(DOT, ONE, **ALL_SIDES, estimator="exact", diffraction=True),
        rx=receiver(DOT, OTHER, **ALL_SIDES),
        knife=screen(1.0, -4.5, 0.5),
    )
    whole = coupled(DOT, ONE, DOT, OTHER, method=ALL_SIDES["obliquity"])
    result = complex(pm.channel(scene).h[0, 0, 0])
    # The other edges of the screen, 5 m away, contribute some per cent.
    assert result == pytest.approx(whole / 2, rel=0.05)


def test_a_path_via_two_mirrors_of_a_corner_passes_their_edges(plain: None) -> None:
    one, other = looking((0.5, 0, 1.5), (-0.5, 0, -1.5)), looking((1.0, 0, 0.4), (-1.0, 0, -0.4))
    walls = {"floor": floor(20.0), "wall": rectangle((0, 0, 0), (0, 1, 0), 90, 20.0, METAL)}
    results = []
    for diffraction in (False, True):
        end = emitter(DOT, one, **ALL_SIDES, estimator="exact", diffraction=diffraction)
        scene = scene_of(tx=end, rx=receiver(DOT, other, **ALL_SIDES), **walls)
        results.append(pm.channel(scene, reflections=2))
    chains = [chains_of(result) for result in results]
    assert chains[0] == chains[1] and [len(chain) for chain in chains[0]] == [0, 1, 1, 2]
    for chain in chains[0]:
        without, with_edges = (path_amplitude(result, *chain) for result in results)
        assert with_edges == pytest.approx(without, rel=0.02)


def test_in_a_band_each_frequency_is_a_channel_of_its_own(plain: None) -> None:
    scene = scene_of(tx=emitter(HANDED, ONE), rx=receiver(pose=OTHER), floor=floor())
    band = np.linspace(90e9, 98e9, 101)
    result = pm.channel(scene, band)
    assert result.h.dims == ("frequency", "receiver", "emitter")
    some = [0, 33, 77]
    alone = pm.channel(scene, band[some])  # too few frequencies for a polynomial
    assert result.h.values[some] == pytest.approx(alone.h.values, rel=BAND)
    for number in range(2):
        delay = result.delay.values[0, 0, number]
        rest = result.amplitude.values[:, 0, 0, number] * np.exp(-2j * np.pi * band * delay)
        turns = np.unwrap(np.angle(rest)) / (2 * np.pi)
        late = (turns[-1] - turns[0]) / (band[-1] - band[0]) * pw.SPEED_OF_LIGHT
        assert abs(late) < HANDED.diameter


@pytest.mark.parametrize("normalise", ["radiated", pytest.param("aperture", marks=SLOW)])
def test_coherent_power_is_the_square_of_the_sum_of_all_paths(plain: None, normalise: str) -> None:
    """The receiver measures radiated power, or power in its aperture."""
    rx = receiver(pose=OTHER, normalise=normalise)
    scene = scene_of(tx=emitter(HANDED, ONE), rx=rx, floor=floor())
    result = pm.received_power(scene, spp=16, coherent=True)
    expected = abs(complex(pm.channel(scene, "94 GHz").h[0, 0, 0])) ** 2
    if normalise == "aperture":
        share = pw.radiated_power(SQUARE, WAVELENGTH) / SQUARE.area
        radiated = scene_of(tx=emitter(HANDED, ONE), rx=receiver(pose=OTHER), floor=floor())
        assert abs(pm.channel(radiated).h.item()) ** 2 * share == pytest.approx(
            expected, rel=SINGLE
        )
    assert result.direct == pytest.approx(expected, rel=SINGLE)
    paths = result.contributions[0].paths
    assert abs(sum(path.amplitude for path in paths)) ** 2 == pytest.approx(expected)
    assert abs(pm.received_power(scene, spp=16).direct / expected - 1) > 0.01


def test_elements_of_two_polarisations_reach_a_receiver_by_its_own(stokes: None) -> None:
    pair = pw.Array([SQUARE.moved((-6e-3, 0)), SQUARE.moved((6e-3, 0))], [1.0, 1.0j])
    scene = scene_of(tx=emitter(pair, ONE, polarisation=["x", "y"]), rx=receiver(pose=OTHER))
    result = complex(pm.channel(scene).h[0, 0, 0])
    expected = 1.0j * coupled(pair.elements[1], ONE, SQUARE, OTHER) / math.sqrt(2)
    # Each end is 0.2 degrees off the axis of the other end.
    assert result == pytest.approx(expected, rel=1e-4)


def test_several_ends_have_a_row_and_a_column_each_in_metres_and_millimetres(plain: None) -> None:
    scene = scene_of(
        a=emitter(pose=ONE),
        b=emitter(pose=looking((0, 0, 0.6), (1, 0, 0))),
        rx=receiver(pose=OTHER),
        back=receiver(pose=looking((2, 0, 0.5), (1, 0, 0))),
        floor=floor(),
    )
    result = pm.channel(scene)
    assert result.h.shape == (1, 2, 2)
    assert result.h.sel(receiver="back").values.tolist() == [[0, 0]]
    assert np.isnan(result.delay.sel(receiver="back").values).all()
    in_mm = np.diag([1e3, 1e3, 1e3, 1.0])
    ends = [in_mm @ pose @ np.linalg.inv(in_mm) for pose in (ONE, OTHER)]
    alone = scene_of(
        tx=emitter(pose=ends[0], scene_unit=1e-3),
        rx=receiver(pose=ends[1], scene_unit=1e-3),
        floor=floor(1e4),
    )
    expected = pm.channel(alone).h.item()
    assert result.h.sel(receiver="rx", emitter="a").item() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *(({"frequencies": value}, "expected") for value in ([], [[94e9]], "fast")),
        ({"reflections": 4}, "expected reflections"),
        ({"polarisation": [1.0, 0.0, 0.0]}, "expected"),
        ({"tolerance": 0.0}, "expected tolerance"),
        ({"bodies": [SQUARE]}, "expected bodies to be a dict"),
        ({"bodies": {"floor": SQUARE}}, "the name 'floor' belongs to a body and to a mirror"),
        ({"bodies": {"a": 3}}, "the body 'a'"),
        ({"bodies": {"a": (SQUARE, 4)}}, "the body 'a'.*reflections"),
    ],
)
def test_an_argument_out_of_range_is_refused(
    plain: None, options: dict[str, Any], message: str
) -> None:
    scene = scene_of(tx=emitter(pose=ONE), rx=receiver(pose=OTHER), floor=floor())
    with pytest.raises(PolywignerError, match=message):
        pm.channel(scene, **options)
    for name in {"polarisation", "bodies"} & set(options):
        with pytest.raises(ArgumentError, match=f"{name}= requires coherent=True"):
            pm.received_power(scene, **options)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tx": None}, "no wigner emitter"),
        ({"rx": {"obliquity": "kirchhoff"}}, "obliquity must be the same"),
        ({"tx": {"bandwidth": 1e9}}, "coherent light"),
        (
            {"floor": {"type": "blendbsdf", "weight": 0.5, "a": METAL, "b": BLACK}},
            "reflection has no phase",
        ),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_scene_without_a_channel_is_refused(
    plain: None, change: dict[str, Any], message: str
) -> None:
    parts = {
        name: make(pose=pose, **(change.get(name) or {}))
        for name, make, pose in (("tx", emitter, ONE), ("rx", receiver, OTHER))
        if change.get(name, {}) is not None
    }
    if "floor" in change:
        parts["floor"] = floor(**change["floor"])
    with pytest.raises(SceneError, match=message):
        pm.channel(scene_of(**parts))


# Relative error due to fields on pieces of a body, and due to edges in physical optics.
PIECES = 3e-3
# Poses of apertures on several sides that point at the origin.
ASKANCE = looking((-0.5, 0, 0.6), (0.5, 0, -0.6)), looking((0.5, 0, 0.6), (-0.5, 0, -0.6))


def plate(side: float, pose: np.ndarray | None = None) -> Any:
    return pw.shapes.square(side).placed(np.eye(4) if pose is None else pose)


def trihedral(side: float) -> list[Any]:
    """Return three triangles that form a right-angled corner at the origin."""
    face = pw.Aperture([(0, 0), (side, 0), (0, side)])
    poses = [np.eye(4) for _ in range(3)]
    for k, pose in enumerate(poses):
        pose[:3, :3] = np.roll(np.eye(3), k, axis=1)
    return [face.placed(pose) for pose in poses]


def between(one: np.ndarray, other: np.ndarray, **parts: Any) -> Any:
    return scene_of(tx=emitter(SQUARE, one), rx=receiver(SQUARE, other), **parts)


@pytest.mark.parametrize("polarisation", [pytest.param("x", marks=SLOW), "y"])
def test_a_wide_plate_is_a_mirror_with_its_phase(plain: None, polarisation: str) -> None:
    echo = pm.channel(between(*ASKANCE), polarisation=polarisation, bodies={"plate": plate(0.6)})
    mirror = pm.channel(between(*ASKANCE, floor=floor()), polarisation=polarisation)
    assert path_amplitude(echo, "plate") == pytest.approx(
        path_amplitude(mirror, "floor"), rel=PIECES
    )
    assert echo.delay.values == pytest.approx(mirror.delay.values)


def test_the_echo_of_a_body_in_the_way_is_its_shadow(plain: None) -> None:
    """The line of sight and the echo add up to the field behind the edges of an obstacle."""
    side, shift = 0.1, 0.02
    pose = looking((1.0, shift, 0.5), (1, 0, 0))
    result = pm.channel(between(ONE, OTHER), bodies={"plate": plate(side, pose)})
    shade = rectangle(pose[:3, 3], (0, 1, 0), 90, side / 2, BLACK)
    sent = emitter(SQUARE, ONE, estimator="exact", diffraction=True)
    edges = pm.channel(scene_of(tx=sent, rx=receiver(SQUARE, OTHER), shade=shade))
    difference = complex(result.h[0, 0, 0] - edges.h[0, 0, 0])
    assert abs(difference) < PIECES * abs(path_amplitude(result))


def test_a_corner_reflector_far_away_obeys_the_radar_equation(plain: None) -> None:
    """The difference is below 0.02 dB. Notes report near bodies and single reflections."""
    body, towards = trihedral(10 * WAVELENGTH), np.ones(3) / math.sqrt(3)
    pose = looking(20.0 * towards, -towards)
    result = pm.channel(between(pose, pose), bodies={"corner": (body, 3)})
    sigma = pw.rcs(body, towards, WAVELENGTH, bounces=3)
    pattern = pw.radiation_pattern(SQUARE, WAVELENGTH, [0.0, 0.1], [0.0])
    gain = 10 ** (pattern.attrs["peak_directivity"] / 10)
    distance = 20.0 - math.sqrt(3) * 5 * WAVELENGTH
    expected = gain**2 * WAVELENGTH**2 * sigma / ((4 * math.pi) ** 3 * distance**4)
    assert 20 * math.log10(abs(path_amplitude(result, "corner"))) == pytest.approx(
        10 * math.log10(expected), abs=0.02
    )
    assert "corner" not in "".join(result.attrs["notes"])
    near = looking(0.3 * towards, -towards)
    notes = pm.channel(between(near, near), bodies={"corner": (body, 3)}).attrs["notes"]
    assert any("'corner' is closer than 2 D^2/lambda" in note for note in notes)
    notes = pm.channel(between(pose, pose), bodies={"corner": body}).attrs["notes"]
    assert any("higher-order reflections between them are not included" in note for note in notes)


def test_echoes_by_the_floor_are_those_of_images(plain: None) -> None:
    body = {"plate": plate(0.02, looking((2.0, 0.05, 0.4), (-1, 0, 0)))}
    one, other = ONE, looking((0, 0.3, 0.7), (1, 0, 0))
    result = pm.channel(
        scene_of(tx=emitter(HANDED, one), rx=receiver(SQUARE, other), floor=floor()), bodies=body
    )
    image = scene_of(tx=emitter(flipped(), below(one)), rx=receiver(SQUARE, other))
    assert path_amplitude(result, "floor", "plate") == pytest.approx(
        path_amplitude(pm.channel(image, bodies=body), "plate"), rel=ROUNDING
    )
    image = scene_of(tx=emitter(HANDED, one), rx=receiver(SQUARE, below(other)))
    assert path_amplitude(result, "plate", "floor") == pytest.approx(
        path_amplitude(pm.channel(image, bodies=body), "plate"), rel=ROUNDING
    )
    assert path_amplitude(result, "floor", "plate", "floor") != 0


def test_echoes_over_a_band_are_those_of_each_frequency(plain: None) -> None:
    body = {"plate": plate(0.03, looking((3.0, 0.1, 0.5), (-1, 0, 0)))}
    band = np.linspace(93e9, 95e9, 21)
    result = pm.channel(between(ONE, ONE), band, bodies=body).h[:, 0, 0].values
    each = [pm.channel(between(ONE, ONE), f, bodies=body).h.values.item() for f in band[::10]]
    assert np.abs(result[::10] - each).max() < PIECES * np.abs(each).max()
    power = pm.received_power(between(ONE, ONE), 16, coherent=True, bodies=body)  # for 1 W
    assert float(power) == pytest.approx(abs(result[10]) ** 2, rel=2 * PIECES)
    (path,) = power.contributions[0].paths
    assert path.mirrors == ("plate",) and path.arrives_from == pytest.approx((0.1 / 3, 0), rel=1e-2)


def test_what_stands_before_a_body_takes_its_share(plain: None, many_rays: None) -> None:
    body = {"plate": plate(0.05, looking((2.0, 0.0, 0.5), (-1, 0, 0)))}
    free = pm.channel(between(ONE, ONE), bodies=body)
    half = pm.channel(between(ONE, ONE, screen=screen(1.0, 0.5, 1.0)), bodies=body)
    assert abs(path_amplitude(half, "plate") / path_amplitude(free, "plate")) == pytest.approx(
        0.25, abs=RAYS
    )
    assert any("%" in note for note in half.attrs["notes"])
    none = pm.channel(between(ONE, ONE, screen=screen(1.0, -4.0, 5.0)), bodies=body)
    assert len(none["path"]) == 0 and any("'plate'" in note for note in none.attrs["notes"])
    behind = pm.channel(between(ONE, ONE), bodies={"plate": plate(0.05)})
    assert any("or behind it" in note for note in behind.attrs["notes"])
