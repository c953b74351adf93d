"""Far-field files of other programs: units, angles and frequencies.

The reference is a sum of few multipoles, whose power is a sum of squares of coefficients.
"""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from oracles.multipoles import FREE_SPACE, POWER, field, intensity
from polywigner.errors import ArgumentError, FileFormatError, PolywignerWarning

# Relative error of tables, which have seven digits, or six decimals of a dB.
DIGITS = 2e-6


THETA, PHI = np.arange(0.0, 181, 15), np.arange(0.0, 360, 20)


def directivity(theta: Any, phi: Any) -> Any:
    return 4 * np.pi * intensity(theta, phi) / POWER


def _rows(thetas: Any = THETA, phis: Any = PHI) -> Any:
    """Return theta and phi in degrees, with theta varying fastest, and both components."""
    phi, theta = (grid.ravel() for grid in np.meshgrid(phis, thetas, indexing="ij"))
    return theta, phi, *field(np.radians(theta), np.radians(phi))


def _size(squares: Any, unit: str) -> Any:
    """Return |rE|^2 in V^2 in a unit."""
    intensity, ratio = squares / (2 * FREE_SPACE), squares / (2 * FREE_SPACE) * 4 * np.pi / POWER
    with np.errstate(divide="ignore"):
        result = {
            "V/m": np.sqrt(squares),
            "mV/m": 1e3 * np.sqrt(squares),
            "kV": 1e-3 * np.sqrt(squares),
            "dBV/m": 10 * np.log10(squares),
            "dB(V/m)": 10 * np.log10(squares),
            "dBuV/m": 10 * np.log10(squares) + 120,
            "dBmV": 10 * np.log10(squares) + 60,
            "W/m^2": intensity,
            "mW/sr": 1e3 * intensity,
            "W": intensity,
            "dBW/m2": 10 * np.log10(intensity),
            "dBm/m^2": 10 * np.log10(intensity) + 30,
            "dBm": 10 * np.log10(intensity) + 30,
            "": ratio,
            "dBi": 10 * np.log10(ratio),
            "dB": 10 * np.log10(ratio),
            "dBd": 10 * np.log10(ratio) - 2.15,
        }[unit]
    return np.maximum(result, -300.0)


