"""Files and tables of ``polywigner propagate`` and ``volume``."""

import re

import numpy as np
import pytest

import polywigner as pw
from polywigner.cli import main

xarray = pytest.importorskip("xarray")
pytest.importorskip("h5netcdf")
pytest.importorskip("zarr")


WAVELENGTH = 299_792_458 / 94e9
SQUARE = pw.shapes.square(10e-3)
FREQUENCY = ("--frequency", "94 GHz")

# Rounding error of the same sums in other blocks.
ROUNDING = 1e-12


@pytest.fixture
def square(tmp_path):
    path = tmp_path / "square.wkt"
    path.write_text("POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
    return path


def propagated(path, *options):
    stem = path.parent / "out" / "field"
    assert main(["propagate", str(path), *FREQUENCY, "--out", str(stem), *options]) == 0
    assert stem.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    with xarray.open_dataset(stem.with_suffix(".nc"), engine="h5netcdf") as result:
        return result.load()


def points_of(result):
    variable = next(iter(result.data_vars.values()))
    parts = [result[name].broadcast_like(variable).transpose(*variable.dims) for name in "xyz"]
    return np.stack([part.values for part in parts], axis=-1)


PLACES = {
    "arc": ("50 mm, 30 deg, 60 deg", "5"),
    "plane": ("-20 mm to 20 mm, 3 mm, 40 mm to 60 mm", "4 x 3"),
    "hemisphere": ("50 mm", "3 x 4"),
}


@pytest.mark.usefixtures("unrendered_figures")
def test_a_warning_that_several_functions_issue_is_shown_once(square, tmp_path, capsys):
    options = "--wavelength", "1 km", "--arc", "50 mm", "--out", str(tmp_path / "a")
    assert main(["propagate", str(square), *options]) == 0
    assert capsys.readouterr().err.count("implausible wavelength") == 1


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.usefixtures("unrendered_figures")
def test_the_values_are_those_of_irradiance_at_the_places(place, square, capfd):
    where, samples = PLACES[place]
    result = propagated(
        square, f"--{place}", where, "--samples", samples, "--method", "wigner kirchhoff",
        "--method", "wigner", "--method", "fraunhofer", "--obliquity", "paper",
        "--against", "wigner kirchhoff",
    )  # fmt: skip
    assert "Differences from wigner-kirchhoff" in capfd.readouterr().out
    assert tuple(result.data_vars) == ("wigner-kirchhoff", "wigner", "fraunhofer")
    points = points_of(result)
    for name, how in (
        ("wigner-kirchhoff", {"obliquity": "kirchhoff"}),
        ("wigner", {"obliquity": "paper"}),
        ("fraunhofer", {"method": "fraunhofer"}),
    ):
        expected = pw.irradiance(SQUARE, points, WAVELENGTH, **how)
        np.testing.assert_allclose(result[name], expected, rtol=ROUNDING, atol=ROUNDING)
        assert result[name].attrs["units"] == "W m-2"


@pytest.mark.usefixtures("unrendered_figures")
def test_places_are_where_they_were_asked_for(square):
    result = propagated(square, "--arc", "50 mm, 30 deg, 60 deg", "--samples", "3",
                       "--method", "fraunhofer")  # fmt: skip
    s, c = 50e-3 * np.sin(np.pi / 3), 50e-3 * np.cos(np.pi / 3)
    across = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    expected = [[*(-s * across), c], [0, 0, 50e-3], [*(s * across), c]]
    np.testing.assert_allclose(points_of(result).reshape(3, 3), expected, atol=1e-12)


def test_complex_fields_are_written_with_their_phase(square):
    result = propagated(square, "--plane", "-20 mm to 20 mm, -20 mm to 20 mm, 40 mm", "--samples",
                       "5 x 4", "--method", "kirchhoff", "--amplitude")  # fmt: skip
    field = result["kirchhoff_real"].values + 1j * result["kirchhoff_imag"].values
    expected = pw.amplitude(SQUARE, points_of(result), WAVELENGTH, "kirchhoff")
    np.testing.assert_allclose(field, expected, rtol=0, atol=1e-9)


@pytest.mark.usefixtures("unrendered_figures")
def test_the_table_says_how_far_methods_are_apart(square, capfd):
    result = propagated(
        square, "--line", "0 mm, 0 mm, 60 mm to 0 mm, 0 mm, 90 mm", "--samples", "4",
        "--method", "wigner", "--method", "rayleigh-sommerfeld-1", "--method", "fraunhofer",
    )  # fmt: skip
    printed = capfd.readouterr().out
    assert "Differences from rayleigh-sommerfeld-1" in printed  # the only exact method
    rows = dict(re.findall(r"^  (\S+)\s+(.*) of 4$", printed, re.MULTILINE))
    assert set(rows) == {"wigner", "fraunhofer"}
    for name, row in rows.items():
        largest, rms, points = map(float, row.split())
        apart = 10 * np.log10(result[name].values / result["rayleigh-sommerfeld-1"].values)
        np.testing.assert_allclose(largest, apart[np.argmax(abs(apart))], atol=5.1e-4)
        np.testing.assert_allclose(rms, np.sqrt(np.mean(apart**2)), atol=5.1e-5)
        assert points == 4
    assert printed.splitlines()[-2:] == [
        str(square.parent / "out" / name) for name in ("field.png", "field.nc")
    ]


BOX = pw.Polyhedron(
    [(x, y, z) for z in (0.02, 0.03) for y in (-0.01, 0.02) for x in (-0.01, 0.01)],
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]],
)


