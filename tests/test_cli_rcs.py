"""``polywigner rcs``: its files hold the cross sections, and it says what it drew."""

from __future__ import annotations

import csv
import json
import math
import warnings
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from oracles.meshes import extruded
from polywigner import figures
from polywigner.cli import main
from polywigner.errors import ArgumentError

Captured = pytest.CaptureFixture[str]

FREQUENCY = ("--frequency", "3 GHz")
WAVELENGTH = pw.SPEED_OF_LIGHT / 3e9
# Of numbers written with twelve digits.
WRITTEN = 1e-11


@pytest.fixture
def square(tmp_path: Path) -> Path:
    path = tmp_path / "square.wkt"
    path.write_text("POLYGON ((-500 -500, 500 -500, 500 500, -500 500, -500 -500))")
    return path


def test_a_plate_comes_out_as_a_table_and_a_picture(square: Path, capsys: Captured) -> None:
    stem = square.parent / "out" / "plate"
    options = ("--step", "30 deg", "--format", "csv", "--format", "json", "--out", str(stem))
    assert main(["rcs", str(square), *FREQUENCY, *options]) == 0
    printed = capsys.readouterr()
    peak = 10 * math.log10(4 * math.pi / WAVELENGTH**2)
    assert f"largest RCS   {peak:.2f} dBsm" in printed.out
    assert f"down to {peak - 40:.2f} dBsm" in printed.out
    assert "30 degrees miss lobes" in printed.err
    assert stem.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    rows = list(csv.DictReader(stem.with_suffix(".csv").open()))
    assert len(rows) == 13 * 7
    for row in rows[::11]:
        a, e = (math.radians(float(row[name])) for name in ("azimuth_deg", "elevation_deg"))
        found = pw.rcs_pattern(pw.shapes.square(1.0), WAVELENGTH, a, e)["rcs"].values.item()
        assert float(row["rcs_m2"]) == pytest.approx(found, rel=WRITTEN, abs=1e-20)
    content = json.loads(stem.with_suffix(".json").read_text())
    assert np.shape(content["rcs_m2"]) == (13, 7)
    assert content["wavelength"] == pytest.approx(WAVELENGTH)


def test_a_mesh_is_a_body(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    body = extruded([(0, 0), (300, 0), (300, 100), (100, 100), (100, 300), (0, 300)], 150)
    lines = [f"v {x} {y} {z}" for x, y, z in body.vertices.tolist()]
    lines += ["f " + " ".join(str(k + 1) for k in face) for face in body.faces]
    path = tmp_path / "body.obj"
    path.write_text("\n".join(lines) + "\n")
    options = ("--step", "30 deg", "--polarisation", "hh", "--format", "nc", "--out", str(tmp_path))
    assert main(["rcs", str(path), *FREQUENCY, *options]) == 0
    with xarray.open_dataset(tmp_path / "body_rcs.nc", engine="h5netcdf") as found:
        value = found["rcs"].sel(azimuth=math.pi / 3, elevation=math.pi / 6, method="nearest")
        s = (math.sqrt(3) / 4, 0.75, 0.5)
        metres = pw.Polyhedron(body.vertices * 1e-3, body.faces)
        assert float(value) == pytest.approx(pw.rcs(metres, s, WAVELENGTH), rel=1e-9)


def test_a_body_with_a_concave_edge_is_warned_of(tmp_path: Path, capsys: Captured) -> None:
    body = extruded([(0, 0), (300, 0), (300, 100), (100, 100), (100, 300), (0, 300)], 150)
    lines = [f"v {x} {y} {z}" for x, y, z in body.vertices.tolist()]
    lines += ["f " + " ".join(str(k + 1) for k in face) for face in body.faces]
    path = tmp_path / "body.obj"
    path.write_text("\n".join(lines) + "\n")
    options = ("--step", "30 deg", "--out", str(tmp_path))
    with warnings.catch_warnings():
        warnings.simplefilter("always")  # not once in a process
        assert main(["rcs", str(path), *FREQUENCY, *options]) == 0
    assert "two or three reflections" in capsys.readouterr().err


def test_pictures_need_a_table_of_cross_sections() -> None:
    single = pw.rcs_pattern(pw.shapes.square(1.0), 0.1, 0.0, 1.0)
    with pytest.raises(ArgumentError, match="two angles each"):
        figures.draw_rcs(single)
    with pytest.raises(ArgumentError, match="rcs_pattern"):
        figures.draw_rcs(3)
    dark = pw.rcs_pattern(pw.shapes.square(1.0), 0.1, [0.0, 1.0], [0.0, 0.0])
    with pytest.raises(ArgumentError, match="zero everywhere"):
        figures.draw_rcs(dark)
