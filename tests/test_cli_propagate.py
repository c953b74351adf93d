"""``polywigner propagate``: its files and its table hold the fields, at the places asked for."""

import re

import numpy as np
import pytest

import polywigner as pw
from polywigner.cli import main
from polywigner.cli.fields import parse_methods, parse_place, place_text
from polywigner.cli.sources import field_title, frequency_text, short_name
from polywigner.quantities import wavelength_of

xarray = pytest.importorskip("xarray")
pytest.importorskip("h5netcdf")


WAVELENGTH = 299_792_458 / 94e9
SQUARE = pw.shapes.square(10e-3)
FREQUENCY = ("--frequency", "94 GHz")

# The same sums, perhaps of points in other blocks.
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
    with xarray.open_dataset(stem.with_suffix(".nc"), engine="h5netcdf") as found:
        return found.load()


def points_of(found):
    variable = next(iter(found.data_vars.values()))
    parts = [found[name].broadcast_like(variable).transpose(*variable.dims) for name in "xyz"]
    return np.stack([part.values for part in parts], axis=-1)


PLACES = {
    "line": ("1 mm, 0 mm, 40 mm to 1 mm, 2 mm, 90 mm", "5"),
    "arc": ("50 mm, 30 deg, 60 deg", "5"),
    "plane": ("-20 mm to 20 mm, 3 mm, 40 mm to 60 mm", "4 x 3"),
    "hemisphere": ("50 mm", "3 x 4"),
}


@pytest.mark.parametrize("place", PLACES)
def test_the_values_are_those_of_irradiance_at_the_places(place, square, capfd):
    where, samples = PLACES[place]
    found = propagated(
        square, f"--{place}", where, "--samples", samples, "--method", "wigner kirchhoff",
        "--method", "wigner", "--method", "fraunhofer", "--obliquity", "paper",
        "--against", "wigner kirchhoff",
    )  # fmt: skip
    assert "Differences from wigner-kirchhoff" in capfd.readouterr().out
    assert tuple(found.data_vars) == ("wigner-kirchhoff", "wigner", "fraunhofer")
    points = points_of(found)
    for name, how in (
        ("wigner-kirchhoff", {"obliquity": "kirchhoff"}),
        ("wigner", {"obliquity": "paper"}),
        ("fraunhofer", {"method": "fraunhofer"}),
    ):
        expected = pw.irradiance(SQUARE, points, WAVELENGTH, **how)
        np.testing.assert_allclose(found[name], expected, rtol=ROUNDING, atol=ROUNDING)
        assert found[name].attrs["units"] == "W m-2"


def test_places_are_where_they_were_asked_for(square):
    found = propagated(square, "--arc", "50 mm, 30 deg, 60 deg", "--samples", "3",
                       "--method", "fraunhofer")  # fmt: skip
    s, c = 50e-3 * np.sin(np.pi / 3), 50e-3 * np.cos(np.pi / 3)
    across = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    expected = [[*(-s * across), c], [0, 0, 50e-3], [*(s * across), c]]
    np.testing.assert_allclose(points_of(found).reshape(3, 3), expected, atol=1e-12)


def test_complex_fields_are_written_with_their_phase(square):
    found = propagated(square, "--plane", "-20 mm to 20 mm, -20 mm to 20 mm, 40 mm", "--samples",
                       "5 x 4", "--method", "kirchhoff", "--amplitude")  # fmt: skip
    field = found["kirchhoff_real"].values + 1j * found["kirchhoff_imag"].values
    expected = pw.amplitude(SQUARE, points_of(found), WAVELENGTH, "kirchhoff")
    np.testing.assert_allclose(field, expected, rtol=0, atol=1e-9)


def test_a_plane_is_an_image_for_others_where_it_is_in_space(square):
    propagated(square, "--plane", "-20 mm to 20 mm, 0 mm, 40 mm to 60 mm", "--samples", "5 x 4",
               "--method", "fraunhofer", "--format", "vti", "--format", "nc")  # fmt: skip
    header = (square.parent / "out" / "field.vti").read_text("latin-1")
    assert 'WholeExtent="0 4 0 0 0 3"' in header and 'Origin="-0.02 0.0 0.04"' in header


ARC = ("--arc", "50 mm", "--samples", "5", "--method", "kirchhoff")