def write_box(path):
    """Write the box in cm, shifted by -5 cm along z."""
    corners = ["v {} {} {}".format(*(100 * v - (0, 0, 5))) for v in BOX.vertices]
    faces = ["f " + " ".join(str(k + 1) for k in face) for face in BOX.faces]
    path.write_text("\n".join(corners + faces))


@pytest.mark.usefixtures("unrendered_figures")
def test_fields_behind_meshes_and_plates_are_those_of_irradiance(square):
    write_box(square.parent / "box.obj")
    plate = f"{square} at 5 mm, 0 mm, 50 mm towards 30 deg, 90 deg"
    result = propagated(
        square, "--plane", "-20 mm to 20 mm, 0 mm, 16 mm to 60 mm", "--samples", "5 x 4",
        "--obstacle", f"{square.parent / 'box.obj'} at 0 mm, 0 mm, 50 mm",
        "--obstacle-unit", "cm", "--engine", "numpy",
    )  # fmt: skip
    assert tuple(result.data_vars) == ("rayleigh-sommerfeld-1",)
    how = {"method": "auto", "engine": "numpy"}
    values = result["rayleigh-sommerfeld-1"]
    expected = pw.irradiance(SQUARE, points_of(result), WAVELENGTH, obstacles=BOX, **how)
    np.testing.assert_allclose(values, expected, rtol=1e-6, atol=1e-9)
    result = propagated(square, "--line", "0 mm, 0 mm, 70 mm to 20 mm, 5 mm, 70 mm", "--samples",
                       "4", "--obstacle", plate, "--edge", "hard", "--engine", "numpy")  # fmt: skip
    # The rotation maps the z axis towards y, and the y axis towards -z.
    s, c = 0.5, 3**0.5 / 2
    pose = [[1, 0, 0, 5e-3], [0, c, s, 0], [0, -s, c, 50e-3], [0, 0, 0, 1]]
    expected = pw.irradiance(
        SQUARE, points_of(result), WAVELENGTH, obstacles=SQUARE.placed(pose), edge="hard", **how
    )
    np.testing.assert_allclose(result["rayleigh-sommerfeld-1"], expected, rtol=1e-6, atol=1e-9)


REGION = ("--box", "-20 mm to 20 mm, -15 mm to 15 mm, 30 mm to 60 mm")
SMALL = (*REGION, "--shape", "6 x 5 x 4", "--chunks", "3 x 3 x 4", "--engine", "numpy")

SINGLE = 1e-6  # values are stored in float32


def run(path, *options):
    out = path.parent / "out" / "field"
    return main(["volume", str(path), *FREQUENCY, "--out", str(out), *options])


