"""Radiation patterns against theory, and their files."""

import math
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, FileFormatError, IlluminationError, PolywignerError

WAVELENGTH = 299792458 / 94e9
SQUARE = pw.shapes.square(10e-3)
OBLIQUITIES = ("paper", "rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2")


def _pattern(source=SQUARE, theta=0.0, phi=0.0, **how):
    return pw.radiation_pattern(source, WAVELENGTH, theta, phi, **how)


@pytest.mark.parametrize(
    ("obliquity", "share"), list(zip(OBLIQUITIES, (0.934, 0.900, 0.938, 0.982), strict=True))
)
def test_a_boundary_condition_radiates_its_share_of_the_power(obliquity, share):
    """int g |F|^2/lambda^2 dOmega over the area of a 10 mm square at 94 GHz, by an independent
    quadrature to three digits.
    """
    power = _pattern(obliquity=obliquity).attrs["radiated_power"]
    assert power / SQUARE.area == pytest.approx(share, abs=6e-4)
    if obliquity == "paper":
        assert power == pytest.approx(pw.power(SQUARE, WAVELENGTH), rel=1e-12)


@pytest.mark.parametrize("obliquity", OBLIQUITIES)
def test_directivity_averages_to_one_over_all_directions(obliquity):
    """Gauss-Legendre nodes in cos(theta), which the library does not use."""
    field = pw.steering((math.sin(0.4), 0, math.cos(0.4)), WAVELENGTH) * pw.cosine_taper(9e-3)
    source = pw.shapes.triangle(9e-3, 7e-3).with_illumination(field)
    node, weight = np.polynomial.legendre.leggauss(60)
    phi = 2 * np.pi * np.arange(90) / 90
    result = _pattern(source, np.arccos((node + 1) / 2), phi, obliquity=obliquity)
    gain = 10 ** (result["directivity"].values / 10)
    root = 1e-6  # cos(theta)^(1/2) of "paper" is not smooth at the horizon
    assert (gain.mean(axis=1) @ weight) / 4 == pytest.approx(1.0, abs=root)


def test_a_uniform_array_of_32_x_32_has_the_directivity_of_theory():
    """Small elements at half a wavelength: a double sum of the array factor over lags.

    With |F|^2 = const and g = cos^2, the power is a sum over pairs of
    int cos^2 exp(i k d.s) dOmega = 2 pi (sin z/z^3 - cos z/z^2), z = k |d|.
    """
    n, pitch = 32, WAVELENGTH / 2
    speck = pw.shapes.square(1e-3 * WAVELENGTH)
    array = pw.phased_array(speck, pw.arrays.grid_positions(n, n, pitch, pitch))
    shift = np.arange(1 - n, n)
    pairs = np.multiply.outer(n - np.abs(shift), n - np.abs(shift)).ravel()
    z = 2 * np.pi / WAVELENGTH * pitch * np.hypot(*np.meshgrid(shift, shift)).ravel()
    with np.errstate(divide="ignore", invalid="ignore"):
        kernel = np.where(z == 0, 1 / 3, np.sin(z) / z**3 - np.cos(z) / z**2)
    theory = 4 * np.pi * n**4 / (2 * np.pi * pairs @ kernel)
    result = _pattern(array).attrs["largest_directivity"]
    size = 1e-4  # dB; elements of a thousandth of a wavelength are points to 1e-5
    assert result == pytest.approx(10 * math.log10(theory), abs=size)


@pytest.mark.parametrize("obliquity", OBLIQUITIES)
def test_the_squared_field_is_the_radiant_intensity_for_its_obliquity(obliquity):
    """|E|^2 = g |F|^2/lambda^2 for the normal wave."""
    theta, phi = np.array([0.1, 0.7, 1.4]), 0.5
    c = np.cos(theta)
    g = {
        "paper": c,
        "rayleigh-sommerfeld-1": c**2,
        "kirchhoff": ((1 + c) / 2) ** 2,
        "rayleigh-sommerfeld-2": np.ones(3),
    }
    s = np.stack([np.sin(theta) * math.cos(phi), np.sin(theta) * math.sin(phi), c], axis=-1)
    field = _pattern(SQUARE, theta, phi, obliquity=obliquity)["field"].values[:, 0]
    expected = g[obliquity] / c * pw.radiant_intensity(SQUARE, s, WAVELENGTH)
    assert np.abs(field) ** 2 == pytest.approx(expected, rel=1e-12)


def test_a_steered_wave_has_the_obliquity_of_its_own_direction():
    """Kirchhoff's (c + p)/2 with p of the beam; all obliquities agree in the beam."""
    angle = 0.6
    beam = (math.sin(angle), 0, math.cos(angle))
    source = SQUARE.with_illumination(pw.steering(beam, WAVELENGTH))
    fields = [
        _pattern(source, [angle, 0.2], obliquity=o)["field"].values[:, 0] for o in OBLIQUITIES[1:]
    ]
    for field in fields:
        assert field[0] == pytest.approx(fields[0][0], rel=1e-12)
    ratio = (math.cos(0.2) + math.cos(angle)) / (2 * math.cos(0.2))
    assert fields[1][1] / fields[0][1] == pytest.approx(ratio, rel=1e-10)


