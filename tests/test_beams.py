"""Beam metrics of patterns against closed forms and dense samples."""

import math
import re

import numpy as np
import pytest

import polywigner as pw
from polywigner.cli import main
from polywigner.errors import ArgumentError, PolywignerWarning
from polywigner.figures import draw_hemispheres, draw_pattern

WAVELENGTH = 299792458 / 94e9
CUTS = np.radians(np.arange(-90, 90.5, 0.5)), np.radians([0.0, 90.0])
SIDE, PITCH = 0.49 * WAVELENGTH, WAVELENGTH / 2
# Relative error of parabolic interpolation with ten samples per beamwidth.
INTERPOLATION = 1e-3


def _metrics(source, theta=CUTS[0], phi=CUTS[1], **how):
    return pw.beam_metrics(pw.radiation_pattern(source, WAVELENGTH, theta, phi, **how))


def test_a_large_uniform_square_has_the_beam_and_sidelobes_of_the_sinc():
    """Half power is at 0.4429 lambda/side, the first sidelobe (-13.26 dB) at 1.4303 lambda/side."""
    side = 20 * WAVELENGTH
    theta = np.radians(np.arange(-20, 20.05, 0.1))
    result = _metrics(pw.shapes.square(side), theta, obliquity="rayleigh-sommerfeld-2")
    for cut in result.cuts:
        half = math.asin(0.442946 / 20)
        assert cut.half_power_beamwidth == pytest.approx(2 * half, rel=INTERPOLATION)
        assert cut.sidelobe_levels == pytest.approx((-13.2615, -13.2615), abs=0.01)
        lobe = math.asin(1.430297 / 20)
        assert cut.sidelobe_angles == pytest.approx((-lobe, lobe), rel=INTERPOLATION)
    assert result.theta == pytest.approx(0.0, abs=1e-9)
    assert result.phi == 0.0


def test_half_meridians_are_joined_to_the_cuts_of_theta_of_both_signs():
    field = pw.steering((math.sin(0.3), 0.0, math.cos(0.3)), WAVELENGTH)
    source = pw.shapes.square(8 * WAVELENGTH).with_illumination(field)
    theta, phi = np.radians(np.arange(0, 91)), np.radians(np.arange(0, 360, 10))
    whole, cuts = _metrics(source, theta, phi), _metrics(source)
    assert (whole.theta, whole.phi) == pytest.approx((cuts.theta, 0.0), abs=1e-3)
    assert len(whole.cuts) == 18
    one, other = whole.cuts[0], cuts.cuts[0]
    step = 1e-2  # degrees, in a beam of six degrees
    assert one.half_power_beamwidth == pytest.approx(other.half_power_beamwidth, rel=step)
    assert one.sidelobe_levels == pytest.approx(other.sidelobe_levels, abs=0.1)


# Error in dB for a beam of 12 degrees whose direction is 0.6 degrees from a sample.
BETWEEN_SAMPLES = 0.05


def _steered(theta, phi):
    """Return a steered array of 8 x 8 patches at half a wavelength."""
    places = pw.arrays.grid_positions(8, 8, PITCH, PITCH)
    direction = [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]
    weights = pw.arrays.steering_weights(places, direction, WAVELENGTH)
    return pw.phased_array(pw.shapes.square(SIDE), places, weights)


@pytest.mark.parametrize(
    ("azimuth", "obliquity"), [(30.0, "rayleigh-sommerfeld-1"), (200.0, "rayleigh-sommerfeld-2")]
)
def test_a_beam_beside_the_cuts_has_its_own_directivity_and_direction(azimuth, obliquity):
    source = _steered(math.radians(45), math.radians(azimuth))
    about = np.radians(azimuth + np.arange(-3, 3.01, 0.1))
    dense = pw.radiation_pattern(
        source, WAVELENGTH, np.radians(np.arange(40, 50, 0.1)), about, obliquity=obliquity
    )
    levels = dense["directivity"].values
    polar, around = np.unravel_index(levels.argmax(), levels.shape)
    with pytest.warns(PolywignerWarning, match="no cut of the pattern passes through the beam"):
        result = _metrics(source, obliquity=obliquity)
    assert result.directivity == pytest.approx(levels.max(), abs=BETWEEN_SAMPLES / 10)
    assert result.directivity >= levels.max()
    assert result.theta == pytest.approx(dense["theta"].values[polar], abs=math.radians(0.1))
    assert result.phi == pytest.approx(about[around], abs=math.radians(0.1))
    assert max(cut.directivity for cut in result.cuts) < levels.max() - 5


