"""Bodies from STL, PLY and OBJ files: closed surfaces, with the transform of the solid."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import FileFormatError, GeometryError, QuantityError, SceneError

trimesh = pytest.importorskip("trimesh")

SIDES = np.array([1.0, 2.0, 3.0])  # millimetres

# Single precision of binary STL and PLY files rounds coordinates by 6e-8 of themselves.
SINGLE = 2e-7

DOUBLE = 1e-13

KINDS = {
    "stl": (".stl", {"file_type": "stl"}),
    "stl ascii": (".STL", {"file_type": "stl_ascii"}),
    "ply": (".ply", {"file_type": "ply"}),
    "ply ascii": (".ply", {"file_type": "ply", "encoding": "ascii"}),
    "obj": (".obj", {"file_type": "obj"}),
}


def written(folder: Path, body: object, kind: str) -> Path:
    suffix, options = KINDS[kind]
    content = body.export(**options)  # type: ignore[attr-defined]
    path = folder / f"body{suffix}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_a_box_has_its_volume_and_its_transform_is_a_product_of_sinc(
    tmp_path: Path, kind: str
) -> None:
    box = trimesh.creation.box(SIDES)
    body = pw.read_polyhedron(written(tmp_path, box, kind))
    assert len(body.vertices) == 8 and len(body.faces) == 12
    assert body.volume == pytest.approx(6e-9, rel=DOUBLE, abs=0.0)
    nu = np.random.default_rng(3).normal(0, 500, (50, 3))
    exact = 6e-9 * np.prod(np.sinc(nu * SIDES / 1000), axis=-1)
    assert np.abs(pw.fourier(body, nu) - exact).max() < DOUBLE * 6e-9


@pytest.mark.parametrize("kind", KINDS)
def test_a_pierced_body_keeps_its_tunnel(tmp_path: Path, kind: str) -> None:
    ring = trimesh.creation.annulus(1.0, 2.0, 1.0, sections=32)
    body = pw.read_polyhedron(written(tmp_path, ring, kind), unit="cm")
    assert body.volume == pytest.approx(ring.volume * 1e-6, rel=SINGLE, abs=0.0)


def test_scenes_take_stl_meshes_in_their_pose(tmp_path: Path) -> None:
    """Two boxes behind each other, the second one mirrored, met by rays."""
    pm = pytest.importorskip("polywigner.mitsuba")
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    written(tmp_path, trimesh.creation.box(SIDES), "stl")
    shape = (
        '<shape type="stl"><string name="filename" value="{}"/>'
        '<transform name="to_world"><scale x="{}" y="2" z="2"/><translate z="{}"/></transform>'
        "</shape>"
    )
    path = tmp_path / "scene.xml"
    both = shape.format("body.stl", 2, 10) + shape.format("body.stl", -4, 20)
    path.write_text(f'<scene version="3.0.0">{both}<emitter type="constant"/></scene>')
    scene = pm.load_scene(path)
    for x, distance in ((0.9, 10 - SIDES[2]), (1.9, 20 - SIDES[2])):
        found = scene.ray_intersect(mi.Ray3f([x, 0.3, 0.0], [0, 0, 1]))
        assert found.t == pytest.approx(distance, rel=SINGLE)
        assert np.allclose(found.n, [0, 0, -1])  # outwards
    (tmp_path / "body.stl").write_bytes(b"solid of nothing")
    with pytest.raises(FileFormatError, match=r"body\.stl"):
        pm.load_scene(path)
    path.write_text(path.read_text().replace("filename", "file"))
    with pytest.raises(SceneError, match="'file'"):
        pm.load_scene(path)


def test_the_unit_says_what_one_stands_for(tmp_path: Path) -> None:
    path = written(tmp_path, trimesh.creation.box((1, 1, 1)), "stl")
    for unit, metres in (("m", 1.0), ("in", 0.0254), ("0.1 mm", 1e-4), (2.0, 2.0)):
        assert pw.read_polyhedron(path, unit).volume == pytest.approx(
            metres**3, rel=DOUBLE, abs=0.0
        )
    with pytest.raises(QuantityError):
        pw.read_polyhedron(path, "parsec")
    with pytest.raises(FileFormatError, match=r"polywigner\.read_polyhedron"):
        pw.read_aperture(path)


def test_polygons_become_triangles_and_texture_seams_close(tmp_path: Path) -> None:
    """A pyramid on a quad, with a seam: vertices repeated for the sake of a texture."""
    path = tmp_path / "pyramid.obj"
    path.write_text(
        "mtllib missing.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 .5 1\nv 0 0 0\nv -0 1 0\n"
        "vt 0 0\nvt 1 1\nusemtl red\nf 4 3 2 1\nf 1/1 2/2 5/1\nf 2 3 5\nf 3 4 5\nf 7 6 5\n"
    )
    body = pw.read_polyhedron(path)
    assert len(body.vertices) == 5 and len(body.faces) == 6
    assert body.volume == pytest.approx(1e-9 / 3, rel=DOUBLE, abs=0.0)


def test_a_body_turned_inside_out_is_turned_back(tmp_path: Path) -> None:
    box = trimesh.creation.box(SIDES)
    box.invert()
    assert pw.read_polyhedron(written(tmp_path, box, "ply")).volume == pytest.approx(
        6e-9, rel=DOUBLE, abs=0.0
    )


def _stl(triangles: np.ndarray, announced: int | None = None) -> bytes:
    count = len(triangles) if announced is None else announced
    facets = b"".join(
        struct.pack("<12fH", 0, 0, 0, *triangle.reshape(-1), 0) for triangle in triangles
    )
    return bytes(80) + struct.pack("<I", count) + facets


BOX = np.asarray(trimesh.creation.box(SIDES).triangles)
PLY = (
    "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
)
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\n"

BAD = {
    "noise.stl": (bytes(range(256)) * 3, FileFormatError, "84 \\+ 50 n bytes"),
    "cut.stl": (_stl(BOX)[:-7], FileFormatError, "announce 12 triangles"),
    "claims.stl": (_stl(BOX, 10**9), FileFormatError, "announce 1000000000 triangles"),
    "none.stl": (_stl(BOX[:0]), FileFormatError, "triangles, got none"),
    "open.stl": (_stl(BOX[:-1]), GeometryError, "closed surface.*add the missing face"),
    "flipped.stl": (
        _stl(np.concatenate([BOX[:-1], BOX[-1:, ::-1]])), GeometryError, "consistently oriented",
    ),
    "twice.stl": (_stl(np.concatenate([BOX, BOX])), GeometryError, "consistently oriented"),
    "flat.stl": (_stl(np.concatenate([BOX[:1], BOX[:1, ::-1]])), GeometryError, "zero volume"),
    "nan.stl": (_stl(np.where(BOX == 0.5, np.nan, BOX)), FileFormatError, "finite"),
    "many.stl": (_stl(np.zeros((200_001, 3, 3))), FileFormatError, "at most 200000 triangles"),
    "words.stl": (
        b"solid a\nfacet\nvertex 0 zero 0\nendsolid a\n", FileFormatError, "cut short",
    ),
    "ascii claims.ply": (
        (PLY.format("ascii", 10**9, 1) + "0 0 0\n").encode(), FileFormatError, "got fewer",
    ),
    "binary claims.ply": (
        PLY.format("binary_big_endian", 9, 10**9).encode() + bytes(99), FileFormatError,
        "announces, got fewer",
    ),
    "number.ply": (
        (PLY.format("ascii", 3, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n").encode(), FileFormatError,
        "vertex numbers up to 3",
    ),
    "points.obj": (b"v 0 0 0\nv 1 0 0\n", FileFormatError, "none"),
    "zeros.obj": (b"v 0 0 0\0\n", FileFormatError, "OBJ as text, got zeros"),
    "many.obj": (b"v 0 0 0\n" + b"f 1 1 1\n" * 200_001, FileFormatError, "200000 triangles"),
    "huge.obj": ((TETRAHEDRON + "f 1 4 3\n").replace("v 1 0", "v 1e200 0").encode(),
                 FileFormatError, "below 1e\\+100"),
    "number.obj": ((TETRAHEDRON + "f 1 4 33\n").encode(), FileFormatError, "OBJ"),
    "aperture.svg": (b"<svg/>", FileFormatError, "polywigner.read_aperture"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_body_raises_one_error(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str
) -> None:
    content, kind, words = BAD[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(kind, match=words) as raised:
        pw.read_polyhedron(path)
    assert str(raised.value).startswith(f"{path}: expected")
    assert "\n" not in str(raised.value)
    assert capfd.readouterr() == ("", "")


def test_open_meshes_are_plates_of_what_lies_in_one_plane(tmp_path: Path) -> None:
    path = tmp_path / "open.obj"  # a box without its lid, all sides of two triangles, but one
    corners = [(x, y, z) for x in (0, 3) for y in (0, 2) for z in (0, 1)]
    quads = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5"]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {quad}" for quad in quads]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(GeometryError, match="read_sheets"):
        pw.read_polyhedron(path, "m")
    plates = pw.read_sheets(path, "m")
    turned = path.read_text().replace("f 5 7 8 6", "f 5 7 8\nf 6 8 5")  # a facet's other side
    path.write_text(turned)
    assert len(pw.read_sheets(path, "m")) == len(plates)
    assert sorted(round(plate.area, 9) for plate in plates) == [2, 2, 3, 3, 6]
    for plate in plates:
        ring = np.column_stack([plate.aperture.rings[0], np.zeros(4), np.ones(4)])
        placed = (ring @ plate.pose.T)[:, :3]
        assert {tuple(place) for place in placed.round(9) + 0.0} <= set(corners)
    path.write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    with pytest.raises(GeometryError, match="triangles with an area"):
        pw.read_sheets(path)
