"""Files that ask for much more than their size suggests: refused before the work, not after it.

What is counted is asserted, and how much memory Python takes; times depend on the machine, and
``make fuzz`` reports them.
"""

from __future__ import annotations

import os
import struct
import tracemalloc
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import shapely

import polywigner as pw
from polywigner.errors import FileFormatError, PolywignerError, SceneError
from polywigner.geometry.exact import (
    area_and_error,
    estimated_area,
    orientations,
    signed_area,
    turn,
)
from polywigner.geometry.io.outlines import Work, nested
from polywigner.geometry.parts import groups_apart, union_on_grid
from polywigner.geometry.rings import without_slight_bends

MIB = 2**20

# What reading a file of some hundred kB may take at most, where a limit stops it.
SOME_MEMORY = 80 * MIB

# Of areas near 100: some hundred vertices, each rounded to a grid of 1e-12.
AREA_ROUNDING = 1e-9


@contextmanager
def memory_below(most: int) -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def refusal(path: Path, content: bytes | str, words: str, read=pw.read_aperture) -> str:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(PolywignerError, match=words) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


# SVG


def test_a_dtd_that_declares_attributes_is_refused_before_they_are_copied(tmp_path: Path) -> None:
    pytest.importorskip("defusedxml")
    default = "x" * 20_000
    text = f'<!DOCTYPE svg [<!ATTLIST g a CDATA "{default}">]><svg>{"<g/>" * 20_000}</svg>'
    with memory_below(SOME_MEMORY):
        refusal(tmp_path / "a.svg", text, "without entities or other declarations")


def test_transforms_are_counted_with_repetitions(tmp_path: Path) -> None:
    pytest.importorskip("defusedxml")
    group = f'<g id="g" transform="{"scale(1)" * 50_001}"/><use href="#g"/>'
    refusal(tmp_path / "a.svg", f"<svg>{group}</svg>", "at most 100000 transforms")


# Outlines


def test_few_sparse_edges_before_many_dense_ones_take_little_memory() -> None:
    sparse = np.column_stack([np.arange(2000.0) + 10, np.arange(2000) % 2 + 10.0])
    heap = np.random.default_rng(1).random((3000, 2))
    with memory_below(5 * SOME_MEMORY), pytest.raises(FileFormatError, match="20000 places where"):
        Work().check_edges([np.concatenate([sparse, heap])])


def _star(count: int) -> list[complex]:
    """A ring that all of its edges but neighbours cross; `count` odd."""
    return [np.exp(1j * np.pi * (count - 1) / count * k) for k in range(count)]


def test_crossings_are_counted_for_all_shapes_of_a_file(tmp_path: Path) -> None:
    """Three stars of 10 010 crossings, none of which is too much alone."""
    pytest.importorskip("gerbonara")
    regions = ""
    for shift in (0, 3_000_000, 6_000_000):
        star = [*_star(143), _star(143)[0]]
        places = [f"X{round(1e6 * p.real) + shift}Y{round(1e6 * p.imag)}" for p in star]
        regions += f"G36*{places[0]}D02*{''.join(f'{at}D01*' for at in places[1:])}G37*"
    text = f"%FSLAX36Y36*%%MOMM*%G01*{regions}M02*"
    refusal(tmp_path / "a.gbr", text, "at most 20000 places where outlines cross")


def test_the_sign_of_an_area_and_whether_it_is_zero_are_exact() -> None:
    """Slivers far from the origin, whose areas floating point rounds away, and spans of discs."""
    dice = np.random.default_rng(4)
    for _ in range(200):
        ring = dice.random((3, 2)) * 2.0 ** dice.integers(-40, 40) + dice.choice([0.0, 1e6])
        ring[2] = ring[0] + (ring[1] - ring[0]) * dice.random()
        exact = signed_area(ring)
        area, error = area_and_error(ring)
        assert abs(area - exact) <= error
        assert np.sign(estimated_area(ring)) == np.sign(exact)