def test_gain_and_eirp_are_those_of_the_beam_and_not_of_the_cuts():
    """EIRP is 4 pi times the largest radiant intensity."""
    source = _steered(math.radians(45), math.radians(30))
    pattern = pw.radiation_pattern(source, WAVELENGTH, *CUTS)
    with pytest.warns(PolywignerWarning, match="no cut of the pattern passes through the beam"):
        result = pw.beam_metrics(pattern, power=2.0, efficiency=0.5)
    assert result.radiated_power == 1.0 and "EIRP" in str(result) and "dBm" in str(result)
    around = np.radians(np.arange(40, 46, 0.02)), np.radians([30.0])
    dense = pw.radiation_pattern(source, WAVELENGTH, *around)
    intensity = float((np.abs(dense["field"].values) ** 2).max())
    intensity /= pw.radiated_power(source, WAVELENGTH)  # normalises to 1 W
    assert result.gain == pytest.approx(10 * math.log10(2 * math.pi * intensity), abs=1e-4)
    assert result.eirp == pytest.approx(4 * math.pi * intensity, rel=1e-5)
    share = pw.radiated_power(source, WAVELENGTH) / (64 * SIDE**2)
    assert result.radiated_fraction == pytest.approx(share, rel=1e-9)


def test_of_equal_beams_the_first_is_named_and_a_plane_of_nulls_has_no_numbers():
    pair = pw.phased_array(
        pw.shapes.square(1.5e-3), [(-2e-3, 0.0), (2e-3, 0.0)], [1, -1]
    )  # two beams, towards +x and -x
    result = _metrics(pair, *CUTS)
    assert result.phi == pytest.approx(0.0, abs=1e-6)
    assert result.theta == pytest.approx(abs(result.cuts[0].theta), abs=1e-3)
    assert result.cuts[1].directivity == -math.inf
    assert math.isnan(result.cuts[1].half_power_beamwidth)
    assert "nothing is radiated" in str(result)


def test_what_the_cut_does_not_reach_is_not_a_number():
    theta = np.radians(np.arange(-3, 3.5, 0.5))
    result = _metrics(pw.shapes.square(10e-3), theta)
    assert math.isnan(result.cuts[0].half_power_beamwidth)
    assert all(map(math.isnan, result.cuts[0].sidelobe_levels))
    assert "not in range" in str(result)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda p: pw.beam_metrics(pw.shapes.square(1.0)), "radiation_pattern"),
        (lambda p: pw.beam_metrics(p, efficiency=1.5), "efficiency"),
        (lambda p: pw.beam_metrics(p.isel(theta=slice(0, 2))), "three"),
        (lambda p: pw.beam_metrics(p.where(p.theta > 0.2)), "NaN"),
        # Degrees instead of radians select no angle.
        (lambda p: pw.beam_metrics(p.sel(theta=slice(10, 30))), "no angles"),
        (lambda p: pw.write_pattern(p.isel(phi=slice(0, 0)), "a.cut"), "no angles"),
        (lambda p: draw_pattern(p, metrics=True), "metrics"),  # type: ignore[arg-type]
        (lambda p: pw.write_pattern(p, None), "path"),  # type: ignore[arg-type]
        (lambda p: draw_pattern(p, cuts="x"), "cuts"),  # type: ignore[arg-type]
        (lambda p: draw_pattern(p, cuts=[]), "cuts"),
        (lambda p: draw_hemispheres(p), "draw_pattern"),
        (lambda p: draw_pattern(p, panels=["map"]), "panels"),
        (lambda p: draw_pattern(p, panels=["uv"]), "phi"),
    ],
)
def test_bad_arguments_are_refused(made, words):
    pattern = pw.radiation_pattern(pw.shapes.square(10e-3), WAVELENGTH, *CUTS)
    with pytest.raises(ArgumentError, match=words):
        made(pattern)


