"""Gerber files: areas, order of dark and clear objects, and errors."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import FileFormatError

# Rounding error of sums over some hundred vertices, scaled from mm to metres.
ROUNDING = 1e-12

# Largest distance of chords from arcs [m]. This distance times the length of the arcs bounds the
# error of the area.
TOLERANCE = 1e-9

HEAD = "G04 A board*\n%FSLAX33Y33*%\n%MOMM*%\n"
PATCH = "G36*\nX0Y0D02*\nG01X30000D01*\nY20000D01*\nX0D01*\nY0D01*\nG37*\n"
FLASH = "D10*\nX5000Y0D03*\n"


@pytest.fixture
def read(tmp_path: Path):
    pytest.importorskip("gerbonara")

    def reader(body: str, head: str = HEAD, end: str = "M02*\n", **how: object) -> pw.Aperture:
        path = tmp_path / "board.gbr"
        path.write_text(head + body + end)
        return pw.read_aperture(path, **how)  # type: ignore[arg-type]

    return reader


def test_a_patch_and_its_feed_by_region_and_by_stroke_are_the_same(read) -> None:
    feed = "%ADD10R,2X2*%\nD10*\nX15000Y-9000D02*\nG01Y1000D01*\n"
    strip = "G36*\nX14000Y-10000D02*\nG01X16000D01*\nY2000D01*\nX14000D01*\nY-10000D01*\nG37*\n"
    stroked, drawn = read(PATCH + feed, unit="km"), read(strip + PATCH)
    assert stroked.area == pytest.approx((600 + 20) * 1e-6, rel=ROUNDING, abs=0.0)
    assert drawn == stroked


@pytest.mark.parametrize(
    ("body", "square_mm", "length_mm"),
    [
        # A capsule, and two capsules at a right angle with a common end.
        ("%ADD10C,2*%D10*X0Y0D02*G01X10000D01*", 20 + math.pi, 2 * math.pi),
        ("%ADD10C,2*%D10*X0Y0D02*X10000D01*Y10000D01*", 39 + 5 * math.pi / 4, 3 * math.pi),
        ("%ADD10C,2*%D10*X0Y0D02*D01*", math.pi, 0),
        # Arcs of radius 10 and width 1: a left turn, a long right turn, and a full circle.
        ("%ADD10C,1*%D10*G75*X10000Y0D02*G03X0Y10000I-10000J0D01*", 5.25 * math.pi, 40),
        ("%ADD10C,1*%D10*G75*X10000Y0D02*G02X0Y10000I-10000J0D01*", 15.25 * math.pi, 120),
        ("%ADD10C,1*%D10*G75*X10000Y0D02*G03X10000Y0I-10000J0D01*", 20 * math.pi, 0),
        ("G75*G36*X10000Y0D02*G03X-10000Y0I-10000J0D01*G1X10000D1*G37*", 50 * math.pi, 40),
        ("%ADD10O,2X1*%" + FLASH, 1 + math.pi / 4, math.pi),
        ("%ADD10C,2X1*%" + FLASH, 0.75 * math.pi, 0),
        ("%ADD10P,2X6X0X1*%" + FLASH, 6 * math.sqrt(3) / 4 - math.pi / 4, 0),
    ],
)
def test_areas_of_strokes_arcs_and_flashes(
    read, body: str, square_mm: float, length_mm: float
) -> None:
    exact = square_mm * 1e-6
    missing = exact - read(body, tolerance=TOLERANCE).area
    assert -ROUNDING * exact <= missing <= length_mm * 1e-3 * TOLERANCE + ROUNDING * exact


def test_a_round_flash_stays_within_the_tolerance_and_keeps_its_area(read) -> None:
    for tolerance in (1e-5, 1e-8):
        disc = read("%ADD10C,2*%" + FLASH, tolerance=tolerance)
        radii = np.hypot(*(np.concatenate(disc.rings) - (5e-3, 0)).T)
        assert np.abs(radii - 1e-3).max() <= tolerance
        assert disc.area == pytest.approx(math.pi * 1e-6, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize("name", ["A", "X", "d", "_", "C1"])
def test_a_macro_may_be_named_by_one_letter(read, name: str) -> None:
    shape = read(f"%AM{name}*21,1,$1,$2,0,0,0*%%ADD10{name},1.5X2*%" + FLASH)
    assert shape.area == pytest.approx(3e-6, rel=ROUNDING, abs=0.0)


def test_the_ends_of_strokes_are_as_fine_wherever_they_lie(read) -> None:
    strokes = [read(f"%ADD10C,2*%D10*X{x}Y0D02*X{x + 5000}D01*") for x in (0, 900_000)]
    assert len(strokes[0].rings[0]) == len(strokes[1].rings[0]) >= 40


def test_dark_adds_and_clear_cuts_in_the_order_of_the_file(read) -> None:
    pen = "%ADD10R,4X4*%\n%ADD11R,2X2*%\n"
    clear, dark = "%LPC*%\nD10*\nX10000Y10000D03*\n", "%LPD*%\nD11*\nX10000Y10000D03*\n"
    island = read(pen + PATCH + clear + dark)
    assert island.area == pytest.approx((600 - 16 + 4) * 1e-6, rel=ROUNDING, abs=0.0)
    assert read(pen + dark + clear + "%LPD*%" + PATCH).area == pytest.approx(6e-4, rel=ROUNDING)


def test_many_changes_of_polarity_only_touch_the_shapes_nearby(read, monkeypatch) -> None:
    from polywigner.geometry.io import gerber

    sizes = []

    def union(polygons: list[object]) -> object:
        sizes.append(len(polygons))
        return union_on_grid(polygons)

    union_on_grid = gerber.union_on_grid
    monkeypatch.setattr(gerber, "union_on_grid", union)
    pads = [f"%LPD*%D10*X{x}Y0D03*%LPC*%D11*X{x}Y0D03*" for x in range(0, 60_000, 3000)]
    shape = read("%ADD10R,2X2*%%ADD11R,1X1*%" + "".join(pads))
    assert shape.area == pytest.approx(20 * 3e-6, rel=ROUNDING, abs=0.0)
    assert max(sizes) <= 2


def test_a_hole_that_a_cut_leads_to_is_open(read) -> None:
    around = "Y10000D01*X10000D01*Y15000D01*X20000D01*Y5000D01*X10000D01*Y10000D01*X0D01*Y0D01*"
    cut_in = PATCH.replace("Y0D01*", around)
    assert read(cut_in).area == pytest.approx(5e-4, rel=ROUNDING, abs=0.0)


def test_units_and_suppressed_zeros_are_those_of_the_file(read) -> None:
    square = "G36*X0Y0D02*X1000D01*Y1000D01*X0D01*Y0D01*G37*"
    inch = read(square, head="%FSLAX33Y33*%%MOIN*%")
    assert inch.area == pytest.approx(0.0254**2, rel=ROUNDING, abs=0.0)
    trailing = read("%ADD10R,1X1*%D10*X00015Y-2D03*", head="%FSTAX33Y33*%%MOMM*%")
    assert trailing.bounds == pytest.approx((-0.35e-3, -200.5e-3, 0.65e-3, -199.5e-3), rel=1e-12)
    # Older files combine both commands, and contain identity transformations.
    neutral = "%FSLAX33Y33*MOMM*%%IPPOS*OFA0.0B0.0*%%SRX1Y1I0J0*%%LR0*%G71*"
    assert read(square, head=neutral).area == pytest.approx(1e-6, rel=ROUNDING, abs=0.0)


# Bounds of a rectangle of 4 x 1 about (5, 0), rotated by 30 degrees.
ACROSS, UP = math.sqrt(3) + 0.25, 1 + math.sqrt(3) / 4
TURNED = (5 - ACROSS, -UP, 5 + ACROSS, UP)


@pytest.mark.parametrize(
    ("macro", "bounds_mm", "square_mm"),
    [
        ("20,1,1,0,0,3,0,90", (4.5, 0, 5.5, 3), 3),
        ("21,1,2,1,1,0,90", (4.5, 0, 5.5, 2), 2),
        ("21,1,4,1,0,0,30", TURNED, 4),
        ("5,1,4,0,0,1,90", (4.5, -0.5, 5.5, 0.5), 0.5),
        ("4,1,3,0,0,1,0,0,2,0,0,90", (3, 0, 5, 1), 1),
        ("0 words*$3=$1x2+(1-0.5)/$2*21,1,$3,-$1+2.5,0,$1,0", (3.375, 1, 6.625, 2), 3.25),
        ("21,1,4,4,0,0,0*21,0,2,2,0,0,0", (3, -2, 7, 2), 12),
    ],
)
def test_macros(read, macro: str, bounds_mm: tuple[float, ...], square_mm: float) -> None:
    shape = (
        read(f"%AMPad*{macro}*%%ADD10Pad,1.5X2*%" + FLASH)
        if "$" in macro
        else read(f"%AMPad*{macro}*%%ADD10Pad*%" + FLASH)
    )
    assert shape.bounds == pytest.approx(tuple(b * 1e-3 for b in bounds_mm), rel=1e-12, abs=1e-15)
    assert shape.area == pytest.approx(square_mm * 1e-6, rel=ROUNDING, abs=0.0)


def test_a_circle_of_a_macro_turns_about_the_origin_and_cuts_its_macro_alone(read) -> None:
    turned = read("%AMPad*1,1,1,2,0,90*%%ADD10Pad*%" + FLASH)
    assert np.mean(turned.bounds[::2]) == pytest.approx(5e-3, rel=1e-9)
    assert np.mean(turned.bounds[1::2]) == pytest.approx(2e-3, rel=1e-9)
    ring = "%AMPad*21,1,4,4,0,0,0*1,0,2,0,0*%%ADD10Pad*%%ADD11R,1X1*%D11*X5000Y0D03*"
    area = read(ring + FLASH).area
    assert area == pytest.approx((16 - math.pi + 1) * 1e-6, rel=ROUNDING, abs=0.0)


SQUARE = "%ADD10R,1X1*%D10*"
ROUND = "%ADD10C,1*%D10*X0Y0D02*"
UNREAD = {
    "step and repeat": "%SRX2Y1I3J0*%" + SQUARE + "X0Y0D03*%SR*%",
    "block": "%ABD12*%" + SQUARE + "X0Y0D03*%AB*%",
    "mirrored aperture": SQUARE + "%LMX*%X0Y0D03*",
    "rotated aperture": SQUARE + "%LR45*%X0Y0D03*",
    "negative image": "%IPNEG*%" + PATCH,
    "scaled image": "%SFA2B2*%" + PATCH,
    "shifted image": "%OFA1B0*%" + PATCH,
    "second statement in one": "%LPD*SRX2Y1I3J0*%" + PATCH,
    "include": "%IFother.gbr*%" + PATCH,
    "incremental": "G91*" + PATCH,
    "no operation": ROUND + "X1000D01*X2000*",
    "decimal point": ROUND + "X1.5D01*",
    "other unit": "G70*" + PATCH,
    "turned polygon": "%ADD10P,2X6X15*%" + FLASH,
    "macro exposure": "%AMPad*1,2,1,0,0*%%ADD10Pad*%" + FLASH,
    "polygon off the centre": "%AMPad*5,1,4,2,0,1,90*%%ADD10Pad*%" + FLASH,
    "macro code": "%AMPad*7,0,0,2,1,.2,0*%%ADD10Pad*%" + FLASH,
}  # fmt: skip
REFUSED = {
    **{name: (body, "an unsupported statement in line") for name, body in UNREAD.items()},
    "endless region": ("G36*X0Y0D02*X1000D01*", "each G36 to be followed by G37"),
    "second unit": ("%MOIN*%" + PATCH, "file units"),
    "arc without centre": (ROUND + "G75*G02X1000Y0D01*", "w/o I, J"),
    "arc of two radii": (ROUND + "G75*G02X1000Y0I100J0D01*", "arcs with one radius"),
    "arc in a quadrant": (ROUND + "G74*G02X1000Y0I500J0D01*", "G74 multi-quad"),
    "arc of a rectangle": (SQUARE + "X0Y0D02*G75*G02X1000Y0I500J0D01*", "arcs drawn with round"),
    "stroke of an obround": ("%ADD10O,1X2*%D10*X0Y0D02*X1000D01*", "Non-circular"),
    "stroke of a ring": ("%ADD10C,1X.5*%D10*X0Y0D02*X1000D01*", "without holes"),
    "rectangular hole": ("%ADD10C,1X.2X.2*%" + FLASH, "gerbonara can read"),
    "undefined": ("D11*X0Y0D03*", "undefined aperture 11"),
    "no aperture": ("X0Y0D03*", "an aperture before"),
    "no such macro": ("%ADD10Pad*%" + FLASH, "is unknown"),
    "macro parameter": ("%AMPad*1,1,$1,0,0*%%ADD10Pad*%" + FLASH, r"unresolved.*\$1"),
    "open region": ("G36*X0Y0D02*X1000D01*Y1000D01*G37*", "closed region outlines"),
    "clear alone": ("%LPC*%" + PATCH, "copper"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_would_be_read_wrongly_is_refused(read, what: str) -> None:
    body, words = REFUSED[what]
    with pytest.raises(FileFormatError, match=rf"board\.gbr: .*{words}"):
        read(body)
