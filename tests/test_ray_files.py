"""Ray files: OpticStudio's format, NetCDF, and errors of damaged files."""

import struct
import warnings

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, FileFormatError, PolywignerWarning

xarray = pytest.importorskip("xarray")


WAVELENGTH = 3.2e-3
# Relative error of numbers and error of unit vectors in single precision.
SINGLE, UNIT = 6e-8, 2e-7


@pytest.fixture(scope="module")
def rays():
    return pw.sample_rays(pw.shapes.square(10e-3), WAVELENGTH, 200, 7)


def test_rays_come_back_from_netcdf_as_they_were(rays, tmp_path):
    pytest.importorskip("h5netcdf")
    path = tmp_path / "rays.nc"
    batched = rays.assign_coords(batch=("ray", np.arange(200) % 4))
    pw.write_netcdf(batched, path)
    result = xarray.load_dataset(path)
    assert result.identical(batched)
    grid = 0.1, (-0.05, -0.05, 0.05, 0.05), (3, 3)
    again, before = pw.rays.rebuild(result, *grid), pw.rays.rebuild(batched, *grid)
    assert np.array_equal(again.standard_error.values, before.standard_error.values)


def test_a_source_file_of_opticstudio_is_written_byte_by_byte(rays, tmp_path):
    path = tmp_path / "rays.dat"
    pw.rays.save(rays, path)
    content = path.read_bytes()
    assert len(content) == 208 + 200 * 7 * 4
    assert struct.unpack_from("<iI", content) == (1010, 200)
    assert content[8:108].rstrip(b"\0") == b"polywigner rays of 200: signed"
    flux, set_flux, micrometres = struct.unpack_from("<3f", content, 108)
    assert flux == set_flux == pytest.approx(float(rays.weight.sum()), rel=1e-6)
    assert micrometres == pytest.approx(3200.0)
    assert struct.unpack_from("<i", content, 136) == (4,)  # mm
    assert struct.unpack_from("<4i", content, 192) == (0, 0, 0, 0)
    x, y, z, l, m, n, w = struct.unpack_from("<7f", content, 208 + 5 * 28)  # noqa: E741
    ray = rays.isel(ray=5)
    assert (x, y, z) == pytest.approx(tuple(ray.position.values * 1e3), rel=SINGLE, abs=1e-30)
    assert (l, m, n) == pytest.approx(tuple(ray.direction.values), rel=SINGLE)
    assert w == pytest.approx(float(ray.weight), rel=SINGLE)


def test_negative_powers_in_a_source_file_are_warned_of_with_their_share(rays, tmp_path):
    weight = rays.weight.values
    rays_below = f"{100 * (weight < 0).mean():.0f} % of the rays"
    below = 100 * -weight[weight < 0].sum() / np.abs(weight).sum()
    power_below = f"{below:.0f} % of the total absolute power"
    with pytest.warns(PolywignerWarning, match=f"{rays_below}.*{power_below}.*split") as result:
        pw.rays.save(rays, tmp_path / "rays.dat")
    assert len(result) == 1
    above = rays.isel(ray=weight > 0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pw.rays.save(rays, tmp_path / "rays.dat", split=True)
        pw.rays.save(above, tmp_path / "above.dat")
        pw.rays.save(rays.isel(ray=slice(0, 0)), tmp_path / "none.dat")


def test_source_files_come_back_in_single_precision(rays, tmp_path):
    path = tmp_path / "rays.dat"
    pw.rays.save(rays, path)
    result = pw.rays.load(path)
    assert result.position.values == pytest.approx(rays.position.values, rel=2 * SINGLE, abs=1e-30)
    assert result.direction.values == pytest.approx(rays.direction.values, abs=UNIT)
    assert result.weight.values == pytest.approx(rays.weight.values, rel=SINGLE)
    assert result.attrs == {"wavelength": pytest.approx(WAVELENGTH, rel=SINGLE), "count": 200}


def test_split_files_hold_powers_above_zero_and_are_the_whole_together(rays, tmp_path):
    paths = pw.rays.save(rays, tmp_path / "rays.dat", split=True)
    assert [path.name for path in paths] == ["rays_positive.dat", "rays_negative.dat"]
    for path in paths:
        stored = np.fromfile(path, "<f4", offset=208).reshape(-1, 7)
        assert (stored[:, 6] > 0).all()
    parts = [pw.rays.load(path) for path in paths]
    whole = xarray.concat(parts, "ray", combine_attrs="override")
    order = np.argsort(np.sign(-rays.weight.values), kind="stable")
    assert whole.weight.values == pytest.approx(rays.weight.values[order], rel=SINGLE)
    assert whole.attrs["count"] == 200


def foreign(kind=0, unit=4, flux=0, second=0.5, turned=1):
    """Return a file of another program with two rays."""
    head = struct.pack("<iI100s", 8675309, 2, b"LED") + struct.pack("<7f", 1, 1, 0, 0, 180, 0, 360)
    head += struct.pack("<i13f", unit, *[0.0] * 13) + struct.pack("<4i", kind, flux, 0, 0)
    rows = [(1, 2, 3, 0, 0.6, 0.8, 0.25), (4, 5, 6, 0, 0, turned, 0.75)]
    spectra = [(*rows[0], 0.5), (*rows[1], second)] if kind == 2 else rows
    return head + b"".join(struct.pack(f"<{len(row)}f", *row) for row in spectra)


@pytest.mark.parametrize(("kind", "unit", "metres"), [(0, 4, 1e-3), (2, 1, 0.0254)])
def test_source_files_of_other_programs_are_read(kind, unit, metres, tmp_path):
    path = tmp_path / "led.dat"
    path.write_bytes(foreign(kind, unit))
    result = pw.rays.load(path)
    expected = metres * np.array([[1, 2, 3], [4, 5, 6]])
    assert result.position.values == pytest.approx(expected, rel=SINGLE)
    assert result.direction.values[0] == pytest.approx([0, 0.6, 0.8], abs=UNIT)
    assert result.weight.values.tolist() == [0.25, 0.75]
    assert result.attrs == ({"wavelength": pytest.approx(0.5e-6)} if kind == 2 else {})


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda rays, p: pw.rays.save(rays, p / "rays.npz"), "write_netcdf"),
        (lambda rays, p: pw.rays.save(3, p / "rays.dat"), "sample_rays"),
        (lambda rays, p: pw.rays.load(p / "rays.txt"), "dat"),
    ],
)
def test_arguments_are_checked_and_nothing_is_written(rays, call, said, tmp_path):
    with pytest.raises(ArgumentError, match=said):
        call(rays, tmp_path)
    assert not list(tmp_path.iterdir())


DAMAGED = {
    "cut header": (b"\0" * 100, "100 bytes"),
    "cut rays": (foreign()[:-4], "52 bytes of data for 2 rays"),
    "another unit": (foreign(unit=9), "another identifier, ray format or unit"),
    "lumens": (foreign(flux=1), "lumens"),
    "still": (foreign(turned=0), "length zero"),
    "NaN": (foreign(turned=np.nan), "NaN"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_file_raises_one_line_that_names_the_fault(name, tmp_path):
    content, fault = DAMAGED[name]
    path = tmp_path / "rays.dat"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=rf"rays\.dat.*{fault}") as error:
        pw.rays.load(path)
    assert "\n" not in str(error.value)