def _cst(
    path: Path, name: str, unit: str, angle: str = "deg.", phase: str = "deg.", **how: Any
) -> Path:
    total = how.pop("total", name)
    theta, phi, a, b = _rows(**how)
    turn = {"deg.": 1.0, "rad": math.pi / 180}
    squares = [np.abs(part) ** 2 for part in (a, b)]
    columns = [
        theta * turn[angle],
        phi * turn[angle],
        _size(sum(squares), how.get("total_unit", unit)),
        _size(squares[0], unit),
        np.degrees(np.angle(a)) % 360 * turn[phase],
        _size(squares[1], unit),
        np.degrees(np.angle(b)) % 360 * turn[phase],
        0 * theta,
    ]
    header = (
        f"Theta [{angle}]  Phi   [{angle}]  Abs({total:4})[{unit:6}]   Abs(Theta)[{unit:6}]  "
        f"Phase(Theta)[{phase}]  Abs(Phi  )[{unit:6}]  Phase(Phi  )[{phase}]  Ax.Ratio[      ]    "
    )
    rows = [" ".join(f"{value:.10e}" for value in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([header, "-" * len(header), *rows]) + "\n")
    return path


def _check(result: Any, power: float = POWER) -> None:
    """Check the directivity, and the field up to a factor."""
    theta, phi = result["theta"].values[:, None], result["phi"].values
    exact = directivity(theta, phi)
    peak = 10 * math.log10(exact.max())
    assert result.attrs["peak_directivity"] == pytest.approx(peak, abs=DIGITS)
    assert 10 ** (result["directivity"].values / 10) == pytest.approx(exact, abs=1e-5)
    assert result.attrs["radiated_power"] == pytest.approx(power, rel=1e-6)
    x, y = _linear(result)
    polar, azimuthal = field(theta, phi)
    scale = math.sqrt(result.attrs["radiated_power"] / POWER / (2 * FREE_SPACE))
    exact_x = scale * (polar * np.cos(phi) - azimuthal * np.sin(phi)).conj()
    exact_y = scale * (polar * np.sin(phi) + azimuthal * np.cos(phi)).conj()
    largest = max(np.abs(exact_x).max(), np.abs(exact_y).max())
    assert np.abs(x - exact_x).max() < 1e-6 * largest
    assert np.abs(y - exact_y).max() < 1e-6 * largest


def _linear(result: Any) -> tuple[Any, Any]:
    """Return the components along x and y in Ludwig's third definition."""
    p, q = np.asarray(result.attrs["polarisation"]).view(np.complex128)
    co, cross = result["field"].values, result["cross_field"].values
    return p * co - np.conj(q) * cross, q * co + np.conj(p) * cross


@pytest.mark.parametrize(
    ("name", "units", "power"),
    [
        ("Dir.", ("dBi", "", "dB", "dBd"), 1.0),
        ("E", ("V/m", "mV/m", "kV", "dBV/m", "dB(V/m)", "dBuV/m", "dBmV"), POWER),
        ("P", ("W/m^2", "mW/sr", "dBW/m2", "dBm/m^2"), POWER),
    ],
)
def test_a_table_of_cst_is_read_in_its_units(
    tmp_path: Path, name: str, units: tuple[str, ...], power: float
) -> None:
    for unit in units:
        _check(pw.read_pattern(_cst(tmp_path / "a.txt", name, unit)), power)
    _check(pw.read_pattern(_cst(tmp_path / "a.txt", name, units[0], "rad", "rad")), power)


@pytest.mark.parametrize(
    ("thetas", "phis"),
    [
        (np.arange(-180.0, 181, 15), np.arange(-90.0, 90, 15)),
        (np.arange(-180.0, 181, 15), np.arange(0.0, 181, 15)),
        (np.arange(-180.0, 180, 15), np.arange(0.0, 361, 20)),
        (np.arange(0.0, 181, 15), np.arange(-180.0, 181, 20)),
    ],
)
def test_theta_of_both_signs_covers_the_sphere(tmp_path: Path, thetas: Any, phis: Any) -> None:
    result = pw.read_pattern(_cst(tmp_path / "a.txt", "E", "V/m", thetas=thetas, phis=phis))
    assert result["theta"].values[[0, -1]] == pytest.approx([0.0, math.pi])
    assert result["phi"].values.min() == 0 and result["phi"].values.max() < 2 * math.pi - 0.1
    _check(result)


@pytest.mark.parametrize(
    ("thetas", "phis"),
    [(THETA, np.array([0.0, 180.0])), (np.array([0.0, 180.0]), PHI)],
)
def test_a_single_cut_through_the_sphere_is_refused(tmp_path: Path, thetas: Any, phis: Any) -> None:
    """Two half planes sample the full circle evenly, but do not determine the power."""
    with pytest.raises(FileFormatError, match="at least three theta angles, and four"):
        pw.read_pattern(_cst(tmp_path / "a.txt", "E", "V/m", thetas=thetas, phis=phis))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("[V/m   ]", "[furlong]"), "furlong"),
        (("[deg.]", "[gon]"), "gon"),
        (("Abs(E   )[V/m   ]", "Abs(E   )[dBi   ]"), "dBi"),
        (("Abs(E   )[V/m   ]   Abs(Theta)[V/m   ]", "Abs(Foo )[]   Abs(Theta)[]"), "unit"),
        (("Theta [deg.]", "Alpha [deg.]"), "Theta"),
        # The values contradict each other.
        (("Abs(E   )[V/m   ]", "Abs(E   )[mV/m  ]"), "Abs.E   . differs"),
        (("Abs(Phi  )[V/m   ]", "Abs(Phi  )[kV/m  ]"), "differs"),
    ],
)
def test_units_that_do_not_fit_are_refused_by_name(
    tmp_path: Path, change: tuple[str, str], words: str
) -> None:
    path = _cst(tmp_path / "a.txt", "E", "V/m")
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(FileFormatError, match=words) as error:
        pw.read_pattern(path)
    assert str(error.value).isprintable()


