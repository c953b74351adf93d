"""Files, figures and messages of ``polywigner rcs``."""

from __future__ import annotations

import csv
import math
import warnings
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from oracles.meshes import extruded
from polywigner import figures
from polywigner.cli import main
from polywigner.cli.radar_commands import write_rows
from polywigner.errors import ArgumentError

Captured = pytest.CaptureFixture[str]

FREQUENCY = ("--frequency", "3 GHz")
WAVELENGTH = pw.SPEED_OF_LIGHT / 3e9
# Rounding error of the written numbers, which have twelve digits.
WRITTEN = 1e-11


@pytest.fixture
def square(tmp_path: Path) -> Path:
    path = tmp_path / "square.wkt"
    path.write_text("POLYGON ((-500 -500, 500 -500, 500 500, -500 500, -500 -500))")
    return path


def test_a_plate_comes_out_as_a_table_and_a_picture(square: Path, capsys: Captured) -> None:
    stem = square.parent / "out" / "plate"
    options = ("--step", "30 deg", "--out", str(stem))
    assert main(["rcs", str(square), *FREQUENCY, *options]) == 0
    printed = capsys.readouterr()
    peak = 10 * math.log10(4 * math.pi / WAVELENGTH**2)
    assert f"largest RCS   {peak:.2f} dBsm" in printed.out
    assert f"down to {peak - 60:.2f} dBsm" in printed.out
    assert "30 degrees are too coarse for lobes" in printed.err
    cuts = np.loadtxt(stem.with_name("plate_cuts.csv"), delimiter=",", skiprows=1)
    lobe = math.degrees(WAVELENGTH / (2 * math.sqrt(2)))
    around = cuts[: len(cuts) // 2]
    assert np.ptp(around[:, 0]) == pytest.approx(360) and (around[:, 1] == 0).all()
    assert 0 < np.diff(around[:, 0]).max() <= lobe / 4 + 1e-9
    assert cuts[:, 2].max() == pytest.approx(10 ** (peak / 10))
    assert stem.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    rows = list(csv.DictReader(stem.with_suffix(".csv").open()))
    assert len(rows) == 13 * 7
    for row in rows[::11]:
        a, e = (math.radians(float(row[name])) for name in ("azimuth_deg", "elevation_deg"))
        result = pw.rcs_pattern(pw.shapes.square(1.0), WAVELENGTH, a, e)["rcs"].values.item()
        assert float(row["rcs_m2"]) == pytest.approx(result, rel=WRITTEN, abs=1e-20)


@pytest.mark.usefixtures("unrendered_figures")
def test_a_mesh_is_a_body_whose_concave_edges_are_warned_of(
    tmp_path: Path, capsys: Captured
) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    body = extruded([(0, 0), (300, 0), (300, 100), (100, 100), (100, 300), (0, 300)], 150)
    lines = [f"v {x} {y} {z}" for x, y, z in body.vertices.tolist()]
    lines += ["f " + " ".join(str(k + 1) for k in face) for face in body.faces]
    path = tmp_path / "body.obj"
    path.write_text("\n".join(lines) + "\n")
    options = ("--step", "30 deg", "--polarisation", "hh", "--format", "nc", "--out", str(tmp_path))
    with warnings.catch_warnings():
        warnings.simplefilter("always")  # for each call
        assert main(["rcs", str(path), *FREQUENCY, *options]) == 0
    assert "two or three reflections" in capsys.readouterr().err
    with xarray.open_dataset(tmp_path / "body_rcs.nc", engine="h5netcdf") as result:
        value = result["rcs"].sel(azimuth=math.pi / 3, elevation=math.pi / 6, method="nearest")
        s = (math.sqrt(3) / 4, 0.75, 0.5)
        metres = pw.Polyhedron(body.vertices * 1e-3, body.faces)
        assert float(value) == pytest.approx(pw.rcs(metres, s, WAVELENGTH), rel=1e-9)


@pytest.mark.usefixtures("unrendered_figures")
def test_an_open_mesh_is_plates_whose_reflections_count(tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "corner.obj"
    path.write_text(
        "v 0 0 0\nv 300 0 0\nv 0 300 0\nv 0 0 300\nf 1 2 3\nf 1 3 4\nf 1 4 2\n", encoding="utf-8"
    )
    assert main(["rcs", str(path), *FREQUENCY]) == 2
    assert "read_sheets" in capsys.readouterr().err
    options = ["--step", "30 deg", "--cut-step", "5 deg", "--smooth", "20 deg", "--bounces", "3"]
    options += ["--cut-elevation", "35 deg", "--cut-azimuth", "45 deg", "--open-mesh"]
    assert main(["rcs", str(path), *FREQUENCY, *options, "--out", str(tmp_path)]) == 0
    assert "three reflections" in capsys.readouterr().out
    rows = np.loadtxt(tmp_path / "corner_rcs_cuts.csv", delimiter=",", skiprows=1)
    assert set(np.round(rows[:73, 1], 9)) == {35.0}
    assert set(np.round(rows[73:, 0], 9)) == {45.0, 225.0}
    axis = rows[(rows[:, 0].round(6) == 45) & (rows[:, 1].round(6) == 35)]
    closed = 4 * math.pi * 0.3**4 / (3 * WAVELENGTH**2)
    assert 10 * math.log10(axis[0, 2] / closed) == pytest.approx(0, abs=1.0)


def test_directions_that_failed_are_left_out_of_pictures_and_files(tmp_path: Path) -> None:
    angles = np.linspace(-3, 3, 13), np.linspace(-1.5, 1.5, 7)
    pattern = pw.rcs_pattern(pw.shapes.square(1.0), 0.1, *angles)
    pattern["rcs"].values[3] = np.nan
    figures.draw_rcs(pattern, smooth=0.5)
    write_rows([pattern], tmp_path / "a.csv")
    values = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)[:, 2].reshape(13, 7)
    assert np.isnan(values[3]).all() and np.isfinite(values[4]).all()


def test_finer_cuts_are_drawn_with_their_medians() -> None:
    plate, angles = pw.shapes.square(1.0), np.linspace(-np.pi, np.pi, 361)
    pattern = pw.rcs_pattern(plate, 0.1, angles[::30], np.linspace(-1.5, 1.5, 7))
    cuts = [
        pw.rcs_pattern(plate, 0.1, angles, 0.5),
        pw.rcs_pattern(plate, 0.1, [0.0, np.pi], np.linspace(-1.5, 1.5, 301)),
    ]
    figure = figures.draw_rcs(pattern, cuts=cuts, smooth=0.2, floor_db=-80)
    first, second, *_ = figure.axes
    assert [len(axes.lines) for axes in (first, second)] == [2, 2]
    assert [len(axes.lines[0].get_xdata()) for axes in (first, second)] == [361, 602]
    raw, median = (line.get_ydata() for line in second.lines)
    assert np.std(median[5:-5]) < np.std(raw[5:-5])
    with pytest.raises(ArgumentError, match="cuts to be a list of two patterns"):
        figures.draw_rcs(pattern, cuts=[*cuts, 3])
    for wrong, message in (
        (cuts[1].isel(elevation=[0]), "2 azimuths and 2 elevations"),
        (3, "rcs_pattern"),
        (pattern.assign(rcs=0 * pattern["rcs"]), "zero at all angles"),
    ):
        with pytest.raises(ArgumentError, match=message):
            figures.draw_rcs(wrong)
