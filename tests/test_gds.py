"""GDSII files: units, cells, layers and paths."""

import math
import struct

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, FileFormatError, GeometryError

# Rounding error of the conversion from the integer database units of GDSII.
ROUNDING = 1e-12


def layout(path):
    """Write cells TOP, with 2 x 2 cells PAD, and OTHER in micrometres with a grid of 1 nm."""
    gdstk = pytest.importorskip("gdstk")
    library = gdstk.Library(unit=1e-6, precision=1e-9)
    pad, top, other = (library.new_cell(name) for name in ("PAD", "TOP", "OTHER"))
    pad.add(gdstk.rectangle((0, 0), (2, 1), layer=1))
    pad.add(gdstk.FlexPath([(1, 0.5), (5, 0.5)], 0.5, layer=2, datatype=1))
    top.add(gdstk.Reference(pad, (0, 0), columns=2, rows=2, spacing=(10, 10)))
    top.add(gdstk.Label("text", (0, 0)))
    hole = gdstk.boolean(gdstk.rectangle((0, 0), (4, 4)), gdstk.rectangle((1, 1), (2, 2)), "not")
    other.add(*hole)
    library.write_gds(path)
    return path


def test_a_layer_of_a_cell_is_read_in_its_own_unit(tmp_path):
    path = layout(tmp_path / "chip.gds")
    pads = pw.read_aperture(path, unit="km", layer=["TOP", "1"])
    assert pads.area == pytest.approx(4 * 2e-12, rel=ROUNDING, abs=0.0)
    assert pads.bounds == pytest.approx((0, 0, 12e-6, 11e-6), rel=ROUNDING, abs=1e-20)
    paths = pw.read_aperture(path, layer=["TOP", "2/1"])
    assert paths.area == pytest.approx(4 * 4 * 0.5e-12, rel=ROUNDING, abs=0.0)
    renamed = path.rename(tmp_path / "chip")  # the content identifies the format
    assert pw.read_aperture(renamed, layer=["TOP", "1/0"]) == pads


