"""Point spread functions and transfer functions of lenses."""

from typing import Any

import numpy as np
import pytest

import polywigner as pw
import polywigner.figures
from polywigner.cli import main
from polywigner.errors import ArgumentError

WAVELENGTH, FOCUS = 0.5e-6, 0.1
PUPIL = pw.shapes.disc(5e-3, n=6)
SQUARE = pw.shapes.square(10e-3)
# Half width of the main lobe of a square pupil in the image.
UNIT = WAVELENGTH * FOCUS / 10e-3
ROUNDING = 1e-12


def points(count):
    return np.random.default_rng(3).uniform(-2, 2, (count, 2)) * UNIT


def test_in_focus_it_is_the_square_of_the_transform_with_unit_power():
    y = points(20)
    scale = WAVELENGTH * FOCUS
    expected = abs(pw.fourier(PUPIL, y / scale)) ** 2 / scale**2 / PUPIL.area
    assert pw.psf(PUPIL, y, WAVELENGTH, FOCUS) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("defocus", [0.0, 0.7])
def test_its_fourier_transform_is_the_transfer_function(defocus):
    """The OTF vanishes beyond lags of 10 mm, so sums over a lattice are exact.

    The truncation error decreases as the third power of the lattice size for a pupil that vanishes
    at its edges.
    """
    pupil = pw.shapes.square(4e-3)
    # The field (cos x + 0.4 sin 2x) cos y has no symmetry in the sign of the defocus.
    waves = [(s * (1 + n), t) for n in (0, 1) for s in (-1, 1) for t in (-1, 1)]
    field = [0.25] * 4 + [-0.1j * s for s in (-1, -1, 1, 1)]
    pupil = pupil.with_illumination(pw.Illumination(field, 125.0 * np.array(waves)))
    step = WAVELENGTH * FOCUS / 10e-3
    axis = step * np.arange(-40, 41)
    y = np.stack(np.meshgrid(axis, axis), axis=-1)
    light = pw.psf(pupil, y, WAVELENGTH, FOCUS, defocus, 2e-3)
    xi = np.array([(0.0, 0.0), (1e-3, 0.5e-3), (-2e-3, 1e-3), (0.3e-3, 3e-3)])
    waves = np.exp(2j * np.pi * (y @ xi.T) / (WAVELENGTH * FOCUS))
    result = np.tensordot(light, waves, 2) * step**2
    assert result == pytest.approx(pw.otf(pupil, xi, defocus, 2e-3), abs=2e-4)


def test_a_square_out_of_focus_has_the_strehl_ratio_of_fresnels_integral():
    """(int exp(2 pi i w t^2) dt/2)^4 over t from -1 to 1, with w at the centre of a side."""
    at, weights = np.polynomial.legendre.leggauss(40)
    for waves in (0.1, 0.5, -1.3):
        expected = abs(np.exp(2j * np.pi * waves * at**2) @ weights / 2) ** 4
        focused, blurred = (
            pw.psf(SQUARE, (0.0, 0.0), WAVELENGTH, FOCUS, w, 5e-3) for w in (0.0, waves)
        )
        assert blurred / focused == pytest.approx(expected, rel=1e-9)


def test_light_of_several_colours_is_their_mean():
    y, colours = points(5), (0.45e-6, 0.6e-6)
    result = pw.psf(PUPIL, y, colours, FOCUS, weights=(1.0, 3.0))
    single = [pw.psf(PUPIL, y, colour, FOCUS) for colour in colours]
    assert result == pytest.approx(0.25 * single[0] + 0.75 * single[1])


def test_a_square_pupil_has_the_triangle_of_its_overlap():
    """The MTF is 1 - lambda f nu/D along the sides of the pupil, and zero from 200 cycles/mm."""
    nu = np.array([0.0, 50.0, 120.0, 200.0, 350.0])
    frequency = np.stack([1e3 * nu, 0 * nu], axis=-1)
    result = pw.mtf(SQUARE, frequency, 0.5e-6, 0.1)
    assert result == pytest.approx(np.maximum(0, 1 - nu / 200), abs=ROUNDING)