def test_a_data_sheet_has_cuts_a_polar_plot_a_map_and_a_table(tmp_path):
    theta, phi = np.radians(np.arange(0, 91, 3)), np.radians(np.arange(0, 360, 15))
    pattern = pw.radiation_pattern(pw.shapes.square(10e-3), WAVELENGTH, theta, phi)
    figure = draw_pattern(pattern, title="square")
    assert [axes.name for axes in figure.axes[:2]] == ["rectilinear", "polar"]
    shown = figure.axes[0].lines[0].get_xydata()
    assert shown[:, 0].min() == pytest.approx(-90.0) and shown[:, 0].max() == pytest.approx(90.0)
    assert np.nanmax(shown[:, 1]) == pytest.approx(pattern.attrs["largest_directivity"])
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert any("directivity" in text for text in texts)
    figure.savefig(tmp_path / "sheet.png")


def _summed(places, weights, directions):
    """Sum the fields of square elements with the obliquity cos^2, and return |E|^2."""
    s = directions / WAVELENGTH
    factor = np.exp(-2j * np.pi * s[..., :2] @ places.T) @ weights
    element = np.sinc(SIDE * s[..., 0]) * np.sinc(SIDE * s[..., 1]) * directions[..., 2]
    return np.square(np.abs(factor * element))


def _reference(places, weights, beam, tangent):
    """Return the width, the first nulls, and the first and peak sidelobes from 8001 directions."""
    angle = np.linspace(-np.pi, np.pi, 8001)
    line = np.cos(angle)[:, None] * beam + np.sin(angle)[:, None] * tangent
    ahead = line[:, 2] > 0
    angle, line = angle[ahead], line[ahead]
    level = 10 * np.log10(_summed(places, weights, line) + 1e-300)
    peak = int(np.abs(angle).argmin())
    level -= level[peak]
    halves, nulls, lobes, peaks = [], [], [], []
    for side in (slice(peak, None, -1), slice(peak, None)):
        along, at = level[side], angle[side]
        flank = int(np.flatnonzero(along < -10 * math.log10(2))[0])
        null = flank + int(np.flatnonzero(np.diff(along[flank:]) > 0)[0])
        first = null + int(np.flatnonzero(np.diff(along[null:]) < 0)[0])
        largest = null + int(along[null:].argmax())
        half = slice(flank, flank - 2, -1)
        halves.append(np.interp(-10 * math.log10(2), along[half], at[half]))
        nulls.append(at[null])
        lobes.append((along[first], at[first]))
        peaks.append((along[largest], at[largest]))
    return halves[1] - halves[0], nulls, lobes, max(peaks)


def _beam_of(places, weights, near):
    from scipy.optimize import minimize

    def loss(uv):
        return -_summed(places, weights, np.array([*uv, math.sqrt(1 - uv @ uv)]))

    u, v = minimize(loss, near[:2], method="Nelder-Mead", options={"xatol": 1e-9}).x
    return np.array([u, v, math.sqrt(1 - u * u - v * v)])


@pytest.mark.parametrize("azimuth", [0.0, 250.0])
def test_the_cuts_of_a_steered_array_are_great_circles_through_its_beam(azimuth):
    """12 x 10 elements with two failed elements have their highest sidelobes far from the beam."""
    places = pw.arrays.grid_positions(12, 10, PITCH)
    theta, phi = math.radians(25), math.radians(azimuth)
    towards = np.array(
        [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]
    )
    weights = pw.arrays.window_weights((12, 10), "taylor", sll=38)
    weights = weights * pw.arrays.steering_weights(places, towards, WAVELENGTH)
    weights[[40, 101]] = 0.0
    array = pw.phased_array(pw.shapes.square(SIDE), places, weights)
    beam = _beam_of(places, weights, towards)
    polar = math.acos(beam[2])
    outwards = np.array([*(beam[:2] * beam[2] / math.sin(polar)), -math.sin(polar)])
    exact = pw.beam_cuts(array, WAVELENGTH)
    angles = np.radians(np.arange(0, 90.5, 1)), np.radians(np.arange(0, 360, 2))
    pattern = pw.radiation_pattern(array, WAVELENGTH, *angles)
    for metrics, rough in ((pw.beam_metrics(exact), 1), (pw.beam_metrics(pattern), 4)):
        assert metrics.theta == pytest.approx(polar, abs=1e-5)
        assert metrics.theta < theta - math.radians(0.1)  # due to the obliquity
        assert [cut.kind for cut in metrics.beam_cuts] == ["meridian", "across"]
        for cut, tangent in zip(
            metrics.beam_cuts, (outwards, np.cross(beam, outwards)), strict=True
        ):
            width, nulls, lobes, peak = _reference(places, weights, beam, tangent)
            assert cut.theta == pytest.approx(0.0, abs=1e-4)
            assert cut.directivity == pytest.approx(metrics.directivity, abs=1e-3)
            assert cut.half_power_beamwidth == pytest.approx(width, rel=3e-3)
            assert cut.first_nulls == pytest.approx(nulls, abs=rough * 2e-3)
            levels, places_of = zip(*lobes, strict=True)
            assert cut.sidelobe_levels == pytest.approx(levels, abs=rough * 0.02)
            assert cut.sidelobe_angles == pytest.approx(places_of, abs=rough * 1e-3)
            assert cut.peak_sidelobe_level == pytest.approx(peak[0], abs=rough * 0.02)
            assert cut.peak_sidelobe_level >= max(cut.sidelobe_levels) - 1e-9


