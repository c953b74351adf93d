"""Datasets as NetCDF and VTK files: the same numbers at the same places, whole files or none."""

import xml.etree.ElementTree as ElementTree

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
    chunks = {"x": 4, "y": 3, "nu_x": 2, "nu_y": 4}
    pw.wigner_table(SQUARE, x, x + 0.125, NU, NU, store, chunks=chunks, engine="numpy")
    return store


def read_vti(path):
    """Attributes of the image, and its arrays, indexed [x, y, z], by the format's description."""
    head, _, rest = path.read_bytes().partition(b'<AppendedData encoding="raw">\n_')
    body, _, tail = rest.rpartition(b"\n</AppendedData>")
    root = ElementTree.fromstring(head + b"<AppendedData/>" + tail)
    assert root.attrib["header_type"] == "UInt64"
    assert root.attrib["byte_order"] == "LittleEndian"
    image = root[0]
    extent = np.array(image.attrib["WholeExtent"].split(), int)
    shape = tuple(extent[1::2] - extent[::2] + 1)
    arrays = {}
    for array in image.iter("DataArray"):
        start = int(array.attrib["offset"])
        size = int(np.frombuffer(body, "<u8", 1, start)[0])
        kind = {"Float32": "<f4", "Float64": "<f8"}[array.attrib["type"]]
        values = np.frombuffer(body[start + 8 : start + 8 + size], kind)
        arrays[array.attrib["Name"]] = values.reshape(shape, order="F")
    return dict(image.attrib), arrays


def test_netcdf_has_the_values_axes_and_units_of_a_store(table, tmp_path):
    pw.write_netcdf(table, tmp_path / "w.nc")
    with xarray.open_dataset(tmp_path / "w.nc", engine="h5netcdf") as result:
        stored = xarray.open_zarr(table)
        xarray.testing.assert_equal(result, stored)
        assert result["W"].attrs["units"] == "m2"
        assert result["nu_x"].attrs["units"] == "1/m"
        assert result.attrs == stored.attrs
    assert [file.name for file in tmp_path.iterdir()] == ["w.nc"]


def test_vtk_image_data_has_the_values_of_a_store(table, tmp_path):
    part = xarray.open_zarr(table).isel(nu_y=1, drop=True)
    pw.write_vti(part, tmp_path / "w.vti")
    image, arrays = read_vti(tmp_path / "w.vti")
    np.testing.assert_array_equal(arrays["W"], part["W"].values)
    np.testing.assert_allclose(np.array(image["Origin"].split(), float), [-0.5, -0.375, -2.0])
    np.testing.assert_allclose(np.array(image["Spacing"].split(), float), [0.2, 0.2, 1.0])


def test_complex_values_become_their_two_parts(tmp_path):
    lags = np.linspace(-0.5, 0.25, 4)
    result = pw.ambiguity_table(SQUARE.moved((0.1, 0)), NU, NU, lags, lags, precision="double")
    part = result.isel(xi_y=0)
    pw.write_vti(part, tmp_path / "a.vti")
    pw.write_netcdf(result, tmp_path / "a.nc")
    _, arrays = read_vti(tmp_path / "a.vti")
    assert abs(arrays["A_imag"]).max() > 0.05
    np.testing.assert_array_equal(arrays["A_real"] + 1j * arrays["A_imag"], part["A"])
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as file:
        np.testing.assert_array_equal(file["A_real"] + 1j * file["A_imag"], result["A"])
        assert file["A_imag"].attrs["units"] == "m2"


def test_planes_and_lines_are_images_of_one_sample_across(table, tmp_path):
    line = xarray.open_zarr(table).isel(x=2, nu_x=2, nu_y=3, drop=True)
    pw.write_vti(line, tmp_path / "line.vti")
    image, arrays = read_vti(tmp_path / "line.vti")
    assert image["WholeExtent"] == "0 0 0 5 0 0"  # along y
    np.testing.assert_array_equal(arrays["W"][0, :, 0], line["W"])


@pytest.mark.parametrize("write", [pw.write_netcdf, pw.write_vti])
def test_what_is_no_dataset_is_refused(tmp_path, write):
    for given in (3, np.zeros(3)):
        with pytest.raises(ArgumentError, match=r"xarray\.Dataset or the path of a store"):
            write(given, tmp_path / "out")
    with pytest.raises(StoreError, match=r"expected a zarr store of format 3 at .*nowhere"):
        write("nowhere.zarr", tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_images_of_four_axes_or_uneven_ones_are_refused(table, tmp_path):
    result = xarray.open_zarr(table)
    for wrong, words in (
        (result, "one to three axes"),
        (result.isel(nu_x=0, x=[0, 1, 3], drop=True), "evenly spaced ascending values of x"),
        (result.isel(nu_x=0, y=slice(None, None, -1), drop=True), "ascending values of y"),
    ):
        with pytest.raises(ArgumentError, match=words):
            pw.write_vti(wrong, tmp_path / "w.vti")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("write", [pw.write_netcdf, pw.write_vti])
def test_a_write_that_fails_leaves_what_was_there(table, tmp_path, write):
    part = xarray.open_zarr(table).isel(nu_y=1, drop=True)
    (tmp_path / "taken").mkdir()
    with pytest.raises(ArgumentError, match="expected to write"):
        write(part, tmp_path / "taken")
    (tmp_path / "old").write_text("old")
    broken = part.map_blocks(lambda block: block / 0 + undefined, template=part)  # noqa: F821
    with pytest.raises(NameError):
        write(broken, tmp_path / "old")
    assert (tmp_path / "old").read_text() == "old"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["old", "taken"]
