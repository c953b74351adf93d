"""Datasets as NetCDF files: the same numbers at the same coordinates, complete files or none."""

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, StoreError

_EXTRA = "the extra `datasets` is not installed"
xarray = pytest.importorskip("xarray", reason=_EXTRA)
for _library in ("zarr", "dask", "h5netcdf", "h5py"):
    pytest.importorskip(_library, reason=_EXTRA)

SQUARE = pw.shapes.square(1.0)
NU = np.linspace(-2.0, 2.0, 5)


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """A W table on disk, in chunks that do not divide its axes."""
    store = tmp_path_factory.mktemp("table") / "w.zarr"
    x = np.linspace(-0.5, 0.5, 6)
    chunks = (4, 3, 2, 4)
    pw.wigner_table(SQUARE, x, x + 0.125, NU, NU, store, chunks=chunks, engine="numpy")
    return store


def test_netcdf_has_the_values_axes_and_units_of_a_store(table, tmp_path):
    pw.write_netcdf(table, tmp_path / "w.nc")
    with xarray.open_dataset(tmp_path / "w.nc", engine="h5netcdf") as result:
        stored = xarray.open_zarr(table)
        xarray.testing.assert_equal(result, stored)
        assert result["W"].attrs["units"] == "m2"
        assert result["nu_x"].attrs["units"] == "1/m"
        assert result.attrs == stored.attrs
    assert [file.name for file in tmp_path.iterdir()] == ["w.nc"]


def test_complex_values_become_their_two_parts(tmp_path):
    lags = np.linspace(-0.5, 0.25, 4)
    result = pw.ambiguity_table(SQUARE.moved((0.1, 0)), NU, NU, lags, lags, precision="double")
    pw.write_netcdf(result, tmp_path / "a.nc")
    assert abs(result["A"].imag).max() > 0.05
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as file:
        np.testing.assert_array_equal(file["A_real"] + 1j * file["A_imag"], result["A"])
        assert file["A_imag"].attrs["units"] == "m2"


def test_what_is_no_dataset_is_refused(tmp_path):
    for given in (3, np.zeros(3)):
        with pytest.raises(ArgumentError, match=r"xarray\.Dataset or the path of a store"):
            pw.write_netcdf(given, tmp_path / "out")
    with pytest.raises(StoreError, match=r"expected a zarr store of format 3 at .*nowhere"):
        pw.write_netcdf("nowhere.zarr", tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_a_write_that_fails_leaves_what_was_there(table, tmp_path):
    part = xarray.open_zarr(table).isel(nu_y=1, drop=True)
    (tmp_path / "taken").mkdir()
    with pytest.raises(ArgumentError, match="expected to write"):
        pw.write_netcdf(part, tmp_path / "taken")
    (tmp_path / "old").write_text("old")
    broken = part.map_blocks(lambda block: block / 0 + undefined, template=part)  # noqa: F821
    with pytest.raises(NameError):
        pw.write_netcdf(broken, tmp_path / "old")
    assert (tmp_path / "old").read_text() == "old"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["old", "taken"]
