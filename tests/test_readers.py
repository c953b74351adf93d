"""Aperture files: outlines in metres, or one error that contains the name of the file."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings

from outlines import CHEVRON, apertures
from polywigner.errors import (
    ArgumentError,
    FileFormatError,
    GeometryError,
    MissingExtraError,
    QuantityError,
)
from polywigner.geometry import Aperture, read_aperture, shapes

MILLIMETRES = 1000 * CHEVRON / 100  # a chevron of 20 mm
EXPECTED = Aperture(MILLIMETRES / 1000)


def _closed(ring) -> list[list[float]]:
    return [*np.asarray(ring).tolist(), np.asarray(ring)[0].tolist()]


POLYGON = {"type": "Polygon", "coordinates": [_closed(MILLIMETRES)]}
FEATURE = {"type": "Feature", "properties": {"name": "antenna"}, "geometry": POLYGON}
EMPTY_FEATURE = {"type": "Feature", "properties": None, "geometry": None}
WKT = shapely.Polygon(MILLIMETRES).wkt
ROWS = [f"{x},{y}" for x, y in MILLIMETRES]

POINTS = " ".join(f"{x} {-y}" for x, y in MILLIMETRES)  # SVG has y downwards
DXF = "\n".join([
    "0\nSECTION\n2\nENTITIES",
    *(
        f"0\nLINE\n8\n0\n10\n{a[0]}\n20\n{a[1]}\n11\n{b[0]}\n21\n{b[1]}"
        for a, b in zip(MILLIMETRES, np.roll(MILLIMETRES, 1, axis=0), strict=True)
    ),
    "0\nENDSEC\n0\nEOF\n",
])  # fmt: skip
CORNERS = [f"X{x * 1e6:.0f}Y{y * 1e6:.0f}" for x, y in _closed(MILLIMETRES)]
GERBER = f"%FSLAX36Y36*%%MOMM*%G01*G36*{CORNERS[0]}D02*{'D01*'.join(CORNERS[1:])}D01*G37*M02*"
SAME = {
    "polygon.geojson": json.dumps(POLYGON),
    "polygon.json": "\ufeff" + json.dumps(POLYGON, indent=1),
    "POLYGON.GEOJSON": json.dumps(POLYGON),
    "flat.geojson": json.dumps(
        {"type": "Polygon", "coordinates": [[[*v, 0] for v in _closed(MILLIMETRES)]]}
    ),
    "multi.geojson": json.dumps({"type": "MultiPolygon", "coordinates": [POLYGON["coordinates"]]}),
    "feature.geojson": json.dumps(FEATURE),
    "collection.geojson": json.dumps({"type": "FeatureCollection", "features": [FEATURE]}),
    "geometries.geojson": json.dumps({"type": "GeometryCollection", "geometries": [POLYGON]}),
    "polygon.wkt": WKT,
    "lines.wkt": WKT.replace(",", ",\n").lower(),
    "multi.wkt": shapely.MultiPolygon([shapely.Polygon(MILLIMETRES)]).wkt,
    "flat.wkt": "POLYGON Z ((0 0 0, 10 5 0, 20 0 0, 20 6 0, 10 11 0, 0 6 0, 0 0 0))",
    "ring.csv": "\n".join(ROWS),
    "header.csv": "x [mm],y [mm]\r\n" + "\r\n".join(ROWS),
    "comments.csv": "# a chevron\n\n" + "\n".join(f"{row}  # corner" for row in ROWS),
    "semicolons.csv": "x;y\n" + "\n".join(ROWS).replace(",", ";").replace(".", ","),
    "blanks.csv": "\n".join(ROWS).replace(",", "\t  "),
    "quotes.csv": "\n".join(f'"{x}","{y}",' for x, y in MILLIMETRES),
    "wkt.txt": WKT,
    "rows.txt": "\n".join(ROWS),
    "json.txt": json.dumps(FEATURE),
    "no_suffix": WKT,
    "path.svg": f'<svg viewBox="0 0 1 1"><path d="M{POINTS}z"/></svg>',
    "path.xml": f'<?xml version="1.0"?><svg><polygon points="{POINTS}"/></svg>',
    "lines.dxf": DXF,
    "region.gbr": GERBER,
    "region.txt": GERBER,
    "lines.txt": "999\na comment\n" + DXF,
}


@pytest.mark.parametrize("name", SAME)
def test_every_format_reads_as_the_same_aperture_in_metres(tmp_path, name):
    path = tmp_path / name
    path.write_text(SAME[name], encoding="utf-8", newline="")
    assert read_aperture(str(path)) == EXPECTED


@pytest.mark.parametrize(
    ("unit", "metres"), [("m", 1.0), ("um", 1e-6), ("in", 0.0254), ("0.1 mm", 1e-4), (0.5, 0.5)]
)
def test_the_unit_says_what_one_stands_for(tmp_path, unit, metres):
    path = tmp_path / "square.csv"
    path.write_text("0,0\n3.1,0\n3.1,3.1\n0,3.1\n")
    side = float(f"{3.1 * metres:.12g}")
    assert read_aperture(path, unit).bounds == pytest.approx((0, 0, side, side), rel=1e-15)
    path.write_text("-3.1,-3.1\n3.1,-3.1\n3.1,3.1\n-3.1,3.1\n")  # nearest floats
    assert read_aperture(path) == shapes.square(0.0062)


def _wkt(aperture: Aperture) -> str:
    """Return WKT with all digits; GEOS writes at most 16 decimals."""

    def ring(vertices) -> str:
        return "(" + ", ".join(f"{x!r} {y!r}" for x, y in _closed(vertices)) + ")"

    polygons = [
        f"({', '.join(ring(r.coords[:-1]) for r in (p.exterior, *p.interiors))})"
        for p in aperture.polygons.geoms
    ]
    return f"MULTIPOLYGON ({', '.join(polygons)})"


@settings(
    deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(apertures())
def test_holes_and_parts_survive_geojson_and_wkt(tmp_path, aperture):
    for name, text in (
        ("any.geojson", shapely.to_geojson(aperture.polygons)),
        ("any.wkt", _wkt(aperture)),
    ):
        (tmp_path / name).write_text(text)
        assert read_aperture(tmp_path / name, unit="m") == aperture


def _polygon_text(*ring: str) -> str:
    return '{"type":"Polygon","coordinates":[[' + ",".join(ring) + "]]}"


NO_ENTITY = "without entities"
BAD_FILES = {
    "cut.geojson": (json.dumps(POLYGON)[:-9], FileFormatError, "does not parse in line 1"),
    "untyped.geojson": ("{}", FileFormatError, "does not parse"),
    "point.geojson": ('{"type":"Point","coordinates":[0,0]}', FileFormatError, "points or lines"),
    "no_vertices.geojson": ('{"type":"Polygon","coordinates":[[]]}', FileFormatError, "got none"),
    "open.geojson": (_polygon_text("[0,0]", "[1,0]", "[1,1]"), FileFormatError, "its first point"),
    "only_null.geojson": (json.dumps(EMPTY_FEATURE), FileFormatError, "does not parse"),
    "booleans.geojson": (_polygon_text("[true,0]", "[1,0]"), FileFormatError, "does not parse"),
    "huge.geojson": (_polygon_text("[1e999,0]", "[1,0]"), FileFormatError, "does not parse"),
    "high.geojson": (
        _polygon_text("[0,0,3]", "[1,0,3]", "[1,1,3]", "[0,0,3]"),
        GeometryError,
        "z = 0",
    ),
    "deep_lists.geojson": ("[" * 200_000, FileFormatError, "does not parse"),
    "two.geojson": (_polygon_text("[0,0]", "[1,1]", "[0,0]"), GeometryError, "3 different"),
    "bow_tie.geojson": (
        _polygon_text("[0,0]", "[2,1]", "[2,0]", "[0,1]", "[0,0]"),
        GeometryError,
        r"crosses itself at \(1, 0\.5\)",  # in the unit of the file
    ),
    "overlap.geojson": (
        json.dumps({"type": "MultiPolygon", "coordinates": [[_closed(MILLIMETRES)]] * 2}),
        GeometryError,
        "do not overlap",
    ),
    "words.wkt": ("hello", FileFormatError, "does not parse"),
    "open.wkt": ("POLYGON ((0 0, 1 0, 1 1, 0 1))", FileFormatError, "its first point"),
    "nothing.wkt": ("POLYGON EMPTY", FileFormatError, "got none"),
    "line.wkt": ("LINESTRING (0 0, 1 1)", FileFormatError, "points or lines"),
    "nan.wkt": ("POLYGON ((0 0, 1 0, nan 1, 0 0))", GeometryError, "finite"),
    "high.wkt": ("POLYGON Z ((0 0 1, 1 0 1, 1 1 1, 0 0 1))", GeometryError, "z = 0"),
    "columns.csv": ("0,0,0\n1,0,0\n1,1,0\n", FileFormatError, "line 1"),
    "word.csv": ("0,0\n1,zero\n1,1\n", FileFormatError, "in line 2, got other text"),
    "nan.csv": ("0,0\n1,nan\n1,1\n", FileFormatError, "line 2"),
    "second_header.csv": ("x,y\nx,y\n0,0\n1,0\n1,1", FileFormatError, "line 2"),
    "huge.csv": ("0,0\n1e999,0\n1,1\n", GeometryError, "finite"),
    "entity.svg": ('<!DOCTYPE svg [<!ENTITY e "ha">]><svg>&e;</svg>', FileFormatError, NO_ENTITY),
    "external.svg": (
        '<!DOCTYPE svg [<!ENTITY x SYSTEM "file:///etc/passwd">]><svg>&x;</svg>',
        FileFormatError,
        NO_ENTITY,
    ),
    "parameter.svg": (
        '<!DOCTYPE svg [<!ENTITY % p SYSTEM "file:///dev/zero"> %p;]><svg/>',
        FileFormatError,
        NO_ENTITY,
    ),
    "cut.dxf": (b"AutoCAD Binary DXF\r\n\x1a\0" + bytes(30), FileFormatError, "cannot read"),
    "endless.gbr": (GERBER.removesuffix("M02*"), FileFormatError, "mandatory M02"),
    "cut.gbr": (GERBER[:-14], FileFormatError, "end with an asterisk"),
    "bare.gbr": (GERBER[GERBER.index("%MO") :], FileFormatError, "%FS and %MO before coordinates"),
    "words.gbr": ("words", FileFormatError, "is a Gerber"),
    "drawing.pdf": (b"%PDF-1.7", FileFormatError, "got .pdf; export"),
}


@pytest.mark.parametrize(("name", "case"), BAD_FILES.items(), ids=BAD_FILES)
def test_a_bad_file_raises_one_error_that_names_it(tmp_path, name, case):
    content, kind, message = case
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(kind, match=message) as raised:
        read_aperture(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert len(str(raised.value)) < 600
    assert raised.value.__cause__ is None


@pytest.mark.parametrize(
    ("name", "library"),
    [
        ("path.svg", "defusedxml"), ("path.svg", "svgelements"), ("lines.dxf", "ezdxf"),
        ("region.gbr", "gerbonara.rs274x"), ("chip.gds", "gdstk"),
    ],
)  # fmt: skip
def test_a_missing_library_is_named_with_its_extra(tmp_path, monkeypatch, name, library):
    path = tmp_path / name
    path.write_text(SAME.get(name, "solid"))
    for module in [m for m in sys.modules if m.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, library, None)
    named = rf'{library.partition(".")[0]}.*pip install "polywigner\[formats\]"'
    with pytest.raises(MissingExtraError, match=named):
        read_aperture(path)


def test_paths_that_are_no_files_raise(tmp_path):
    for path in (tmp_path / "missing.csv", Path("x" * 5000)):
        with pytest.raises(FileFormatError, match=r"path of a file|cannot read the file"):
            read_aperture(path)
    for path in (None, ["aperture.csv"], Path("nul\0character.csv")):
        with pytest.raises(ArgumentError, match="expected the path of a file"):
            read_aperture(path)


def _many(item: str, count: int) -> str:
    return ",".join([item] * count)


TRIANGLE = "[[[0,0],[1,0],[1,1],[0,0]]]"
TOO_MUCH = {
    "vertices.csv": ("0,1\n" * (10**6 + 2), "at most 1000000 vertices"),
    "polygons.geojson": (f'{{"type":"MultiPolygon","coordinates":[{_many(TRIANGLE, 10_001)}]}}',
                         "at most 10000 outlines"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", TOO_MUCH)
def test_vertices_and_outlines_are_counted(tmp_path, name):
    content, words = TOO_MUCH[name]
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(FileFormatError, match=words):
        read_aperture(path)


@pytest.mark.parametrize("unit", ["furlong", "0 mm", None])
def test_a_unit_that_does_not_parse_raises(tmp_path, unit):
    path = tmp_path / "square.csv"
    path.write_text("0,0\n1,0\n1,1\n")
    with pytest.raises(QuantityError, match="expected"):
        read_aperture(path, unit)