def test_groups_are_apart_along_x_or_y_by_more_than_the_gap() -> None:
    lattice = [shapely.box(3 * i, 3 * j, 3 * i + 2, 3 * j + 2) for i in range(9) for j in range(9)]
    bridge = [shapely.box(1, 1, 4, 2)]
    groups = groups_apart([*lattice, *bridge], 0.0)
    assert sorted(map(len, groups)) == [1] * 79 + [3]
    assert sorted(np.concatenate(groups).tolist()) == list(range(82))
    assert len(groups_apart(lattice, 1.5)) == 1


def test_a_union_of_groups_is_that_of_all() -> None:
    discs = [shapely.Point(k % 9 * 1.7, k // 9 * 2.5).buffer(1) for k in range(45)]
    assert abs(union_on_grid(discs).area - shapely.union_all(discs).area) < AREA_ROUNDING
    assert len(union_on_grid(discs).geoms) == 5


def _squares(count: int) -> list[np.ndarray]:
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return [corners * (k + 1) for k in range(count)]


def test_squares_in_squares_are_rings_by_turns() -> None:
    polygons = nested(_squares(41))
    assert len(polygons) == 21
    assert sorted(len(rings) for rings in polygons) == [1, *[2] * 20]


def test_very_many_outlines_inside_each_other_are_refused() -> None:
    with pytest.raises(FileFormatError, match="2000000 pairs of near outlines"):
        nested(_squares(2100))


def test_a_small_outline_beside_one_of_many_vertices_counts_its_vertices(tmp_path: Path) -> None:
    top = ", ".join(f"{k} {1e-3 * (k % 2)}" for k in range(30_000))
    big = f"(({top}, 29999 -5, 0 -5, 0 0))"
    small = [f"(({k} -6, {k}.5 -6, {k}.5 -5, {k} -5, {k} -6))" for k in range(7000)]
    text = f"MULTIPOLYGON ({big}, {', '.join(small)})"
    refusal(tmp_path / "a.wkt", text, "200000000 vertices of such pairs")


# Text


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", b"," * 100_000, "at most 65536 characters, got 100000 in line 1"),
        ("a.csv", b"0,0" + b"\r" * 1_000_001, "at most 1000000 vertices"),
        ("a.geojson", b"[" + b"1," * 6_000_001 + b"1]", "at most 6000000 values"),
        ("a.json", b"[" + b"1," * 6_000_001 + b"1]", "at most 6000000 values"),
    ],
    ids=["separators", "line ends", "numbers", "numbers of a source"],
)
def test_text_is_counted_before_it_is_split(
    tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    read = pw.read_source if name == "a.json" else pw.read_aperture
    with memory_below(SOME_MEMORY), pytest.raises(FileFormatError, match=words):
        read(path)


SECRETS = {
    "secret.csv": "root:hunter2hash:0:0\nuser:swordfish:1:1\n",
    "columns.csv": "1,2,hunter2hash\n",
    "secret.wkt": "hunter2hash",
    "inner.wkt": "POLYGON ((0 0, hunter2hash 1))",
    "secret.geojson": '{"password": hunter2hash}',
    "type.geojson": '{"type": "hunter2hash"}',
    "position.geojson": '{"type": "Polygon", "coordinates": [[["hunter2hash", 1]]]}',
    "secret.svg": "<password>hunter2hash</password>",
    "tag.svg": "<hunter2hash/>",
    "entity.svg": "<svg>&hunter2hash;</svg>",
    "secret.gbr": "hunter2hash",
    "statement.gbr": "hunter2hash*",
    "word.gbr": "HUNTER2hash=1*",
    "begun.gbr": "%FSLAX36Y36*%\n%MOMM*%\nPASSWORD=hunter2hash*\nM02*\n",
    "ended.gbr": "%FSLAX36Y36*%\n%MOMM*%\nM02*\nHUNTER2*\n",
    "extended.gbr": "%FSLAX36Y36*%\n%PWhunter2hash*%\nM02*\n",
    "macro.gbr": "%MOMM*%\n%AMhunter2*swordfish*%\nM02*\n",
    "include.gbr": "%IFhunter2hash*%\nM02*\n",
    "secret.dxf": "hunter2hash\nhunter2hash\n",
    "secret.ply": "ply\nhunter2hash\n",
    "secret.obj": "v hunter2hash 1 2\nf 1 1 1\n",
    "secret.stl": "solid\nfacet normal\nvertex hunter2hash\n",
    "secret.toml": "password = hunter2hash",
    "key.toml": "hunter2hash = 1\nhunter2hash = 2",
    "table.toml": "version = 'hunter2hash'",
    "secret.json": '{"password": "hunter2hash",}',
    "kind.json": '{"frequency": "hunter2hash"}',
}


@pytest.mark.parametrize("name", SECRETS)
def test_errors_do_not_quote_files_of_another_kind(tmp_path: Path, name: str) -> None:
    pytest.importorskip("ezdxf")
    pytest.importorskip("trimesh")
    readers = {".toml": pw.read_source, ".json": pw.read_source}
    readers |= dict.fromkeys((".ply", ".obj", ".stl"), pw.read_polyhedron)
    read = readers.get(Path(name).suffix, pw.read_aperture)
    message = refusal(tmp_path / name, SECRETS[name], "expected", read)
    for secret in ("hunter2", "HUNTER2", "swordfish", "root"):
        assert secret not in message.removeprefix(str(tmp_path))


# Bodies

CUBE = (
    "0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n",
    "4 3 2 1 0\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n",
)


def _ply(body: bytes, vertices: int = 8, faces: int = 6, kind: str = "ascii") -> bytes:
    return (
        f"ply\nformat {kind} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {faces}\nproperty list uchar int vertex_indices\n"
        "end_header\n"
    ).encode() + body


def _binary_cube() -> bytes:
    numbers = [[int(n) for n in line.split()] for line in CUBE[1].splitlines()]
    points = np.array([float(x) for x in CUBE[0].split()], dtype="<f4").tobytes()
    return points + b"".join(struct.pack("<B4i", *row) for row in numbers)


def test_a_ply_that_holds_what_it_announces_is_read(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    path = tmp_path / "cube.ply"
    binary = _ply(_binary_cube(), kind="binary_little_endian")
    for content in (_ply("".join(CUBE).encode()), binary, binary + b"\n"):
        path.write_bytes(content)
        assert pw.read_polyhedron(path, "m").volume == 1


@pytest.mark.parametrize("cut", ["rows", "bytes", "announced", "binary announced", "more"])
def test_a_ply_that_holds_less_or_more_than_it_announces_is_refused(
    tmp_path: Path, cut: str
) -> None:
    pytest.importorskip("trimesh")
    text, binary = "".join(CUBE).encode(), "binary_little_endian"
    content = {
        "rows": _ply(text[:-10]),
        "bytes": _ply(_binary_cube()[:-1], kind=binary),
        "announced": _ply(text, faces=12),  # two cubes, of which one is there
        "binary announced": _ply(_binary_cube(), faces=12, kind=binary),
        "more": _ply(text, faces=5),
    }[cut]
    refusal(tmp_path / "a.ply", content, "which announces them", pw.read_polyhedron)


def test_faces_of_a_line_are_counted_as_triangles(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    face = b"v 0 0 0\nf" + b" 1" * 2000 + b"\n"
    refusal(tmp_path / "a.obj", face, "faces of at most 1000 vertices", pw.read_polyhedron)
    faces = b"v 0 0 0\n" + (b"f" + b" 1" * 900 + b"\n") * 300
    refusal(tmp_path / "b.obj", faces, "200000 triangles, got 269400", pw.read_polyhedron)


@pytest.mark.parametrize("types", ["list", "uchar list int", "list uchar list"])
def test_a_ply_of_types_that_are_none_is_refused(tmp_path: Path, types: str) -> None:
    pytest.importorskip("trimesh")
    content = _ply(_binary_cube(), kind="binary_little_endian")
    changed = content.replace(b"property list uchar int", f"property {types}".encode())
    assert changed != content
    refusal(tmp_path / "a.ply", changed, "PLY of numbers", pw.read_polyhedron)


def test_an_stl_with_a_facet_cut_short_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    facet = "facet normal 0 0 1\nouter loop\n" + "vertex 0 0 0\n" * 3 + "endloop\nendfacet\n"
    text = f"solid a\n{facet * 3}facet normal 0 0 1\nouter loop\nvertex 0 0 0\n"
    refusal(tmp_path / "a.stl", text, "three vertices in each facet", pw.read_polyhedron)


# Source files

SQUARE = '{kind = "aperture", shape = {name = "square", a = 1}}'


def test_products_of_tapers_are_counted_before_they_are_multiplied(tmp_path: Path) -> None:
    taper = '{kind = "taylor_taper", width = 1, height = 1, nbar = 60}'
    aperture = 'kind = "aperture"\nshape = {name = "square", a = 1}\n'
    text = f"{aperture}illumination = [{', '.join([taper] * 4)}]\n"
    with memory_below(SOME_MEMORY):
        refusal(tmp_path / "a.toml", text, "illumination: .*1000000 plane waves", pw.read_source)
    element = f"[[elements]]\n{aperture}illumination = {taper}\n"
    text = 'kind = "array"\n' + element * 90
    refusal(tmp_path / "b.toml", text, "element 7.: illumination: ", pw.read_source)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f'kind = "array"\nelements = [{",".join([SQUARE] * 10_001)}]', "at most 10000 elements"),
        ('kind = "aperture"\nshape = {name = "hexagonal_segments", flat_to_flat = 1, rings = 60}',
         "rings of at most 10000 segments"),
        ('kind = "aperture"\nshape = {name = "interferometer", radius = 1, n = 4096, '
         f'positions = [{",".join(["[0, 0]"] * 300)}]}}', "at most 1000000 vertices"),
        ("a." * 100 + "a = 1", "keys of a few names"),
        ("a = 1\n" * (2 * MIB), "at most 8 MiB of TOML"),
        (f'kind = "phased-array"\nelement = {SQUARE}\n'
         'positions = {kind = "grid", nx = 100000, ny = 100000, pitch_x = 1}', "1048576 elements"),
    ],
    ids=["elements", "hexagons", "discs", "long key", "size", "grid"],
)  # fmt: skip
def test_a_source_is_counted_before_it_is_made(tmp_path: Path, text: str, words: str) -> None:
    refusal(tmp_path / "a.toml", text, words, pw.read_source)