def _change_levels(path: Path, change: Any) -> None:
    """Change the levels in a CST table."""
    rows = [line.split() for line in path.read_text().splitlines()]
    for row in rows[2:]:
        for k in (2, 3, 5):
            row[k] = f"{change(float(row[k])):.12g}"
    path.write_text("\n".join(" ".join(row) for row in rows))


@pytest.mark.parametrize("half", [True, False])
def test_linear_directivities_under_a_header_in_dbi_are_refused(tmp_path: Path, half: bool) -> None:
    """All columns agree, but their integral contradicts their directivity."""
    thetas = np.arange(0.0, 91 if half else 181, 5)
    beam = pw.radiation_pattern(
        pw.shapes.square(4e-3), 3.9e-3, np.radians(thetas), np.radians(PHI), polarisation="x"
    )
    pw.write_pattern(beam, tmp_path / "a.txt")
    _change_levels(tmp_path / "a.txt", lambda level: 10 ** (level / 10))
    with pytest.raises(FileFormatError, match=r"integral|differs"):
        pw.read_pattern(tmp_path / "a.txt")


def test_a_directivity_that_the_integral_contradicts_is_warned_of(tmp_path: Path) -> None:
    """Half of the sphere is missing; the directivity of the file is kept."""
    half = np.arange(0.0, 91, 15)
    path = _cst(tmp_path / "a.txt", "Dir.", "dBi", thetas=half)
    with pytest.warns(PolywignerWarning, match="integral over its directions"):
        result = pw.read_pattern(path)
    front = 10 * math.log10(directivity(np.radians(half)[:, None], np.radians(PHI)).max())
    assert result.attrs["peak_directivity"] == pytest.approx(front, abs=DIGITS)


@pytest.mark.parametrize("efficiency", [0.5, 2.0])
def test_a_gain_above_the_directivity_is_warned_of(tmp_path: Path, efficiency: float) -> None:
    """An efficiency of 50 % lowers gain and power by 3 dB; 200 % is impossible."""
    path = _cst(tmp_path / "a.txt", "Gain", "dBi")
    _change_levels(path, lambda level: level + 10 * math.log10(efficiency))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        _check(pw.read_pattern(path), efficiency)
    assert [("exceeds the directivity" in str(w.message)) for w in caught] == [True] * (
        efficiency > 1
    )


def _hfss(path: Path, columns: dict[str, Any], **how: Any) -> Path:
    theta, phi, a, b = _rows(**how)
    squares = np.abs(a) ** 2, np.abs(b) ** 2
    values = {name: make(theta, phi, a, b, squares) for name, make in columns.items()}
    lines = [",".join(f'"{name}"' for name in values)]
    for row in zip(*values.values(), strict=True):
        lines.append(",".join(x if isinstance(x, str) else f"{x:.12g}" for x in row))
    path.write_text("\n".join(lines))
    return path


ANGLES = {"Phi [deg]": lambda t, p, *_: p, "Theta [deg]": lambda t, p, *_: t}


def _both(theta: str, phi: str, make: Any) -> dict[str, Any]:
    """Return columns of both components, computed from E and |E|^2."""
    return {
        theta: lambda t, p, a, b, s: make(a, s[0]),
        phi: lambda t, p, a, b, s: make(b, s[1]),
    }


def _parts(unit: str, factor: float) -> dict[str, Any]:
    return {
        **_both(f"re(rETheta) [{unit}]", f"re(rEPhi) [{unit}]", lambda e, s: factor * e.real),
        **_both(f"im(rETheta) [{unit}]", f"im(rEPhi) [{unit}]", lambda e, s: factor * e.imag),
    }


def _phase(e: Any, _: Any) -> Any:
    return np.degrees(np.angle(e))