def test_the_phase_tells_where_the_source_is():
    """r exp(-ikr) U of a source moved by d has the phase exp(-ik s.d)."""
    here, there = (
        _pattern(one, 0.5)["field"].values[0, 0] for one in (SQUARE, SQUARE.moved((1e-3, 2e-3)))
    )
    turn = np.exp(-2j * np.pi / WAVELENGTH * 1e-3 * math.sin(0.5))
    assert there == pytest.approx(here * turn, rel=1e-12)


def test_nothing_goes_backwards_and_negative_theta_is_the_opposite_side():
    source = pw.shapes.triangle(9e-3, 7e-3)
    result = _pattern(source, np.radians([-180, -40, 0, 40, 90, 100]), np.radians([30, 210]))
    field = result["field"].values
    assert field[1, 0] == pytest.approx(field[3, 1])
    assert field[1, 0] != pytest.approx(field[3, 0])
    assert not field[[0, 4, 5]].any()
    assert np.isneginf(result["directivity"].values[[0, 4, 5]]).all()


def test_a_pattern_says_what_it_is():
    result = _pattern(SQUARE, [0.0, 0.1], [0.0, 1.0, 2.0])
    assert result["directivity"].dims == ("theta", "phi")
    assert result["directivity"].attrs["units"] == "dBi"
    assert result["theta"].attrs["units"] == "rad"
    assert result.attrs["frequency"] == pytest.approx(94e9)
    assert result.attrs["wavelength"] == WAVELENGTH
    assert result.attrs["obliquity"] == "rayleigh-sommerfeld-1"
    assert result["field"].attrs["polywigner_version"] == pw.__version__
    single = _pattern(SQUARE, 0.3, precision="single")["field"].values
    assert single.dtype == np.complex64


THETA, PHI = np.radians(np.linspace(0, 180, 37)), np.radians(np.linspace(0, 355, 72))


@pytest.mark.parametrize("polarisation", ["x", "y"])
@pytest.mark.parametrize(
    ("suffix", "head"),
    [
        ("csv", ["Phi [deg],Theta [deg],dB(DirTotal)"]),
        ("txt", ["Theta [deg.", "-----"]),
        ("ffd", ["0 180 37", "0 355 72", "Frequencies 1", "Frequency 94"]),
    ],
)
def test_files_carry_the_field_and_its_power(suffix, head, polarisation, tmp_path):
    """test_far_field_files.py tests the readers."""
    source = SQUARE.moved((1e-3, -2e-3)).with_illumination(pw.te_mode(10e-3, 10e-3))
    pattern, path = _pattern(source, THETA, PHI), tmp_path / f"horn.{suffix}"
    pw.write_pattern(pattern, path, polarisation=polarisation)
    lines = path.read_text().splitlines()
    assert [line[: len(part)] for line, part in zip(lines, head, strict=False)] == head
    result = pw.read_pattern(path, frequency=94e9) if suffix == "txt" else pw.read_pattern(path)
    jones = np.abs(result.attrs["polarisation"])[::2]
    assert jones == pytest.approx({"x": [1, 0], "y": [0, 1]}[polarisation], abs=1e-6)
    about, power = pattern.attrs, math.sqrt(pattern.attrs["radiated_power"])
    if suffix != "txt":  # .txt files have directivities
        assert result.attrs["radiated_power"] == pytest.approx(about["radiated_power"], rel=1e-4)
    one = pattern["field"].values / power
    other = result["field"].values / math.sqrt(result.attrs["radiated_power"])
    digits = 1e-5  # six decimals of dB, and quadrature with steps of 5 degrees
    assert np.abs(other - one).max() < digits * np.abs(one).max()
    assert result.attrs["peak_directivity"] == pytest.approx(about["peak_directivity"], abs=1e-4)


def test_grasp_reads_cuts_whose_square_is_the_directivity(tmp_path):
    """Header, start, step, number, phi, components and values of each cut."""
    pattern = _pattern(SQUARE, np.radians(np.arange(-60, 61, 5)), np.radians([0.0, 30.0]))
    pw.write_pattern(pattern, tmp_path / "a.cut")
    lines = (tmp_path / "a.cut").read_text().splitlines()
    for j, phi in enumerate((0.0, 30.0)):
        block = lines[j * 27 : (j + 1) * 27]
        assert [float(word) for word in block[1].split()] == [-60, 5, 25, phi, 1, 1, 2]
        values = np.loadtxt(block[2:])
        level = 10 * np.log10((values**2).sum(axis=1))
        assert level == pytest.approx(pattern["directivity"].values[:, j], abs=1e-6)


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".ffd", ".cut", ".msi"])
def test_angles_in_any_order_are_written_in_ascending_order(tmp_path, suffix):
    degrees, about = np.arange(0.0, 91.0, 10.0), np.arange(0.0, 271.0, 90.0)
    theta, phi = np.radians(degrees), np.radians(about)
    files = [tmp_path / f"up{suffix}", tmp_path / f"down{suffix}"]
    pw.write_pattern(_pattern(SQUARE, theta, phi), files[0])
    pw.write_pattern(_pattern(SQUARE, theta[::-1], phi[::-1]), files[1])
    assert files[0].read_text() == files[1].read_text()


