"""Bodies from STL, PLY and OBJ files: closed surfaces, concave faces and rounded corners.

Reference areas and volumes are computed with the shoelace formula.
"""

from __future__ import annotations

import itertools
import math
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import (
    FileFormatError,
    GeometryError,
    PolywignerWarning,
    QuantityError,
)

DATA = Path(__file__).parent / "data" / "readers"

# Rounding error of sums of ten products, scaled to metres.
ROUNDING = 1e-12

COMB = [(0, 0), (7, 0), (7, 4), (6, 4), (6, 1), (4, 1), (4, 5), (3, 5), (3, 1), (1, 1), (1, 3),
        (0, 3)]  # fmt: skip
ARROW = [(0, 0), (4, 1), (0, 2), (1, 1)]
SPIRAL = [(0, 0), (6, 0), (6, 6), (1, 6), (1, 2), (4, 2), (4, 4), (3, 4), (3, 3), (2, 3), (2, 5),
          (5, 5), (5, 1), (0, 1)]  # fmt: skip
# Ring with some corners that lie on straight lines between their neighbours.
STRAIGHT = [(2, 0), (4, 0), (4, 3), (2, 3), (2, 2), (1, 2), (0, 2), (0, 0)]
RINGS = {"comb": COMB, "arrow": ARROW, "spiral": SPIRAL, "straight": STRAIGHT}


def shoelace(ring) -> float:
    x, y = np.array(ring, float).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def prism(ring, height: float, first: int = 0):
    """Return vertices and faces of a prism, whose lids begin at the corner `first`."""
    n = len(ring)
    points = [(*p, z) for z in (0, height) for p in ring]
    lid = [(first + k) % n for k in range(n)]
    sides = [[k, (k + 1) % n, (k + 1) % n + n, k + n] for k in range(n)]
    return np.array(points, float), [lid[::-1], [k + n for k in lid], *sides]


def obj(points, faces) -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(points).tolist()]
    lines += ["f " + " ".join(str(k + 1) for k in face) for face in faces]
    return ("\n".join(lines) + "\n").encode()


def ply(points, faces, form: str = "ascii", extra: bool = False) -> bytes:
    """Return a PLY file; ``extra`` adds normals, edges and further properties of faces."""
    order = {"binary_big_endian": ">", "binary_little_endian": "<", "ascii": ""}[form]
    head = ["ply", f"format {form} 1.0", f"element vertex {len(points)}"]
    head += [f"property double {axis}" for axis in "xyz"]
    head += ["property uchar red", "element edge 1", "property short a"] if extra else []
    head += [f"element face {len(faces)}"] + ["property float quality"] * extra
    head += ["property list uchar uint vertex_indices"]
    head += ["property list uchar float texcoord"] * extra + ["end_header", ""]
    out = "\n".join(head).encode()
    rows = [("ddd" + "B" * extra, [*point, *[7] * extra]) for point in np.asarray(points).tolist()]
    rows += [("h", [3])] * extra
    for face in faces:
        form_of_row = "f" * extra + f"B{len(face)}I" + "B2f" * extra
        rows.append((form_of_row, [*[0.5] * extra, len(face), *face, *[2, 0.25, 0.5] * extra]))
    if not order:
        return out + "\n".join(" ".join(map(repr, values)) for _, values in rows).encode() + b"\n"
    return out + b"".join(struct.pack(order + row, *values) for row, values in rows)


def stl(corners) -> bytes:
    """Return a text file for triangles (n, 3, 3)."""
    facets = [
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x!r} {y!r} {z!r}\n" for x, y, z in triangle)
        + "endloop\nendfacet\n"
        for triangle in np.asarray(corners, float).tolist()
    ]
    return ("solid a b\n" + "".join(facets) + "endsolid a b\n").encode()