def test_the_store_holds_the_irradiance_in_the_box(square, capfd):
    assert run(square, *SMALL, "--method", "wigner kirchhoff", "--netcdf") == 0
    out = square.parent / "out"
    names = ("field.zarr", "field.png", "field.nc")
    assert capfd.readouterr().out.splitlines() == [str(out / name) for name in names]
    assert sorted(path.name for path in out.iterdir()) == sorted(names)
    result = xarray.open_zarr(out / "field.zarr")
    assert result["wigner"].dims == ("x", "y", "z") and result["wigner"].shape == (6, 5, 4)
    assert dict(result.chunksizes) == {"x": (3, 3), "y": (3, 2), "z": (4,)}
    np.testing.assert_allclose(result["y"], np.linspace(-15e-3, 15e-3, 5))
    axes = np.meshgrid(*(result[name].values for name in "xyz"), indexing="ij")
    expected = pw.irradiance(SQUARE, np.stack(axes, -1), WAVELENGTH, obliquity="kirchhoff")
    np.testing.assert_allclose(result["wigner"], expected, rtol=SINGLE, atol=SINGLE)
    with xarray.open_dataset(out / "field.nc", engine="h5netcdf") as copy:
        assert np.array_equal(copy["wigner"], result["wigner"])


@pytest.mark.usefixtures("unrendered_figures")
def test_the_same_command_completes_what_is_missing(square):
    assert run(square, *SMALL) == 0
    store = square.parent / "out" / "field.zarr"
    before = xarray.open_zarr(store)["wigner"].load()
    chunks = sorted(path for path in (store / "wigner" / "c").rglob("*") if path.is_file())
    kept, lost = chunks[0], chunks[-1]
    time = kept.stat().st_mtime_ns
    lost.unlink()
    assert run(square, *SMALL) == 0
    assert kept.stat().st_mtime_ns == time and lost.exists()
    assert xarray.open_zarr(store)["wigner"].identical(before)


@pytest.mark.usefixtures("unrendered_figures")
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


@pytest.mark.usefixtures("unrendered_figures")
def test_a_store_of_other_settings_is_not_gone_on_with(square, capfd):
    assert run(square, *SMALL) == 0
    store = square.parent / "out" / "field.zarr"
    content = {path: path.read_bytes() for path in store.rglob("*") if path.is_file()}
    assert run(square, *SMALL, "--obliquity", "kirchhoff") == 2
    assert "obliquity" in capfd.readouterr().err
    assert content == {path: path.read_bytes() for path in store.rglob("*") if path.is_file()}


@pytest.mark.usefixtures("unrendered_figures")
def test_the_store_of_a_field_behind_an_obstacle_is_no_other_field(square, capfd):
    plate = ("--obstacle", f"{square} at 0 mm, 0 mm, 20 mm")
    assert run(square, *SMALL, *plate) == 0
    result = xarray.open_zarr(square.parent / "out" / "field.zarr")["rayleigh-sommerfeld-1"]
    pose = np.eye(4)
    pose[2, 3] = 0.02
    axes = np.meshgrid(*(result[name].values for name in "xyz"), indexing="ij")
    expected = pw.irradiance(
        SQUARE, np.stack(axes, -1), WAVELENGTH, "auto", obstacles=SQUARE.placed(pose)
    )
    np.testing.assert_allclose(result, expected, rtol=SINGLE, atol=SINGLE)
    (square.parent / "out" / "field.png").unlink()
    capfd.readouterr()
    assert run(square, *SMALL, "--obstacle", f"{square} at 0 mm, 1 mm, 20 mm") == 2
    assert "obstacles" in capfd.readouterr().err


def test_volumes_of_some_seconds_have_several_chunks(tmp_path):
    box = [(-0.02, -0.02, 0.05), (0.02, 0.02, 0.1)]
    how = {"method": "fraunhofer", "out": tmp_path / "field.zarr"}
    result = pw.volume(SQUARE, box, (48, 48, 48), WAVELENGTH, **how)
    counts, largest = zip(*((len(n), n[0]) for n in result["fraunhofer"].chunks), strict=True)
    assert np.prod(counts) >= 4 and np.prod(largest) <= 1 << 15