def test_planning_tools_get_attenuations_all_around(tmp_path):
    """Horizontal cuts are clockwise from above: a beam towards x is on the left."""
    field = pw.steering((math.sin(0.2), 0.0, math.cos(0.2)), WAVELENGTH)
    source = SQUARE.with_illumination(field)
    pattern = _pattern(source, np.radians(np.arange(0, 91)), np.radians([0.0, 90.0, 180.0, 270.0]))
    pw.write_pattern(pattern, tmp_path / "a.msi")
    lines = (tmp_path / "a.msi").read_text().splitlines()
    assert lines[2] == "FREQUENCY 94000"
    start = lines.index("HORIZONTAL 360") + 1
    levels = np.array([line.split() for line in lines[start : start + 360]], float)
    assert levels[:, 0].tolist() == list(range(360))
    assert levels[levels[:, 1].argmin(), 0] in (349, 350)  # 11 degrees to the left
    assert (levels[91:270, 1] == 99.9).all()
    assert lines[start + 360] == "VERTICAL 360" and len(lines) == start + 721


def test_planning_tools_get_the_gain_of_a_beam_beside_both_cuts(tmp_path):
    """Gain minus attenuation is the directivity along the cuts."""
    direction = (0.5, 0.5, math.sqrt(0.5))
    source = pw.shapes.square(30e-3).with_illumination(pw.steering(direction, WAVELENGTH))
    pattern = _pattern(source, np.radians(np.arange(-90, 91)), np.radians([0.0, 90.0]))
    pw.write_pattern(pattern, tmp_path / "a.msi")
    lines = (tmp_path / "a.msi").read_text().splitlines()
    gain = float(lines[3].split()[1])
    beam = pw.radiation_pattern(source, WAVELENGTH, np.radians(np.arange(40, 46, 0.1)), np.pi / 4)
    sample = 0.01  # dB, for steps of 0.1 degrees
    assert gain == pytest.approx(beam.attrs["largest_directivity"], abs=sample)
    attenuation = float(lines[lines.index("HORIZONTAL 360") + 1].split()[1])
    rounding = 1e-3
    assert gain - attenuation == pytest.approx(pattern["directivity"].values[90, 0], abs=rounding)


REFUSED: list[tuple[Any, type[PolywignerError], str]] = [
    (lambda: _pattern(SQUARE, 0.0, window="hann"), ArgumentError, "one of the options obliquity"),
    (lambda: _pattern(SQUARE, [0, 45]), ArgumentError, "radians"),
    (lambda: _pattern(SQUARE, "0"), ArgumentError, "theta"),
    (lambda: _pattern(SQUARE, 0.0, []), ArgumentError, "phi"),
    (lambda: _pattern(SQUARE, 0.0, math.inf), ArgumentError, "finite"),
    (lambda: _pattern(obliquity="cosine"), ArgumentError, "kirchhoff"),
    (lambda: _pattern(pw.Array([SQUARE, SQUARE], [1, -1])), IlluminationError, "radiates"),
    (lambda: _pattern(pw.Slits([[0, 1]])), ArgumentError, "rectangles"),
    (
        lambda: pw.write_pattern(_pattern(SQUARE, THETA, [0.0, np.pi]), "a.msi"),
        ArgumentError,
        "phi = 90",
    ),
    (lambda: pw.write_pattern(_pattern(), "a.ffs"), FileFormatError, "csv"),
    (lambda: pw.write_pattern(SQUARE, "a.csv"), ArgumentError, "radiation_pattern"),
    (
        lambda: pw.write_pattern(_pattern(), "a.csv", polarisation="right"),
        ArgumentError,
        "one of .x",
    ),
    (
        lambda: pw.write_pattern(_pattern(polarisation="y"), "a.csv", polarisation="x"),
        ArgumentError,
        "already has a polarisation",
    ),
    (lambda: _pattern(polarisation="x", obliquity="kirchhoff"), ArgumentError, "obliquity or a"),
    (lambda: _pattern(method="magnetic"), ArgumentError, "requires a polarisation"),
    (lambda: _pattern(polarisation="x", method="kirchhoff"), ArgumentError, "huygens"),
    (lambda: _pattern(polarisation=["x", "y"]), ArgumentError, "Jones"),
    (lambda: pw.write_pattern(_pattern(SQUARE, [0.0, 0.1, 0.3]), "a.ffd"), ArgumentError, "evenly"),
    (lambda: pw.write_pattern(_pattern(SQUARE, [-0.1, 0.1]), "a.ffd"), ArgumentError, "0 to 180"),
    (lambda: pw.write_pattern(_pattern(), f"{__file__}/a.csv"), ArgumentError, "cannot write"),
]


@pytest.mark.parametrize(("call", "kind", "words"), REFUSED)
def test_what_is_no_pattern_is_refused_in_words_and_leaves_no_file(
    call, kind, words, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(kind, match=words):
        call()
    assert not list(tmp_path.iterdir())