def test_a_store_holds_the_same_complex_fields_as_other_formats(square):
    pytest.importorskip("zarr")
    formats = ("--format", "zarr", "--format", "nc")
    split = propagated(square, *ARC, "--amplitude", *formats)
    store = square.parent / "out" / "field.zarr"
    with xarray.open_zarr(store) as found:
        whole = split["kirchhoff_real"].values + 1j * split["kirchhoff_imag"].values
        assert np.array_equal(found["kirchhoff"].values, whole)
        assert found.attrs["wavelength"] == split.attrs["wavelength"]
    propagated(square, *ARC, *formats)  # an earlier run's is replaced, as files are
    with xarray.open_zarr(store) as found:
        assert found["kirchhoff"].dtype == np.float64
    names = sorted(path.name for path in store.parent.iterdir())
    assert names == ["field.nc", "field.png", "field.zarr"]


@pytest.mark.parametrize("is_volume", [True, False])
def test_a_store_of_hours_of_work_and_a_file_in_its_place_are_left_alone(is_volume, square, capfd):
    pytest.importorskip("zarr")
    store = square.parent / "out" / "field.zarr"
    if is_volume:
        box = ((-0.02, -0.02, 0.04), (0.02, 0.02, 0.06))
        pw.volume(SQUARE, box, (2, 2, 2), WAVELENGTH, method="fraunhofer", out=store)
    else:
        store.parent.mkdir()
        store.touch()
    out = ("--out", str(store.parent / "field"))
    assert main(["propagate", str(square), *FREQUENCY, *ARC, "--format", "zarr", *out]) == 2
    assert "choose another name" in capfd.readouterr().err
    assert not is_volume or "fraunhofer" in xarray.open_zarr(store)
    assert list(store.parent.iterdir()) == [store]


def test_the_table_says_how_far_methods_are_apart(square, capfd):
    found = propagated(
        square, "--line", "0 mm, 0 mm, 60 mm to 0 mm, 0 mm, 90 mm", "--samples", "4",
        "--method", "wigner", "--method", "rayleigh-sommerfeld-1", "--method", "fraunhofer",
    )  # fmt: skip
    printed = capfd.readouterr().out
    assert "Differences from rayleigh-sommerfeld-1" in printed  # the exact one among them
    rows = dict(re.findall(r"^  (\S+)\s+(.*) of 4$", printed, re.MULTILINE))
    assert set(rows) == {"wigner", "fraunhofer"}
    for name, row in rows.items():
        largest, rms, points = map(float, row.split())
        apart = 10 * np.log10(found[name].values / found["rayleigh-sommerfeld-1"].values)
        np.testing.assert_allclose(largest, apart[np.argmax(abs(apart))], atol=5.1e-4)
        np.testing.assert_allclose(rms, np.sqrt(np.mean(apart**2)), atol=5.1e-5)
        assert points == 4
    assert printed.splitlines()[-2:] == [
        str(square.parent / "out" / name) for name in ("field.png", "field.nc")
    ]


def test_tapers_arrays_and_steering_are_those_of_other_commands(square):
    found = propagated(
        square, "--array", "3 x 2, 12 mm", "--taper", "cosine", "--steering", "20 deg, 90 deg",
        "--arc", "500 mm, 90 deg, 40 deg", "--samples", "81", "--method", "fraunhofer",
    )  # fmt: skip
    places = pw.arrays.grid_positions(3, 2, 12e-3)
    beam = (0.0, np.sin(np.radians(20)), np.cos(np.radians(20)))
    source = pw.phased_array(
        SQUARE.with_illumination(pw.cosine_taper(10e-3, 10e-3)),
        places,
        pw.arrays.steering_weights(places, beam, WAVELENGTH),
    )
    expected = pw.irradiance(source, points_of(found), WAVELENGTH, "fraunhofer")
    scale = expected.max()
    np.testing.assert_allclose(found["fraunhofer"], expected, rtol=0, atol=ROUNDING * scale)