@pytest.mark.parametrize(
    "columns",
    [
        _parts("mV", 1e3),
        {  # magnitudes and phases
            **_both("mag(rETheta) [mV]", "mag(rEPhi) [mV]", lambda e, s: 1e3 * np.abs(e)),
            "ang_deg(rETheta) [deg]": lambda t, p, a, b, s: _phase(a, s),
            "ang_rad(rEPhi)": lambda t, p, a, b, s: np.angle(b),
        },
        {
            **_both("dB(rETheta)", "dB20(rEPhi) []", lambda e, s: _size(s, "dBV/m")),
            **_both("cang_deg(rETheta) [deg]", "cang_deg(rEPhi) [deg]", _phase),
        },
    ],
)
def test_a_report_of_hfss_is_read_in_its_units(tmp_path: Path, columns: dict[str, Any]) -> None:
    repeated = {
        "dB(DirTotal)": lambda t, p, a, b, s: _size(s[0] + s[1], "dBi"),
        "rETotal [mV]": lambda t, p, a, b, s: _size(s[0] + s[1], "mV/m"),
        "dB(RealizedGainTotal)": lambda t, p, a, b, s: _size(s[0] + s[1], "dBi") - 1.7,
        "GainTheta": lambda t, p, a, b, s: 0.8 * _size(s[0], ""),
        "dB(GainPhi)": lambda t, p, a, b, s: _size(s[1], "dBi") - 0.5,
        "AxialRatioValue": lambda t, p, a, b, s: 0 * t,
    }
    _check(pw.read_pattern(_hfss(tmp_path / "a.csv", {**ANGLES, **columns})))
    _check(pw.read_pattern(_hfss(tmp_path / "b.csv", {**repeated, **columns, **ANGLES})))


def test_gains_with_phases_are_a_field(tmp_path: Path) -> None:
    columns = {
        **_both("dB(GainTheta)", "dB(GainPhi)", lambda e, s: _size(s, "dBi") - 3),
        **_both("ang_deg(rETheta) [deg]", "ang_deg(rEPhi) [deg]", _phase),
    }
    _check(pw.read_pattern(_hfss(tmp_path / "a.csv", {**ANGLES, **columns})), 10**-0.3)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (_parts("Tesla", 1.0), "Tesla"),
        ({**_parts("V", 1), "dB(DirTotal)": lambda t, p, a, b, s: 20 * np.log10(s[0])}, "DirTotal"),
        ({**_parts("V", 1), **_parts("mV", 1e3)}, "contains two columns for"),
        ({"rETheta [mV]": lambda t, p, a, b, s: a.real, "rEPhi": lambda *_: _[3].real}, "phase"),
        ({"dB(rETheta) [mV]": lambda t, p, a, b, s: _size(s[0], "dBV/m")}, "mV"),
    ],
)
def test_columns_of_hfss_that_do_not_fit_are_refused(
    tmp_path: Path, columns: dict[str, Any], words: str
) -> None:
    path = _hfss(tmp_path / "a.csv", {**ANGLES, **columns})
    with pytest.raises(FileFormatError, match=re.escape(words)):
        pw.read_pattern(path)


def test_a_report_of_several_frequencies_needs_one(tmp_path: Path) -> None:
    """The field at 80 GHz is half of the field at 77 GHz."""
    one, other = (
        _hfss(
            tmp_path / f"{f}.csv",
            {"Freq [GHz]": lambda t, *_, f=f: f + 0 * t, **ANGLES, **_parts("V", size)},
        )
        for f, size in ((77, 1.0), (80, 0.5))
    )
    _check(pw.read_pattern(one))
    assert pw.read_pattern(one).attrs["frequency"] == pytest.approx(77e9)
    both = tmp_path / "both.csv"
    both.write_text(one.read_text() + "\n" + "\n".join(other.read_text().splitlines()[1:]))
    _check(pw.read_pattern(both, frequency=77e9), POWER)
    _check(pw.read_pattern(both, frequency=80e9), POWER / 4)
    with pytest.raises(FileFormatError, match=r"7.7e.10, 8e.10 Hz"):
        pw.read_pattern(both)
    with pytest.raises(FileFormatError, match=r"requested frequency of 7.8e.10 Hz"):
        pw.read_pattern(both, frequency=78e9)


def test_a_pivoted_report_has_its_frequency_in_the_header(tmp_path: Path) -> None:
    columns = {f"{name} - Freq='77GHz'": make for name, make in _parts("mV", 1e3).items()}
    result = pw.read_pattern(_hfss(tmp_path / "a.csv", {**ANGLES, **columns}))
    _check(result)
    assert result.attrs["frequency"] == pytest.approx(77e9)