def test_the_direction_of_steering_is_told_when_the_beam_is_off_it():
    """The steering comes from phases of weights, and from a plane wave on an aperture."""
    angle = math.radians(25)
    wave = pw.steering((math.sin(angle), 0.0, math.cos(angle)), WAVELENGTH)
    square = pw.shapes.square(8 * WAVELENGTH)
    sources = {0: square.with_illumination(wave), 130: _steered(angle, math.radians(130))}
    for azimuth, source in sources.items():
        metrics = pw.beam_metrics(pw.beam_cuts(source, WAVELENGTH))
        assert metrics.steering == pytest.approx((angle, math.radians(azimuth)), abs=1e-6)
        squint = math.degrees(angle - metrics.theta)
        shown = f"steered to        theta 25.00°, phi {azimuth:.2f}°: {squint:.2f}° off"
        assert squint > 0.01 and shown in str(metrics)
    assert "steered to" not in str(pw.beam_metrics(pw.beam_cuts(square, WAVELENGTH)))
    random = np.exp(2j * np.pi * np.random.default_rng(1).random(64))
    places = pw.arrays.grid_positions(8, 8, PITCH)
    pattern = pw.beam_cuts(pw.phased_array(pw.shapes.square(SIDE), places, random), WAVELENGTH)
    assert pw.beam_metrics(pattern).steering is None


def test_a_beam_next_to_the_normal_is_cut_along_the_axes():
    tilt, phi = math.radians(0.3), math.radians(37)
    source = _steered(tilt, phi)
    straight = pw.beam_metrics(pw.beam_cuts(_steered(0.0, 0.0), WAVELENGTH))
    metrics = pw.beam_metrics(pw.beam_cuts(source, WAVELENGTH))
    assert [cut.kind for cut in metrics.beam_cuts] == ["x", "y"]
    for cut, other in zip(metrics.beam_cuts, straight.beam_cuts, strict=True):
        assert cut.half_power_beamwidth == pytest.approx(other.half_power_beamwidth, rel=1e-3)
        assert cut.peak_sidelobe_level == pytest.approx(other.peak_sidelobe_level, abs=0.5)


def test_a_grating_lobe_on_the_horizon_is_the_peak_sidelobe():
    """At 0.95 wavelengths and 10 degrees, a grating lobe has sin(theta) = 0.17 - 1/0.95."""
    places = pw.arrays.grid_positions(12, 1, 0.95 * WAVELENGTH)
    weights = pw.arrays.steering_weights(places, (math.sin(math.radians(10)), 0.0), WAVELENGTH)
    array = pw.phased_array(pw.shapes.rectangle(0.2 * WAVELENGTH, WAVELENGTH), places, weights)
    how = {"obliquity": "rayleigh-sommerfeld-2"}
    cut = pw.beam_metrics(pw.beam_cuts(array, WAVELENGTH, **how)).beam_cuts[0]
    lobe = math.asin(math.sin(math.radians(10)) - 1 / 0.95)
    assert cut.peak_sidelobe_level > -2
    assert cut.peak_sidelobe_angle == pytest.approx(lobe - math.radians(10), abs=0.03)


