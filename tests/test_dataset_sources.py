"""Datasets say in a line which source they are of, and hold the whole of it beside."""

from typing import Any

import pytest

import polywigner as pw
from polywigner.errors import FileFormatError

xarray = pytest.importorskip("xarray", reason="the extra datasets is not installed")
for _library in ("zarr", "dask", "h5netcdf"):
    pytest.importorskip(_library, reason="the extra datasets is not installed")

WAVELENGTH = 3e-3
SOURCE = pw.shapes.disc(10e-3, 64).with_illumination(pw.steering((0.0, 0.6, 0.8), WAVELENGTH))
BOX = ((0.0, 0.0, 0.1), (0.02, 0.01, 0.2))
AXIS = [0.0, 1e-3]
LONGEST = 200


def _datasets(folder):
    how: dict[str, Any] = {"method": "fraunhofer"}
    return {
        "line": pw.line(SOURCE, BOX, 3, WAVELENGTH, **how),
        "pattern": pw.radiation_pattern(SOURCE, WAVELENGTH, [0.0, 0.1], [0.0]),
        "table": pw.wigner_table(SOURCE, AXIS, AXIS, AXIS, AXIS, engine="numpy"),
        "stored table": pw.wigner_table(
            SOURCE, AXIS, AXIS, AXIS, AXIS, folder / "w.zarr", engine="numpy"
        ),
        "stored volume": pw.volume(
            SOURCE, BOX, (2, 2, 2), WAVELENGTH, out=folder / "v.zarr", engine="numpy", **how
        ),
    }


def test_a_dataset_tells_its_source_in_a_line_and_gives_it_back(tmp_path):
    for name, found in _datasets(tmp_path).items():
        assert found.attrs["source"] == repr(SOURCE), name
        assert pw.read_source(found) == SOURCE, name
        assert "source_json" not in found.data_vars, name
        own = {k: v for k, v in found.attrs.items() if not k.startswith("polywigner_")}
        assert max(len(str(value)) for value in own.values()) <= LONGEST, name
        assert all("polygons" not in str(value) for value in found.attrs.values()), name


def test_fields_and_patterns_show_themselves_in_few_lines(tmp_path):
    """A line of the display for each axis, each variable and each attribute, beside five."""
    found = _datasets(tmp_path)
    assert set(found["line"].attrs) == {"wavelength", "frequency", "source"}
    assert len(repr(found["line"]).splitlines()) <= 14
    assert len(repr(found["pattern"]).splitlines()) <= 24


def test_files_give_the_source_back_too(tmp_path):
    found = _datasets(tmp_path)
    for name in ("line", "stored volume"):
        pw.write_netcdf(found[name], tmp_path / f"{name}.nc")
        with xarray.open_dataset(tmp_path / f"{name}.nc", engine="h5netcdf") as read:
            assert pw.read_source(read) == SOURCE
    assert pw.read_source(xarray.open_zarr(tmp_path / "w.zarr")) == SOURCE


def test_a_source_too_long_to_keep_is_told_by_its_digest():
    long = pw.shapes.disc(10e-3, 2000)
    found = pw.line(long, BOX, 2, WAVELENGTH, method="fraunhofer")
    assert len(found.attrs["source_sha256"]) == 64
    with pytest.raises(FileFormatError, match="source_json, got one without"):
        pw.read_source(found)
