"""Far-field files of simulators as array elements."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles import multipoles
from polywigner.errors import ArgumentError, FileFormatError, GeometryError, PolywignerWarning

WAVELENGTH = 299792458 / 77e9
ELEMENT = pw.shapes.rectangle(0.9 * WAVELENGTH, 0.6 * WAVELENGTH).moved((0.1 * WAVELENGTH, 0))
PLACES = pw.arrays.grid_positions(6, 5, 0.95 * WAVELENGTH, 0.7 * WAVELENGTH)
WEIGHTS = pw.arrays.steering_weights(PLACES, (0.3, 0.2), WAVELENGTH)
ARRAY = pw.phased_array(ELEMENT, PLACES, WEIGHTS)
GRID = np.radians(np.arange(0, 91, 2)), np.radians(np.arange(0, 360, 5))
FINE = np.radians(np.arange(0, 360, 0.2))
# Angles between all samples, of both signs, and behind the source.
PLACES_BETWEEN = np.radians(np.linspace(-89.3, 95.1, 63)), np.radians([0.0, 33.3, 90.0, 201.7])


def _pattern(source: Any = ELEMENT, angles: Any = GRID, **how: Any) -> Any:
    return pw.radiation_pattern(source, WAVELENGTH, *angles, **how)


def _file(folder: Path, suffix: str = ".csv", angles: Any = GRID, **how: Any) -> Path:
    path = folder / f"element{suffix}"
    pw.write_pattern(_pattern(angles=angles, **{"polarisation": "right", **how}), path)
    return path


@pytest.mark.parametrize(
    ("suffix", "jones", "method"),
    [(".csv", "x", "magnetic"), (".ffd", "right", "huygens"), (".cut", "right", "huygens")],
)
def test_an_array_of_a_written_pattern_is_the_array_it_was_made_from(
    tmp_path: Path, suffix: str, jones: str, method: Any
) -> None:
    """Files have nine digits, or six decimals of dB and degrees."""
    element = pw.read_pattern(_file(tmp_path, suffix, polarisation=jones, method=method))
    exact = _pattern(ARRAY, PLACES_BETWEEN, polarisation=jones, method=method)
    result = _pattern(ARRAY, PLACES_BETWEEN, polarisation=jones, element=element)
    size = np.abs(exact["field"].values).max()
    factor = 1.0
    if suffix == ".cut":  # .cut files have directivities, for a power of 1 W
        own = _pattern(polarisation=jones, method=method)
        factor = math.sqrt(own.attrs["radiated_power"])
        phase = result["field"].values.ravel()[20] / exact["field"].values.ravel()[20]
        assert abs(phase / abs(phase) - 1) < 1e-6
    for name in ("field", "cross_field"):
        assert np.abs(factor * result[name].values - exact[name].values).max() < 1e-6 * size
    for name in ("peak_directivity", "peak_theta", "peak_phi"):
        assert result.attrs[name] == pytest.approx(exact.attrs[name], abs=1e-5)


def _sphere_file(path: Path, thetas: Any, phis: Any) -> Path:
    lines = ["Phi[deg],Theta[deg],re(rETheta)[V],im(rETheta)[V],re(rEPhi)[V],im(rEPhi)[V]"]
    for phi in phis:
        for theta in thetas:
            a, b = multipoles.field(math.radians(theta), math.radians(phi))
            values = (phi, theta, a.real, a.imag, b.real, b.imag)
            lines.append(",".join(f"{value:.15g}" for value in values))
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.mark.parametrize("steps", [(7, 9), (19, 12)])
def test_a_band_limited_sphere_is_exact_between_its_samples(
    tmp_path: Path, steps: tuple[int, int]
) -> None:
    """Steps of 30 degrees resolve second-degree harmonics."""
    phis = np.arange(steps[1]) * 360 / steps[1]
    path = _sphere_file(tmp_path / "sphere.csv", np.linspace(0, 180, steps[0]), [*phis, 360.0])
    element = pw.read_pattern(path)
    alone = pw.phased_array(pw.shapes.square(1e-3), [[0.0, 0.0]])
    angles = np.linspace(0.01, 3.1, 23), np.linspace(0, 6.2, 17)
    result = pw.radiation_pattern(alone, WAVELENGTH, *angles, element=element)
    intensity = np.abs(result["field"].values) ** 2 + np.abs(result["cross_field"].values) ** 2
    expected = multipoles.intensity(angles[0][:, None], angles[1])
    assert intensity == pytest.approx(expected, rel=1e-11, abs=1e-14)
    assert result.attrs["radiated_power"] == pytest.approx(multipoles.POWER, rel=1e-11)


DAMAGES: dict[str, tuple[Any, str]] = {
    "empty": (lambda t: "", "empty"),
    "another": (lambda t: "hello\nworld\n", "columns"),
    "a text": (lambda t: t.replace("\n0,2,", "\n0,two,", 1), "line 3"),
    "not finite": (lambda t: re.sub(r"\n0,2,[^,]*,[^,]*", "\n0,2,0,nan", t), "finite"),
    "a row less": (lambda t: t[: t.rstrip().rfind("\n")], "a grid of"),
    "zeros": (lambda t: re.sub(r"(?m)^(\d+,\d+,[^,]*),.*", r"\1,0,0,0,0", t), "zero"),
    "a cut": (lambda t: "\n".join(t.splitlines()[: 1 + len(GRID[0])]), "full circle"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_files_that_are_no_far_field_are_refused_in_a_sentence(tmp_path: Path, damage: str) -> None:
    path = _file(tmp_path)
    change, words = DAMAGES[damage]
    path.write_text(change(path.read_text()))
    with pytest.raises(FileFormatError, match=words):
        pw.read_pattern(path)


def test_other_files_and_elements_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="suffix"):
        pw.read_pattern(tmp_path / "a.ffs")
    with pytest.raises(FileFormatError, match="exist"):
        pw.read_pattern(tmp_path / "a.csv")
    short = _file(tmp_path, angles=(GRID[0][:30], GRID[1]))
    with pytest.raises(FileFormatError, match="90"):
        pw.read_pattern(short)
    element = _pattern(polarisation="x")
    for wrong, words in (
        ({"source": ELEMENT}, "phased_array"),
        ({"element": _pattern()}, "polarisation"),
        ({"element": _pattern(angles=(GRID[0], FINE), polarisation="x")}, "at most"),
        ({"method": "magnetic"}, "method"),
        ({"obliquity": "paper"}, "obliquity"),
    ):
        with pytest.raises(ArgumentError, match=words):
            _pattern(**{"source": ARRAY, "element": element, **wrong})


def test_an_element_of_another_frequency_is_told() -> None:
    with pytest.warns(PolywignerWarning, match="Hz"):
        pw.radiation_pattern(ARRAY, 1.1 * WAVELENGTH, 0.0, 0.0, element=_pattern(polarisation="x"))


@pytest.mark.usefixtures("unrendered_figures")
def test_the_command_line_takes_a_file_as_the_element(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from polywigner.cli import main

    element = _file(tmp_path, ".ffd")
    pw.write_source(ARRAY, tmp_path / "array.toml")
    call = ["pattern", str(tmp_path / "array.toml"), "--frequency", "77 GHz", "--step", "3 deg"]
    call += ["--out", f"{tmp_path}/", "--element", str(element)]
    assert main(call) == 0
    said = capsys.readouterr().out
    exact = _pattern(ARRAY, (0.0, 0.0), polarisation="right")
    assert f"directivity       {exact.attrs['peak_directivity']:.2f} dBi" in said
    assert "axial ratio       0.00 dB" in said and "radiated part" not in said
    for more in (["--method", "magnetic"], ["--obliquity", "paper"]):
        assert main([*call, *more]) == 2
    assert main([*call[:-1], str(tmp_path / "array.toml")]) == 2
    assert "suffix" in capsys.readouterr().err


SIDES, ASIDE = (1.6 * WAVELENGTH, 1.1 * WAVELENGTH), (0.4 * WAVELENGTH, 0.0)
OUTLINE = pw.shapes.rectangle(*SIDES).moved(ASIDE)
HORN = OUTLINE.with_illumination(pw.te_mode(*SIDES).moved(ASIDE))


def test_the_residual_is_how_far_both_far_fields_are_apart() -> None:
    """The residual includes directions between the samples and all components."""
    jones, method = "right", "magnetic"
    table = _pattern(HORN, polarisation=jones, method=method)
    fit = pw.fit_pattern(table, OUTLINE, method=method)
    node, weight = np.polynomial.legendre.leggauss(24)
    angles = np.arccos((node + 1) / 2), np.radians(np.arange(1.3, 360, 5))
    off, size = 0.0, 0.0
    for name in ("field", "cross_field"):
        sent, wanted = (
            _pattern(source, angles, polarisation=jones, method=method)[name].values
            for source in (fit.aperture, HORN)
        )
        off += weight @ np.square(np.abs(sent - wanted)).sum(axis=1)
        size += weight @ np.square(np.abs(wanted)).sum(axis=1)
    assert math.sqrt(off / size) == pytest.approx(fit.residual, rel=1e-3)
    assert fit.residual < 2e-3
    power = _pattern(fit.aperture, polarisation=jones, method=method).attrs
    assert fit.power_ratio == pytest.approx(power["aperture_power"] / power["radiated_power"])


def test_a_wide_element_is_fitted_in_enough_directions() -> None:
    sides = 4 * WAVELENGTH, 0.5 * WAVELENGTH
    outline = pw.shapes.rectangle(*sides)
    table = _pattern(outline.with_illumination(pw.te_mode(*sides)), polarisation="y")
    fit = pw.fit_pattern(table, outline)
    power = _pattern(fit.aperture, polarisation="y").attrs
    assert fit.power_ratio == pytest.approx(power["aperture_power"] / power["radiated_power"])


def test_a_fitted_element_has_the_links_and_arrays_of_its_pattern(tmp_path: Path) -> None:
    """Friis' formula with the directivities of the file, within the residual."""
    element = pw.read_pattern(_file(tmp_path, ".ffd", source=HORN, polarisation="x"))
    fit = pw.fit_pattern(element, OUTLINE)
    facing = np.diag([-1.0, 1.0, -1.0, 1.0])
    facing[2, 3] = 5.0
    b = pw.coupling(fit.aperture, fit.aperture, facing, WAVELENGTH, polarisation="x")
    gain = 10 ** (float(element["directivity"].values[0, 0]) / 10)
    assert abs(b) == pytest.approx(gain * WAVELENGTH / (4 * math.pi * 5.0), rel=2 * fit.residual)
    places = pw.arrays.grid_positions(2, 2, 1.8 * WAVELENGTH, 1.4 * WAVELENGTH)
    exact = _pattern(pw.phased_array(OUTLINE, places), element=element, polarisation="x")
    result = _pattern(pw.phased_array(fit.aperture, places), polarisation="x")["field"].values
    apart = np.abs(result - exact["field"].values).max()
    assert apart < 5 * fit.residual * np.abs(result).max()


