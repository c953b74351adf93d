"""Ids, order and messages of scenes from files and dictionaries."""

from __future__ import annotations

import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_scenes import PATH, receiver, rectangle, scene, source, written
from mitsuba_scenes import METAL, MIRROR, SQUARE, WAVELENGTH, facing, scene_of, use
from polywigner.errors import ArgumentError, FileFormatError, SceneError

pytestmark = [pytest.mark.drjit, pytest.mark.llvm, pytest.mark.usefixtures("few_rays")]
pm = pytest.importorskip("polywigner.mitsuba")
import mitsuba as mi  # noqa: E402 (after the package, which chooses the LLVM library)

WHITE = {"type": "diffuse", "reflectance": 0.5}
IDS = ["zeta", "alpha", "mid"]


@pytest.fixture(autouse=True)
def plain_variant() -> None:
    use("scalar_rgb")


def moved(x: float, y: float, z: float) -> Any:
    return mi.ScalarTransform4f().translate([x, y, z])


def entries(bsdf: Any = WHITE) -> dict[str, Any]:
    """Return sources, receivers and walls, which share a BSDF, in another order than their ids."""
    made: dict[str, Any] = {"type": "scene"}
    for k, name in enumerate(IDS):
        made[name] = pm.aperture(SQUARE, WAVELENGTH, moved(0.02 * k, 0, 0), power=1.0 + k)
        made[f"{name} rx"] = pm.receiver(SQUARE, WAVELENGTH, facing(1.0, 0.02 * k))
        to_world = moved(5.0 + k, 0, 0.5).rotate([0, 1, 0], -90).scale(2.0)
        made[f"{name} wall"] = {"type": "rectangle", "bsdf": bsdf, "to_world": to_world}
    return made


@pytest.mark.slow
def test_results_follow_the_ids_however_mitsuba_orders_its_emitters() -> None:
    """Mitsuba's loader merges the walls, and returns emitters in any order."""
    scenes = [mi.load_dict(entries()), pm.load_scene(entries())]
    channel = pm.channel(scenes[0], reflections=0)
    assert channel["emitter"].values.tolist() == sorted(IDS)
    assert channel["receiver"].values.tolist() == sorted(f"{name} rx" for name in IDS)
    powers = [pm.received_power(s, spp=16, receiver="mid rx", reflections=0) for s in scenes]
    for one in powers:
        assert [part.name for part in one.contributions] == sorted(IDS)
        direct = [part.direct for part in one.contributions]
        assert direct == [part.direct for part in powers[0].contributions]
    h = channel["h"].values[0, sorted(IDS).index("mid")]
    watts = [1.0 + IDS.index(name) for name in sorted(IDS)]
    assert np.abs(h) ** 2 * watts == pytest.approx(direct, rel=1e-6)
    first = pm.received_power(scenes[1], spp=16, receiver=0, reflections=0)
    assert first.receiver == scenes[1].sensors()[1].id() == "alpha rx"


@pytest.mark.slow
def test_loaded_scenes_repeat_their_random_numbers() -> None:
    floor = {"floor": {"type": "rectangle", "bsdf": WHITE, "to_world": moved(0, 0, 2).scale(3)}}
    floor["floor"]["to_world"] = floor["floor"]["to_world"].rotate([1, 0, 0], 180)
    made = {k: v for k, v in entries().items() if not k.endswith(" rx")} | floor
    made["rx"] = pm.receiver(SQUARE, WAVELENGTH, moved(0.3, 0, 0))
    result = [pm.received_power(pm.load_scene(made), spp=16, seed=3).scattered for _ in range(3)]
    assert result[0] > 0
    assert result == [result[0]] * 3


# Walls by name, each with the axis and angle of its rotation and with its position.
WALLS = {
    "north": ((0, 1, 0), -90, (0.3, 0, 0.5)),
    "south": ((0, 1, 0), 90, (-0.3, 0, 0.5)),
    "floor": ((1, 0, 0), -90, (0, -0.3, 0.5)),
}


def posed(axis: Any, turn: float, at: Any) -> Any:
    return moved(*at).rotate(axis, turn).scale(0.2)


def corridor() -> dict[str, Any]:
    """Return a link between three mirrors with equal BSDFs."""
    walls = {
        name: {"type": "rectangle", "bsdf": MIRROR, "to_world": posed(*wall)}
        for name, wall in WALLS.items()
    }
    rx = pm.receiver(SQUARE, WAVELENGTH, facing(1.0))
    return {"type": "scene", "tx": pm.aperture(SQUARE, WAVELENGTH), "rx": rx, **walls}


def text_of_scene(folder: Path) -> Path:
    """Write the same scene as XML."""
    conductor = '<bsdf type="conductor"><string name="material" value="none"/></bsdf>'
    walls = (
        rectangle(
            f'<scale value="0.2"/><rotate value="{str(axis)[1:-1]}" angle="{turn}"/>'
            f'<translate value="{str(at)[1:-1]}"/>',
            conductor,
            name,
        )
        for name, (axis, turn, at) in WALLS.items()
    )
    return written(folder, scene('<integrator type="path"/>', source(), receiver(), *walls))


def test_mirrors_of_one_bsdf_keep_their_names_in_files_and_dictionaries(tmp_path: Path) -> None:
    for given in (corridor(), text_of_scene(tmp_path)):
        names = pm.channel(pm.load_scene(given), reflections=1)["mirrors"].values
        assert names.tolist() == ["", "floor", "north", "south"]