def test_white_light_is_the_modulus_of_the_mean_otf():
    """An aberration in metres has more waves at shorter wavelengths."""
    frequency, lengths, weights = np.array([60e3, 20e3]), np.array([0.4e-6, 0.7e-6]), [1.0, 3.0]
    mean = (0.4e-6 + 3 * 0.7e-6) / 4
    parts = [
        w / 4 * pw.otf(SQUARE, frequency * length * 0.1, 0.6 * mean / length)
        for w, length in zip(weights, lengths, strict=True)
    ]
    result = pw.mtf(SQUARE, frequency, lengths, 0.1, 0.6, weights=weights)
    assert result == pytest.approx(abs(sum(parts)), abs=ROUNDING)


def test_pixels_multiply_the_lens_by_their_own_transfer_function() -> None:
    pupil, frequency = pw.shapes.square(10e-3), np.array([(30e3, 0.0), (0.0, 80e3), (40e3, -70e3)])
    lens = pw.mtf(pupil, frequency, 0.5e-6, 0.1)
    with_pixels = pw.mtf(pupil, frequency, 0.5e-6, 0.1, pixel=(4e-6, 6e-6))
    own = np.sinc(frequency[:, 0] * 4e-6) * np.sinc(frequency[:, 1] * 6e-6)
    assert with_pixels == pytest.approx(lens * own, abs=ROUNDING)


USUAL = {"source": SQUARE, "wavelength": WAVELENGTH, "focal_length": FOCUS}


@pytest.mark.parametrize(
    ("function", "name", "value"),
    [
        (pw.psf, "source", pw.Slits([(0.0, 1e-3)])),
        (pw.psf, "focal_length", 0.0),
        (pw.psf, "pupil_radius", -1.0),
        (pw.mtf, "wavelength", [[1e-6]]),
        (pw.mtf, "weights", [-1.0]),
        (pw.mtf, "frequency", (1.0, 2.0, 3.0)),
        (pw.mtf, "defocus", float("nan")),
        (pw.mtf, "pixel", -1e-6),
    ],
)
def test_wrong_arguments_are_named(function, name, value):
    places = {"points" if function is pw.psf else "frequency": (1.0, 0.0)}
    with pytest.raises(ArgumentError, match=f"{name}|Slits"):
        function(**{**USUAL, **places, name: value})


