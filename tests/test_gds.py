"""Apertures drawn as GDSII layouts: units, cells, layers, paths; and files that end gdstk."""

import random

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, FileFormatError, GeometryError

# GDSII holds whole numbers of database units; the reader makes some ulp of them.
ROUNDING = 1e-12


def layout(path):
    """A cell TOP with 2 x 2 cells PAD, and a cell OTHER; in micrometres, to a nanometre."""
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
    renamed = path.rename(tmp_path / "chip")  # known by its content
    assert pw.read_aperture(renamed, layer=["TOP", "1/0"]) == pads


def test_shapes_of_layers_that_overlap_are_joined_when_asked(tmp_path):
    path = layout(tmp_path / "chip.gds")
    with pytest.raises(GeometryError, match=r"union=True \(--union\)"):
        pw.read_aperture(path, layer="PAD")
    other = pw.read_aperture(path, layer="OTHER")  # a cut leads to its hole
    assert other.area == pytest.approx(15e-12, rel=ROUNDING, abs=0.0)
    assert any(len(polygon.interiors) for polygon in np.atleast_1d(other.polygons.geoms))
    joined = pw.read_aperture(path, layer="PAD", union=True)
    assert joined.area == pytest.approx(2e-12 + 3 * 0.5e-12, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize(
    ("layer", "error", "words"),
    [
        (None, FileFormatError, "expected one top cell, got the cells OTHER, TOP"),
        ("NONE", FileFormatError, "'NONE'.*OTHER, PAD, TOP"),
        (["TOP", "7"], FileFormatError, "expected a layer of the cell, got 7; it has 1/0, 2/1"),
        (["TOP", "2/0"], FileFormatError, "got 2/0"),
        (["TOP", "PAD"], ArgumentError, "expected one cell, got TOP, PAD"),
    ],
)
def test_what_is_not_in_the_file_is_answered_with_what_is(layer, error, words, tmp_path):
    with pytest.raises(error, match=words):
        pw.read_aperture(layout(tmp_path / "chip.gds"), layer=layer)


def test_files_that_end_gdstk_are_refused_and_leave_this_process_alone(tmp_path):
    """Cut, overwritten and repeated pieces, of which some are segmentation faults."""
    content = layout(tmp_path / "chip.gds").read_bytes()
    path = tmp_path / "damaged.gds"
    damaged = [content.replace(b"PAD\0", b"TOP\0")]  # a cell within itself
    for seed in range(3):
        dice = random.Random(seed)
        at = dice.randrange(8, len(content) // 2)
        damaged.append(content[:at] + dice.randbytes(3) + content[at + 1 : at + 300])
    for piece in damaged:
        path.write_bytes(piece)
        with pytest.raises(FileFormatError, match=r"damaged\.gds: expected"):
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