def test_a_source_file_with_a_mistake_is_a_file_format_error_in_a_scene(tmp_path: Path) -> None:
    file = tmp_path / "source.toml"
    file.write_text('version = 1\nkind = "apertur"\n')
    text = '<string name="wavelength" value="3 mm"/><string name="source" value="source.toml"/>'
    shape = f'<shape type="wigner">{text}</shape>'
    with pytest.raises(FileFormatError, match="apertur"):
        pm.load_scene(written(tmp_path, scene(shape)))


def test_a_dictionary_is_checked_as_a_file_is() -> None:
    with pytest.raises(ArgumentError, match="no parameters, got width"):
        pm.load_scene({"type": "scene"}, width=3)
    with pytest.raises(SceneError, match='add "type": "scene"'):
        pm.load_scene({"type": "sphere"})
    with pytest.raises(SceneError, match="polarised variant"):
        pm.load_scene({"type": "scene", "e": pm.aperture(SQUARE, WAVELENGTH, polarisation="x")})
    changed = pm.load_scene(entries(), diffraction=True)
    assert all(sensor.spec.diffraction for sensor in changed.sensors())


def notes_over(bsdf: Any, kind: str = "cube", **how: Any) -> Any:
    """Return the notes of a link of 1 m next to a reflecting body at half of the distance."""
    scene = scene_of(
        tx=pm.aperture(SQUARE, WAVELENGTH, power=1.0),
        rx=pm.receiver(SQUARE, WAVELENGTH, facing(1.0)),
        shell={"type": kind, "bsdf": bsdf, "to_world": moved(-0.25, 0, 0.5).scale(0.2)},
    )
    return pm.received_power(scene, spp=16, reflections=1, **how)


GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}


@pytest.mark.parametrize("coherent", [False, True])
def test_faces_of_a_glass_box_are_mirrors_and_the_note_names_transmission_alone(
    coherent: bool,
) -> None:
    result = notes_over(GLASS, coherent=coherent)
    reflected = result.contributions[0].paths[1]
    metal = notes_over(MIRROR, coherent=coherent)
    sine = 0.5 / np.hypot(0.5, 0.05)  # the face is 0.05 m from the line
    cosine, root = np.sqrt(1 - sine**2), np.sqrt(1.5**2 - sine**2)
    s, p = (cosine - root) / (cosine + root), (2.25 * cosine - root) / (2.25 * cosine + root)
    # The face is parallel to y, so E is perpendicular to the plane of incidence.
    expected = s**2 if coherent else (s**2 + p**2) / 2
    share = reflected.power / metal.contributions[0].paths[1].power
    assert share == pytest.approx(expected, rel=5e-3)
    assert reflected.mirrors[0].startswith("shell[")
    assert "not included: refraction through 'shell'" in result.notes
    assert not any("curved" in note for note in result.notes)


def test_a_smooth_ball_is_reported_as_curved() -> None:
    (note,) = notes_over({"type": "conductor"}, "sphere").notes
    assert note.startswith("not included: reflections from 'shell' (curved")


def test_direct_power_beside_a_missing_line_of_sight_is_explained_as_reflections() -> None:
    """Both ends are in one plane, and see each other in a mirror only."""
    scene = scene_of(
        tx=pm.aperture(SQUARE, WAVELENGTH, power=1.0),
        rx=pm.receiver(SQUARE, WAVELENGTH, moved(0.05, 0, 0)),
        mirror={"type": "rectangle", "bsdf": METAL, "to_world": moved(0, 0, 0.5)},
    )
    seen = pm.received_power(scene, spp=16)
    assert seen.direct > 0
    assert "no line-of-sight path" in seen.notes[0]
    assert "its direct power arrives via reflections" in seen.notes[0]
    alone = pm.received_power(scene, spp=16, reflections=0)
    assert alone.direct == 0
    assert "no line-of-sight path" in alone.notes[0] and "arrives" not in alone.notes[0]


def test_merged_walls_without_a_bounding_box_are_aimed_at_without_warnings() -> None:
    small = {
        f"plate {k}": {
            "type": "rectangle",
            "bsdf": WHITE,
            "to_world": moved(k - 0.5, 0, 3.0).rotate([1, 0, 0], 180).scale(0.05),
        }
        for k in range(2)
    }
    ends = {
        "tx": pm.aperture(SQUARE, WAVELENGTH, power=1.0, estimator="exact"),
        "rx": pm.receiver(SQUARE, WAVELENGTH, moved(0.05, 0, 0)),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        merged = pm.received_power(mi.load_dict({"type": "scene", **ends, **small}), spp=512)
    apart = pm.received_power(pm.load_scene({"type": "scene", **ends, **small}), spp=512)
    # Without importance sampling, 16 batches miss the plate.
    assert merged.standard_error < 0.2 * merged.scattered
    assert merged.scattered == pytest.approx(apart.scattered, rel=0.3)


@pytest.mark.slow
def test_threads_that_load_and_receive_at_once_get_the_power_of_one(tmp_path: Path) -> None:
    floor = '<scale value="0.3"/><rotate x="1" angle="180"/><translate z="0.5"/>'
    ends = source(), receiver(pose='<translate x="0.05"/>'), rectangle(floor)
    path = written(tmp_path, scene(PATH.format(3), *ends))

    def power(_: int) -> float:
        loaded = pm.load_scene(path, "llvm_ad_mono")
        return float(pm.received_power(loaded, spp=1 << 7, seed=1).power)

    alone = power(0)
    assert alone > 0
    with ThreadPoolExecutor(4) as pool:
        result = list(pool.map(power, range(25)))
    # Kernels add in single precision, in an order that depends on the living scenes.
    assert result == pytest.approx([alone] * 25, rel=1e-6)