def test_a_file_without_a_frequency_takes_the_one_that_is_given(tmp_path: Path) -> None:
    path = _cst(tmp_path / "a.txt", "E", "V/m")
    assert math.isnan(pw.read_pattern(path).attrs["frequency"])
    result = pw.read_pattern(path, frequency=10e9)
    assert result.attrs["wavelength"] == pytest.approx(0.0299792458)
    for wrong in (0.0, -1e9, "10 GHz"):
        with pytest.raises(ArgumentError, match="frequency"):
            pw.read_pattern(path, frequency=wrong)  # type: ignore[arg-type]


def _ffd(path: Path, factors: dict[float, float], thetas: Any, phis: Any) -> Path:
    lines = [f"{axis[0]:g} {axis[-1]:g} {len(axis)}" for axis in (thetas, phis)]
    lines.append(f"Frequencies {len(factors)}")
    for frequency, factor in factors.items():
        lines.append(f"Frequency {frequency:.12g}")
        parts = field(np.radians(thetas)[:, None], np.radians(phis))
        for a, b in zip(*(factor * part.ravel() for part in parts), strict=True):
            lines.append(f"{a.real:.12e} {a.imag:.12e} {b.real:.12e} {b.imag:.12e}")
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("thetas", [THETA, np.arange(-180.0, 181, 15)])
def test_far_field_data_of_hfss_have_frequencies_and_signs_of_theta(
    tmp_path: Path, thetas: Any
) -> None:
    path = _ffd(tmp_path / "a.ffd", {1e9: 1.0, 2e9: 3.0, 3e9: 0.1}, thetas, np.arange(0.0, 361, 20))
    for frequency, factor in ((1e9, 1.0), (2e9, 3.0), (3.0001e9, 0.1)):
        result = pw.read_pattern(path, frequency=frequency)
        assert result.attrs["frequency"] == pytest.approx(frequency, rel=1e-3)
        _check(result, factor**2 * POWER)
    with pytest.raises(FileFormatError, match=r"frequency= as one of 1e.09, 2e.09, 3e.09 Hz"):
        pw.read_pattern(path)
    with pytest.raises(FileFormatError, match=r"2.5e.09"):
        pw.read_pattern(path, frequency=2.5e9)
    path.write_text(path.read_text().replace("Frequencies 3", "Frequencies 2"))
    with pytest.raises(FileFormatError, match="Frequencies"):
        pw.read_pattern(path, frequency=1e9)


def test_a_direction_with_two_fields_is_refused(tmp_path: Path) -> None:
    path = _ffd(tmp_path / "a.ffd", {1e9: 1.0}, THETA, np.arange(0.0, 361, 20))
    lines = path.read_text().splitlines()
    lines[-1] = "0 9 9 0"  # phi = 360 degrees
    path.write_text("\n".join(lines))
    with pytest.raises(FileFormatError, match="different fields for the same direction"):
        pw.read_pattern(path)


def _ffe(path: Path, factors: dict[float, float], kind: str = "Gain", level: float = 0.0) -> Path:
    lines = ["##File Type: Far field", "##File Format: 6", "** File exported by FEKO kernel", ""]
    theta, phi, a, b = _rows()
    total = _size(np.abs(a) ** 2 + np.abs(b) ** 2, "dBi") + level
    parts = (_size(np.abs(part) ** 2, "dBi") + level for part in (a, b))
    gains = np.column_stack([*parts, total])
    for frequency, factor in factors.items():
        lines += [
            "#Configuration Name: Standard",
            "#Request Name: FarField1",
            f"#Frequency:   {frequency:.8E}",
            "#Coordinate System: Spherical",
            f"#No. of Theta Samples: {len(THETA)}",
            f"#Result Type: {kind}",
            '#   "Theta" "Phi" "Re(Etheta)" "Im(Etheta)" "Re(Ephi)" "Im(Ephi)" '
            + " ".join(f'"{kind}({name})"' for name in ("Theta", "Phi", "Total")),
        ]
        values = [theta, phi, *(factor * x for x in (a.real, a.imag, b.real, b.imag)), *gains.T]
        lines += ["  ".join(f"{x:.10E}" for x in row) for row in np.column_stack(values)]
        lines.append("")
    path.write_text("\n".join(lines))
    return path