def _drawn(figure):
    """Return the peak and the half-power width of each drawn line."""
    result = []
    for line in figure.axes[0].lines[:2]:
        angle, level = line.get_xydata().T
        peak = int(level.argmax())
        low, high = (
            np.interp(10 * math.log10(2), level[peak] - level[side], angle[side])
            for side in (slice(peak, max(peak - 200, 0), -1), slice(peak, peak + 200))
        )
        result.append((level[peak], high - low))
    return result


def test_the_table_has_the_numbers_of_the_lines_in_the_picture():
    source = _steered(0.6, math.radians(40))
    angles = np.radians(np.arange(0, 90.5, 1)), np.radians(np.arange(0, 360, 2))
    pattern = pw.radiation_pattern(source, WAVELENGTH, *angles)
    fine = np.radians(np.arange(-90, 90.25, 0.25))
    planes = pw.radiation_pattern(source, WAVELENGTH, fine, [0.0, math.pi / 2])
    circles = pw.beam_cuts(source, WAVELENGTH)
    shown_cuts = (None, "beam", [circles], "principal", [planes])
    for k, cuts in enumerate(shown_cuts):
        through = k < 3
        figure = draw_pattern(pattern, panels=["cuts", "table"], cuts=cuts)
        axes, table = figure.axes[0], figure.axes[1].texts[0].get_text()
        assert ("through the beam" in axes.get_title()) == through
        assert ("from the beam" in axes.get_xlabel()) == through
        assert ("across it" in table) == through and ("phi 90.00°" in table) != through
        widths = [float(w) for w in re.findall(r"half-power width ([\d.]+)°", table)]
        peaks = [float(p) for p in re.findall(r"peak (-?[\d.]+) dBi", table.replace("\u2212", "-"))]
        assert len(widths) == len(peaks) == 2
        if through:
            for (level, width), peak, shown in zip(_drawn(figure), peaks, widths, strict=True):
                assert peak == pytest.approx(level, abs=0.02)
                assert shown == pytest.approx(width, rel=1e-2)
        else:
            assert max(peaks) < pattern.attrs["peak_directivity"] - 10
    with pytest.raises(ArgumentError, match="both"):
        draw_pattern(pattern, cuts=[circles, planes])
    with pytest.raises(ArgumentError, match="beam_cuts"):
        draw_pattern(planes, cuts="beam")


def test_cuts_of_a_polarised_source_have_a_cross_polar_part(tmp_path):
    """A right-handed Huygens source is circularly polarised on its axis only."""
    source = _steered(0.6, math.radians(40))
    cuts = pw.beam_cuts(source, WAVELENGTH, polarisation="right")
    angles = np.radians(np.arange(0, 90.5, 1)), np.radians(np.arange(0, 360, 2))
    pattern = pw.radiation_pattern(source, WAVELENGTH, *angles, polarisation="y")
    for given in (None, [cuts]):
        figure = draw_pattern(pattern, panels="cuts", cuts=given)
        assert any("from the beam" in axes.get_xlabel() for axes in figure.axes)
    metrics = pw.beam_metrics(cuts)
    assert metrics.axial_ratio is not None and len(metrics.beam_cuts) == 2


def test_a_dipole_in_a_file_is_cut_around_the_sphere(tmp_path):
    """A dipole has 1.5 = 1.761 dBi and a half-power width of 90 degrees in both cuts."""
    lines = ["Theta [deg],Phi [deg],re(rETheta) [V],im(rETheta) [V],re(rEPhi) [V],im(rEPhi) [V]"]
    for phi in range(0, 360, 10):
        for theta in range(0, 181, 5):
            # The dipole is along x.
            t, p = math.radians(theta), math.radians(phi)
            lines.append(f"{theta},{phi},{math.cos(t) * math.cos(p):.9g},0,{-math.sin(p):.9g},0")
    (tmp_path / "dipole.csv").write_text("\n".join(lines))
    metrics = pw.beam_metrics(pw.read_pattern(tmp_path / "dipole.csv"))
    assert metrics.directivity == pytest.approx(10 * math.log10(1.5), abs=1e-6)
    along, across = metrics.beam_cuts
    assert along.half_power_beamwidth == pytest.approx(math.pi / 2, rel=1e-3)
    assert math.isnan(across.half_power_beamwidth)  # constant in all directions