def test_shapes_of_layers_that_overlap_are_joined_when_asked(tmp_path):
    path = layout(tmp_path / "chip.gds")
    with pytest.raises(GeometryError, match=r"union=True \(--union\)"):
        pw.read_aperture(path, layer="PAD")
    other = pw.read_aperture(path, layer="OTHER")  # a cut connects the hole
    assert other.area == pytest.approx(15e-12, rel=ROUNDING, abs=0.0)
    assert any(len(polygon.interiors) for polygon in np.atleast_1d(other.polygons.geoms))
    joined = pw.read_aperture(path, layer="PAD", union=True)
    assert joined.area == pytest.approx(2e-12 + 3 * 0.5e-12, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize(
    ("layer", "error", "words"),
    [
        (None, FileFormatError, "expected a layout with one top cell, got the cells OTHER, TOP"),
        ("NONE", FileFormatError, "'NONE'.*OTHER, PAD, TOP"),
        (
            ["TOP", "7"],
            FileFormatError,
            "the cell has no layer 7; its layers are 1/0, 2/1",
        ),
        (["TOP", "2/0"], FileFormatError, "no layer 2/0"),
        (["TOP", "PAD"], ArgumentError, "expected the name of one cell, got TOP, PAD"),
    ],
)
def test_what_is_not_in_the_file_is_answered_with_what_is(layer, error, words, tmp_path):
    with pytest.raises(error, match=words):
        pw.read_aperture(layout(tmp_path / "chip.gds"), layer=layer)


def test_a_cell_within_itself_is_refused(tmp_path):
    content = layout(tmp_path / "chip.gds").read_bytes()
    path = tmp_path / "cycle.gds"
    path.write_bytes(content.replace(b"PAD\0", b"TOP\0"))
    with pytest.raises(FileFormatError, match="do not contain themselves, got TOP in TOP"):
        pw.read_aperture(path, layer=["TOP", "1"])


def test_a_polygon_of_one_point_is_none(tmp_path):
    gdstk = pytest.importorskip("gdstk")
    box, path = gdstk.rectangle((0, 0), (5, 5)), tmp_path / "a.gds"
    library = gdstk.Library()
    library.new_cell("a").add(box)
    library.write_gds(path)
    head = "000408000006 0D02 0001 0006 0E02 0000"
    point = bytes.fromhex(f"{head} 000C 1003 0000 0000 0000 0000 0004 1100")
    end = bytes.fromhex("0004 0700")
    path.write_bytes(path.read_bytes().replace(end, 2 * point + end))
    assert pw.read_aperture(path).area == pytest.approx(25e-12)


# Tests write raw records, because gdstk writes neither points nor absolute widths.


def _record(kind: int, data: bytes = b"") -> bytes:
    data += b"\0" * (len(data) % 2)
    return struct.pack(">HH", 4 + len(data), kind) + data


def _real(value: float) -> bytes:
    """Return a real number as eight bytes: sign, exponent of 16, and 56 bits of the fraction."""
    exponent = 0
    while value >= 1:
        value, exponent = value / 16, exponent + 1
    while 0 < value < 1 / 16:
        value, exponent = value * 16, exponent - 1
    return bytes([64 + exponent]) + int(value * 2**56).to_bytes(7, "big")


def _points(points) -> bytes:
    return _record(0x1003, struct.pack(f">{2 * len(points)}i", *np.ravel(points)))


def _path(points, width: int, ends: int) -> bytes:
    head = _record(0x0900) + _record(0x0D02, b"\0\1") + _record(0x0E02, b"\0\0")
    head += _record(0x2102, struct.pack(">h", ends)) + _record(0x0F03, struct.pack(">i", width))
    return head + _points(points) + _record(0x1100)


def _reference(name: str, at=(0, 0), scale=1.0, degrees=0.0, flags=0) -> bytes:
    head = _record(0x0A00) + _record(0x1206, name.encode())
    head += _record(0x1A01, struct.pack(">H", flags)) + _record(0x1B05, _real(scale))
    return head + _record(0x1C05, _real(degrees)) + _points([at]) + _record(0x1100)


SQUARE = _record(0x0800) + _record(0x0D02, b"\0\1") + _record(0x0E02, b"\0\0")
SQUARE += _points([(0, 0), (3000, 0), (3000, 3000), (0, 3000), (0, 0)]) + _record(0x1100)


def written(path, **cells: bytes):
    """Write a library in micrometres with a grid of 1 nm."""
    dates = struct.pack(">12h", *[1] * 12)
    out = _record(0x0002, b"\x02\x58") + _record(0x0102, dates) + _record(0x0206, b"LIB")
    out += _record(0x0305, _real(1e-3) + _real(1e-9))
    for name, content in cells.items():
        out += _record(0x0502, dates) + _record(0x0606, name.encode()) + content + _record(0x0700)
    path.write_bytes(out + _record(0x0400))
    return path


def test_a_path_of_zero_length_on_a_layer_that_is_read_is_refused(tmp_path):
    dot = _path([(7000, 2000)] * 2, 1400, 1)
    for name, cells in {
        "a": {"TOP": dot + SQUARE},
        "b": {"P": dot, "TOP": _reference("P")},
    }.items():
        path = written(tmp_path / f"{name}.gds", **cells)
        with pytest.raises(
            FileFormatError, match="paths of nonzero length, got a path of length zero on layer 1/0"
        ):
            pw.read_aperture(path)
    other = written(tmp_path / "c.gds", TOP=dot + SQUARE.replace(b"\x0d\x02\0\1", b"\x0d\x02\0\2"))
    assert pw.read_aperture(other, layer="2").area == pytest.approx(9e-12, rel=ROUNDING, abs=0.0)


def test_a_path_with_a_repeated_point_is_that_without(tmp_path):
    path = written(tmp_path / "a.gds", TOP=_path([(0, 0), (0, 0), (5000, 0), (5000, 0)], 600, 0))
    assert pw.read_aperture(path).area == pytest.approx(3e-12, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize(("width", "area"), [(500, 4 * 10 * 0.5 * 4), (-500, 4 * 10 * 0.5)])
def test_a_negative_width_is_not_scaled(tmp_path, width, area):
    """The path has a width of 10 and is in two nested cells, each scaled by 2."""
    cells = {"P": _path([(0, 0), (10000, 0)], width, 0), "Q": _reference("P", (0, 0), 2.0)}
    path = written(tmp_path / "a.gds", **cells, TOP=_reference("Q", (0, 0), 2.0, 30.0))
    assert pw.read_aperture(path).area == pytest.approx(area * 1e-12, rel=1e-6, abs=0.0)


def test_round_ends_stay_within_the_tolerance(tmp_path):
    path = written(tmp_path / "a.gds", TOP=_path([(0, 0), (10000, 0)], 4000, 1))
    exact = (40 + 4 * math.pi) * 1e-12
    for tolerance in (1e-8, 1e-11):
        missing = exact - pw.read_aperture(path, tolerance=tolerance).area
        assert 0 <= missing <= 4e-6 * math.pi * tolerance
    assert pw.read_aperture(path).area == pytest.approx(exact, rel=1e-3)


@pytest.mark.parametrize("depth", [1, 2])
def test_a_cell_that_is_missing_is_named(tmp_path, depth):
    inner = {"IN": _reference("LOST")} if depth == 2 else {}
    path = written(tmp_path / "a.gds", **inner, TOP=SQUARE + _reference("IN" if inner else "LOST"))
    with pytest.raises(FileFormatError, match=r"cell '(TOP|IN)' refers to the cell 'LOST'"):
        pw.read_aperture(path)
    other = written(tmp_path / "b.gds", GOOD=SQUARE, TOP=_reference("LOST"))
    assert pw.read_aperture(other, layer="GOOD").area == pytest.approx(9e-12)


@pytest.mark.parametrize("flag", [4, 2], ids=["magnification", "angle"])
def test_absolute_transformations_are_refused(tmp_path, flag):
    cells = {"A": SQUARE, "TOP": _reference("A", (0, 0), 2.0, 10.0, flag)}
    with pytest.raises(FileFormatError, match="absolute magnification or angle"):
        pw.read_aperture(written(tmp_path / "a.gds", **cells))
