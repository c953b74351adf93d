"""Files that ask for much more than their size suggests: refused with one clear error.

Drawings are read in a process apart, within 20 s of its processor and 1 GiB; ``make fuzz`` reports
times and memory of many.
"""

from __future__ import annotations

import io
import os
import struct
import tracemalloc
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import FileFormatError, PolywignerError, SceneError
from polywigner.geometry.io import limits

MIB = 2**20

# What reading a file of some hundred kB may take at most, where a limit stops it.
SOME_MEMORY = 80 * MIB


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


# Drawings


def _star(count: int) -> list[complex]:
    """A ring that all of its edges but neighbours cross; `count` odd."""
    return [np.exp(1j * np.pi * (count - 1) / count * k) for k in range(count)]


def _doubling(levels: int) -> str:
    """2^levels rectangles by groups that use the group before twice."""
    groups = "".join(
        f'<g id="g{k + 1}"><use href="#g{k}"/><use href="#g{k}" x="1"/></g>' for k in range(levels)
    )
    return f'<svg><rect id="g0" width="1" height="1"/>{groups}</svg>'


def _crossing(count: int) -> str:
    points = " ".join(f"{p.real:.6f},{p.imag:.6f}" for p in _star(count))
    return f'<svg><polygon points="{points}"/></svg>'


def _blocks(levels: int) -> str:
    """10^(4 levels) circles by grids of blocks in blocks of a DXF file."""
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new()
    document.blocks.new("B0").add_circle((0, 0), 1)
    grid = {"row_count": 100, "column_count": 100, "row_spacing": 3, "column_spacing": 3}
    for k in range(levels):
        block = document.blocks.new(f"B{k + 1}")
        block.add_blockref(f"B{k}", (0, 0), dxfattribs=grid)
    document.modelspace().add_blockref(f"B{levels}", (0, 0))
    text = io.StringIO()
    document.write(text)
    return text.getvalue()


def test_a_dtd_that_declares_attributes_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("defusedxml")
    default = "x" * 20_000
    text = f'<!DOCTYPE svg [<!ATTLIST g a CDATA "{default}">]><svg>{"<g/>" * 20_000}</svg>'
    refusal(tmp_path / "a.svg", text, "without entities or other declarations")


def test_a_drawing_has_20_s_and_1_gib() -> None:
    assert (limits._SECONDS, limits._MEMORY) == (20, 1 << 30)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="limits of memory are Unix's")
@pytest.mark.parametrize(
    ("name", "make", "limit"),
    [
        ("uses.svg", lambda: _doubling(30), ("_SECONDS", 2)),
        ("star.svg", lambda: _crossing(4001), ("_SECONDS", 2)),
        ("blocks.dxf", lambda: _blocks(3), ("_SECONDS", 2)),
        ("rows.csv", lambda: "0,1\n" * 10**6, ("_MEMORY", 1 << 28)),
    ],
)
def test_a_drawing_that_fills_memory_or_takes_long_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, make, limit
) -> None:
    pytest.importorskip("defusedxml")
    pytest.importorskip("svgelements")
    monkeypatch.setattr(limits, *limit)  # of a process apart: 20 s and 1 GiB
    refusal(tmp_path / name, make(), f"within {limits._SECONDS} s and {limits._MEMORY >> 30} GiB")
    # the next drawing is read as ever
    (tmp_path / "c.svg").write_text('<svg><rect width="1" height="1"/></svg>')
    assert pw.read_aperture(tmp_path / "c.svg", "m").area == 1


# Text