def binary_stl(corners) -> bytes:
    rows = [struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in np.asarray(corners, np.float32)]
    return bytes(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def box(a, b, inverted: bool = False) -> np.ndarray:
    """Return the twelve triangles of a box between two corners."""
    points = np.array(list(itertools.product(*zip(a, b, strict=True))), float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = points[[t for q in quads for t in (q[:3], (q[0], q[2], q[3]))]]
    return triangles[:, ::-1] if inverted else triangles


SIDES = np.array([1.0, 2.0, 3.0])  # millimetres


def centred(kind: str, sides=SIDES, inverted: bool = False) -> bytes:
    """A box about the origin as a file of this kind."""
    corners = box(-np.asarray(sides) / 2, np.asarray(sides) / 2, inverted)
    vertices, faces = corners.reshape(-1, 3), np.arange(36).reshape(12, 3).tolist()
    return {
        "binary.stl": lambda: binary_stl(corners), "text.STL": lambda: stl(corners),
        "binary.ply": lambda: ply(vertices, faces, "binary_little_endian"),
        "text.ply": lambda: ply(vertices, faces), "a.obj": lambda: obj(vertices, faces),
    }[kind]()  # fmt: skip


KINDS = ("binary.stl", "text.STL", "binary.ply", "text.ply", "a.obj")


@pytest.fixture
def written(tmp_path: Path):
    def write(name: str, content: bytes) -> Path:
        path = tmp_path / name
        path.write_bytes(content)
        return path

    return write


def surface(body: pw.Polyhedron) -> float:
    corners = body.vertices[body.triangles]
    normals = np.cross(*np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0))
    return float(np.linalg.norm(normals, axis=1).sum()) / 2


@pytest.mark.parametrize("name", RINGS)
def test_faces_of_any_outline_are_covered_once_from_any_first_corner(written, name: str) -> None:
    ring, height = RINGS[name], 1.5
    sides = sum(math.dist(a, b) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)) * height
    area, volume = 2 * shoelace(ring) + sides, shoelace(ring) * height
    for first in range(len(ring)):
        content = prism(ring, height, first)
        direct = pw.Polyhedron(*content)
        assert surface(direct) == pytest.approx(area, rel=ROUNDING)
        assert direct.volume == pytest.approx(volume, rel=ROUNDING)
        if first % 5:  # files of every fifth one
            continue
        for path in (
            written("a.obj", obj(*content)),
            written("a.ply", ply(*content)),
            written("b.ply", ply(*content, "binary_big_endian")),
        ):
            body = pw.read_polyhedron(path)
            assert surface(body) == pytest.approx(area * 1e-6, rel=ROUNDING, abs=0.0)
            assert body.volume == pytest.approx(volume * 1e-9, rel=ROUNDING, abs=0.0)
            plates = sum(plate.aperture.area for plate in pw.read_sheets(path))
            assert plates == pytest.approx(area * 1e-6, rel=1e-9, abs=0.0)


def test_the_files_of_reported_faults_have_their_areas_and_volumes() -> None:
    assert sum(s.aperture.area for s in pw.read_sheets(DATA / "L_prism.obj")) == pytest.approx(
        22e-6
    )
    for name, cubic_mm, tolerance in (
        ("tiny.stl", 6000, ROUNDING),
        ("endsolid.stl", 6, ROUNDING),
        ("hex.ply", 3 * 0.866025, ROUNDING),
        ("mixq.ply", 1.5 * 3**0.5, ROUNDING),
        ("letrail.ply", 6, ROUNDING),
    ):
        volume = pw.read_polyhedron(DATA / name).volume
        assert volume == pytest.approx(cubic_mm * 1e-9, rel=tolerance, abs=0.0), name


def test_an_edge_run_along_twice_leads_to_a_hole(written) -> None:
    outer, inner = [(0, 0), (6, 0), (6, 5), (0, 5)], [(1, 1), (1, 3), (4, 3), (4, 1)]
    points = [(*p, 0.0) for p in outer + inner]
    path = written("a.obj", obj(points, [[0, 1, 2, 3, 0, 4, 5, 6, 7, 4]]))
    assert sum(s.aperture.area for s in pw.read_sheets(path)) == pytest.approx(24e-6, rel=1e-9)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("extra", [False, True])
