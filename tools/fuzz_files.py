"""Good files of every format, and ways to damage them; for tools/fuzz."""

from __future__ import annotations

import io
import json
import logging
import random
import re
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

__all__ = ["FORMATS", "Format", "case", "place", "seeds"]


@dataclass(frozen=True)
class Format:
    """How a format's seeds are made, and how its files are named."""

    suffix: str
    make: Callable[[], list[bytes]]
    reader: str = "aperture"
    """aperture, body, source, rays, pattern, elements, scene or store: which function reads it."""
    beside: str = ""
    """Scene that names the file, "case" and the suffix, and is read in its place."""


def case(seed: int, number: int, formats: list[str]) -> tuple[str, str, bytes]:
    """Format, suffix and content of one damaged file, the same each time."""
    dice = random.Random(f"{seed}:{number}")
    name = formats[number % len(formats)]
    content = dice.choice(seeds(name))
    own = OWN_DAMAGES.get(name, [])
    damages = own + TEXT_DAMAGES
    if name in BINARY or dice.random() < 0.2:
        damages = BYTE_DAMAGES + (own if name in BINARY else [])
    for _ in range(dice.choice((1, 1, 1, 2, 2, 4))):
        content = dice.choice(damages)(content, name, dice)
    return name, FORMATS[name].suffix, content


@cache
def seeds(name: str) -> list[bytes]:
    return FORMATS[name].make()


# Damages: each takes the content, the format's name and the dice. Those of text leave text, which
# gets farther than noise does.


def flip_bytes(content: bytes, name: str, dice: random.Random) -> bytes:
    damaged = bytearray(content)
    for _ in range(dice.randint(1, 8) if damaged else 0):
        damaged[dice.randrange(len(damaged))] ^= 1 << dice.randrange(8)
    return bytes(damaged)


def random_bytes(content: bytes, name: str, dice: random.Random) -> bytes:
    at = dice.randint(0, len(content))
    return content[:at] + dice.randbytes(dice.randint(1, 12)) + content[at + dice.randint(0, 12) :]


def truncate(content: bytes, name: str, dice: random.Random) -> bytes:
    return content[: dice.randint(0, len(content))]