def test_texts_of_places_say_what_they_show():
    texts = dict.fromkeys(PLACES)
    line = parse_place({**texts, "line": "1 mm,0,.002 to 0 mm , -2 mm, 0.1 m"}, None)
    assert line.points == ((1e-3, 0.0, 2e-3), (0.0, -2e-3, 0.1))
    plane = parse_place({**texts, "plane": "-1 cm to 1 cm, 2 mm, 5 mm to 9 mm"}, "7 × 5")
    assert plane.points == ((-1e-2, 2e-3, 5e-3), (1e-2, 2e-3, 9e-3)) and plane.shape == (7, 5)
    arc = parse_place({**texts, "arc": "50 mm, 90 deg"}, "9")
    assert (arc.radius, arc.phi, arc.reach) == pytest.approx((0.05, np.pi / 2, np.radians(80)))
    rays, plain = parse_methods(["wigner kirchhoff", "wigner"], "paper")
    assert rays == ("wigner-kirchhoff", "wigner", "kirchhoff")
    assert plain[2] == "paper"


@pytest.mark.parametrize(
    ("kind", "text", "expected"),
    [
        ("line", "0 mm, 0 mm, 2 mm to 0 mm, -5 mm, 50 mm", "line from (0, 0, 2) to (0, −5, 50) mm"),
        ("plane", "-3 m to 3 m, 2 m, 1 m to 4 m", "plane y = 2 m"),
        ("arc", "50 mm, 45 deg", "arc of radius 50 mm, φ = 45°"),
        ("hemisphere", "120 um", "hemisphere of radius 120 µm"),
    ],
)
def test_a_picture_says_where_its_field_is(kind, text, expected):
    kinds = ("line", "arc", "plane", "hemisphere")
    place = parse_place({name: text if name == kind else None for name in kinds}, None)
    assert place_text(place) == expected


def test_a_picture_says_source_and_frequency_and_cuts_a_long_name():
    metres = wavelength_of(94e9)
    assert field_title("folder/horn.dxf", metres) == "horn.dxf, 94 GHz (wavelength 3.189 mm)"
    assert frequency_text(wavelength_of(1e12)) == "1 THz"
    assert frequency_text(wavelength_of(0.25)) == "0.25 Hz"
    long = short_name(f"{'antenna' * 9}.geojson")
    assert len(long) == 32
    assert long.endswith("…nna.geojson")


BOX = pw.Polyhedron(
    [(x, y, z) for z in (0.02, 0.03) for y in (-0.01, 0.02) for x in (-0.01, 0.01)],
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]],
)


def write_box(path):
    """The box in cm, 5 cm before its place."""
    corners = ["v {} {} {}".format(*(100 * v - (0, 0, 5))) for v in BOX.vertices]
    faces = ["f " + " ".join(str(k + 1) for k in face) for face in BOX.faces]
    path.write_text("\n".join(corners + faces))


def test_fields_behind_meshes_and_plates_are_those_of_irradiance(square):
    write_box(square.parent / "box.obj")
    plate = f"{square} at 5 mm, 0 mm, 50 mm towards 30 deg, 90 deg"
    found = propagated(
        square, "--plane", "-20 mm to 20 mm, 0 mm, 16 mm to 60 mm", "--samples", "5 x 4",
        "--obstacle", f"{square.parent / 'box.obj'} at 0 mm, 0 mm, 50 mm",
        "--obstacle-unit", "cm", "--engine", "numpy",
    )  # fmt: skip
    assert tuple(found.data_vars) == ("rayleigh-sommerfeld-1",)
    how = {"method": "auto", "engine": "numpy"}
    values = found["rayleigh-sommerfeld-1"]
    expected = pw.irradiance(SQUARE, points_of(found), WAVELENGTH, obstacles=BOX, **how)
    np.testing.assert_allclose(values, expected, rtol=1e-6, atol=1e-9)
    found = propagated(square, "--line", "0 mm, 0 mm, 70 mm to 20 mm, 5 mm, 70 mm", "--samples",
                       "4", "--obstacle", plate, "--engine", "numpy")  # fmt: skip
    # x stays x where z is turned towards y, and y towards -z
    s, c = 0.5, 3**0.5 / 2
    pose = [[1, 0, 0, 5e-3], [0, c, s, 0], [0, -s, c, 50e-3], [0, 0, 0, 1]]
    expected = pw.irradiance(
        SQUARE, points_of(found), WAVELENGTH, obstacles=SQUARE.placed(pose), **how
    )
    np.testing.assert_allclose(found["rayleigh-sommerfeld-1"], expected, rtol=1e-6, atol=1e-9)
