"""Polarised light in scenes: Stokes parameters, Malus, Fresnel, handedness, receivers and links."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import cli_scenes
import mitsuba_scenes
import polywigner as pw
import polywigner.mitsuba as pwm
from cli_scenes import source, written
from mitsuba_scenes import (
    SQUARE,
    WAVELENGTH,
    emitter,
    film,
    receiver,
    scene_of,
    spectrum,
    use,
)
from polywigner.cli import main
from polywigner.errors import ArgumentError, EngineError, SceneError
from polywigner.figures import draw_polarisation, draw_stokes

pytestmark = pytest.mark.drjit

# Rounding error of single precision in direct views. Noise is common to all Stokes parameters of a
# pixel.
ERROR = 1e-3
ROOT = np.sqrt(0.5)
JONES = {"x": (1, 0), "y": (0, 1), "45 deg": (ROOT, ROOT), "right": (ROOT, 1j * ROOT)}
JONES["left"] = (ROOT, -1j * ROOT)
# Stokes parameters S1 to S3. As in Mitsuba, S3 > 0 is left-handed: the field rotates clockwise when
# viewed against the wave.
STOKES = {"x": (1, 0, 0), "y": (-1, 0, 0), "45 deg": (0, 1, 0), "right": (0, 0, -1)}
STOKES["left"] = (0, 0, 1)
PAIR = pw.Array([pw.shapes.square(5e-3).moved((s * 4e-3, 0)) for s in (-1, 1)], [1, 0.5j])


BLACK = {"type": "diffuse", "reflectance": spectrum(0.0)}


def looking(origin: Any, target: Any, up: Any = (0, 1, 0)) -> Any:
    return mi.ScalarTransform4f().look_at(*(list(map(float, v)) for v in (origin, target, up)))


def plane(pose: Any, bsdf: dict[str, Any], half: float = 0.2) -> dict[str, Any]:
    return {"type": "rectangle", "to_world": pose.scale(half), "bsdf": bsdf}


def seen(
    polarisation: Any,
    others: dict[str, Any] | None = None,
    camera: Any = ((0, 0, 1), (0, 0, 0)),
    source: Any = SQUARE,
    half: float = 5e-4,
    size: int = 2,
    spp: int = 4,
    inner: str = "path",
    **more: Any,
) -> np.ndarray:
    """Return the mean Stokes parameters in a camera that views a source directly or by surfaces."""
    sensor = mitsuba_scenes.camera(*camera[:2], size, half, *camera[2:])
    sensor |= {"sampler": {"type": "multijitter"}}
    entry = pwm.aperture(source, WAVELENGTH, bsdf=BLACK, polarisation=polarisation, **more)
    scene = {"type": "scene", "integrator": {"type": inner}, "sensor": sensor, "a": entry}
    image = pwm.render(mi.load_dict(scene | (others or {})), "stokes", spp=spp)
    return pwm.stokes_of(image).mean(axis=(1, 2))


@pytest.mark.parametrize("name", STOKES)
def test_a_source_seen_straight_has_the_stokes_numbers_of_its_name(name: str) -> None:
    use("scalar_spectral_polarized")
    result = seen(name)
    assert result[1:] / result[0] == pytest.approx(STOKES[name], abs=ERROR)
    by_numbers = seen(3.0 * np.array(JONES[name]))
    assert by_numbers == pytest.approx(result, rel=ERROR, abs=ERROR * result[0])


def test_an_unpolarised_source_sends_light_of_the_same_radiance() -> None:
    use("scalar_spectral_polarized")
    plain = seen("unpolarised")
    assert not plain[1:].any()
    assert seen("right")[0] == pytest.approx(plain[0], rel=1e-6)


@pytest.mark.llvm
@pytest.mark.parametrize(
    ("name", "aside"),
    [("x", (0.5, 0.3, 1.0)), ("45 deg", (-0.4, 0.8, 0.6)), ("right", (0.05, -0.9, 0.3))],
)
def test_beside_the_axis_the_field_turns_the_shortest_way(name: str, aside: Any) -> None:
    """Ludwig's third definition with the camera's right and up vectors."""
    use("llvm_ad_mono_polarized")
    s, up = np.array(aside) / np.linalg.norm(aside), np.array([0.1, 1.0, 0.2])
    z, p = np.array([0.0, 0.0, 1.0]), np.array([*JONES[name], 0.0])
    field = p - (p @ s) * (z + s) / (1 + s[2])
    right = np.cross(-s, up) / np.linalg.norm(np.cross(-s, up))
    a, b = field @ right, field @ np.cross(s, right)
    both = 2 * a * np.conj(b)
    expected = abs(a) ** 2 - abs(b) ** 2, both.real, both.imag
    result = seen(name, camera=(s, (0, 0, 0), up))
    assert result[1:] / result[0] == pytest.approx(expected, abs=ERROR)


@pytest.mark.llvm
def test_a_turned_polariser_passes_the_square_of_the_cosine() -> None:
    """The power follows Malus' law."""
    use("llvm_ad_mono_polarized")
    plate = {"type": "polarizer"}
    free = seen("x", inner="volpath")[0]
    for angle in (30, 90):
        pose = looking((0, 0, 0.5), (0, 0, 1)).rotate([0, 0, 1], angle)
        result = seen("x", {"p": plane(pose, plate)}, inner="volpath")[0]
        assert result / free == pytest.approx(np.cos(np.radians(angle)) ** 2, abs=ERROR)