def test_far_fields_of_feko_are_read(tmp_path: Path) -> None:
    path = _ffe(tmp_path / "a.ffe", {1e9: 1.0, 2e9: 0.2})
    _check(pw.read_pattern(path, frequency=1e9))
    assert pw.read_pattern(path, frequency=2e9).attrs["radiated_power"] == pytest.approx(
        0.04 * POWER
    )
    _check(pw.read_pattern(_ffe(tmp_path / "b.ffe", {1e9: 1.0}, "Directivity")))
    with pytest.warns(PolywignerWarning, match="exceeds the directivity"):
        pw.read_pattern(_ffe(tmp_path / "c.ffe", {1e9: 1.0}, level=3.0))
    for wrong, words in (
        (("Spherical", "Cartesian"), "spherical"),
        (("Result Type: Gain", "Result Type: RCS"), "RCS"),
        (('"Re(Etheta)"', '"Re(Ex)"'), "E_theta"),
        (('#   "Theta"', '**  "Theta"'), "contains the column names"),
    ):
        changed = tmp_path / "d.ffe"
        changed.write_text(_ffe(tmp_path / "e.ffe", {1e9: 1.0}).read_text().replace(*wrong))
        with pytest.raises(FileFormatError, match=words):
            pw.read_pattern(changed)


def _grasp(path: Path, kind: int, cut: int, thetas: Any, phis: Any, text: str = "cut") -> Path:
    """Write cuts of E_theta, E_phi (1), RHC, LHC (2) or co, cross (3), normalised to 4 pi W."""
    scale = math.sqrt(4 * math.pi / (2 * FREE_SPACE * POWER))
    lines: list[str] = []
    outer, inner = (phis, thetas) if cut == 1 else (thetas, phis)
    for constant in outer:
        lines.append(text)
        step = inner[1] - inner[0]
        lines.append(f"  {inner[0]:g} {step:g} {len(inner)} {constant:g} {kind} {cut} 2")
        for variable in inner:
            theta, phi = np.radians((variable, constant) if cut == 1 else (constant, variable))
            a, b = (scale * part for part in field(theta, phi))
            co, cross = a * np.cos(phi) - b * np.sin(phi), a * np.sin(phi) + b * np.cos(phi)
            # A right-handed wave along z has the field x - j y.
            right, left = (co + 1j * cross) / math.sqrt(2), (co - 1j * cross) / math.sqrt(2)
            one, two = {1: (a, b), 2: (right, left), 3: (co, cross)}[kind]
            lines.append(f"{one.real:.10E} {one.imag:.10E} {two.real:.10E} {two.imag:.10E}")
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("kind", [1, 2, 3])
@pytest.mark.parametrize(
    ("cut", "thetas", "phis"),
    [
        (1, THETA, np.arange(0.0, 360, 20)),
        (1, np.arange(-180.0, 181, 15), np.arange(0.0, 180, 15)),
        (2, THETA, np.arange(0.0, 361, 20)),
    ],
)
def test_cuts_of_grasp_are_read(
    tmp_path: Path, kind: int, cut: int, thetas: Any, phis: Any
) -> None:
    _check(pw.read_pattern(_grasp(tmp_path / "a.cut", kind, cut, thetas, phis)), 1.0)


def test_two_cuts_of_grasp_have_the_directivity_of_their_normalisation(tmp_path: Path) -> None:
    thetas = np.arange(-60.0, 61, 5)
    path = _grasp(tmp_path / "a.cut", 3, 1, thetas, [0.0, 90.0], "horn, 12.5 GHz")
    result = pw.read_pattern(path)
    assert result["theta"].values == pytest.approx(np.radians(thetas))
    exact = directivity(np.radians(thetas)[:, None], np.radians([0.0, 90.0]))
    assert 10 ** (result["directivity"].values / 10) == pytest.approx(exact, rel=1e-6)
    assert result.attrs["frequency"] == pytest.approx(12.5e9)
    assert len(pw.beam_metrics(result).cuts) == 2