def test_ply_faces_of_different_sizes_and_other_properties(written, form: str, extra: bool) -> None:
    hexagon = [(math.cos(k * math.pi / 3), math.sin(k * math.pi / 3)) for k in range(6)]
    path = written("a.ply", ply(*prism(hexagon, 2.5), form, extra))
    exact = shoelace(hexagon) * 2.5e-9
    assert pw.read_polyhedron(path).volume == pytest.approx(exact, rel=ROUNDING, abs=0.0)


def test_obj_corners_count_back_and_carry_textures_and_normals(written) -> None:
    text = b"o x\nv 0 0 0 1 0 0\nv 3 0 0\nv 3 2 0 \\\n\nv 0 2 0\nvt 0 0\nvn 0 0 1\ng y\n"
    path = written("a.obj", text + b"f -4/1/1 -3//1 -2/1 -1 # a comment\nl 1 2\n")
    assert sum(s.aperture.area for s in pw.read_sheets(path)) == pytest.approx(6e-6)


def test_obj_files_with_free_form_surfaces_are_refused(written) -> None:
    text = b"v 0 0 0\nv 3 0 0\nv 3 2 0\nf 1 2 3\nsurf 0 1 0 1 1 2 3\n"
    with pytest.raises(FileFormatError, match="free-form curves or surfaces"):
        pw.read_sheets(written("a.obj", text))


def test_a_face_that_is_not_planar_is_warned_of_and_stays_closed(written) -> None:
    points, faces = prism([(0, 0), (3, 0), (3, 2), (0, 2)], 1)
    points[6, 2] = 1.25
    path = written("a.obj", obj(points, faces))
    with pytest.warns(PolywignerWarning, match="face 1 of the mesh is not planar"):
        volume = pw.read_polyhedron(path).volume
    # The lifted corner belongs to one or to both triangles of the lid, depending on the diagonal.
    assert min(abs(volume * 1e9 - v) for v in (6 + 0.25 * 3 / 3, 6 + 0.25 * 6 / 3)) < 1e-9


def test_a_face_that_crosses_itself_is_refused(written) -> None:
    path = written("a.obj", b"v 0 0 0\nv 2 2 0\nv 2 0 0\nv 0 3 0\nf 1 2 3 4\n")
    with pytest.raises(GeometryError, match="cross themselves, got face 0"):
        pw.read_sheets(path)


@pytest.mark.parametrize("noise", [1e-16, 1e-14, 1e-12])
def test_corners_that_are_equal_up_to_rounding_are_one(written, noise: float) -> None:
    corners = box((-20, 0, 0), (20, 30, 7))
    random = np.random.default_rng(4)
    noisy = corners + noise * 40 * random.uniform(-1, 1, corners.shape)
    faces = np.arange(36).reshape(12, 3)
    for path in (
        written("a.stl", stl(noisy)),
        written("a.obj", obj(noisy.reshape(-1, 3), faces.tolist())),
        written("a.ply", ply(noisy.reshape(-1, 3), faces.tolist(), "binary_little_endian")),
    ):
        body = pw.read_polyhedron(path)
        assert len(body.vertices) == 8
        assert body.volume == pytest.approx(8400e-9, rel=100 * noise + ROUNDING, abs=0.0)


def test_corners_rounded_up_and_down_in_single_precision_are_one(written) -> None:
    corners = np.float32(box((0.1, 0.2, 100.3), (1.1, 3.3, 100.9)))
    random = np.random.default_rng(5)
    up = np.nextafter(corners, np.float32(1e9))
    noisy = np.where(random.random(corners.shape) < 0.5, up, corners)
    volume = pw.read_polyhedron(written("a.stl", binary_stl(noisy))).volume
    assert volume == pytest.approx(1 * 3.1 * 0.6 * 1e-9, rel=1e-4)