@pytest.mark.llvm
def test_the_right_of_engineers_is_the_left_of_the_plugin_circular() -> None:
    use("llvm_ad_mono_polarized")
    free = seen("x", inner="volpath")[0]
    for left_handed, name in ((True, "right"), (False, "left")):
        filters = {"type": "circular", "left_handed": left_handed}
        through = {"p": plane(looking((0, 0, 0.5), (0, 0, 1)), filters)}
        assert seen(name, through, inner="volpath")[0] / free == pytest.approx(1.0, abs=ERROR)
        other = {"right": "left", "left": "right"}[name]
        assert seen(other, through, inner="volpath")[0] / free == pytest.approx(0.0, abs=ERROR)


@pytest.mark.llvm
@pytest.mark.parametrize("name", ["45 deg", "right"])
def test_a_metal_of_finite_index_turns_slants_into_the_ellipse_of_fresnel(name: str) -> None:
    """The sign of S3 is the sign of the phase between two reflections."""
    use("llvm_ad_mono_polarized")
    angle, index = np.radians(60), 0.2 + 3.0j
    cosine, root = np.cos(angle), np.sqrt(index**2 - np.sin(angle) ** 2)
    along = (index**2 * cosine - root) / (index**2 * cosine + root)  # for H, and thus for E = d x H
    across = (cosine - root) / (cosine + root)
    x, y = JONES[name]
    # In the plane of incidence, E is along z x y = -x before the reflection, and along -d' x y, the
    # camera's right, after the reflection.
    a, b = along * x, across * y
    both = 2 * a * np.conj(b)
    size = abs(a) ** 2 + abs(b) ** 2
    expected = np.array([abs(a) ** 2 - abs(b) ** 2, both.real, both.imag]) / size
    metal = {"type": "conductor", "eta": spectrum(0.2), "k": spectrum(3.0)}
    middle, back = np.array([0, 0, 0.5]), np.array([np.sin(2 * angle), 0, -np.cos(2 * angle)])
    mirror = plane(looking(middle, middle + back - [0, 0, 1]), metal)
    result = seen(name, {"m": mirror}, (middle + back, middle))
    assert result[1:] / result[0] == pytest.approx(expected, abs=ERROR)


@pytest.mark.llvm
@pytest.mark.parametrize("estimator", ["exact", "wigner"])
def test_an_unpolarised_sky_gives_half_to_a_polarised_receiver(estimator: str) -> None:
    """A sky of 2 k T/lambda^2 in both polarisations gives k T in a bandwidth of 1 Hz."""
    mi = use("llvm_ad_mono_polarized")
    sky = {"type": "constant", "radiance": spectrum(2.0 / WAVELENGTH**2)}
    result = []
    for polarisation in ("unpolarised", "x", "left"):
        taker = receiver(polarisation=polarisation, estimator=estimator)
        scene = {"type": "scene", "integrator": {"type": "path"}, "r": taker, "sky": sky}
        result.append(float(pwm.render(mi.load_dict(scene), spp=2**14).mean()))
    assert result[1] == pytest.approx(result[0] / 2, rel=1e-6)
    assert result[2] == pytest.approx(result[0] / 2, rel=1e-6)
    assert result[1] == pytest.approx(1.0, rel=0.01 if estimator == "exact" else 0.2)


