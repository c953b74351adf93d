"""Files that ask for much more work or memory than their size suggests; for tools/fuzz.

Each kind is made on purpose, where damaged files are made by chance. Some are honest but large:
they must be read.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

__all__ = ["KINDS", "Kind", "gds_array", "gds_box", "gds_of"]


@dataclass(frozen=True)
class Kind:
    """How a file is named, made and read."""

    name: str
    make: Callable[[], bytes]
    reader: str = "aperture"
    """aperture, body or source: which function reads it."""
    is_read: bool = False
    """Whether it is honest, and has to be read."""
    others: Callable[[], dict[str, bytes]] = dict
    """Files beside it that it names."""

    def write(self, folder: Path) -> Path:
        """The path of the file, made in `folder`."""
        for name, content in {**self.others(), self.name: self.make()}.items():
            (folder / name).write_bytes(content)
        return folder / self.name


def svg(body: str, head: str = "", attributes: str = "") -> bytes:
    return f'{head}<svg xmlns="http://www.w3.org/2000/svg" {attributes}>{body}</svg>'.encode()


def squares(sizes: Iterable[float], x: float = 0.0) -> str:
    return "".join(f"M{x - s} {-s}H{x + s}V{s}H{x - s}Z" for s in sizes)


def _doubling(levels: int) -> str:
    groups = "".join(
        f'<g id="g{k + 1}"><use href="#g{k}"/><use href="#g{k}" x="1"/></g>' for k in range(levels)
    )
    return f'<defs><rect id="g0" width="1" height="1"/>{groups}</defs><use href="#g{levels}"/>'


def _attributes_by_default() -> bytes:
    head = f'<!DOCTYPE svg [<!ATTLIST g a CDATA "{"x" * 100_000}">]>'
    return svg("<g/>" * 49_000, head)


def _rules() -> bytes:
    rules = "".join(f".c{k},#i{k}{{fill:red}}" for k in range(499))
    names = " ".join(f"n{k}" for k in range(40))
    return svg(f"<style>{rules}</style>" + f'<g class="{names}"/>' * 49_000)


def _crosses(count: int) -> str:
    return "".join(f"M{k} 0h.5v.5z" for k in range(count))


def _star(count: int) -> list[tuple[float, float]]:
    """Spikes that all but reach the centre."""
    step = 2 * math.pi / count
    return [
        ((r := 1e-3 if k % 2 else 1.0) * math.cos(k * step), r * math.sin(k * step))
        for k in range(count)
    ]


def _tangle(count: int) -> str:
    """A ring that all of its edges but neighbours cross; `count` odd."""
    turns = (math.pi * (count - 1) / count * k for k in range(count))
    return " ".join(f"{math.cos(t):.6f},{math.sin(t):.6f}" for t in turns)


def _wave(count: int) -> list[tuple[float, float]]:
    """A simple outline: a disc with a fine ripple."""
    return [
        (
            (r := 100 + 1e-3 * math.sin(20_000 * t)) * math.cos(t),
            r * math.sin(t),
        )
        for t in (2 * math.pi * k / count for k in range(count))
    ]


def _comb(count: int, turn: float = 0.0) -> list[tuple[float, float]]:
    """A meander of `count` long teeth, turned by an angle."""
    points: list[tuple[float, float]] = []
    for k in range(count):
        x = 2.0 * k
        points += [(x, 0.0), (x, 1.9 * count), (x + 1, 1.9 * count), (x + 1, 0.0)]
    points += [(2.0 * count, -1.0), (-1.0, -1.0), (-1.0, 0.0)]
    c, s = math.cos(turn), math.sin(turn)
    return [(c * x - s * y, s * x + c * y) for x, y in points]


def csv_of(points: Iterable[tuple[float, float]]) -> bytes:
    return "\n".join(f"{x:.15g},{y:.15g}" for x, y in points).encode()


def _ring_text(points: Iterable[tuple[float, float]]) -> str:
    rows = [f"{x:.15g} {y:.15g}" for x, y in points]
    return "(" + ", ".join([*rows, rows[0]]) + ")"


def _box(x: float, y: float, w: float, h: float) -> list[tuple[float, float]]:
    return [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]


def multipolygon(rings: Iterable[list[tuple[float, float]]]) -> bytes:
    return f"MULTIPOLYGON ({', '.join(f'({_ring_text(r)})' for r in rings)})".encode()


def geojson(rings: Iterable[list[tuple[float, float]]]) -> bytes:
    polygons = [[[*map(list, ring), list(ring[0])]] for ring in rings]
    return json.dumps({"type": "MultiPolygon", "coordinates": polygons}).encode()


def _dense_outline_with_boxes() -> bytes:
    """Small squares that all touch one outline of very many vertices."""
    n = 200_000
    top = [(float(k), 1e-3 * (k % 2)) for k in range(n)]
    big = [*top, (n - 1.0, -5.0), (0.0, -5.0)]
    small = [_box(20.0 * k, -6.0, 10.0, 1.0) for k in range(9000)]
    return multipolygon([big[::-1], *small])


def dxf(entities: str, blocks: str = "") -> bytes:
    return (
        "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1015\n0\nENDSEC\n"
        f"0\nSECTION\n2\nBLOCKS\n{blocks}0\nENDSEC\n"
        f"0\nSECTION\n2\nENTITIES\n{entities}0\nENDSEC\n0\nEOF\n"
    ).encode()


def _block(name: str, body: str) -> str:
    return (
        f"0\nBLOCK\n8\n0\n2\n{name}\n70\n0\n10\n0\n20\n0\n30\n0\n3\n{name}\n{body}0\nENDBLK\n8\n0\n"
    )


def _insert(name: str, x: float = 0.0, rows: int = 1, columns: int = 1, step: float = 1.0) -> str:
    return (
        f"0\nINSERT\n8\n0\n2\n{name}\n10\n{x}\n20\n0\n30\n0\n"
        f"70\n{columns}\n71\n{rows}\n44\n{step}\n45\n{step}\n"
    )


def _circle(x: float, y: float, r: float) -> str:
    return f"0\nCIRCLE\n8\n0\n10\n{x}\n20\n{y}\n40\n{r}\n"


_TRIANGLE = (
    "0\nLWPOLYLINE\n100\nAcDbEntity\n8\n0\n100\nAcDbPolyline\n90\n3\n70\n1\n"
    "10\n0\n20\n0\n10\n1\n20\n0\n10\n0\n20\n1\n"
)


def _spline(points: int, degree: int) -> str:
    knots = [0] * (degree + 1) + list(range(1, points - degree)) + [points - degree] * (degree + 1)
    body = "".join(f"40\n{k}\n" for k in knots)
    body += "".join(f"10\n{math.cos(k):.3f}\n20\n{math.sin(k):.3f}\n30\n0\n" for k in range(points))
    return (
        "0\nSPLINE\n100\nAcDbEntity\n8\n0\n100\nAcDbSpline\n70\n8\n"
        f"71\n{degree}\n72\n{len(knots)}\n73\n{points}\n74\n0\n{body}"
    )


def _gds_record(kind: int, data_type: int, data: bytes = b"") -> bytes:
    return struct.pack(">HBB", 4 + len(data), kind, data_type) + data


def _gds_real(value: float) -> bytes:
    exponent = math.ceil(math.log(value, 16))
    return struct.pack(">Q", ((exponent + 64) << 56) | int(value / 16.0**exponent * 2**56))


def _gds_text(kind: int, text: str) -> bytes:
    return _gds_record(kind, 6, text.encode() + b"\0" * (len(text) % 2))


def gds_of(cells: dict[str, bytes]) -> bytes:
    dates = struct.pack(">12H", *[2024, 1, 1, 0, 0, 0] * 2)
    units = _gds_record(3, 5, _gds_real(1e-3) + _gds_real(1e-9))
    found = _gds_record(0, 2, struct.pack(">H", 600)) + _gds_record(1, 2, dates)
    found += _gds_text(2, "lib") + units
    for name, body in cells.items():
        found += _gds_record(5, 2, dates) + _gds_text(6, name) + body + _gds_record(7, 0)
    return found + _gds_record(4, 0)


def gds_box(x: int, y: int, size: int) -> bytes:
    points = [(x, y), (x + size, y), (x + size, y + size), (x, y + size), (x, y)]
    flat = [value for point in points for value in point]
    return (
        _gds_record(8, 0)
        + _gds_record(13, 2, b"\0\1")
        + _gds_record(14, 2, b"\0\0")
        + _gds_record(16, 3, struct.pack(">10i", *flat))
        + _gds_record(17, 0)
    )


def gds_array(name: str, columns: int, rows: int, step: int) -> bytes:
    corners = (0, 0, columns * step, 0, 0, rows * step)
    return (
        _gds_record(11, 0)
        + _gds_text(18, name)
        + _gds_record(19, 2, struct.pack(">2h", columns, rows))
        + _gds_record(16, 3, struct.pack(">6i", *corners))
        + _gds_record(17, 0)
    )


def gerber(body: str) -> bytes:
    return f"%FSLAX36Y36*%\n%MOMM*%\n{body}M02*\n".encode()


def _gerber_changes(count: int) -> str:
    """Dark and clear by turns, upon each other."""
    lines = ["%ADD10C,1*%\n%ADD11R,40X40*%\nD11*\nX0Y0D03*\nD10*\n"]
    for k in range(count):
        polarity = "CD"[k % 2]
        lines.append(f"%LP{polarity}*%\nX{(k % 60 - 30) * 500000}Y{(k // 60 - 30) * 500000}D03*\n")
    return "".join(lines)


def _gerber_arcs(count: int) -> str:
    """Half circles in rows, apart from each other."""
    places = ((3_000_000 * (k % 100), 3_000_000 * (k // 100)) for k in range(count))
    arcs = (f"X{x}Y{y}D02*\nG03X{x}Y{y + 2_000_000}I0J1000000D01*\n" for x, y in places)
    return "%ADD10C,0.1*%\nD10*\nG75*\n" + "".join(arcs)


def _ply(vertices: int, faces: int, body: bytes, kind: str = "ascii") -> bytes:
    return (
        f"ply\nformat {kind} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {faces}\nproperty list uchar int vertex_indices\n"
        "end_header\n"
    ).encode() + body


_CUBE = ("0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n",
         "4 3 2 1 0\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n")  # fmt: skip


def _truncated_ply() -> bytes:
    """Two cubes are announced; the faces of one are there."""
    return _ply(8, 12, (_CUBE[0] + _CUBE[1]).encode())


def sphere(count: int) -> bytes:
    """A closed surface of 4 count^2 triangles, as binary STL."""
    columns, rows = 2 * count, count + 1
    facets = []

    def point(i: int, j: int) -> tuple[float, float, float]:
        if i in (0, rows):
            return (0.0, 0.0, 1.0 if i == 0 else -1.0)
        t, p = math.pi * i / rows, 2 * math.pi * (j % columns) / columns
        return (math.sin(t) * math.cos(p), math.sin(t) * math.sin(p), math.cos(t))

    for i in range(rows):
        for j in range(columns):
            a, b, c, d = point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)
            if i < rows - 1:
                facets.append((a, b, c))
            if i > 0:
                facets.append((a, c, d))
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *a, *b, *c, 0) for a, b, c in facets)
    return bytes(80) + struct.pack("<I", len(facets)) + body


def _tapers(count: int, factors: int) -> bytes:
    one = '{kind = "taylor_taper", width = 1, height = 1, nbar = 100}'
    lines = "\n".join(f"  {one}," for _ in range(factors))
    aperture = f'shape = {{name = "square", a = 1}}\nillumination = [\n{lines}\n]\n'
    if count == 1:
        return f'kind = "aperture"\n{aperture}'.encode()
    return ('kind = "array"\n' + f'[[elements]]\nkind = "aperture"\n{aperture}' * count).encode()


def _elements(count: int, body: str) -> bytes:
    return f'{{"kind": "array", "elements": [{",".join([body] * count)}]}}'.encode()


_MIB = 2**20
_SHAPE = '{"kind": "aperture", "shape": {"name": "disc", "radius": 1, "n": 4096}}'

KINDS = {
    "svg attributes by default": Kind("a.svg", _attributes_by_default),
    "svg transforms in one attribute": Kind(
        "a.svg", lambda: svg(f'<g transform="{"translate(1)" * 200_000} "><rect width="1" '
                             'height="1"/></g>')),
    "svg transforms, repeated": Kind(
        "a.svg", lambda: svg(f'<g id="g" transform="{"rotate(1)" * 1000}"/>'
                             + '<use href="#g"/>' * 20_000)),
    "svg nested groups": Kind(
        "a.svg", lambda: svg("".join('<g transform="rotate(1)">' * 60 + "</g>" * 60
                                     for _ in range(800)) + '<rect width="1" height="1"/>')),
    "svg deep": Kind("a.svg", lambda: svg("<g>" * 5_000_000)),
    "svg uses that double": Kind("a.svg", lambda: svg(_doubling(28))),
    "svg long path": Kind("a.svg", lambda: svg(f'<path d="M0 0{"l1 1" * 10_000_000}z"/>')),
    "svg curves": Kind(
        "a.svg", lambda: svg('<path d="M0 0' + "c0 9 9 9 9 0" * 199_000 + 'z"/>')),
    "svg spaces in a path": Kind(
        "a.svg", lambda: svg(f'<path d="M0 0{" " * 60 * _MIB}L1 1 0 1z"/>')),
    "svg style sheet": Kind("a.svg", _rules),
    "svg text": Kind("a.svg", lambda: svg(f'<title>{"x" * 60 * _MIB}\U0001f600</title>'
                                          '<rect width="1" height="1"/>')),
    "svg attributes of one element": Kind(
        "a.svg", lambda: svg("", attributes=" ".join(f'a{k}=""' for k in range(4_000_000)))),
    "svg nested squares": Kind("a.svg", lambda: svg(
        f'<path fill-rule="evenodd" d="{squares(range(1, 9_991))}"/>')),
    "svg nested squares, each a shape": Kind("a.svg", lambda: svg(
        "".join(f'<path fill-rule="evenodd" d="{squares((k, k + .5))}"/>'
                for k in range(1, 4_990)))),
    "svg circles": Kind("a.svg", lambda: svg("".join(
        f'<circle cx="{3 * (k % 99)}" cy="{3 * (k // 99)}" r="1"/>' for k in range(9_900))),
        is_read=True),
    "svg stars": Kind("a.svg", lambda: svg("".join(
        f'<polygon points="{_tangle(199)}" transform="translate({3 * k})"/>' for k in range(99)))),
    "svg tiny squares": Kind("a.svg", lambda: svg(f'<path d="{_crosses(50_000)}"/>')),
    "svg collinear rectangles": Kind("a.svg", lambda: svg(
        '<path d="' + "".join(f"M{k} 0H{20_000 + k}V1H{k}Z" for k in range(9_900)) + '"/>')),
    "csv star": Kind("a.csv", lambda: csv_of(_star(300_000))),
    "csv separators": Kind("a.csv", lambda: b"," * (60 * _MIB)),
    "csv one line": Kind("a.csv", lambda: b"1," * (30 * _MIB)),
    "csv carriage returns": Kind("a.csv", lambda: b"0,0" + b"\r" * (60 * _MIB)),
    "csv comment": Kind("a.csv", lambda: b"#" * (60 * _MIB)),
    "csv meander aslant": Kind("a.csv", lambda: csv_of(_comb(10_000, 0.78))),
    "csv million vertices": Kind("a.csv", lambda: csv_of(_wave(1_000_000)), is_read=True),
    "csv meander": Kind("a.csv", lambda: csv_of(_comb(100_000)), is_read=True),
    "wkt million vertices": Kind(
        "a.wkt", lambda: f"POLYGON ({_ring_text(_wave(900_000))})".encode(), is_read=True),
    "wkt deep": Kind("a.wkt", lambda: b"GEOMETRYCOLLECTION (" * 3_000_000),
    "wkt grid of squares": Kind("a.wkt", lambda: multipolygon(
        _box(i, j, 1, 1) for i in range(99) for j in range(99)), is_read=True),
    "wkt squares on a dense outline": Kind("a.wkt", _dense_outline_with_boxes),
    "wkt two dense neighbours": Kind("a.wkt", lambda: multipolygon([
        [*((float(k), 1e-3 * (k % 3)) for k in range(100_000)), (99_999.0, 9.0), (0.0, 9.0)],
        [*((float(k), 1e-3 * (k % 3)) for k in range(100_000)), (99_999.0, -9.0), (0.0, -9.0)],
    ])),
    "geojson deep": Kind("a.geojson", lambda: b"[" * (60 * _MIB)),
    "geojson numbers": Kind("a.geojson", lambda: b"[" + b"-9," * (20 * _MIB) + b"1]"),
    "geojson texts": Kind("a.geojson", lambda: b"[" + b'"ab",' * (12 * _MIB) + b"1]"),
    "geojson huge number": Kind("a.geojson", lambda: b"[" + b"9" * (60 * _MIB) + b"]"),
    "geojson keys": Kind("a.geojson", lambda: b"{" + b",".join(
        b'"%x":0' % k for k in range(5 * _MIB)) + b"}"),
    "geojson million vertices": Kind("a.geojson", lambda: geojson([_wave(990_000)]), is_read=True),
    "geojson squares": Kind("a.geojson", lambda: geojson(
        _box(2 * i, 2 * j, 1, 1) for i in range(400) for j in range(400))),
    "dxf nested circles": Kind("a.dxf", lambda: dxf(
        "".join(_circle(0, 0, k + 1) for k in range(9_900)))),
    "dxf circles": Kind("a.dxf", lambda: dxf(
        "".join(_circle(3 * k, 0, 1) for k in range(100_000)))),
    "dxf circles within limits": Kind("a.dxf", lambda: dxf(
        "".join(_circle(3 * (k % 99), 3 * (k // 99), 1) for k in range(9_900))), is_read=True),
    "dxf splines": Kind("a.dxf", lambda: dxf(_spline(2_000, 10) * 50)),
    "dxf blocks that double": Kind("a.dxf", lambda: dxf(_insert("b15"), _block("b0", _TRIANGLE)
        + "".join(_block(f"b{k + 1}", _insert(f"b{k}") * 8) for k in range(15)))),
    "dxf array of blocks": Kind("a.dxf", lambda: dxf(
        _insert("b", 0, 30_000, 30_000, 3.0), _block("b", _TRIANGLE))),
    "dxf blocks upon each other": Kind("a.dxf", lambda: dxf(
        _insert("b", 0, 50_000, 1, 1e-12), _block("b", _TRIANGLE))),
    "dxf lines": Kind("a.dxf", lambda: dxf("".join(
        f"0\nLINE\n8\n0\n10\n{k}\n20\n0\n11\n{k + 1}\n21\n0\n" for k in range(190_000)))),
    "gds array of references": Kind("a.gds", lambda: gds_of(
        {"a": gds_box(0, 0, 5), "b": gds_array("a", 30_000, 30_000, 10)})),
    "gds arrays of arrays": Kind("a.gds", lambda: gds_of(
        {"a": gds_box(0, 0, 5)}
        | {f"b{k}": gds_array("a" if k == 0 else f"b{k - 1}", 100, 100, 10) for k in range(6)})),
    "gds boxes": Kind("a.gds", lambda: gds_of(
        {"a": b"".join(gds_box(10 * k, 0, 5) for k in range(230_000))})),
    "gds ten thousand boxes": Kind("a.gds", lambda: gds_of(
        {"a": b"".join(gds_box(10 * k, 0, 5) for k in range(9_999))}), is_read=True),
    "gerber flashes": Kind("a.gbr", lambda: gerber("%ADD10C,1*%\nD10*\n" + "".join(
        f"X{2000000 * (k % 400)}Y{2000000 * (k // 400)}D03*\n" for k in range(150_000)))),
    "gerber strokes": Kind("a.gbr", lambda: gerber("%ADD10C,1*%\nD10*\nX0Y0D02*\n" + "".join(
        f"X{1000000 * (k % 400)}Y{1000000 * (k // 400)}D01*\n" for k in range(150_000)))),
    "gerber arcs": Kind("a.gbr", lambda: gerber(_gerber_arcs(9_000))),
    "gerber arcs, fewer": Kind("a.gbr", lambda: gerber(_gerber_arcs(4_600)), is_read=True),
    "gerber flashes within limits": Kind("a.gbr", lambda: gerber("%ADD10C,1*%\nD10*\n" + "".join(
        f"X{2000000 * (k % 99)}Y{2000000 * (k // 99)}D03*\n" for k in range(9_801))), is_read=True),
    "gerber changes of polarity": Kind("a.gbr", lambda: gerber(_gerber_changes(3_600))),
    "ply cut short": Kind("a.ply", _truncated_ply, "body"),
    "ply values": Kind("a.ply", lambda: _ply(
        8, 12, _CUBE[0].encode() + b"255 " * (12 * _MIB)), "body"),
    "obj one line": Kind("a.obj", lambda: b"v 0 0 0\nf" + b" 1" * (28 * _MIB), "body"),
    "stl sphere": Kind("a.stl", lambda: sphere(220), "body"),
    "toml tapers": Kind("a.toml", lambda: _tapers(1, 4), "source"),
    "toml tapers of many elements": Kind("a.toml", lambda: _tapers(1_000, 1), "source"),
    "toml grid": Kind("a.toml", lambda: b'kind = "phased-array"\nelement = {kind = "aperture", '
        b'shape = {name = "square", a = 1}}\npositions = {kind = "grid", nx = 100000, '
        b'ny = 100000, pitch_x = 1}\n', "source"),
    "toml numbers": Kind("a.toml", lambda: b'kind = "slits"\nintervals = [' + b"1.5," * (
        15 * _MIB) + b"]\n", "source"),
    "toml long key": Kind("a.toml", lambda: b"a." * 200_000 + b"a = 1\n", "source"),
    "toml segments": Kind("a.toml", lambda: b'kind = "aperture"\nshape = {name = '
        b'"hexagonal_segments", flat_to_flat = 1, gap = 0.1, rings = 4096}\n', "source"),
    "json shapes": Kind("a.json", lambda: _elements(800_000, _SHAPE), "source"),
    "json elements": Kind("a.json", lambda: _elements(
        500_000, '{"kind": "aperture", "shape": {"name": "square", "a": 1}}'), "source"),
    "json one outline, many names": Kind(
        "a.json", lambda: b'{"kind": "array", "elements": ['
        + b",".join(b'{"kind": "aperture", "file": "%sb.wkt"}' % (b"./" * k) for k in range(300))
        + b"]}", "source", others=lambda: {"b.wkt": multipolygon([_wave(100_000)])}),
    "json numbers": Kind("a.json", lambda: b'{"kind": "slits", "intervals": [' + b"-9," * (
        20 * _MIB) + b"1]}", "source"),
}  # fmt: skip