def test_scalar_sources_take_the_pattern_of_the_first_boundary_condition() -> None:
    """The pattern is cos(theta) F in Ludwig's third definition."""
    table = _pattern(HORN, polarisation="y")
    scalar = _pattern(HORN, obliquity="rayleigh-sommerfeld-1")
    table["field"], table["cross_field"] = scalar["field"], 0.0 * table["cross_field"]
    fit = pw.fit_pattern(table, OUTLINE, method="rayleigh-sommerfeld-1", cut_off=1e-8)
    result = _pattern(fit.aperture, obliquity="rayleigh-sommerfeld-1")["field"].values
    apart = np.abs(result - scalar["field"].values).max() / np.abs(result).max()
    assert fit.residual < 2e-6 and apart < 2e-5
    rough = pw.fit_pattern(table, OUTLINE, method="rayleigh-sommerfeld-1", cut_off=0.1)
    assert rough.residual > 1e3 * fit.residual
    with pytest.warns(
        PolywignerWarning, match="fit is poor: the residual of the far field is 0.71"
    ):
        other = pw.fit_pattern(
            table, OUTLINE, polarisation="45 deg", method="rayleigh-sommerfeld-1"
        )
    assert other.residual == pytest.approx(math.sqrt(0.5), rel=1e-2)  # half of the power


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pattern": 3}, "the result of read_pattern or radiation_pattern"),
        ({"aperture": HORN}, "expected an Aperture without a field"),
        ({"aperture": pw.shapes.square(0.1)}, "at most 2400 waves in a fit"),
        ({"method": "kirchhoff"}, "expected method"),
        ({"polarisation": "y"}, "no radiation in the specified polarisation"),
        ({"cut_off": 2.0}, "expected cut_off to be a fraction"),
    ],
)
def test_what_no_field_can_be_fitted_to_is_refused(change: Any, message: str) -> None:
    table = _pattern(polarisation="x", method="huygens")
    table["cross_field"] = 0.0 * table["cross_field"]
    given = {"pattern": table, "aperture": OUTLINE, **change}
    with pytest.raises((ArgumentError, GeometryError), match=message):
        pw.fit_pattern(given.pop("pattern"), given.pop("aperture"), **given)
    if not change.keys() - {"wavelength"}:
        table.attrs["wavelength"] = math.nan
        with pytest.raises(ArgumentError, match="the pattern does not contain a wavelength"):
            pw.fit_pattern(table, OUTLINE)