def linked(sent: Any, taken: Any, roll: float = 0.0) -> Any:
    """Return the power at a receiver that faces a source, both with horizontal x axes."""
    here, there = (0.0, 0.0, 0.0), (0.1, 0.4, 0.2)
    pose = looking(there, here, (0, 0, 1)).rotate([0, 0, 1], roll)
    scene = scene_of(
        e=emitter(SQUARE, looking(here, there, (0, 0, 1)), polarisation=sent),
        r=receiver(SQUARE, pose, polarisation=taken),
    )
    return pwm.received_power(scene, spp=32)


@pytest.mark.llvm
@pytest.mark.usefixtures("few_batches")
def test_links_keep_the_share_of_power_in_the_receivers_polarisation() -> None:
    use("llvm_ad_mono_polarized")
    whole = linked("unpolarised", "unpolarised").power
    table = [
        ("x", "x", 30, 0.75), ("unpolarised", "left", 0, 0.5),
        ("45 deg", "45 deg", 0, 0.0), ("right", "right", 37, 1.0),
    ]  # fmt: skip
    for sent, taken, roll, share in table:
        assert linked(sent, taken, roll=roll).power / whole == pytest.approx(share, abs=1e-5)


@pytest.mark.slow
@pytest.mark.llvm
def test_an_array_of_two_polarisations_has_the_pattern_of_the_sum_of_fields() -> None:
    """Radiance times area is |F|^2 in a direction, and the products of the components of F."""
    use("llvm_ad_mono_polarized")
    s = np.array([0.25, 0.0, np.sqrt(1 - 0.25**2)])
    each = [pw.fourier(element, s[:2] / WAVELENGTH) for element in PAIR.elements]
    x, y = (np.array(each) * PAIR.weights) @ np.array([JONES["x"], JONES["right"]])
    both = 2 * x * np.conj(y)
    size = abs(x) ** 2 + abs(y) ** 2
    expected = np.array([abs(x) ** 2 - abs(y) ** 2, both.real, both.imag]) / size
    camera = (s, (0, 0, 0))
    result = seen(["x", "right"], None, camera, PAIR, half=8e-3, size=64, spp=64)
    # In the x-z plane, x is to the camera's right, and y is up.
    assert result[1:] / result[0] == pytest.approx(expected, abs=5e-3)


@pytest.mark.slow
@pytest.mark.llvm
def test_both_estimators_light_a_street_alike() -> None:
    use("llvm_ad_mono_polarized")
    floor = {"type": "pplastic", "alpha": 0.2, "diffuse_reflectance": spectrum(0.3)}
    pose = looking((0, -0.5, 0.3), (0, 0, 0), (0, 0, 1))
    result = [
        seen(
            ["x", "right"], {"f": plane(looking((0, 0, 0), (0, 0, 1)), floor, 0.3)},
            ((0, 0.5, 0.3), (0, 0, 0), (0, 0, 1)), PAIR, 0.1, 8, 2048,
            to_world=pose, estimator=estimator,
        )
        for estimator in ("wigner", "exact")
    ]  # fmt: skip
    assert result[0] == pytest.approx(result[1], abs=0.02 * result[1][0])  # noise of W
    assert np.linalg.norm(result[1][1:]) > 0.1 * result[1][0]


@pytest.mark.slow
@pytest.mark.llvm
@pytest.mark.usefixtures("few_batches")
def test_ranges_and_scatterers_add_up_to_the_polarised_power() -> None:
    """Three computations of the power of crossed ends, which is due to oblique rays."""
    use("llvm_ad_mono_polarized")
    if importlib.util.find_spec("mitransient") is None:  # its import sets a default variant
        pytest.skip("mitransient is not installed")
    poses = [looking((x, 0, 0.3), (0, 0, 0)) for x in (-0.1, 0.1)]
    value = spectrum(3000.0)
    metal = {"type": "roughconductor", "alpha": 0.3, "eta": value, "k": value}
    scene = scene_of(
        e=emitter(SQUARE, poses[0], polarisation="x"),
        r=receiver(SQUARE, poses[1], polarisation="y"),
        f=plane(looking((0, 0, 0), (0, 0, 1)), metal, 0.5),
    )
    expected = pwm.received_power(scene, spp=2**15, seed=1)
    by_range = pwm.range_profile(scene, np.linspace(0.2, 0.6, 9), spp=2**15, seed=1)
    assert float(by_range.scattered) == pytest.approx(expected.scattered, rel=0.01)
    cloud = pwm.scatterers(scene, 10_000, seed=1)
    assert float(cloud.power.sum()) == pytest.approx(expected.scattered, rel=0.05)