def test_numbers_of_a_source_are_counted_before_it_is_parsed(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(b"[" + b"1," * 6_000_001 + b"1]")
    with memory_below(SOME_MEMORY), pytest.raises(FileFormatError, match="at most 6000000 values"):
        pw.read_source(path)


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


def test_a_ply_that_holds_less_or_more_than_it_announces_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    path, text, binary = tmp_path / "a.ply", "".join(CUBE).encode(), "binary_little_endian"
    whole = _ply(_binary_cube(), kind=binary)
    for content in (_ply(text), whole):
        path.write_bytes(content)
        assert pw.read_polyhedron(path, "m").volume == 1
    announces, length = "announces, got", "do not follow the format"
    for content, words in (
        (_ply(text[:-10]), announces),
        (_ply(_binary_cube()[:-1], kind=binary), announces),
        (_ply(text, faces=12), announces),  # two cubes, of which one is there
        (_ply(_binary_cube(), faces=12, kind=binary), announces),
        (_ply(text, faces=5), announces),
        (whole.replace(b"property list uchar int", b"property list"), length),
    ):
        refusal(path, content, words, pw.read_polyhedron)


def test_an_stl_with_a_facet_cut_short_is_refused(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    text = trimesh.creation.box((1, 1, 1)).export(file_type="stl_ascii")
    path = tmp_path / "a.stl"
    path.write_text(text)
    assert pw.read_polyhedron(path, "m").volume == pytest.approx(1)
    refusal(path, text[: text.rindex("vertex")], "expected", pw.read_polyhedron)


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
    (tmp_path / "link").symlink_to(inner)
    for name in ("outlines/a.wkt", "outlines/../outlines/a.wkt", "below.wkt"):
        file.write_text(_named(name))
        assert isinstance(pw.read_source(file), pw.Aperture)
        assert isinstance(pw.read_source(tmp_path / "link" / "source.toml"), pw.Aperture)
    for name in ("../a.wkt", str(tmp_path / "a.wkt"), "link.wkt", "/etc/passwd"):
        refusal(file, _named(name), "in the folder of the source file or below", pw.read_source)
    file.write_text(_named("../a.wkt"))
    assert isinstance(pw.read_source(file, allow_outside=True), pw.Aperture)


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


def test_a_line_of_rays_without_an_end_is_refused_before_it_is_cut(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("# {}\nx,y,z,l,m,n,weight\n" + "1," * 100_000)
    with pytest.raises(FileFormatError, match="a line of over 65536 characters"):
        pw.rays.load(path)


# Scenes

SCENE = '<scene version="3.0.0">{}</scene>'
PLY = (
    "ply\nformat {} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
)


def mesh(kind: str, file: str) -> str:
    return f'<shape type="{kind}"><string name="filename" value="{file}"/></shape>'


def picture(file: str) -> str:
    texture = f'<texture type="bitmap" name="reflectance"><string name="filename" value="{file}"/>'
    return f'<bsdf type="diffuse">{texture}</texture></bsdf>'


def mask(k: int, inside: str) -> str:
    return f'<bsdf type="blendbsdf" id="b{k}">{inside}</bsdf>'


REFERENCES = [f'<ref id="b{k}"/>' for k in range(99)]
DIFFUSE = '<bsdf type="diffuse" id="b0"/>'
LIBRARY = "libraries of its own"
MANY_SAMPLES = '<integer name="sample_count" value="2147483647"/>'
HOSTILE = {
    "deep": ("<shape>" * 100_000, "64 elements in each other"),
    "many": ("<shape/>" * 200_001, "200000 elements"),
    "pipe": (mesh("ply", "pipe.ply"), "pipe"),
    "included": ('<default name="f" value="deep.xml"/><include filename="$f"/>', "64 elements in"),
    "library beside it": ('<shape type="evil"/>', LIBRARY),
    "library by path": ('<shape type="../plugins/evil"/>', LIBRARY),
    "library by default": ('<default name="t" value="evil"/><shape type="$t"/>', LIBRARY),
    "includes of includes": ('<include filename="wide0.xml"/>' * 8, "256"),
    "defaults of defaults": (
        '<default name="a0" value="xxxxxxxx"/>'
        + "".join(f'<default name="a{k}" value="{f"$a{k - 1}" * 8}"/>' for k in range(1, 13)),
        "characters in a value"),
    "defaults": ("".join(f'<default name="a{k}" value="$a"/>' for k in range(60_000)),
                 "1000 .parameters"),
    "library by the default of an include": (
        '<include filename="sets.xml"/><default name="T" value="sphere"/><shape type="$T"/>',
        LIBRARY),
    "chain of references": (
        DIFFUSE + "".join(mask(k, REFERENCES[k - 1]) for k in range(1, 99)),
        "hold each other by references"),
    "tree of references": (
        DIFFUSE + "".join(mask(k, 2 * REFERENCES[k - 1]) for k in range(1, 40)),
        "references counted"),
    "too many samples": (
        f'<sensor type="perspective"><sampler type="ldsampler">{MANY_SAMPLES}</sampler></sensor>',
        "at most 16777216"),
    "mesh named before": ('<default name="f" value="beyond.ply"/>' + mesh("ply", "$f"),
                          "number 200000000"),
    "end in a comment": (mesh("ply", "comment.ply"), "number 200000000"),
    "form feed": (mesh("ply", "feed.ply"), "number 200000000"),
    "negative length": (mesh("ply", "negative.ply"), "ends early"),
    "corners beyond 64 bits": (mesh("ply", "digits.ply"), "ends early"),
    "corners of floats": (mesh("ply", "floats.ply"), "ends early"),
    "header alone": (mesh("ply", "header.ply"), "without its header"),
    "second mesh": (mesh("serialized", "two.serialized"), "number 200000000"),
    "EXR behind a text": (picture("text.exr"), "pixels"),
    "half an EXR": (picture("half.exr"), "with its size"),
    "objects in each other": (
        '<shape type="sphere">' + '<bsdf type="twosided">' * 60 + "</bsdf>" * 60 + "</shape>",
        "16 objects in each other"),
    "search path": ('<path value="sub"/><shape type="evil"/>', "search path"),
    "pipe of a spectrum": ('<bsdf type="diffuse"><spectrum name="a" filename="pipe.ply"/></bsdf>',
                           "pipe"),
    **{f"large {end}": (picture(f"large.{end.lower()}"), "pixels")
       for end in ("PNG", "EXR", "PFM", "HDR")},
    "corner beyond": (mesh("ply", "beyond.ply"), "number 200000000"),
    "corner below": (mesh("ply", "below.ply"), "number -20000"),
    "corner beyond, in bytes": (mesh("ply", "bytes.ply"), "number 7"),
    "half a mesh": (mesh("ply", "half.ply"), "ends early"),
    "corner beyond, serialized": (mesh("serialized", "a.serialized"), "number 200000000"),
    "one of three meshes": (
        "".join(mesh("ply", f"{name}.ply") for name in ("good", "bytes", "also")), "of bytes.ply"),
    "EXR cut short": (picture("cut.exr"), "whole OpenEXR picture"),
    "channels of a volume": (
        '<shape type="cube"><medium name="interior" type="heterogeneous"><volume type="gridvolume" '
        'name="sigma_t"><string name="filename" value="deep.vol"/></volume></medium></shape>',
        "pixels"),
    "a name of a megabyte": (
        f'<shape type="sphere"><string name="{"x" * 2**20}" value="x"/></shape>',
        r"^.{,900}\.\.\.$"),
    "letters that a terminal obeys": (
        '<shape type="sphere"><string name="&#x9b;31m" value="x"/></shape>', "\ufffd31m"),
    "vertices without a face": (mesh("ply", "many.ply"), "ends early"),
    "addresses in memory": (
        '<shape type="blender"><integer name="verts" value="4096"/></shape>', "meshes of files"),
    "reflectance above 1": (
        '<bsdf type="diffuse"><rgb name="reflectance" value="0.5, 1.5, 0"/></bsdf>', "from 0 to 1"),
    "reflectance of no number": (
        '<bsdf type="diffuse"><spectrum name="reflectance" value="nan"/></bsdf>', "from 0 to 1"),
    "one default in many texts": (
        f'<default name="a" value="{"x" * 10_000}"/>' + '<string name="b" value="$a"/>' * 1000,
        "8 MiB of scenes"),
    "a long scene included often": ('<include filename="long.xml"/>' * 9, "8 MiB of scenes"),
    "file that cannot be read": (picture("/proc/self/mem"), "readable file"),
    "radius of no number": (
        '<shape type="sphere"><float name="radius" value="nan"/></shape>',
        "radius of a sphere in numbers, got nan"),
    "pose of no numbers": (
        '<shape type="disk"><transform name="to_world"><scale value="nan"/></transform></shape>',
        "to_world of a disk in numbers, got nan"),
}  # fmt: skip
HOSTILE_SCENES = {name: (SCENE.format(inside), words) for name, (inside, words) in HOSTILE.items()}
HOSTILE_SCENES |= {
    "entity": ('<!DOCTYPE a [<!ENTITY e "e">]>' + SCENE.format("&e;"), "DTD"),
    "no xml": ("hunter2hash", "not XML in line 1"),
    "encoding": ('<?xml version="1.0" encoding="foo"?>' + SCENE.format(""), "UTF-8"),
}


def _write_half_an_exr(path: Path) -> None:
    """A picture without its last bytes: Mitsuba's reader ends the process."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    mi.Bitmap(np.zeros((4, 4, 3), np.float32)).write(str(path))
    path.write_bytes(path.read_bytes()[:-40])


def _write_hostile_files(folder: Path) -> None:
    """Files that hostile scenes name: what each announces is more than it holds."""
    (folder / "deep.xml").write_text(HOSTILE_SCENES["deep"][0])
    for k in range(12):
        (folder / f"wide{k}.xml").write_text(
            SCENE.format(f'<include filename="wide{k + 1}.xml"/>' * 8)
        )
    (folder / "wide12.xml").write_text(SCENE.format(""))
    (folder / "long.xml").write_text(SCENE.format(" " * 2**20))
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
    _write_half_an_exr(folder / "cut.exr")
    (folder / "deep.vol").write_bytes(b"VOL\3" + struct.pack("<5i", 1, 4, 4, 4, 2_000_000_000))
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
    for name in ("good.ply", "also.ply"):
        (folder / name).write_bytes(head + vertices + face[:-4] + bytes([2, 0, 0, 0]))
    none = head.replace(b"vertex 3", b"vertex 999999999").replace(b"face 1", b"face 0")
    (folder / "many.ply").write_bytes(none + vertices)
    (folder / "half.ply").write_bytes(head + vertices + face[:6])
    (folder / "header.ply").write_bytes(b"end_header\n")
    lines = PLY.format("ascii").replace("ply\n", "ply\ncomment end_header\n", 1)
    (folder / "comment.ply").write_text(f"{lines}{triangle}3 0 1 200000000\n")
    lines = PLY.format("ascii").replace("ply\n", "ply\ncomment \x0celement vertex 999999999\n", 1)
    (folder / "feed.ply").write_text(f"{lines}{triangle}3 0 1 200000000\n")
    (folder / "digits.ply").write_text(f"{PLY.format('ascii')}{triangle}3 0 1 {10**20}\n")
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