@pytest.mark.usefixtures("unrendered_figures")
def test_the_command_line_prints_the_cuts_that_are_drawn_and_eirp_of_a_power(tmp_path, capsys):
    pw.write_source(_steered(0.6, math.radians(40)), tmp_path / "array.toml")
    call = ["pattern", str(tmp_path / "array.toml"), "--frequency", "94 GHz", "--step", "6 deg"]
    call += ["--out", f"{tmp_path}/"]
    for options in ([], ["--power", "10 dBm"]):
        assert main([*call, *options]) == 0
        shown = capsys.readouterr().out
        names = re.findall(r"^cut \S+ \S+", shown, re.MULTILINE)
        assert names == ["cut phi 40.00°", "cut across it"]
        assert "steered to" in shown and "peak sidelobe" in shown
        assert ("EIRP" in shown) == bool(options)


def test_modes_with_nulls_on_samples_have_numbers():
    """A parabola through a null would overshoot by tens of dB."""
    theta, phi = np.radians(np.arange(0, 180.5, 0.5)), np.radians(np.arange(0, 360, 10))
    mode = pw.te_mode(14e-3, 11e-3, 2, 0)
    source = pw.shapes.rectangle(14e-3, 11e-3).with_illumination(mode)
    pattern = pw.radiation_pattern(source, WAVELENGTH, theta, phi)
    result = pw.beam_metrics(pattern)
    assert result.directivity == pytest.approx(pattern.attrs["largest_directivity"], abs=0.05)
    for cut in result.cuts:
        assert all(math.isnan(level) or level < 0.1 for level in cut.sidelobe_levels)


def test_a_lobe_that_runs_into_the_horizon_is_no_sidelobe():
    square = pw.shapes.square(1.4 * WAVELENGTH)
    theta = np.radians(np.arange(-180, 180.5, 0.5))
    for obliquity in ("rayleigh-sommerfeld-2", "kirchhoff", "rayleigh-sommerfeld-1"):
        for cut in _metrics(square, theta, obliquity=obliquity).cuts:
            assert all(math.isnan(level) or level < 0 for level in cut.sidelobe_levels)


def test_the_first_sidelobe_of_a_rippled_beam_is_the_first_beyond_half_power():
    """The beam has a bump of -2.3 dB at 10 degrees, half power at 13 and a lobe at 24 degrees."""
    mouth = 5.5 * WAVELENGTH
    horn = pw.horns.e_plane(0.7 * WAVELENGTH, mouth, mouth**2 / (4 * WAVELENGTH), WAVELENGTH)
    theta = np.radians(np.arange(0, 60, 0.01))
    levels = pw.radiation_pattern(horn, WAVELENGTH, theta, [math.pi / 2])["directivity"].values
    fall = 10 * math.log10(2)
    flank = int(np.flatnonzero(levels[:, 0] < levels.max() - fall)[0])
    null = flank + int(np.flatnonzero(np.diff(levels[flank:, 0]) > 0)[0])
    lobe = null + int(levels[null:, 0].argmax())
    cut = _metrics(horn).cuts[1]
    assert cut.half_power_beamwidth / 2 == pytest.approx(theta[flank], rel=1e-2)
    assert cut.sidelobe_angles == pytest.approx((-theta[lobe], theta[lobe]), rel=1e-2)
    expected = levels[lobe, 0] - levels.max()
    assert cut.sidelobe_levels == pytest.approx((expected, expected), abs=0.01)


def test_few_samples_in_a_beam_are_warned_of():
    theta = np.radians(np.arange(-90, 91, 5))
    with pytest.warns(PolywignerWarning, match="coarse for a half-power beamwidth"):
        _metrics(pw.shapes.square(10e-3), theta)


def test_axes_in_the_other_order_are_read_as_well():
    pattern = pw.radiation_pattern(pw.shapes.rectangle(9e-3, 12e-3), WAVELENGTH, *CUTS)
    assert pw.beam_metrics(pattern.transpose()) == pw.beam_metrics(pattern)
    one, other = (
        draw_pattern(result, panels=["cuts"]).axes[0].lines[0].get_xydata()
        for result in (pattern, pattern.transpose())
    )
    np.testing.assert_array_equal(one, other)