@pytest.fixture
def pupil_file(tmp_path: Any) -> Any:
    path = tmp_path / "pupil.wkt"
    path.write_text("POLYGON((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
    return path


def test_commands_write_spots_and_transfer_functions(tmp_path: Any, pupil_file: Any) -> None:
    import xarray as xr

    lens = ["--focal-length", "100 mm", "--defocus", "0, 0.5", "--samples", "33", "--out"]
    waves = ["--wavelengths", "500 nm, 600 nm"]
    assert (
        main(["psf", str(pupil_file), *waves, "--width", "40 um", *lens, str(tmp_path) + "/"]) == 0
    )
    with xr.open_dataset(tmp_path / "pupil_psf.nc") as result:
        x, spots = result["x"].values, result["psf"].values
    points = np.stack(np.meshgrid(x, x), axis=-1)
    square = pw.shapes.square(10e-3)
    expected = pw.psf(square, points, [500e-9, 600e-9], 0.1, 0.5)
    assert spots.shape == (2, 33, 33)
    assert spots[1] == pytest.approx(expected, rel=1e-12)
    assert (
        main(["mtf", str(pupil_file), *waves, "--pixel", "3 um", *lens, str(tmp_path) + "/"]) == 0
    )
    rows = np.genfromtxt(tmp_path / "pupil_mtf.csv", delimiter=",", names=True)
    assert rows["frequency_per_mm"][-1] == pytest.approx(200.0)  # along both axes
    at = np.column_stack([1e3 * rows["frequency_per_mm"], np.zeros(33)])
    assert rows["mtf_x_defocus_0"] == pytest.approx(
        pw.mtf(square, at, [500e-9, 600e-9], 0.1, pixel=3e-6)
    )
    for kind in ("psf", "mtf"):
        assert (tmp_path / f"pupil_{kind}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("unrendered_figures")
def test_commands_take_zernike_coefficients_and_a_numerical_aperture(
    tmp_path: Any, pupil_file: Any
) -> None:
    import xarray as xr

    lens = ["--numerical-aperture", "0.05", "--pupil-radius", "5 mm", "--wavelength", "500 nm"]
    lens += ["--zernike", "8: 0.1, 6: -0.05", "--samples", "9", "--out", str(tmp_path) + "/"]
    wave = pw.zernike({8: 50e-9, 6: -25e-9}, 5e-3)
    square = pw.shapes.square(10e-3)
    assert main(["psf", str(pupil_file), "--linear", "--width", "40 um", *lens]) == 0
    with xr.open_dataset(tmp_path / "pupil_psf.nc") as result:
        x, spot = result["x"].values, result["psf"].values[0]
        assert result.attrs["focal_length"] == pytest.approx(0.1)
    points = np.stack(np.meshgrid(x, x), axis=-1)
    assert spot == pytest.approx(pw.psf(square, points, 500e-9, 0.1, aberration=wave))
    assert main(["mtf", str(pupil_file), *lens]) == 0
    rows = np.genfromtxt(tmp_path / "pupil_mtf.csv", delimiter=",", names=True)
    at = np.column_stack([1e3 * rows["frequency_per_mm"], np.zeros(9)])
    expected = pw.mtf(square, at, 500e-9, 0.1, aberration=wave)
    assert rows["mtf_x_defocus_0"] == pytest.approx(expected, abs=1e-9)


def test_figures_mark_reversed_contrast_and_masks() -> None:
    import xarray as xr

    curves = np.array([[[1.0, 0.2, 0.1], [1.0, 0.4, 0.2]]])
    dims = ("defocus", "direction", "frequency")
    values = xr.Dataset(
        {"mtf": (dims, curves), "reversed": (dims, curves < 0.15), "limit": (dims[1:], curves[0])},
        {"defocus": [1.0], "direction": ["x", "y"], "frequency": [0.0, 50.0, 100.0]},
    )
    figure = pw.figures.draw_mtf(values)
    drawn = {line.get_label(): line.get_xydata() for line in figure.axes[0].get_lines()}
    (along_x,) = [drawn[name] for name in drawn if str(name).startswith("along x")]
    assert along_x.T.tolist() == [[0.0, 50.0, 100.0], [1.0, 0.2, 0.1]]
    names = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert "contrast reversed" in names and "without aberrations" in names
    x = np.linspace(-2e-6, 2e-6, 5)
    image = xr.DataArray(np.eye(5), coords=[("y", x), ("x", x)])
    figure = pw.figures.draw_image(image, pw.shapes.square(1e-6))
    assert len(figure.axes[0].patches) == 1
    assert figure.axes[1].get_ylabel() == "fraction of 1"
    with pytest.raises(ArgumentError, match="image"):
        pw.figures.draw_image(image[0])


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("psf", ["--defocus", "much"]),
        ("psf", ["--wavelengths", "500 nm", "--wavelength", "500 nm"]),
        ("mtf", ["--wavelengths", "blue"]),
        ("mtf", ["--pupil-radius", "0 m"]),
        ("mtf", ["--zernike", "coma"]),
        ("psf", ["--zernike", "4: 0.1, 4: 0.2"]),
        ("psf", ["--numerical-aperture", "0.1"]),
    ],
)
def test_odd_options_of_lenses_are_refused(
    tmp_path: Any, pupil_file: Any, command: str, options: list[str], capfd: Any
) -> None:
    usual = ["--focal-length", "100 mm", "--out", str(tmp_path / "out")]
    waves = [] if "--wavelengths" in options else ["--wavelength", "500 nm"]
    assert main([command, str(pupil_file), *usual, *waves, *options]) == 2
    err = capfd.readouterr().err
    assert "expected" in err and err.count("\n") == 1
    assert not list(tmp_path.glob("out*"))