def test_a_foil_of_a_millionth_of_the_size_keeps_both_sides(written) -> None:
    for path in (
        written("a.stl", stl(box((0, 0, 0), (1000, 1000, 0.001)))),
        written("b.stl", binary_stl(box((0, 0, 0), (1000, 1000, 0.001)))),
    ):
        assert pw.read_polyhedron(path).volume == pytest.approx(1000e-9, rel=1e-6)


@pytest.mark.parametrize(
    "end", ["endsolid", "endsolid a b", "end solid a b", "ENDSOLID\r\n\r\n", "endsolid\n  "]
)
def test_stl_as_text_ends_in_several_ways(written, end: str) -> None:
    text = stl(box((0, 0, 0), (2, 3, 4))).replace(b"endsolid a b\n", end.encode())
    assert pw.read_polyhedron(written("a.stl", text)).volume == pytest.approx(24e-9)


def test_stl_as_text_without_its_end_is_refused(written) -> None:
    text = stl(box((0, 0, 0), (2, 3, 4)))
    for content in (text.replace(b"endsolid a b\n", b""), (DATA / "noend.stl").read_bytes()):
        for read in (pw.read_polyhedron, pw.read_sheets):
            with pytest.raises(FileFormatError, match="ends with the line endsolid"):
                read(written("a.stl", content))
    half = text[: text.index(b"endloop", 900)]
    with pytest.raises(FileFormatError, match="three vertices in each facet"):
        pw.read_sheets(written("a.stl", half))


OUTER, INNER, CORE = ((0, 0, 0), (9, 9, 9)), ((2, 2, 2), (7, 7, 7)), ((4, 3, 3), (5, 6, 6))
APART = ((20, 0, 0), (22, 3, 4))


@pytest.mark.parametrize("turned", list(itertools.product([False, True], repeat=4)))
def test_each_closed_surface_is_oriented_by_what_lies_around_it(written, turned) -> None:
    """A box with a cavity, a box in the cavity and a separate box are each tested inside out."""
    boxes = [box(*ends, t) for ends, t in zip((OUTER, INNER, CORE, APART), turned, strict=True)]
    body = pw.read_polyhedron(written("a.stl", stl(np.concatenate(boxes))))
    assert body.volume == pytest.approx((729 - 125 + 9 + 24) * 1e-9, rel=ROUNDING, abs=0.0)
    corners = body.vertices[body.triangles]
    normals = np.cross(*np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0))
    flux = (normals * corners.mean(axis=1)).sum() / 6  # divergence theorem for x: 3 V
    assert flux == pytest.approx(body.volume, rel=1e-9)


def test_a_surface_in_a_body_that_faces_the_same_way_is_warned_of(written) -> None:
    for turned in (False, True):
        boxes = np.concatenate([box(*OUTER, turned), box(*INNER, turned)])
        with pytest.warns(PolywignerWarning, match="counts as a cavity"):
            body = pw.read_polyhedron(written("a.stl", stl(boxes)))
        assert body.volume == pytest.approx((729 - 125) * 1e-9, rel=ROUNDING, abs=0.0)
        boxes = np.concatenate([box(*OUTER, turned), box(*INNER, not turned)])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            pw.read_polyhedron(written("a.stl", stl(boxes)))