def _named(name: str) -> str:
    return f"kind = \"aperture\"\nfile = '{name}'\n"


def test_a_source_names_files_below_its_own_folder_alone(tmp_path: Path) -> None:
    inner = tmp_path / "source"
    (inner / "outlines").mkdir(parents=True)
    outline = "POLYGON ((0 0, 1 0, 1 1, 0 0))"
    for place in (tmp_path, inner / "outlines"):
        (place / "a.wkt").write_text(outline)
    (inner / "link.wkt").symlink_to(tmp_path / "a.wkt")
    (inner / "below.wkt").symlink_to(inner / "outlines" / "a.wkt")
    file = inner / "source.toml"
    for name in ("outlines/a.wkt", "outlines/../outlines/a.wkt", "below.wkt"):
        file.write_text(_named(name))
        assert isinstance(pw.read_source(file), pw.Aperture)
    for name in ("../a.wkt", str(tmp_path / "a.wkt"), "link.wkt", "/etc/passwd"):
        refusal(file, _named(name), "in the folder of the source file or below", pw.read_source)
    file.write_text(_named("../a.wkt"))
    assert isinstance(pw.read_source(file, allow_outside=True), pw.Aperture)


def test_a_source_in_a_folder_that_is_a_link_may_name_its_neighbours(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "a.wkt").write_text("POLYGON ((0 0, 1 0, 1 1, 0 0))")
    (tmp_path / "real" / "a.toml").write_text(_named("a.wkt"))
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert isinstance(pw.read_source(tmp_path / "link" / "a.toml"), pw.Aperture)


