"""Files of ``polywigner transform``."""

import json

import numpy as np
import pytest
import shapely

import polywigner as pw
from polywigner.cli import main
from polywigner.quantities import wavelength_of

# Error of the kernel relative to the area.
ROUNDING = 1e-12

RECTANGLE = "POLYGON ((-3 -2, 3 -2, 3 2, -3 2, -3 -2))"  # 6 mm x 4 mm
SIDES = np.array([6e-3, 4e-3])


@pytest.fixture
def rectangle(tmp_path):
    path = tmp_path / "rectangle.wkt"
    path.write_text(RECTANGLE)
    return path


def transformed(path, *options):
    stem = path.parent / "out" / "values"
    assert main(["transform", str(path), "--out", str(stem), *options]) == 0
    assert stem.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    with np.load(stem.with_suffix(".npz")) as file:  # plain arrays without pickle
        return dict(file)


def test_the_values_are_those_of_the_closed_forms(rectangle):
    values = transformed(
        rectangle,
        *("--frequency", "94 GHz", "--samples", "17"),
        *("--x", "-1 mm,0.5 mm", "--xi", "2 mm,-1 mm"),
    )
    axis = values["frequency"]
    assert axis.shape == (17,)
    assert axis[-1] == -axis[0] == 1 / wavelength_of(94e9)
    nu = np.stack(np.meshgrid(axis, axis), axis=-1)
    area = SIDES.prod()
    expected = np.prod(SIDES * np.sinc(nu * SIDES), axis=-1)
    np.testing.assert_allclose(values["fourier"], expected, rtol=0, atol=ROUNDING * area)

    np.testing.assert_allclose(values["x"], [-1e-3, 0.5e-3])
    lengths = SIDES - 2 * np.abs(values["x"])
    expected = np.prod(2 * lengths * np.sinc(2 * nu * lengths), axis=-1)
    np.testing.assert_allclose(values["wigner"], expected, rtol=0, atol=ROUNDING * 4 * area)

    np.testing.assert_allclose(values["xi"], [2e-3, -1e-3])
    lengths = SIDES - np.abs(values["xi"])
    expected = np.prod(lengths * np.sinc(nu * lengths), axis=-1)
    np.testing.assert_allclose(values["ambiguity"], expected, rtol=0, atol=ROUNDING * area)


@pytest.mark.usefixtures("unrendered_figures")
def test_units_digits_and_versions_are_kept(rectangle):
    rectangle.write_text("POLYGON ((0 0, 0.1 0, 0.30000000000000004 1, 0 0))")
    values = transformed(rectangle, "--unit", "in", "--samples", "3")
    np.testing.assert_allclose(values["fourier"][1, 1], 0.05 * 25.4e-3**2, rtol=ROUNDING)
    outline = shapely.from_geojson(str(values["aperture_geojson"]))
    assert pw.Aperture(outline) == pw.read_aperture(rectangle, unit="in")
    metadata = json.loads(str(values["metadata"]))
    assert set(metadata["units"]) == set(values) - {"metadata"}
    assert metadata["polywigner"] == pw.__version__
    assert np.isnan(values["wavelength"])


@pytest.mark.usefixtures("unrendered_figures")
def test_the_files_are_named_after_the_aperture_and_told(rectangle, tmp_path, capfd):
    out = f"{tmp_path}/new/"
    options = ("--samples", "65", "--frequency", "94 Hz")  # far from the size of the aperture
    assert main(["transform", str(rectangle), *options, "--out", out]) == 0
    captured = capfd.readouterr()
    assert captured.out.splitlines() == [f"{out}rectangle.png", f"{out}rectangle.npz"]
    (warned,) = captured.err.splitlines()
    assert warned.startswith("polywigner: warning: ") and "should be in GHz" in warned


@pytest.mark.usefixtures("unrendered_figures")
def test_a_source_too_wide_for_a_picture_is_shown_in_its_middle(rectangle, capfd):
    wide = ("--unit", "m", "--wavelength", "500 nm")
    values = transformed(rectangle, *wide)
    diameter = np.hypot(6.0, 4.0)
    np.testing.assert_allclose(values["frequency"][[0, -1]], np.array([-8, 8]) / diameter)
    assert len(values["frequency"]) == 257 and np.abs(values["fourier"]).max() == 24.0
    err = capfd.readouterr().err
    assert "cropped to the centre" in err and "too few for the lobes" not in err
    transformed(rectangle, *wide, "--samples", "9")
    assert "9 samples along an axis are too few for the lobes" in capfd.readouterr().err


@pytest.mark.usefixtures("unrendered_figures")
def test_a_steered_aperture_has_its_peak_at_the_direction(rectangle):
    values = transformed(
        rectangle, "--steering", "30 deg, 90 deg", "--wavelength", "1 mm", "--samples", "65"
    )
    j, i = np.unravel_index(np.abs(values["fourier"]).argmax(), (65, 65))
    peak = values["frequency"][[i, j]]
    np.testing.assert_allclose(peak, [0.0, 500.0], atol=1e-9)  # sin(30 deg)/mm is on the grid