@pytest.mark.llvm
def test_scene_files_and_entries_have_the_same_polarisations(tmp_path: Path) -> None:
    use("llvm_ad_mono_polarized")
    path = written(tmp_path, cli_scenes.scene(source('<string name="polarisation" value="$p"/>')))
    texts = {"y": "y", "-30 deg": "-30 deg", "1, 1j": (1, 1j), "0.5+0.5j, 2": (0.5 + 0.5j, 2)}
    for text, given in texts.items():
        scene = pwm.load_scene(path, p=text)
        entry = scene_of(a=pwm.aperture(SQUARE, WAVELENGTH, polarisation=given))
        (one,), (other,) = scene.emitters(), entry.emitters()
        assert one.spec.polarisation == pytest.approx(other.spec.polarisation, abs=1e-15)


def test_polarisations_that_are_none_are_refused() -> None:
    for bad in ("z", (0, 0), (1, 2, 3), ["x", "y"], np.eye(2), 3.0, (np.nan, 1)):
        with pytest.raises(ArgumentError, match="expected polarisation to be"):
            pwm.aperture(SQUARE, WAVELENGTH, polarisation=bad)
        with pytest.raises(ArgumentError, match="expected polarisation to be"):
            pwm.receiver(SQUARE, WAVELENGTH, polarisation=bad)
    with pytest.raises(SceneError, match="same polarisation for all elements"):
        pwm.aperture(PAIR, WAVELENGTH, estimator="exact", diffraction=True, polarisation=["x", "y"])


def test_a_polarisation_asks_for_a_polarised_variant() -> None:
    use("scalar_rgb")
    for entry in (
        pwm.aperture(SQUARE, WAVELENGTH, polarisation="x"),
        pwm.receiver(SQUARE, WAVELENGTH, polarisation="x"),
    ):
        with pytest.raises(RuntimeError, match="requires a polarised variant of Mitsuba"):
            scene_of(it=entry)
    assert pwm.choose_variant(polarised=True).endswith("_polarized")
    with pytest.raises(EngineError, match="renders unpolarised light"):
        pwm.choose_variant("scalar_rgb", polarised=True)
    seen = {"type": "orthographic", "film": film(2)}
    scene = scene_of(a=pwm.aperture(SQUARE, WAVELENGTH), s=seen)
    with pytest.raises(SceneError, match="integrator stokes requires a polarised variant"):
        pwm.render(scene, "stokes", spp=1)


def test_pictures_of_polarisation_take_four_stokes_numbers() -> None:
    numbers = np.zeros((4, 5, 6))
    numbers[0], numbers[1, 2:] = 1.0, -0.5
    assert len(draw_stokes(numbers, "a title").axes) == 5
    degree, angle = (axes.images[0].get_array() for axes in draw_polarisation(numbers).axes[:2])
    assert degree[3, 3] == pytest.approx(0.5) and degree[0, 0] == 0.0
    assert abs(angle[3, 3]) == pytest.approx(90.0)
    assert np.ma.getmaskarray(np.ma.masked_invalid(angle))[0, 0]  # no angle without polarisation
    for draw in (draw_stokes, draw_polarisation):
        with pytest.raises(ArgumentError, match="expected stokes"):
            draw(np.zeros((3, 5, 6)))


@pytest.mark.slow
def test_the_command_writes_stokes_numbers_and_their_pictures(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    street = Path(__file__).parents[1] / "examples" / "wet_street"
    text = (street / "street.xml").read_text(encoding="utf-8")
    for size in ("480", "320"):
        text = text.replace(f'value="{size}"', 'value="16"')
    (tmp_path / "street.xml").write_text(text, encoding="utf-8")
    (tmp_path / "antenna.wkt").write_bytes((street / "antenna.wkt").read_bytes())
    out = tmp_path / "out" / "wet"
    options = ["--polarised", "--spp", "16", "--out", str(out)]
    assert main(["render", str(tmp_path / "street.xml"), *options]) == 0
    for name in ("wet.png", "wet_stokes.png", "wet_polarisation.png"):
        assert (out.parent / name).read_bytes().startswith(b"\x89PNG")
    with np.load(out.parent / "wet_stokes.npz") as kept:
        stokes = kept["stokes"]
    assert stokes.shape == (4, 16, 16)
    assert np.linalg.norm(stokes[1:], axis=0).max() <= stokes[0].max() * (1 + 1e-5)
    record = json.loads(out.with_suffix(".json").read_text())
    assert record["used"]["variant"].endswith("_polarized")
    assert record["used"]["polarisation"].startswith("45 deg: ")
    assert main(["render", str(tmp_path / "street.xml"), "--out", str(out)]) == 2