def test_one_file_under_many_names_is_read_once(tmp_path: Path) -> None:
    """Else their vertices would be too many together."""
    ring = [(k, 1e-3 * (k % 2)) for k in range(20_000)]
    (tmp_path / "a.csv").write_text(
        "".join(f"{x},{y}\n" for x, y in [*ring, (19_999, -9), (0, -9)])
    )
    elements = [f"[[elements]]\n{_named('./' * k + 'a.csv')}" for k in range(60)]
    (tmp_path / "a.toml").write_text('kind = "array"\n' + "".join(elements))
    array = pw.read_source(tmp_path / "a.toml")
    assert isinstance(array, pw.Array)
    assert len({id(element) for element in array.elements}) == 1


def test_the_command_line_reads_files_outside_when_told_to(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    from polywigner.cli import main
    from polywigner.cli.sources import SourceOptions

    (tmp_path / "inner").mkdir()
    (tmp_path / "a.wkt").write_text("POLYGON ((0 0, 1 0, 1 1, 0 0))")
    file = tmp_path / "inner" / "a.toml"
    file.write_text(_named("../a.wkt"))
    assert main(["transform", str(file), "--out", str(tmp_path / "out")]) == 2
    assert "--allow-outside" in capfd.readouterr().err
    assert isinstance(SourceOptions(str(file), allow_outside=True).read()[0], pw.Aperture)


# What is no file


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("suffix", [".csv", ".ply", ".toml", ".json", ".gds"])
def test_pipes_devices_and_folders_are_refused(tmp_path: Path, suffix: str) -> None:
    readers = {".toml": pw.read_source, ".json": pw.read_source, ".ply": pw.read_polyhedron}
    read = readers.get(suffix, pw.read_aperture)
    os.mkfifo(tmp_path / f"pipe{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    (tmp_path / f"zero{suffix}").symlink_to("/dev/zero")
    for name, words in (("pipe", "pipe"), ("zero", "device"), ("folder", "directory")):
        with pytest.raises(FileFormatError, match=words):
            read(tmp_path / f"{name}{suffix}")


# Scenes

SCENE = '<scene version="3.0.0">{}</scene>'
PICTURE = SCENE.format(
    '<bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
    '<string name="filename" value="{}"/></texture></bsdf>'
)
MESH = SCENE.format('<shape type="{}"><string name="filename" value="{}"/></shape>')
PLY = (
    "ply\nformat {} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
)
HOSTILE_SCENES = {
    "deep": (SCENE.format("<shape>" * 100_000), "64 elements in each other"),
    "many": (SCENE.format("<shape/>" * 200_001), "200000 elements"),
    "entity": ('<!DOCTYPE a [<!ENTITY e "e">]>' + SCENE.format("&e;"), "DTD"),
    "no xml": ("hunter2hash", "not XML in line 1"),
    "pipe": (
        SCENE.format('<shape type="ply"><string name="filename" value="pipe.ply"/></shape>'),
        "pipe",
    ),
    "included": (
        SCENE.format('<default name="f" value="deep.xml"/><include filename="$f"/>'),
        "64 elements in each other",
    ),
    "library beside it": (SCENE.format('<shape type="evil"/>'), "libraries of its own"),
    "library by path": (SCENE.format('<shape type="../plugins/evil"/>'), "libraries of its own"),
    "library by default": (
        SCENE.format('<default name="t" value="evil"/><shape type="$t"/>'),
        "libraries of its own",
    ),
    "includes of includes": (SCENE.format('<include filename="wide0.xml"/>' * 8), "256"),
    "defaults of defaults": (
        SCENE.format(
            '<default name="a0" value="xxxxxxxx"/>'
            + "".join(f'<default name="a{k}" value="{f"$a{k - 1}" * 8}"/>' for k in range(1, 13))
        ),
        "characters in a value",
    ),
    "defaults": (
        SCENE.format("".join(f'<default name="a{k}" value="$a"/>' for k in range(60_000))),
        "1000 .parameters",
    ),
    "library by the default of an include": (
        SCENE.format(
            '<include filename="sets.xml"/><default name="T" value="sphere"/><shape type="$T"/>'
        ),
        "libraries of its own",
    ),
    "chain of references": (
        SCENE.format(
            '<bsdf type="diffuse" id="b0"/>'
            + "".join(
                f'<bsdf type="mask" id="b{k}"><ref id="b{k - 1}"/></bsdf>' for k in range(1, 99)
            )
        ),
        "hold each other by references",
    ),
    "tree of references": (
        SCENE.format(
            '<bsdf type="diffuse" id="b0"/>'
            + "".join(
                f'<bsdf type="blendbsdf" id="b{k}"><ref id="b{k - 1}"/><ref id="b{k - 1}"/></bsdf>'
                for k in range(1, 40)
            )
        ),
        "references counted",
    ),
    "encoding": ('<?xml version="1.0" encoding="foo"?>' + SCENE.format(""), "UTF-8"),
    "too many samples": (
        SCENE.format(
            '<sensor type="perspective"><sampler type="ldsampler">'
            '<integer name="sample_count" value="2147483647"/></sampler></sensor>'
        ),
        "at most 16777216",
    ),
    "mesh named before": (
        SCENE.format(
            '<default name="f" value="beyond.ply"/>'
            '<shape type="ply"><string name="filename" value="$f"/></shape>'
        ),
        "number 200000000",
    ),
    "end in a comment": (MESH.format("ply", "comment.ply"), "number 200000000"),
    "form feed": (MESH.format("ply", "feed.ply"), "number 200000000"),
    "negative length": (MESH.format("ply", "negative.ply"), "ends early"),
    "corners of floats": (MESH.format("ply", "floats.ply"), "ends early"),
    "header alone": (MESH.format("ply", "header.ply"), "without its header"),
    "second mesh": (MESH.format("serialized", "two.serialized"), "number 200000000"),
    "EXR behind a text": (PICTURE.format("text.exr"), "pixels"),
    "half an EXR": (PICTURE.format("half.exr"), "with its size"),
    "objects in each other": (
        SCENE.format(
            '<shape type="sphere">' + '<bsdf type="twosided">' * 60 + "</bsdf>" * 60 + "</shape>"
        ),
        "16 objects in each other",
    ),
    "search path": (
        SCENE.format('<path value="sub"/><shape type="evil"/>'),
        "search path",
    ),
    "pipe of a spectrum": (
        SCENE.format('<bsdf type="diffuse"><spectrum name="a" filename="pipe.ply"/></bsdf>'),
        "pipe",
    ),
    "large PNG": (PICTURE.format("large.png"), "pixels"),
    "large EXR": (PICTURE.format("large.exr"), "pixels"),
    "large PFM": (PICTURE.format("large.pfm"), "pixels"),
    "large HDR": (PICTURE.format("large.hdr"), "pixels"),
    "corner beyond": (MESH.format("ply", "beyond.ply"), "number 200000000"),
    "corner below": (MESH.format("ply", "below.ply"), "number -20000"),
    "corner beyond, in bytes": (MESH.format("ply", "bytes.ply"), "number 7"),
    "half a mesh": (MESH.format("ply", "half.ply"), "ends early"),
    "corner beyond, serialized": (MESH.format("serialized", "a.serialized"), "number 200000000"),
    "reflectance above 1": (
        SCENE.format('<bsdf type="diffuse"><rgb name="reflectance" value="0.5, 1.5, 0"/></bsdf>'),
        "from 0 to 1",
    ),
    "reflectance of no number": (
        SCENE.format('<bsdf type="diffuse"><spectrum name="reflectance" value="nan"/></bsdf>'),
        "from 0 to 1",
    ),
}


def _write_hostile_files(folder: Path) -> None:
    """Files that hostile scenes name: what each announces is more than it holds."""
    (folder / "deep.xml").write_text(HOSTILE_SCENES["deep"][0])
    for k in range(12):
        (folder / f"wide{k}.xml").write_text(
            SCENE.format(f'<include filename="wide{k + 1}.xml"/>' * 8)
        )
    (folder / "wide12.xml").write_text(SCENE.format(""))
    (folder / "plugins").mkdir()
    (folder / "plugins" / "evil.so").write_bytes(b"")
    os.mkfifo(folder / "pipe.ply")
    chunk = b"IHDR" + struct.pack(">IIBBBBB", 40_000, 40_000, 8, 2, 0, 0, 0)
    png = struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    (folder / "large.png").write_bytes(b"\x89PNG\r\n\x1a\n" + png)
    window = b"dataWindow\0box2i\0" + struct.pack("<I4i", 16, 0, 0, 39_999, 39_999) + b"\0"
    magic = b"\x76\x2f\x31\x01\x02\0\0\0"
    (folder / "large.exr").write_bytes(magic + window)
    note = b"dataWindow\0box2i\0" + bytes(5000)
    text = b"note\0string\0" + struct.pack("<I", len(note)) + note
    (folder / "text.exr").write_bytes(magic + text + window)
    (folder / "half.exr").write_bytes(magic + b"dataWindow\0box2i\0")
    (folder / "large.pfm").write_bytes(b"PF\n40000 40000\n-1.0\n")
    (folder / "large.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 40000 +X 40000\n")
    triangle = "0 0 0\n1 0 0\n0 1 0\n"
    head = PLY.format("ascii")
    (folder / "beyond.ply").write_text(f"{head}{triangle}3 0 1 200000000\n")
    (folder / "below.ply").write_text(f"{head}{triangle}3 0 1 -20000\n")
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    face = b"\x03" + np.array([0, 1, 7], "<i4").tobytes()
    head = PLY.format("binary_little_endian").encode()
    (folder / "bytes.ply").write_bytes(head + vertices + face)
    (folder / "half.ply").write_bytes(head + vertices + face[:6])
    (folder / "header.ply").write_bytes(b"end_header\n")
    lines = PLY.format("ascii").replace("ply\n", "ply\ncomment end_header\n", 1)
    (folder / "comment.ply").write_text(f"{lines}{triangle}3 0 1 200000000\n")
    lines = PLY.format("ascii").replace("ply\n", "ply\ncomment \x0celement vertex 999999999\n", 1)
    (folder / "feed.ply").write_text(f"{lines}{triangle}3 0 1 200000000\n")
    lists = PLY.format("binary_little_endian").replace("vertex 3", "vertex 0")
    negative = lists.replace("face 1", "face 5").replace("uchar int", "int int")
    (folder / "negative.ply").write_bytes(negative.encode() + b"\xff" * 8)
    floats = lists.replace("uchar int", "uchar float").encode()
    (folder / "floats.ply").write_bytes(floats + b"\x03" + b"\x00\x00\x80\x7f" * 3)
    (folder / "sets.xml").write_text(SCENE.format('<default name="T" value="evil"/>'))
    mesh = struct.pack("<I", 0x1000) + b"a\0" + struct.pack("<QQ", 3, 1) + vertices
    mesh += struct.pack("<3I", 0, 1, 200_000_000)
    bad = struct.pack("<HH", 0x041C, 4) + zlib.compress(mesh)
    (folder / "a.serialized").write_bytes(bad + struct.pack("<QI", 0, 1))
    good = struct.pack("<HH", 0x041C, 4) + zlib.compress(mesh[:-4] + struct.pack("<I", 2))
    (folder / "two.serialized").write_bytes(good + bad + struct.pack("<QQI", 0, len(good), 2))


@pytest.mark.drjit
@pytest.mark.parametrize("case", HOSTILE_SCENES)
def test_a_scene_is_looked_through_before_mitsuba_reads_it(tmp_path: Path, case: str) -> None:
    import polywigner.mitsuba as pwm

    text, words = HOSTILE_SCENES[case]
    (tmp_path / "scene.xml").write_text(text)
    _write_hostile_files(tmp_path)
    with pytest.raises(SceneError, match=words) as caught:
        pwm.load_scene(tmp_path / "scene.xml", "scalar_rgb")
    assert "hunter2" not in str(caught.value)


# Arithmetic behind them


def test_orientations_of_many_points_on_a_line_are_those_of_one_at_a_time() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 200, 2))
    c = a + rng.integers(-3, 4, size=(200, 1)) * 0.1 * (b - a)  # on the line up to rounding
    expected = [np.sign(turn(*map(tuple, three))) for three in np.stack([a, b, c], 1).tolist()]
    assert (orientations(a, b, c) == expected).all()
    assert {-1, 0, 1} == set(expected)