def cut_out(content: bytes, name: str, dice: random.Random) -> bytes:
    start = dice.randint(0, len(content))
    return content[:start] + content[start + dice.randint(1, 1 + len(content) // 8) :]


def repeat(content: bytes, name: str, dice: random.Random) -> bytes:
    start = dice.randint(0, len(content))
    piece = content[start : start + dice.randint(1, 1 + len(content) // 4)]
    return content[:start] + piece * dice.choice((2, 3, 50)) + content[start + len(piece) :]


def mix_lines(content: bytes, name: str, dice: random.Random) -> bytes:
    return b"\n".join(_mixed(content.split(b"\n"), dice))


def mix_pairs(content: bytes, name: str, dice: random.Random) -> bytes:
    """DXF: groups of a code and a value change places."""
    lines = content.split(b"\n")
    pairs = [b"\n".join(lines[k : k + 2]) for k in range(0, len(lines), 2)]
    return b"\n".join(_mixed(pairs, dice))


def mix_attributes(content: bytes, name: str, dice: random.Random) -> bytes:
    """SVG: an attribute damaged so that the file stays XML."""
    found = list(re.finditer(rb'"([^"<]*)"', content))
    for match in sorted(dice.sample(found, min(len(found), 2)), key=lambda m: -m.start()):
        damage = dice.choice((mix_tokens, odd_numbers, odd_letters, cut_out, repeat))
        value = damage(match[1], name, dice).replace(b'"', b"").replace(b"<", b"")
        content = content[: match.start(1)] + value + content[match.end(1) :]
    return content


def within_members(content: bytes, name: str, dice: random.Random) -> bytes:
    """An archive of arrays, one of them damaged and packed anew: its checksums are right."""
    packed = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [(each.filename, archive.read(each)) for each in archive.infolist()]
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError, zlib.error):
        return content
    with zipfile.ZipFile(packed, "w") as archive:
        hit = dice.randrange(len(members)) if members else 0
        for number, (member, inner) in enumerate(members):
            damaged = dice.choice(BYTE_DAMAGES)(inner, name, dice) if number == hit else inner
            archive.writestr(zipfile.ZipInfo(member), damaged)
    return packed.getvalue()


def within_packed(content: bytes, name: str, dice: random.Random) -> bytes:
    """A serialized mesh that is damaged and packed anew."""
    try:
        inner = zlib.decompressobj().decompress(content[4:], 1 << 20)
    except zlib.error:
        return content
    packed = zlib.compress(dice.choice(BYTE_DAMAGES)(inner, name, dice))
    return content[:4] + packed + struct.pack("<QI", 0, 1)


def within_chunks(content: bytes, name: str, dice: random.Random) -> bytes:
    """A PNG, the header or the pixels of which are damaged; its checksums are right."""
    made, place, hit = [content[:8]], 8, dice.choice((b"IHDR", b"IHDR", b"IDAT"))
    while place + 12 <= len(content):
        (size,) = struct.unpack_from(">I", content, place)
        kind, inner = content[place + 4 : place + 8], content[place + 8 : place + 8 + size]
        if kind == hit:
            inner = dice.choice((flip_bytes, odd_fields))(inner, name, dice)[: len(inner)]
        made.append(struct.pack(">I", len(inner)) + kind + inner)
        made.append(struct.pack(">I", zlib.crc32(kind + inner)))
        place += 12 + size
    return b"".join(made)


def odd_letters(content: bytes, name: str, dice: random.Random) -> bytes:
    """Letters replaced by others: other commands, words and codes."""
    found = list(re.finditer(rb"[A-Za-z]", content))
    for match in dice.sample(found, min(len(found), dice.choice((1, 1, 3)))):
        letter = dice.choice(b"MmZzLlHhVvCcSsQqTtAaEeXx %(;").to_bytes()
        content = content[: match.start()] + letter + content[match.end() :]
    return content


def swap_numbers(content: bytes, name: str, dice: random.Random) -> bytes:
    parts = re.split(rb"([+-]?\d+\.?\d*(?:[eE][+-]?\d+)?)", content)
    numbers = range(1, len(parts), 2)
    for _ in range(dice.randint(1, 3) if len(numbers) > 1 else 0):
        i, j = dice.choice(numbers), dice.choice(numbers)
        parts[i], parts[j] = parts[j], parts[i]
    return b"".join(parts)


def mix_tokens(content: bytes, name: str, dice: random.Random) -> bytes:
    """Words and numbers change places; what stands between them stays."""
    parts = re.split(rb"([A-Za-z0-9.+-]+)", content)
    parts[1::2] = (_mixed(parts[1::2], dice) + [b""] * len(parts))[: len(parts[1::2])]
    return b"".join(parts)


def _mixed(items: list[bytes], dice: random.Random) -> list[bytes]:
    items = list(items)
    for _ in range(dice.randint(1, 4) if len(items) > 1 else 0):
        i, j = dice.randrange(len(items)), dice.randrange(len(items))
        what = dice.randrange(4)
        if what == 0:
            items[i], items[j] = items[j], items[i]
        elif what == 1:
            items.insert(i, items[j])
        elif what == 2 and len(items) > 2:
            del items[i]
        else:
            run = items[min(i, j) : max(i, j)]
            dice.shuffle(run)
            items[min(i, j) : max(i, j)] = run
    return items


ODD_NUMBERS = [
    b"nan", b"NaN", b"inf", b"-inf", b"Infinity", b"1e308", b"-1e308", b"1e-308", b"5e-324",
    b"1e999", b"-1e999", b"1e99", b"1e-99", b"0", b"-0.0", b"-1", b"1", b"0.5", b"1e9", b"1e-9",
    b"1000000000", b"4294967295", b"2147483648", b"-2147483648", b"18446744073709551616",
    b"9" * 400, b"0." + b"3" * 400, b"1e", b".", b"+", b"--1", b"0x10", b"1_0", b"1,5", b"",
    "\u0663".encode(), b"1e-16", b"3.0000000000000004", b"65536", b"255", b"256",
]  # fmt: skip


def odd_numbers(content: bytes, name: str, dice: random.Random) -> bytes:
    """Numbers in text replaced, by odd ones or by slightly different ones."""
    found = list(re.finditer(rb"[+-]?\d+\.?\d*(?:[eE][+-]?\d+)?", content))
    chosen = dice.sample(found, min(len(found), dice.choice((1, 1, 2, 5))))
    for match in sorted(chosen, key=lambda match: -match.start()):
        number = dice.choice(ODD_NUMBERS)
        if dice.random() < 0.3:
            number = repr(float(match[0]) * dice.choice((-1, 1 + 1e-12, 2, 1e6, 1e-6))).encode()
        content = content[: match.start()] + number + content[match.end() :]
    return content


def odd_fields(content: bytes, name: str, dice: random.Random) -> bytes:
    """Four or eight bytes replaced by an odd number in binary."""
    number = dice.choice((float("nan"), float("inf"), 3e38, 1e-40, -1.0, 0.0, 1e20))
    field = dice.choice((
        struct.pack("<f", number), struct.pack("<d", number), struct.pack(">f", number),
        struct.pack("<I", dice.choice((0, 1, 10**9, 2**31, 2**32 - 1))),
        struct.pack("<q", dice.choice((-1, 0, 2**62))), struct.pack("<H", 65535),
    ))  # fmt: skip
    at = dice.randint(0, len(content))
    return content[:at] + field + content[at + len(field) :]


def splice(content: bytes, name: str, dice: random.Random) -> bytes:
    """The start of one file, the end of another of the format, or of any."""
    other = dice.choice(seeds(name if dice.random() < 0.8 else dice.choice(list(FORMATS))))
    return content[: dice.randint(0, len(content))] + other[dice.randint(0, len(other)) :]


def exchange(content: bytes, name: str, dice: random.Random) -> bytes:
    """Mostly nothing; at times a file of another format under this one's suffix."""
    return dice.choice(seeds(dice.choice(list(FORMATS)))) if dice.random() < 0.2 else content


BINARY = (
    "dxf binary", "stl", "gds", "rays npz", "rays nc", "rays dat", "scene serialized", "scene png",
    "scene exr", "store chunk",
)  # fmt: skip
BYTE_DAMAGES = [
    flip_bytes, flip_bytes, random_bytes, truncate, cut_out, repeat, odd_fields, odd_fields, splice,
    exchange,
]  # fmt: skip
TEXT_DAMAGES = [
    truncate, cut_out, repeat, mix_lines, mix_tokens, odd_numbers, odd_numbers, odd_numbers,
    swap_numbers, swap_numbers, odd_letters, splice, exchange,
]  # fmt: skip
OWN_DAMAGES = {
    "svg": [mix_attributes] * 12,
    "svg text": [mix_attributes] * 12,
    "dxf": [mix_pairs] * 6,
    "scene": [mix_attributes] * 12,
    "rays npz": [within_members] * 12,
    "scene serialized": [within_packed] * 12,
    "scene png": [within_chunks] * 12,
}


# Seeds. Small, so that damage hits something that matters.

RING = [[0, 0], [8, 0], [8, 3], [5, 3], [5, 6], [0, 6], [0, 0]]
HOLE = [[1, 1], [1, 2], [2.5, 2], [2.5, 1], [1, 1]]


def geojson() -> list[bytes]:
    polygon = {"type": "Polygon", "coordinates": [RING, HOLE]}
    shifted = [[[x + 10, y] for x, y in RING]]
    features = [{"type": "Feature", "properties": {"n": 1}, "geometry": polygon}]
    return [
        json.dumps(item).encode()
        for item in (
            polygon,
            {"type": "MultiPolygon", "coordinates": [[RING, HOLE], shifted]},
            {"type": "FeatureCollection", "features": features},
            {"type": "GeometryCollection", "geometries": [polygon]},
        )
    ]


def wkt() -> list[bytes]:
    ring, hole = (", ".join(f"{x} {y}" for x, y in r) for r in (RING, HOLE))
    return [
        f"POLYGON (({ring}), ({hole}))".encode(),
        f"MULTIPOLYGON ((({ring}), ({hole})), ((20 0, 21.5 0, 21.5 1e0, 20 0)))".encode(),
        b"POLYGON Z ((0 0 0, 4 0 0, 4 4 0, 0 0 0))",
    ]


def csv() -> list[bytes]:
    return [
        "\n".join(f"{x},{y}" for x, y in RING).encode(),
        b"x;y\n0;0\n1,5;0\n1,5;2,25\n0;2,25\n",
        b"# a triangle\n0 0\n4 0  # corner\n1e0 3.5\n",
    ]


SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg" '
    'xmlns:xlink="http://www.w3.org/1999/xlink" width="40mm" height="30mm" '
    'viewBox="0 0 40 30">\n{}\n</svg>\n'
)


def svg() -> list[bytes]:
    bodies = [
        '<path fill-rule="evenodd" d="M1 1h8v8h-8z M3,3 5,3 5,5 3,5Z"/>',
        '<path d="M1 5A4 4 0 0 1 9 5L5 9 z m 12,0 c 0,3 4,3 4,0 s 4,-2 4,1 q 1,4 -2,4 t -3,1"/>',
        '<g transform="translate(5 5) rotate(30)"><circle cx="5" cy="5" r="3"/>'
        '<ellipse cx="15" cy="5" rx="3" ry="1.5" transform="skewX(10) scale(1,2)"/></g>',
        '<style>.a {fill: none} rect, #b {fill: red}</style><rect class="a" width="9" height="9"/>'
        '<rect x="2" y="2" width="6" height="4" rx="1" ry="2"/>\n'
        '<polygon id="b" style="opacity: 0.5" points="10,10 20,10 15,18"/>',
        '<defs><g id="g"><rect width="2" height="2"/><rect x="3" width="2" height="2"/></g></defs>'
        '<use xlink:href="#g" x="5" y="5"/>\n<use href="#g" transform="matrix(1 .5 -.5 1 20 10)"/>',
        '<symbol id="s" viewBox="0 0 2 2"><circle cx="1" cy="1" r="1"/></symbol>'
        '<use href="#s" width="8" height="4"/><svg x="50%" width="10mm" height="4" '
        'viewBox="0 0 10 10" preserveAspectRatio="xMinYMax slice">'
        '<path d="M0 0L9 9 9 0 0 9"/></svg>',
    ]
    doctype = '<!DOCTYPE svg [ <!ENTITY e "eeee"> <!ENTITY x SYSTEM "file:///etc/hostname"> ]>\n'
    entity = SVG.format("<title>&e;&x;</title>" + bodies[0]).replace("<svg", doctype + "<svg", 1)
    return [SVG.format(body).encode() for body in bodies] + [entity.encode()]


HEADER = "0 SECTION 2 HEADER 9 $ACADVER 1 AC1015 9 $INSUNITS 70 4 0 ENDSEC"


def dxf_entities() -> list[bytes]:
    """Drawings of nothing but entities, as R12 and many programs write them."""
    groups = {
        "polyline": """0 LWPOLYLINE 100 AcDbEntity 8 0 100 AcDbPolyline 90 4 70 1
            10 0.0 20 0.0 42 1.0 10 4.0 20 0.0 10 4.0 20 3.0 10 0.0 20 3.0""",
        "circles": """0 CIRCLE 8 0 10 5.0 20 5.0 40 3.0 0 CIRCLE 8 0 10 5.0 20 5.0 40 1.0
            0 ELLIPSE 8 0 10 20.0 20 0.0 30 0.0 11 3.0 21 1.0 31 0.0 40 0.5 41 0.0
            42 6.283185307179586""",
        "chain": """0 LINE 8 0 10 0.0 20 0.0 11 4.0 21 0.0 0 LINE 8 0 10 4.0 20 3.0 11 4.0 21 0.0
            0 LINE 8 0 10 4.0 20 3.0 11 0.0 21 3.0
            0 ARC 8 0 10 0.0 20 1.5 40 1.5 50 90.0 51 270.0""",
        "spline": """0 SPLINE 100 AcDbEntity 8 0 100 AcDbSpline 70 11 71 3 72 8 73 4 74 0
            40 0.0 40 0.0 40 0.0 40 0.0 40 1.0 40 1.0 40 1.0 40 1.0 41 1.0 41 2.0 41 2.0 41 1.0
            10 0.0 20 0.0 30 0.0 10 5.0 20 0.0 30 0.0 10 5.0 20 5.0 30 0.0 10 0.0 20 5.0 30 0.0""",
        "hatch": """0 HATCH 100 AcDbEntity 8 0 100 AcDbHatch 10 0.0 20 0.0 30 0.0 2 SOLID 70 1 71 0
            91 2 92 3 72 1 73 1 93 4 10 0.0 20 0.0 42 0.0 10 9.0 20 0.0 42 0.3 10 9.0 20 9.0 42 0.0
            10 0.0 20 9.0 42 0.0 97 0 92 1 93 1 72 2 10 4.0 20 4.0 40 2.0 50 0.0 51 360.0 73 1 97 0
            75 0 76 1 98 0""",
    }
    files = []
    for name, body in groups.items():
        header = [] if name in ("circles", "chain") else HEADER.split()
        entities = ["0", "SECTION", "2", "ENTITIES", *body.split(), "0", "ENDSEC", "0", "EOF", ""]
        files.append("\n".join([*header, *entities]).encode())
    return files


def _drawing(version: str, is_binary: bool = False) -> bytes:
    import ezdxf

    # No dates and random identifiers: a case is the same each time.
    ezdxf.options.write_fixed_meta_data_for_testing = True
    logging.getLogger("ezdxf").addHandler(logging.NullHandler())  # R12 has no units, it says
    document = ezdxf.new(version, units=4)
    space = document.modelspace()
    block = document.blocks.new("B")
    block.add_circle((0, 0), 1)
    space.add_blockref("B", (20, 5), dxfattribs={"xscale": 2, "rotation": 30})
    grid = {"row_count": 2, "column_count": 3, "row_spacing": 5, "column_spacing": 4}
    space.add_blockref("B", (0, 20), dxfattribs=grid)
    space.add_polyline2d([(0, 0), (9, 0), (9, 9)], close=True)
    if is_binary:
        stream = io.BytesIO()
        document.write(stream, fmt="bin")
        return stream.getvalue()
    text = io.StringIO()
    document.write(text)
    # The classes stand in the order of a set, which differs from run to run.
    plain = re.sub(r" *0\nSECTION\n *2\nCLASSES\n.*?ENDSEC\n", "", text.getvalue(), flags=re.S)
    return plain.encode()


def dxf() -> list[bytes]:
    # Whole drawings are some 20 kB, mostly tables: one of each kind.
    return dxf_entities() * 2 + [_drawing("R2010"), _drawing("R12")]


def dxf_binary() -> list[bytes]:
    return [_drawing("R12", is_binary=True)]


def _meshes(kind: str) -> list[bytes]:
    import trimesh

    bodies = [
        trimesh.creation.box((1, 2, 3)),
        trimesh.creation.annulus(1.0, 2.0, 1.0, sections=6),
    ]
    exported: list[Any] = [body.export(file_type=kind) for body in bodies]
    return [item.encode() if isinstance(item, str) else item for item in exported]


def ply() -> list[bytes]:
    import trimesh

    box = trimesh.creation.box((1, 2, 3))
    square = (
        b"ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 5\nproperty list uchar int vertex_indices\nend_header\n"
        b"0 0 0\n1 0 0\n1 1 0\n0 1 0\n.5 .5 1\n4 3 2 1 0\n3 0 1 4\n3 1 2 4\n3 2 3 4\n3 3 0 4\n"
    )
    return [*_meshes("ply"), box.export(file_type="ply", encoding="ascii"), square]


def obj() -> list[bytes]:
    pyramid = (
        b"mtllib missing.mtl\no pyramid\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 .5 1\n"
        b"vt 0 0\nvn 0 0 1\nusemtl red\nf 4 3 2 1\nf 1/1/1 2/1/1 5/1/1\nf 2//1 3//1 5//1\n"
        b"f -3 -2 -1\nf 4 1 5\n"
    )
    return [*_meshes("obj"), pyramid, pyramid.replace(b"f -3 -2 -1", b"f 3 4 5")]


def gerber() -> list[bytes]:
    """A patch with its feed, dark and clear, arcs, and a macro."""
    head = "G04 board*\n%FSLAX33Y33*%\n%MOMM*%\n"
    bodies = (
        "G36*\nX0Y0D02*\nG01X8000D01*\nY6000D01*\nX0D01*\nY0D01*\nG37*\n%ADD10C,1*%\nD10*\n"
        "X4000Y0D02*\nY-5000D01*\n%LPC*%\nX4000Y3000D03*\n%LPD*%\n",
        "%ADD10C,0.5X0.2*%\n%ADD11O,1X2*%\n%ADD12P,2X6*%\n%ADD13C,0.3*%\nD10*\nX0Y0D03*\nD11*\n"
        "X3000D03*\nD12*\nX6000D03*\nD13*\nG75*\nX9000Y0D02*\nG03X10000Y1000I0J1000D01*\n",
        "%AMBox*0 rounded*21,1,$1,$2,0,0,30*1,1,$1/2,$1-0.5,0*1,0,0.2,0,0*%\n%ADD10Box,2X1*%\n"
        "D10*\nX0Y0D03*\nX5000Y5000D03*\n",
    )
    return [f"{head}{body}M02*\n".encode() for body in bodies]


def gds() -> list[bytes]:
    from hostile_files import gds_array, gds_box, gds_of

    boxes = gds_box(0, 0, 500) + gds_box(1000, 0, 500)
    return [gds_of({"a": boxes}), gds_of({"a": boxes, "b": gds_array("a", 3, 2, 5000)})]


def sources(suffix: str) -> list[bytes]:
    """An aperture with a taper, an array, a horn, slits and a body."""
    import polywigner as pw

    square = pw.shapes.square(0.01)
    tapered = square.with_illumination(pw.cosine_taper(0.01, 0.01))
    array = pw.phased_array(tapered, pw.arrays.grid_positions(3, 2, 0.02))
    horn = pw.horns.pyramidal(0.03, 0.02, 0.1, 0.1, 0.003)
    found = []
    for source in (tapered, array, horn, pw.Slits([[0.0, 0.01], [0.02, 0.03]])):
        with tempfile.TemporaryDirectory() as folder:
            pw.write_source(source, path := Path(folder) / f"source{suffix}")
            found.append(path.read_bytes())
    return found


def by_hand() -> list[bytes]:
    """Sources as people write them."""
    head = b'kind = "phased-array"\nelement = {kind = "aperture", shape = {name = "square", a = '
    grid = b'positions = {kind = "grid", nx = 4, ny = 3, pitch_x = "2 mm"}\n'
    return [
        b'kind = "slits"\nintervals = [[0.0, 1.0], [2.0, 3.5]]\n',
        b'wavelength = "3.2 mm"\n' + head + b'"5 mm"}}\n' + grid,
        b'kind = "aperture"\nshape = {name = "disc", radius = 1, n = 32}\n'
        b'illumination = [{kind = "taylor_taper", width = 2, height = 2, nbar = 4}]\n',
    ]


def rays(suffix: str) -> list[bytes]:
    import polywigner as pw

    found = pw.sample_rays(pw.shapes.square(0.01), 0.003, 16)
    found["weight"] = abs(found["weight"])
    with tempfile.TemporaryDirectory() as folder:
        (path,) = pw.rays.save(found, Path(folder) / f"rays{suffix}")
        return [path.read_bytes()]


def patterns(suffix: str) -> list[bytes]:
    import numpy as np

    import polywigner as pw

    angles = np.radians(np.arange(0, 91, 15)), np.radians(np.arange(0, 360, 45))
    square = pw.shapes.square(2e-3)
    found = pw.radiation_pattern(square, 3.9e-3, *angles, polarisation="right")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"pattern{suffix}"
        pw.write_pattern(found, path)
        return [path.read_bytes()]


def elements() -> list[bytes]:
    """Tables with a row for each element."""
    rows = [f"{k},{k % 3},{1 + k / 10},{20 * k},{15 * k}" for k in range(20)]
    return [
        "\n".join(["x,y,amplitude,phase,angle", *rows]).encode(),
        b"# complex\nim; re; y; x\n0;1;0;0\n0,5;0;2,5;0\n",
        b"0 0\n2 0\n4 1\n",
    ]


SCENE = """<scene version="3.0.0">
<default name="spp" value="4"/><default name="shine" value="0.5"/>
<integrator type="path"><integer name="max_depth" value="3"/></integrator>
<bsdf type="diffuse" id="grey"><rgb name="reflectance" value="$shine, 0.2, 0.1"/></bsdf>
<sensor type="perspective"><float name="fov" value="40"/>
<transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
<sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
</sensor>
<shape type="wigner"><string name="frequency" value="94 GHz"/><string name="power" value="1 mW"/>
<string name="aperture" value="square.wkt"/></shape>
{}</scene>
"""


def scenes() -> list[bytes]:
    bodies = (
        '<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" '
        'angle="180"/><translate z="-1"/></transform><ref id="grey"/></shape>',
        '<shape type="sphere"><point name="center" value="0, 1, 0"/><bsdf type="roughconductor">'
        '<float name="alpha" value="0.1"/></bsdf></shape><emitter type="constant"><rgb '
        'name="radiance" value="0.1"/></emitter>',
        '<sensor type="wigner_receiver"><string name="aperture" value="square.wkt"/><string '
        'name="frequency" value="94 GHz"/><film type="hdrfilm"><integer name="width" value="1"/>'
        '<integer name="height" value="1"/><rfilter type="box"/></film></sensor>',
        '<shape type="cube"><bsdf type="twosided"><bsdf type="principled"><texture name='
        '"base_color" type="checkerboard"/></bsdf></bsdf></shape><alias id="grey" as="other"/>',
    )
    return [SCENE.format(body).encode() for body in bodies]


NAMING = {
    kind: SCENE.format(
        f'<shape type="{kind}"><string name="filename" value="case.{kind}"/></shape>'
    )
    for kind in ("ply", "obj", "serialized")
} | {
    kind: SCENE.format(
        '<shape type="cube"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
        f'<string name="filename" value="case.{kind}"/></texture></bsdf></shape>'
    )
    for kind in ("png", "exr")
}
"""Scenes that name a mesh or a picture."""


def serialized() -> list[bytes]:
    vertices = struct.pack("<12f", 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1)
    body = struct.pack("<I", 0x1000) + b"a\0" + struct.pack("<QQ", 4, 4) + vertices
    body += struct.pack("<12I", 0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3)
    return [struct.pack("<HH", 0x041C, 4) + zlib.compress(body) + struct.pack("<QI", 0, 1)]


def pictures(suffix: str) -> list[bytes]:
    import mitsuba as mi
    import numpy as np

    mi.set_variant("scalar_rgb")
    values = np.linspace(0, 1, 4 * 4 * 3, dtype=np.float32).reshape(4, 4, 3)
    bitmap = mi.Bitmap(values if suffix == ".exr" else (255 * values).astype(np.uint8))
    with tempfile.TemporaryDirectory() as folder:
        bitmap.write(str(path := Path(folder) / f"picture{suffix}"))
        return [path.read_bytes()]


@cache
def array() -> dict[str, bytes]:
    """The files of an array in a store of zarr."""
    import xarray

    with tempfile.TemporaryDirectory() as folder:
        xarray.Dataset({"u": (("x", "y"), [[0.0, 1.0], [2.0, 3.0]])}).to_zarr(
            folder, zarr_format=3, consolidated=False
        )
        return {name: Path(folder, "u", name).read_bytes() for name in ("zarr.json", "c/0/0")}


def place(name: str, content: bytes, folder: Path) -> Path:
    """Write a damaged file and all that belongs to it; the path that is read."""
    path = folder / f"case{FORMATS[name].suffix}"
    if FORMATS[name].reader == "scene":
        (folder / "square.wkt").write_text("POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
    if FORMATS[name].reader == "store":
        damaged = "c/0/0" if name == "store chunk" else "zarr.json"
        for member, inner in (array() | {damaged: content}).items():
            file = path / "u" / member
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(inner)
        group = {"zarr_format": 3, "node_type": "group", "attributes": {}}
        (path / "zarr.json").write_text(json.dumps(group))
        return path
    path.write_bytes(content)
    if not FORMATS[name].beside:
        return path
    (folder / "scene.xml").write_text(FORMATS[name].beside)
    return folder / "scene.xml"


FORMATS = {
    "geojson": Format(".geojson", geojson),
    "wkt": Format(".wkt", wkt),
    "csv": Format(".csv", csv),
    "svg": Format(".svg", svg),
    "svg text": Format(".txt", svg),
    "dxf": Format(".dxf", dxf),
    "dxf binary": Format(".dxf", dxf_binary),
    "gerber": Format(".gbr", gerber),
    "gds": Format(".gds", gds),
    "stl": Format(".stl", lambda: _meshes("stl"), "body"),
    "stl ascii": Format(".stl", lambda: _meshes("stl_ascii"), "body"),
    "ply": Format(".ply", ply, "body"),
    "obj": Format(".obj", obj, "body"),
    "toml": Format(".toml", lambda: sources(".toml") + by_hand(), "source"),
    "json": Format(".json", lambda: sources(".json"), "source"),
    "rays npz": Format(".npz", lambda: rays(".npz"), "rays"),
    "rays csv": Format(".csv", lambda: rays(".csv"), "rays"),
    "rays nc": Format(".nc", lambda: rays(".nc"), "rays"),
    "rays dat": Format(".dat", lambda: rays(".dat"), "rays"),
    "pattern csv": Format(".csv", lambda: patterns(".csv"), "pattern"),
    "pattern txt": Format(".txt", lambda: patterns(".txt"), "pattern"),
    "pattern ffd": Format(".ffd", lambda: patterns(".ffd"), "pattern"),
    "elements": Format(".csv", elements, "elements"),
    "scene": Format(".xml", scenes, "scene"),
    "scene ply": Format(".ply", ply, "scene", NAMING["ply"]),
    "scene obj": Format(".obj", obj, "scene", NAMING["obj"]),
    "scene serialized": Format(".serialized", serialized, "scene", NAMING["serialized"]),
    "scene png": Format(".png", lambda: pictures(".png"), "scene", NAMING["png"]),
    "scene exr": Format(".exr", lambda: pictures(".exr"), "scene", NAMING["exr"]),
    "store": Format(".zarr", lambda: [array()["zarr.json"]], "store"),
    "store chunk": Format(".zarr", lambda: [array()["c/0/0"]], "store"),
}
