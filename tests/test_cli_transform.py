"""``polywigner transform``: the files it writes hold the transforms, with their units."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapely

import polywigner as pw
from polywigner.cli import main
from polywigner.quantities import wavelength_of

# Separable closed forms of a rectangle; the kernel's own bound, relative to the area.
ROUNDING = 1e-12

RECTANGLE = "POLYGON ((-3 -2, 3 -2, 3 2, -3 2, -3 -2))"  # 6 mm x 4 mm
SIDES = np.array([6e-3, 4e-3])


@pytest.fixture
def rectangle(tmp_path: Path) -> Path:
    path = tmp_path / "rectangle.wkt"
    path.write_text(RECTANGLE)
    return path


def transformed(path: Path, *options: str) -> dict[str, np.ndarray]:
    stem = path.parent / "out" / "values"
    assert main(["transform", str(path), "--out", str(stem), *options]) == 0
    assert stem.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    with np.load(stem.with_suffix(".npz")) as file:  # without pickle: plain arrays only
        return dict(file)


def test_the_values_are_those_of_the_closed_forms(rectangle: Path) -> None:
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


def test_units_digits_and_versions_are_kept(rectangle: Path) -> None:
    """The unit scales the aperture, whose outline comes back with all digits."""
    rectangle.write_text("POLYGON ((0 0, 0.1 0, 0.30000000000000004 1, 0 0))")
    values = transformed(rectangle, "--unit", "in", "--samples", "3")
    np.testing.assert_allclose(values["fourier"][1, 1], 0.05 * 25.4e-3**2, rtol=ROUNDING)
    outline = shapely.from_geojson(str(values["aperture_geojson"]))
    assert pw.Aperture(outline) == pw.read_aperture(rectangle, unit="in")
    metadata = json.loads(str(values["metadata"]))
    assert set(metadata["units"]) == set(values) - {"metadata"}
    assert metadata["polywigner"] == pw.__version__
    assert np.isnan(values["wavelength"])


@pytest.mark.slow
def test_a_drawn_circle_transforms_as_a_disc_of_its_stated_size(tmp_path: Path) -> None:
    """Its size is in the file, which rules over --unit; --tolerance says how round it is."""
    drawing = tmp_path / "disc.svg"
    drawing.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="10mm" viewBox="0 0 1 1">'
        '<circle cx=".5" cy=".5" r=".4"/></svg>'
    )
    coarse = transformed(drawing, "--samples", "3", "--unit", "in")
    fine = transformed(drawing, "--samples", "3", "--tolerance", "0.1 um")
    corners = [len(json.loads(str(v["aperture_geojson"]))["coordinates"][0][0])
               for v in (coarse, fine)]  # fmt: skip
    assert 40 < corners[0] < 80 and corners[1] > 300
    for values in (coarse, fine):
        area = np.pi * 4e-3**2
        np.testing.assert_allclose(values["fourier"][1, 1], area, rtol=ROUNDING)


def test_the_files_are_named_after_the_aperture_and_told(
    rectangle: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = f"{tmp_path}/new/"
    assert main(["transform", str(rectangle), "--samples", "65", "--out", out]) == 0
    captured = capfd.readouterr()
    assert captured.out.splitlines() == [f"{out}rectangle.png", f"{out}rectangle.npz"]
    assert captured.err == f"polywigner: made the folder {out.rstrip('/')}\n"


@pytest.mark.slow
def test_a_wide_aperture_gets_more_samples_and_where_they_do_not_do_a_warning(
    rectangle: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    # Its 6 mm are 12 wavelengths of 0.5 mm: 24 lobes of four samples, in the frequencies up to the
    # horizon on either side.
    needed = 4 * 24 + 1
    options = ("--wavelength", "0.5 mm", "--samples")
    (rectangle.parent / "out").mkdir()  # nothing to say of a folder that is there
    transformed(rectangle, *options, str(needed))
    assert capfd.readouterr().err == ""
    transformed(rectangle, *options, str(needed - 2))
    assert f"--samples {needed} would do" in capfd.readouterr().err
    values = transformed(rectangle, "--wavelength", "0.15 mm")
    assert 257 < len(values["frequency"]) <= 513
    assert capfd.readouterr().err == ""


def test_a_wavelength_far_from_the_apertures_size_is_pointed_out(
    rectangle: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    transformed(rectangle, "--frequency", "94 Hz", "--samples", "65")
    err = capfd.readouterr().err
    assert err.startswith("polywigner: warning: ")
    assert err.count("warning") == 1
    assert "did you mean GHz" in err


@pytest.mark.slow
def test_a_source_file_and_options_say_the_same_array(rectangle: Path) -> None:
    weights = pw.arrays.window_weights((3, 4), "hamming")
    element = pw.read_aperture(rectangle).with_illumination(pw.cosine_taper(6e-3, 4e-3))
    array = pw.phased_array(element, pw.arrays.grid_positions(3, 4, 7e-3, 5e-3), weights)
    written = rectangle.with_suffix(".json")
    pw.write_source(array, written)
    options = ("--samples", "9", "--x", "1 mm,2 mm", "--xi", "1 mm,1 mm")
    told = transformed(
        rectangle, "--taper", "cosine", "--array", "3 x 4, 7 mm, 5 mm", "--window", "hamming",
        *options,
    )  # fmt: skip
    read = transformed(written, *options)
    for name, values in read.items():
        np.testing.assert_array_equal(values, told[name])
    axis = read["frequency"]
    grid = np.stack(np.meshgrid(axis, axis), axis=-1)
    energy = pw.lag_marginal(array, (0.0, 0.0)).real
    for name, expected in (
        ("fourier", pw.fourier(array, grid)),
        ("wigner", pw.wigner(array, read["x"], grid)),
    ):
        np.testing.assert_allclose(read[name], expected, rtol=0, atol=1e-9 * energy)


def test_a_steered_aperture_has_its_peak_at_the_direction(rectangle: Path) -> None:
    values = transformed(
        rectangle, "--steering", "30 deg, 90 deg", "--wavelength", "1 mm", "--samples", "65"
    )
    j, i = np.unravel_index(np.abs(values["fourier"]).argmax(), (65, 65))
    peak = values["frequency"][[i, j]]
    np.testing.assert_allclose(peak, [0.0, 500.0], atol=1e-9)  # sin(30 deg)/mm is on the grid


@pytest.mark.slow
def test_a_source_file_is_shown_at_its_own_wavelength_unless_told_another(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    steered = tmp_path / "steered.toml"
    steered.write_text(
        'kind = "aperture"\nwavelength = "2 mm"\nshape = {name = "square", a = "6 mm"}\n'
        '[illumination]\nkind = "steering"\ntheta = "30 deg"\n'
    )
    for options in ((), ("--wavelength", "2.001 mm")):
        values = transformed(steered, "--samples", "41", *options)
        assert values["wavelength"] == pytest.approx(2e-3, rel=1e-3)
        assert np.abs(values["frequency"]).max() == pytest.approx(500, rel=1e-3)
        assert "squints" not in capsys.readouterr().err
    values = transformed(steered, "--samples", "41", "--frequency", "100 GHz")
    assert values["wavelength"] == wavelength_of(100e9)
    message = capsys.readouterr().err
    assert "steered.toml" in message
    assert "squints" in message
    assert message.count("\n") == 1
    # the phases of the file stay: the beam keeps its frequency, sin(30 deg)/(2 mm)
    j, i = np.unravel_index(np.abs(values["fourier"]).argmax(), (41, 41))
    spacing = np.diff(values["frequency"]).max()
    assert values["frequency"][[i, j]] == pytest.approx([250.0, 0.0], abs=spacing / 2)


def test_a_layer_is_read_alone_and_what_overlaps_is_joined(tmp_path: Path) -> None:
    path = tmp_path / "antenna.svg"
    path.write_text(
        '<svg><g id="board"><rect width="9" height="9"/></g>'
        '<g id="pad"><rect x="1" y="1" width="2" height="1"/></g>'
        '<g id="feed"><rect x="2" y="1" width="3" height="1"/></g></svg>'
    )
    layers = ("--layer", "pad", "--layer", "feed")
    drawn = transformed(path, *layers, "--union", "--samples", "3")
    assert drawn["fourier"][1, 1].real == pytest.approx(4e-6, rel=ROUNDING, abs=0.0)


SPACE, LENS = pw.FirstOrder.free_space(0.05), pw.FirstOrder.lens(0.08)
SYSTEMS = {
    "space 50 mm, lens 8 cm": LENS @ SPACE,
    "lens 80 mm inf, turn 90 deg": pw.FirstOrder.rotation(np.pi / 2)
    @ pw.FirstOrder.lens((0.08, np.inf)),
    "magnifier -2, fourier 0.1, fractional 0.5 20 mm": pw.FirstOrder.fractional(0.5, 0.02)
    @ pw.FirstOrder.fourier(0.1)
    @ pw.FirstOrder.magnifier(-2),
}


@pytest.mark.parametrize("text", SYSTEMS)
def test_the_light_passes_parts_in_the_order_of_the_text(text: str, rectangle: Path) -> None:
    options = ("--frequency", "94 GHz", "--samples", "5", "--through", text)
    np.testing.assert_array_equal(transformed(rectangle, *options)["matrix"], SYSTEMS[text].matrix)


def test_the_values_behind_a_system_are_those_of_its_transform(rectangle: Path) -> None:
    options = ("--frequency", "94 GHz", "--samples", "33", "--through", "fourier 50 mm")
    found = transformed(rectangle, *options)
    scale = 0.05 * wavelength_of(94e9)
    points = np.stack(np.meshgrid(found["across"], found["up"]), axis=-1)
    light = abs(pw.fourier(pw.shapes.rectangle(*SIDES), points / scale)) ** 2 / scale**2
    assert found["light"] == pytest.approx(light, rel=1e-6, abs=1e-9)
    metadata = json.loads(str(found["metadata"]))
    assert set(metadata["units"]) == set(found) - {"metadata", "matrix", "light"}
