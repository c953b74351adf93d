"""Diffracted shadows in scenes: images, links and receivers against fields at points."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest
from scipy.special import fresnel

import cli_scenes
import polywigner as pw
import polywigner.mitsuba as pm
from cli_scenes import source
from mitsuba_scenes import BLACK, camera, emitter, receiver, rectangle, scene_of, use
from oracles import meshes
from polywigner.cli import main
from polywigner.errors import SceneError
from polywigner.geometry.silhouettes import Obstacles
from polywigner.mitsuba.plugins.films import threads_for_openexr
from polywigner.mitsuba.scenes.surfaces import bodies_of

mi = use("scalar_rgb")
pytestmark = pytest.mark.drjit

WAVELENGTH = 299792458.0 / 94e9
HALF = 0.005 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
SQUARE, SMALL = pw.Aperture(HALF), pw.Aperture(0.3 * HALF)
FLOOR, SIDE = 0.3, 0.1
HALF_WHITE = {"type": "diffuse", "reflectance": 0.5}
BOX = meshes.box((-0.03, -0.02, 0.08), (0.03, 0.02, 0.12))


def transform() -> Any:
    return mi.ScalarTransform4f()


def box(**more: Any) -> dict[str, Any]:
    pose = transform().translate([0, 0, 0.1]).scale([0.03, 0.02, 0.02])
    return {"type": "cube", "to_world": pose, "bsdf": BLACK, **more}


def scene(count: int, obstacles: dict[str, Any], source: Any = SQUARE, **options: Any) -> Any:
    options = {"estimator": "exact", "diffraction": True, "power": 1.0} | options
    return scene_of(
        source=pm.aperture(source, WAVELENGTH, **options),
        floor=rectangle((0, 0, FLOOR), (1, 0, 0), 180, 1.0, HALF_WHITE),
        camera=camera((0, 0, FLOOR - 0.01), (0, 0, FLOOR), count, SIDE)
        | {"sampler": {"type": "stratified"}},
        **obstacles,
    )


def rendered(made: Any, spp: int) -> Any:
    return pm.render(made, "direct", spp=spp)[..., 0]


def on_floor(count: int, fine: int, obstacles: Any = None, source: Any = SQUARE) -> Any:
    """Return the mean radiance of the pixels of a floor, from fields at points."""
    x = SIDE * (1 - (2 * np.arange(count * fine) + 1) / (count * fine))
    places = np.stack([*np.meshgrid(x, x), np.full((x.size, x.size), FLOOR)], axis=-1)
    field = pw.amplitude(source, places, WAVELENGTH, obstacles=obstacles, tolerance=1e-4)
    cosine = FLOOR / np.linalg.norm(places, axis=-1)
    power = pw.radiated_power(source, WAVELENGTH)
    radiance = 0.5 / math.pi * np.abs(field) ** 2 * cosine / power
    return radiance.reshape(count, fine, count, fine).mean(axis=(1, 3))


def group() -> dict[str, Any]:
    inner = {"type": "shapegroup", "id": "g", "cube": box()}
    moved = transform().translate([0.01, 0, 0])
    return {
        "group": inner,
        "one": {"type": "instance", "to_world": moved, "shape": {"type": "ref", "id": "g"}},
    }


def disk_of(radius: float, z: float) -> Any:
    angles = np.linspace(0, 2 * math.pi, 200, endpoint=False)
    outline = pw.Aperture(radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1))
    pose = np.eye(4)
    pose[2, 3] = z
    return outline.placed(pose)


@pytest.mark.llvm
def test_picture_is_the_field_behind_a_box_in_a_group() -> None:
    use("llvm_ad_mono")
    count = 8
    result = rendered(scene(count, group()), 256)
    expected = on_floor(count, 4, meshes.moved(BOX, 0.01, 0, 0))
    assert np.abs(result - expected).max() < 1e-3 * on_floor(count, 1).max()
    # Geometric shadows would differ.
    assert expected[count // 2, count // 2] > 1e-3 * on_floor(count, 1).max()


@pytest.mark.slow
@pytest.mark.llvm
def test_a_sphere_throws_the_shadow_of_the_disk_where_tangents_touch() -> None:
    use("llvm_ad_mono")
    ball = {"type": "sphere", "center": [0, 0, 0.1], "radius": 0.02, "bsdf": BLACK}
    point = pw.Aperture(0.05 * HALF)  # nearly a point source, from which the silhouette is a circle
    result = rendered(scene(8, {"ball": ball}, source=point), 324)
    disk = disk_of(0.02 * math.sqrt(1 - 0.04), 0.1 - 0.02 * 0.2)
    expected = on_floor(8, 12, disk, point)
    assert np.abs(result - expected).max() < 2e-2 * on_floor(8, 1, None, point).max()


@pytest.mark.slow
@pytest.mark.llvm
def test_plate_before_a_wall_has_the_field_of_both_in_pictures_and_at_points() -> None:
    use("llvm_ad_mono")

    def black(x: float, z: float, side: float) -> dict[str, Any]:
        return rectangle((x, 0, z), (1, 0, 0), 0, side, BLACK)

    def plate(x: float, z: float, side: float) -> Any:
        pose = np.eye(4)
        pose[:3, 3] = x, 0, z
        return pw.shapes.square(2 * side).placed(pose)

    places = [(0.005, 0.08, 0.012), (0.04, 0.18, 0.04)]
    shapes = {f"r{k}": black(*place) for k, place in enumerate(places)}
    bodies = [plate(*place) for place in places]
    result = rendered(scene(8, shapes), 324)
    expected = on_floor(8, 6, bodies)
    assert np.abs(result - expected).max() < 5e-3 * on_floor(8, 1).max()
    use("scalar_rgb")
    # On the line through the source's centre and a corner, in single precision.
    point = pw.Aperture(0.05 * HALF)
    made = scene(2, {"r0": black(0.0, 0.1, 0.02)}, source=point)
    weights = []
    with pm.receiving(made):
        for x in (0.06, 0.06 + 1e-6, 0.06 - 1e-6):
            it = dr.zeros(mi.SurfaceInteraction3f)
            it.p, it.n = mi.Point3f(x, 0.06, FLOOR), mi.Normal3f(0, 0, -1)
            weights.append(float(made.sample_emitter_direction(it, mi.Point2f(0.3, 0.6))[1][0]))
    assert weights[0] == pytest.approx(weights[1], rel=1e-2)
    assert weights[0] == pytest.approx(weights[2], rel=1e-2)


@pytest.mark.slow
def test_null_surfaces_let_pass_and_moved_ones_are_found_again() -> None:
    use("llvm_ad_mono")
    free = rendered(scene(4, {}), 64)
    clear = rendered(scene(4, {"box": box(bsdf={"type": "null"})}), 64)
    assert np.abs(clear - free).max() < 1e-3 * free.max()
    made = scene(4, {"box": box()})
    shaded = rendered(made, 64)
    assert np.abs(shaded - free).max() > 0.1 * free.max()
    params = mi.traverse(made)
    places = np.array(params["box.vertex_positions"]).reshape(-1, 3) + np.array([0.5, 0, 0])
    params["box.vertex_positions"] = places.ravel().tolist()
    params.update()
    assert np.abs(rendered(made, 64) - free).max() < 2e-2 * free.max()


@pytest.mark.llvm
def test_a_body_around_the_source_hides_it() -> None:
    use("llvm_ad_mono")
    around = {"type": "cube", "to_world": transform().scale(0.02), "bsdf": BLACK}
    dark = rendered(scene(2, {"around": around}), 4)
    assert dark.max() < 1e-6 * on_floor(2, 1).max()


def edge_at(x: float, z: float) -> dict[str, Any]:
    """Return a half plane that covers all points left of x."""
    pose = transform().translate([x - 2, 0, z]).scale([2, 4, 1])
    return {"edge": {"type": "rectangle", "to_world": pose, "bsdf": BLACK}}


def received(obstacles: dict[str, Any], first: Any, last: Any, diffraction: bool) -> Any:
    up = transform().translate([0, 0, 1.0]).rotate([1, 0, 0], 180)
    made = scene_of(
        source=emitter(first, estimator="exact", diffraction=diffraction, visible=False),
        receiver=receiver(last, up, diffraction=diffraction),
        **obstacles,
    )
    return pm.received_power(made, spp=16)


@pytest.mark.usefixtures("few_batches")
def test_link_over_an_edge() -> None:
    use("scalar_rgb")
    small = pw.Aperture(0.1 * HALF)
    free = received({}, small, small, False).direct
    for x in (-0.03, 0.02):
        result = received(edge_at(x, 0.4), small, small, True).direct / free
        v = x * math.sqrt(2 / WAVELENGTH * (1 / 0.4 + 1 / 0.6))
        s, c = fresnel(v)
        knife = abs(0.5 - c - 1j * (0.5 - s)) ** 2 / 2
        # The integral is paraxial, and the pattern decreases towards the edge.
        assert 10 * abs(math.log10(result / knife)) < (0.02 if x <= 0 else 0.05)
    assert received(edge_at(0.02, 0.4), small, small, False).direct == 0


def cubes(*boxes: Any) -> dict[str, Any]:
    result = {}
    for k, (low, high) in enumerate(boxes):
        pose = transform().translate((low + high) / 2).scale((high - low) / 2)
        result[f"b{k}"] = {"type": "cube", "to_world": pose, "bsdf": BLACK}
    return result


@pytest.mark.usefixtures("few_batches")
def test_a_wall_of_butted_or_crossing_cubes_is_a_wall() -> None:
    """The gap is a few roundings in single precision. Lengths are in wavelengths."""
    use("scalar_rgb")
    small, off = pw.Aperture(0.1 * HALF), np.array((0.137, 0.211, 0.05))

    def level(*boxes: Any) -> float:
        places = [off + WAVELENGTH * np.array(p) for p in ((1.3, -0.2, -7.0), (-1.0, 0.3, 6.0))]
        up = transform().translate(places[0])
        down = transform().translate(places[1]).rotate([1, 0, 0], 180)
        made = scene_of(
            source=pm.aperture(
                small, WAVELENGTH, power=1.0, estimator="exact", diffraction=True, to_world=up
            ),
            receiver=pm.receiver(small, WAVELENGTH, to_world=down),
            **cubes(*(off + WAVELENGTH * np.array(box) for box in boxes)),
        )
        return 10 * math.log10(pm.received_power(made, spp=16).direct)

    low, high = (-3, -2, 0), (3, 2, 1)
    left, right = (0.7, 2, 1), (0.7 + 2e-5, -2, 0)
    wall = level((low, high))
    assert level((low, left), (right, high)) == pytest.approx(wall, abs=0.02)
    assert level((low, left), ((-1, -2, 0), high)) == pytest.approx(wall, abs=0.02)


def test_cubes_of_one_mesh_with_a_common_face_are_in_contact_with_what_touches_them() -> None:
    """Four faces meet at each edge of the common face, so the mesh is closed, but not simple."""
    cube = meshes.box((0, 0, 0), (1, 1, 1))
    pair = meshes.joined([cube, meshes.moved(cube, 1, 0, 0)])
    bodies = [(body.vertices, body.triangles) for body in (pair, meshes.moved(cube, 0, 1, 0))]
    result = Obstacles(bodies_of(bodies))
    assert result.contacts.tolist() == [[0, 1]]


@pytest.mark.slow
@pytest.mark.usefixtures("few_batches")
def test_both_ends_of_a_link_over_an_edge_are_exchanged() -> None:
    use("scalar_rgb")
    ends = SMALL, pw.Aperture(0.2 * HALF)
    one = received(edge_at(0.02, 0.4), *ends, True).direct
    other = received(edge_at(0.02, 0.6), *ends[::-1], True).direct
    assert one == pytest.approx(other, rel=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("few_batches")
def test_bodies_on_mirrored_ways() -> None:
    """A body in front of a mirror blocks the path twice, as body and as image."""
    use("scalar_rgb")
    centre = [0.3, 0, 0.5]
    mirror = rectangle(centre, (0, 1, 0), -90, 2.0, {"type": "conductor"})

    def mirrored(z: float) -> float:
        turn = 31.0 if z < 0.5 else -31.0
        plate = rectangle((0.15, 0, z), (0, 1, 0), turn, 0.02, BLACK)
        ends = [transform().look_at(origin=[0, 0, z], target=centre, up=[0, 1, 0]) for z in (0, 1)]
        made = scene_of(
            source=emitter(SQUARE, ends[0], estimator="exact", diffraction=True, visible=False),
            receiver=receiver(SQUARE, ends[1], diffraction=True),
            mirror=mirror,
            plate=plate,
        )
        result = pm.received_power(made, spp=2)
        return next(p.transmission for p in result.contributions[0].paths if p.mirrors)

    before, behind = mirrored(0.25), mirrored(0.75)
    assert before < 0.7
    # The values are only nearly equal, because single edges of a plate and of its image are not
    # exactly reciprocal.
    assert before == pytest.approx(behind, rel=1e-2)


@pytest.mark.slow
@pytest.mark.llvm
def test_receiver_takes_light_over_edges() -> None:
    """The power is an integral of the fields of both ends over a floor that a plate hides."""
    use("llvm_ad_mono")
    height, side, apart = 0.4, 0.3, 0.1
    places = [np.eye(4), np.eye(4)]
    places[0][0, 3], places[1][0, 3] = -apart, apart
    pose = transform().translate([apart, 0, 0.2]).scale([0.07, 0.05, 1])
    made = scene_of(
        source=emitter(SQUARE, places[0], estimator="exact", diffraction=True, visible=False),
        receiver=receiver(SQUARE, places[1], diffraction=True),
        integrator={"type": "path", "max_depth": 2},
        floor=rectangle(
            (0, 0, height), (1, 0, 0), 180, side, {"type": "diffuse", "reflectance": 0.8}
        ),
        plate={"type": "rectangle", "to_world": pose, "bsdf": BLACK},
    )
    result = pm.received_power(made, spp=1 << 16)
    x = side * (2 * np.arange(80) + 1 - 80) / 80
    floor = np.stack([*np.meshgrid(x, x), np.full((80, 80), height)], axis=-1)
    pose_of_plate = np.eye(4)
    pose_of_plate[:3, 3] = apart, 0, 0.2
    outline = pw.Aperture(np.array([0.07, 0.05]) * np.sign(HALF))
    seen = []
    for place in places:
        own = pose_of_plate.copy()
        own[:3, 3] -= place[:3, 3]
        points = floor - place[:3, 3]
        plate = outline.placed(own)
        field = pw.amplitude(SQUARE, points, WAVELENGTH, obstacles=plate, tolerance=1e-3)
        seen.append(np.abs(field) ** 2 * height / np.linalg.norm(points, axis=-1))
    norm = pw.radiated_power(SQUARE, WAVELENGTH)
    each = 0.8 / math.pi * seen[0] * seen[1] * (WAVELENGTH / norm) ** 2
    expected = each.sum() * (2 * side / 80) ** 2
    assert result.scattered == pytest.approx(expected, abs=4 * result.standard_error)
    assert result.standard_error < 0.05 * expected


def test_what_diffraction_cannot_do_is_said() -> None:
    use("llvm_ad_mono")
    with pytest.raises(SceneError, match='diffraction requires the estimator "exact"'):
        pm.aperture(SQUARE, WAVELENGTH, diffraction=True)
    partly = SQUARE.partially_coherent(0.005)
    with pytest.raises(SceneError, match="coherent light"):
        pm.aperture(partly, WAVELENGTH, estimator="exact", diffraction=True)
    with pytest.raises(SceneError, match="convert it to a mesh"):
        values = np.linspace(-1, 1, 8, dtype=np.float32).reshape(2, 2, 2, 1)
        points = {"type": "sdfgrid", "grid": mi.TensorXf(values)}
        rendered(scene(2, {"grid": points}), 1)
    fog = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 1.0}
    with pytest.raises(SceneError, match="not supported in a scene with fog"):
        rendered(scene(2, {"cube": box(interior=fog)}), 1)
    large = pw.Aperture(100 * HALF)
    with pytest.raises(SceneError, match="at most 1024"):
        rendered(scene(2, {"box": box()}, source=large), 1)


def test_renders_without_the_scene_are_refused() -> None:
    use("scalar_rgb")
    made = scene(1, {"box": box()})
    with pytest.raises((SceneError, RuntimeError), match=r"polywigner\.mitsuba\.receiving"):
        mi.render(made, spp=1, integrator=mi.load_dict({"type": "direct"}))
    with pm.receiving(made):
        assert (
            np.array(mi.render(made, spp=1, integrator=mi.load_dict({"type": "direct"}))).max() > 0
        )


def test_a_source_without_its_scene_lights_nothing_and_leaves_other_scenes_alone(llvm) -> None:
    """Mitsuba traces the sources of all living scenes into each kernel."""
    use("llvm_ad_mono")
    direct = mi.load_dict({"type": "direct"})
    lamp = {"type": "point", "position": [0, 0, 0.1], "intensity": 1.0}
    floor = rectangle((0, 0, FLOOR), (1, 0, 0), 180, 1.0, HALF_WHITE)
    seen = camera((0, 0, FLOOR - 0.01), (0, 0, FLOOR), 2, SIDE)
    other = scene_of(lamp=lamp, floor=floor, camera=seen)
    alone = np.array(mi.render(other, spp=1, integrator=direct))
    assert alone.max() > 0
    made = scene(2, {"box": box()})
    with pytest.warns(RuntimeWarning, match=r"polywigner\.mitsuba\.receiving"):
        assert np.isnan(mi.render(made, spp=1, integrator=direct)).any()
    with pytest.warns(RuntimeWarning, match=r"polywigner\.mitsuba\.receiving"):
        again = np.array(mi.render(other, spp=1, integrator=direct))
    # Threads add the samples of a pixel in any order.
    np.testing.assert_allclose(again, alone, rtol=1e-5, atol=0.0)


CAMERA = cli_scenes.camera(
    0.1, '<lookat origin="0, 0, 0.29" target="0, 0, 0.3" up="0, 1, 0"/>', (8, 8)
)
OWN = '<string name="estimator" value="exact"/>', '<boolean name="diffraction" value="true"/>'


@pytest.mark.llvm
@pytest.mark.usefixtures("unrendered_figures")
def test_command_and_scene_file_ask_for_diffraction(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    floor = cli_scenes.rectangle('<rotate x="1" angle="180"/><translate z="0.3"/>')
    cube = """<shape type="cube"><transform name="to_world">
        <scale x="0.03" y="0.02" z="0.02"/><translate z="0.1"/>
    </transform></shape>"""
    for name, more in (("own", OWN), ("plain", ())):
        parts = '<integrator type="direct"/>', CAMERA, source(*more), cube, floor
        cli_scenes.written(tmp_path, cli_scenes.scene(*parts)).rename(f"{name}.xml")
    for name, options in (("own", []), ("plain", ["--diffraction"])):
        assert main(["render", f"{name}.xml", "--out", name, *options]) == 0
    with threads_for_openexr():
        pictures = [np.array(mi.Bitmap(f"{name}.exr")) for name in ("own", "plain")]
    assert pictures[0].max() > 0
    assert pictures[0] == pytest.approx(pictures[1], rel=1e-3)
    plain = pm.render(pm.load_scene("plain.xml", "llvm_ad_mono"), spp=16)
    assert pictures[0][4, 4] > 100 * plain[4, 4]