def test_a_run_of_slight_bends_goes_as_a_whole_wherever_the_ring_starts() -> None:
    side = [(k / 8, 1e-9 * (k % 3)) for k in range(8)]
    bent = [(1.0, 0.0), (1.01, 0.25), (1.0, 0.5), (1.0, 0.75)]
    ring = np.array([*side, *bent, (1.0, 1.0), (0.0, 1.0)])
    expected = {(0.0, 0.0), (1.0, 0.0), (1.01, 0.25), (1.0, 0.5), (1.0, 1.0), (0.0, 1.0)}
    for shift in range(len(ring)):
        kept = without_slight_bends(np.roll(ring, shift, axis=0), 1e-6)
        assert {(float(x), float(y)) for x, y in kept} == expected


GOOD_PLY = {
    "colours of faces": (
        "property uchar red\nproperty list uchar int vertex_indices\nproperty uchar blue\n",
        "7 3 0 1 2 9\n7 4 0 1 2 3 9\n",
        b"\x07\x03" + np.array([0, 1, 2], "<i4").tobytes() + b"\x09"
        b"\x07\x04" + np.array([0, 1, 2, 3], "<i4").tobytes() + b"\x09",
    ),
    "texture coordinates": (
        "property list uchar uint vertex_index\nproperty list uchar float texcoord\n",
        "3 0 1 2 2 0.5 0.5\n\n3 1 2 3 2 0 1\n",
        b"\x03" + np.array([0, 1, 2], "<u4").tobytes() + b"\x02" + bytes(8)
        + b"\x03" + np.array([1, 2, 3], "<u4").tobytes() + b"\x02" + bytes(8),
    ),
}  # fmt: skip


@pytest.mark.drjit
@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("kind", GOOD_PLY)
def test_meshes_with_more_than_corners_are_looked_through_as_well(
    tmp_path: Path, kind: str, end: str
) -> None:
    from polywigner.mitsuba.scene_files import _ply

    own, text, content = GOOD_PLY[kind]
    head = (
        "ply\nformat {} 1.0\ncomment of a program\nelement vertex 4\nproperty float x\n"
        f"property float y\nproperty float z\nelement face 2\n{own}end_header\n"
    ).replace("\n", end)
    vertices = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
    corners, count = _ply((head.format("ascii") + (vertices + text).replace("\n", end)).encode())
    binary = head.format("binary_little_endian").encode()
    packed = np.zeros((4, 3), "<f4").tobytes()
    again, _ = _ply(binary + packed + content)
    assert count == 4 and corners.tolist() == again.tolist()
    assert set(corners.tolist()) == {0, 1, 2, 3}
