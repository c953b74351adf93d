"""``polywigner volume``: a store that can be gone on with, a picture, and files for others."""

import numpy as np
import pytest

import polywigner as pw
from polywigner.cli import main

xarray = pytest.importorskip("xarray")
pytest.importorskip("zarr")


WAVELENGTH = 299_792_458 / 94e9
SQUARE = pw.shapes.square(10e-3)
BOX = ("--box", "-20 mm to 20 mm, -15 mm to 15 mm, 30 mm to 60 mm")
SMALL = (*BOX, "--shape", "6 x 5 x 4", "--chunks", "3 x 3 x 4", "--engine", "numpy")

SINGLE = 1e-6  # values are stored in float32


@pytest.fixture
def square(tmp_path):
    path = tmp_path / "square.wkt"
    path.write_text("POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
    return path


def run(path, *options):
    out = path.parent / "out" / "field"
    common = ("--frequency", "94 GHz", "--out", str(out))
    return main(["volume", str(path), *common, *options])


def test_the_store_holds_the_irradiance_in_the_box(square, capfd):
    formats = ("--format", "nc", "--format", "vti", "--format", "vti", "--format", "zarr")
    assert run(square, *SMALL, "--method", "wigner kirchhoff", *formats) == 0
    out = square.parent / "out"
    names = ("field.zarr", "field.png", "field.nc", "field.vti")
    assert capfd.readouterr().out.splitlines() == [str(out / name) for name in names]
    assert sorted(path.name for path in out.iterdir()) == sorted(names)
    found = xarray.open_zarr(out / "field.zarr")
    assert found["wigner"].dims == ("x", "y", "z") and found["wigner"].shape == (6, 5, 4)
    assert dict(found.chunksizes) == {"x": (3, 3), "y": (3, 2), "z": (4,)}
    np.testing.assert_allclose(found["y"], np.linspace(-15e-3, 15e-3, 5))
    axes = np.meshgrid(*(found[name].values for name in "xyz"), indexing="ij")
    expected = pw.irradiance(SQUARE, np.stack(axes, -1), WAVELENGTH, obliquity="kirchhoff")
    np.testing.assert_allclose(found["wigner"], expected, rtol=SINGLE, atol=SINGLE)
    with xarray.open_dataset(out / "field.nc", engine="h5netcdf") as copy:
        assert np.array_equal(copy["wigner"], found["wigner"])
    assert b'WholeExtent="0 5 0 4 0 3"' in (out / "field.vti").read_bytes()  # for ParaView
    chunks = {path: path.stat().st_mtime_ns for path in (out / "field.zarr").glob("*/c/*/*/*")}
    min(chunks).unlink()
    assert run(square, *SMALL, "--method", "wigner kirchhoff") == 0  # completes the store
    assert all(p.stat().st_mtime_ns == t for p, t in chunks.items() if p != min(chunks))


def test_methods_side_by_side_have_stores_of_their_own(square, capfd):
    methods = ("--method", "fraunhofer", "--method", "kirchhoff")
    assert run(square, *SMALL, *methods) == 0
    printed = capfd.readouterr().out
    out = square.parent / "out"
    first, second = (xarray.open_zarr(out / f"field-{m}.zarr")[m].values for m in methods[1::2])
    apart = 10 * np.log10(first / second)[second > second.max() * 1e-3]
    row = next(line.split() for line in printed.splitlines() if line.startswith("  fraunhofer"))
    np.testing.assert_allclose(float(row[1]), apart.flat[np.argmax(abs(apart))], atol=5.1e-4)
    np.testing.assert_allclose(float(row[2]), np.sqrt(np.mean(apart**2)), atol=5.1e-5)
    assert int(row[3]) == apart.size < second.size == int(row[5])
    assert (out / "field-kirchhoff.png").exists()


def test_the_store_of_a_field_behind_an_obstacle_is_no_other_field(square, capfd):
    plate = ("--obstacle", f"{square} at 0 mm, 0 mm, 20 mm")
    assert run(square, *SMALL, *plate) == 0
    found = xarray.open_zarr(square.parent / "out" / "field.zarr")["rayleigh-sommerfeld-1"]
    pose = np.eye(4)
    pose[2, 3] = 0.02
    axes = np.meshgrid(*(found[name].values for name in "xyz"), indexing="ij")
    expected = pw.irradiance(
        SQUARE, np.stack(axes, -1), WAVELENGTH, "auto", obstacles=SQUARE.placed(pose)
    )
    np.testing.assert_allclose(found, expected, rtol=SINGLE, atol=SINGLE)
    assert run(square, *SMALL, "--obstacle", f"{square} at 0 mm, 1 mm, 20 mm") == 2
    assert "obstacles" in capfd.readouterr().err


def test_volumes_of_some_seconds_have_several_chunks(tmp_path):
    box = [(-0.02, -0.02, 0.05), (0.02, 0.02, 0.1)]
    found = pw.volume(
        SQUARE, box, (48, 48, 48), WAVELENGTH, method="fraunhofer", out=tmp_path / "field.zarr"
    )
    counts, largest = zip(*((len(n), n[0]) for n in found["fraunhofer"].chunks), strict=True)
    assert np.prod(counts) >= 4 and np.prod(largest) <= 1 << 15