@pytest.mark.parametrize("inverted", [False, True])
def test_bodies_that_touch_or_overlap_are_no_cavities(written, inverted: bool) -> None:
    """The boxes lie in a notch, along an edge, and half inside another box."""
    notched = prism([(0, 0), (9, 0), (9, 9), (6, 9), (6, 6), (3, 6), (3, 9), (0, 9)], 9)
    triangles = pw.Polyhedron(*notched)
    notch = triangles.vertices[triangles.triangles]
    cases = [
        (((3.5, 6.5, 1), (5, 8, 2)), 2.25),
        (((9, 9, 0), (10, 11, 9)), 18),
        (((8, 1, 1), (10, 2, 2)), 2),
    ]
    for ends, more in cases:
        content = stl(np.concatenate([notch, box(*ends, inverted)]))
        volume = pw.read_polyhedron(written("a.stl", content)).volume
        assert volume == pytest.approx((648 + more) * 1e-9, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_box_has_its_volume_and_its_transform_is_a_product_of_sinc(written, kind: str) -> None:
    for inverted in (False, True):
        body = pw.read_polyhedron(written(kind, centred(kind, inverted=inverted)))
        assert len(body.vertices) == 8 and len(body.faces) == 12
        assert body.volume == pytest.approx(6e-9, rel=ROUNDING, abs=0.0)
        nu = np.random.default_rng(3).normal(0, 500, (50, 3))
        exact = 6e-9 * np.prod(np.sinc(nu * SIDES / 1000), axis=-1)
        assert np.abs(pw.fourier(body, nu) - exact).max() < ROUNDING * 6e-9


def test_a_pierced_body_keeps_its_tunnel(written) -> None:
    """The body is a frame of 6 x 6 with a tunnel of 2 x 2 and a height of 1."""
    rings = [[(-s, -s), (s, -s), (s, s), (-s, s)] for s in (3, 1)]
    points = [(*p, z) for z in (0, 1) for ring in rings for p in ring]
    faces = []
    for k in range(4):
        n = (k + 1) % 4
        faces += [[k, n, n + 8, k + 8], [n + 4, k + 4, k + 12, n + 12]]
        faces += [[n, k, k + 4, n + 4], [k + 8, n + 8, n + 12, k + 12]]
    for path in (written("a.obj", obj(points, faces)), written("a.ply", ply(points, faces))):
        volume = pw.read_polyhedron(path, unit="cm").volume
        assert volume == pytest.approx(32e-6, rel=ROUNDING, abs=0.0)


def test_scenes_take_stl_meshes_in_their_pose(written, tmp_path: Path) -> None:
    """Rays hit two boxes, of which the second is mirrored."""
    pm = pytest.importorskip("polywigner.mitsuba")
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    written("body.stl", centred("binary.stl"))
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
        result = scene.ray_intersect(mi.Ray3f([x, 0.3, 0.0], [0, 0, 1]))
        assert result.t == pytest.approx(distance, rel=2e-7)
        assert np.allclose(result.n, [0, 0, -1])  # outwards
    (tmp_path / "body.stl").write_bytes(b"solid of nothing")
    with pytest.raises(FileFormatError, match=r"body\.stl"):
        pm.load_scene(path)


def test_the_unit_says_what_one_stands_for(written) -> None:
    path = written("a.stl", centred("binary.stl", (1, 1, 1)))
    for unit, metres in (("m", 1.0), ("in", 0.0254), ("0.1 mm", 1e-4), (2.0, 2.0)):
        volume = pw.read_polyhedron(path, unit).volume
        assert volume == pytest.approx(metres**3, rel=ROUNDING, abs=0.0)
    with pytest.raises(QuantityError):
        pw.read_polyhedron(path, "parsec")
    with pytest.raises(FileFormatError, match=r"polywigner\.read_polyhedron"):
        pw.read_aperture(path)


def test_polygons_become_triangles_and_texture_seams_close(written) -> None:
    """The body is a pyramid with a texture seam, along which vertices are repeated."""
    path = written(
        "pyramid.obj",
        b"mtllib missing.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 .5 1\nv 0 0 0\nv -0 1 0\n"
        b"vt 0 0\nvt 1 1\nusemtl red\nf 4 3 2 1\nf 1/1 2/2 5/1\nf 2 3 5\nf 3 4 5\nf 7 6 5\n",
    )
    body = pw.read_polyhedron(path)
    assert len(body.vertices) == 5 and len(body.faces) == 6
    assert body.volume == pytest.approx(1e-9 / 3, rel=ROUNDING, abs=0.0)


BOX = box(-SIDES / 2, SIDES / 2)


def announced(count: int) -> bytes:
    content = binary_stl(BOX)
    return content[:80] + struct.pack("<I", count) + content[84:]


PLY = (
    "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
)
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\n"

BAD = {
    "cut.stl": (binary_stl(BOX)[:-7], FileFormatError, "12 triangles in the header"),
    "claims.stl": (announced(10**9), FileFormatError, "1000000000 triangles in the header"),
    "none.stl": (binary_stl(BOX[:0]), FileFormatError, "contains no triangles"),
    "open.stl": (binary_stl(BOX[:-1]), GeometryError, "closed surface.*add the missing face"),
    "flipped.stl": (
        binary_stl([*BOX[:-1], BOX[-1, ::-1]]), GeometryError, "consistently oriented",
    ),
    "twice.stl": (binary_stl([*BOX, *BOX]), GeometryError, "each face only once"),
    "flat.stl": (binary_stl([BOX[0], BOX[0, ::-1]]), GeometryError, "volume of zero"),
    "nan.stl": (binary_stl(np.where(BOX == 0.5, np.nan, BOX)), FileFormatError, "finite"),
    "many.stl": (binary_stl(np.zeros((200_001, 3, 3))), FileFormatError, "200000 triangles"),
    "words.stl": (
        b"solid a\nfacet\nvertex 0 zero 0\nendsolid a\n", FileFormatError, "truncated",
    ),
    "ascii claims.ply": (
        (PLY.format("ascii", 10**9, 1) + "0 0 0\n").encode(), FileFormatError, "got fewer",
    ),
    "binary claims.ply": (
        PLY.format("binary_big_endian", 9, 10**9).encode() + bytes(99), FileFormatError,
        "specifies, got fewer",
    ),
    "number.ply": (
        (PLY.format("ascii", 3, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n").encode(), FileFormatError,
        "vertex numbers up to 3",
    ),
    "points.obj": (b"v 0 0 0\nv 1 0 0\n", FileFormatError, "contains no triangles"),
    "zeros.obj": (b"v 0 0 0\0\n", FileFormatError, "do not follow the format"),
    "many.obj": (b"v 0 0 0\n" + b"f 1 1 1\n" * 200_001, FileFormatError, "200000 triangles"),
    "huge.obj": ((TETRAHEDRON + "f 1 4 3\n").replace("v 1 0", "v 1e200 0").encode(),
                 FileFormatError, "below 1e\\+100"),
    "number.obj": ((TETRAHEDRON + "f 1 4 33\n").encode(), FileFormatError, "OBJ"),
    "aperture.svg": (b"<svg/>", FileFormatError, "polywigner.read_aperture"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_body_raises_one_error(tmp_path: Path, name: str) -> None:
    content, kind, words = BAD[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(kind, match=words) as raised:
        pw.read_polyhedron(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)


def test_open_meshes_are_plates_of_what_lies_in_one_plane(tmp_path: Path) -> None:
    path = tmp_path / "open.obj"  # a box without its lid
    corners = [(x, y, z) for x in (0, 3) for y in (0, 2) for z in (0, 1)]
    quads = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5"]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {quad}" for quad in quads]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(GeometryError, match="read_sheets"):
        pw.read_polyhedron(path, "m")
    plates = pw.read_sheets(path, "m")
    turned = path.read_text().replace("f 5 7 8 6", "f 5 7 8\nf 6 8 5")  # opposite orientation
    for far in ("", "1000000"):  # digits before the x coordinates
        path.write_text(turned.replace("v ", f"v {far}"))
        assert len(pw.read_sheets(path, "m")) == len(plates)
    assert sorted(round(plate.area, 9) for plate in plates) == [2, 2, 3, 3, 6]
    for plate in plates:
        ring = np.column_stack([plate.aperture.rings[0], np.zeros(4), np.ones(4)])
        placed = (ring @ plate.pose.T)[:, :3]
        assert {tuple(place) for place in placed.round(9) + 0.0} <= set(corners)
    path.write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    with pytest.raises(GeometryError, match="triangles with nonzero area"):
        pw.read_sheets(path)