def test_cuts_of_grasp_that_are_not_read_are_named(tmp_path: Path) -> None:
    path = _grasp(tmp_path / "a.cut", 1, 1, THETA, PHI)
    text = path.read_text()
    for change, words in (
        (lambda t: re.sub(r" 1 1 2\n", " 9 1 2\n", t), "ICOMP 9"),
        (lambda t: re.sub(r" 1 1 2\n", " 1 3 2\n", t), "ICUT 3"),
        (lambda t: re.sub(r" 1 1 2\n", " 1 1 3\n", t), "NCOMP 3"),
        (lambda t: "\n".join(t.splitlines()[:-3]), "fewer"),
    ):
        path.write_text(change(text))
        with pytest.raises(FileFormatError, match=words):
            pw.read_pattern(path)
    # Fortran omits the E of exponents with three digits.
    path.write_text(re.sub(r"\n(\S+) (\S+) ", r"\n0.1-100 \2 ", text, count=0))
    pw.read_pattern(path)


def test_a_written_planning_file_is_read_back(tmp_path: Path) -> None:
    """Attenuations have three decimals, and end at 99.9 dB."""
    tilted = pw.steering((0.0, -0.1, math.sqrt(0.99)), 3.9e-3)
    source = pw.shapes.rectangle(9e-3, 14e-3).moved((1e-3, 2e-3)).with_illumination(tilted)
    theta, phi = np.radians(np.arange(-90, 91)), np.radians([0.0, 90.0])
    written = pw.radiation_pattern(source, 3.9e-3, theta, phi)
    for suffix in (".msi", ".pln"):
        pw.write_pattern(written, tmp_path / f"a{suffix}", efficiency=0.8)
        result = pw.read_pattern(tmp_path / f"a{suffix}")
        assert result["theta"].values == pytest.approx(np.radians(np.arange(-180, 181)))
        assert result["phi"].values == pytest.approx(phi)
        front = result["directivity"].values[90:271]
        expected = written["directivity"].values + 10 * math.log10(0.8)
        strong = expected > -40
        assert front[strong] == pytest.approx(expected[strong], abs=2e-3)
        assert result.attrs["frequency"] == pytest.approx(written.attrs["frequency"], rel=1e-8)
        metrics, own = pw.beam_metrics(result), pw.beam_metrics(written)
        widths = [[cut.half_power_beamwidth for cut in m.cuts] for m in (metrics, own)]
        assert widths[0] == pytest.approx(widths[1], rel=2e-3)
    with pytest.raises(ArgumentError, match="no complex field"):
        pw.write_pattern(result, tmp_path / "b.cut")


@pytest.mark.parametrize(
    ("gain", "expected"), [("17 dBi", 17.0), ("17 dBd", 19.15), ("17.0dBi", 17.0), ("17", 19.15)]
)
def test_the_gain_of_a_planning_file_has_a_unit(tmp_path: Path, gain: str, expected: float) -> None:
    rows = "".join(f"{k} {min(k, 360 - k) / 10}\n" for k in range(0, 360, 10))
    path = tmp_path / "a.msi"
    text = f"NAME x\nFREQUENCY 2140\nGAIN {gain}\nHORIZONTAL 36\n{rows}VERTICAL 36\n{rows}"
    path.write_text(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = pw.read_pattern(path)
    assert result.attrs["peak_directivity"] == pytest.approx(expected)
    assert result.attrs["frequency"] == 2.14e9
    assert bool(caught) == ("dB" not in gain)
    assert "nan" not in str(pw.beam_metrics(result)).lower()
    for change, words in (
        ((f"GAIN {gain}", "GAIN 17 lbs"), "GAIN"),
        (("2140", "2140 furlongs"), "frequency"),
        (("HORIZONTAL 36", "HORIZONTAL 35"), "HORIZONTAL"),
        (("VERTICAL", "VERTIKAL"), "VERTICAL"),
    ):
        path.write_text(text.replace(*change))
        with pytest.raises(FileFormatError, match=words):
            pw.read_pattern(path)
