"""What data sheets say of a pattern: against closed forms, and against the pattern itself."""

import math

import numpy as np
import pytest

import polywigner as pw
from polywigner.cli import main
from polywigner.errors import ArgumentError, PolywignerWarning
from polywigner.figures import draw_hemispheres, draw_pattern

WAVELENGTH = 299792458 / 94e9
CUTS = np.radians(np.arange(-90, 90.5, 0.5)), np.radians([0.0, 90.0])
# Of a beamwidth with some ten samples in it or more: a parabola's error.
INTERPOLATION = 1e-3


def _metrics(source, theta=CUTS[0], phi=CUTS[1], **how):
    return pw.beam_metrics(pw.radiation_pattern(source, WAVELENGTH, theta, phi, **how))


def test_a_large_uniform_square_has_the_beam_and_sidelobes_of_the_sinc():
    """Half power at 0.4429 lambda/side, first sidelobe -13.26 dB at 1.4303 lambda/side; obliquity 1
    as of RS-II leaves the sinc as it is."""
    side = 20 * WAVELENGTH
    theta = np.radians(np.arange(-20, 20.05, 0.1))
    found = _metrics(pw.shapes.square(side), theta, obliquity="rayleigh-sommerfeld-2")
    for cut in found.cuts:
        half = math.asin(0.442946 / 20)
        assert cut.half_power_beamwidth == pytest.approx(2 * half, rel=INTERPOLATION)
        assert cut.sidelobe_levels == pytest.approx((-13.2615, -13.2615), abs=0.01)
        lobe = math.asin(1.430297 / 20)
        assert cut.sidelobe_angles == pytest.approx((-lobe, lobe), rel=INTERPOLATION)
    assert found.theta == pytest.approx(0.0, abs=1e-9)
    assert found.phi == 0.0


def test_a_steered_beam_is_found_where_the_pattern_is_largest():
    """A hemisphere of half meridians: joined, they give the same cut as theta of both signs."""
    field = pw.steering((math.sin(0.3), 0.0, math.cos(0.3)), WAVELENGTH)
    source = pw.shapes.square(8 * WAVELENGTH).with_illumination(field)
    theta, phi = np.radians(np.arange(0, 91)), np.radians(np.arange(0, 360, 10))
    whole, cuts = _metrics(source, theta, phi), _metrics(source)
    fine = np.linspace(0.2, 0.4, 20001)
    exact = pw.radiation_pattern(source, WAVELENGTH, fine, 0.0)["directivity"].values[:, 0]
    assert whole.theta == pytest.approx(fine[exact.argmax()], abs=1e-3)
    assert whole.phi == pytest.approx(0.0, abs=1e-9)
    assert whole.directivity == pytest.approx(exact.max(), abs=2e-3)
    assert len(whole.cuts) == 18
    one, other = whole.cuts[0], cuts.cuts[0]
    step = 1e-2  # degrees in a beam of six
    assert one.half_power_beamwidth == pytest.approx(other.half_power_beamwidth, rel=step)
    assert one.sidelobe_levels == pytest.approx(other.sidelobe_levels, abs=0.1)


# A beam 0.6 degrees from a cut or a sample: well below this, in dB, of one of 12 degrees.
BETWEEN_SAMPLES = 0.05


def _steered(theta, phi):
    """An array of 8 x 8 patches half a wavelength apart."""
    places = pw.arrays.grid_positions(8, 8, WAVELENGTH / 2, WAVELENGTH / 2)
    direction = [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]
    weights = pw.arrays.steering_weights(places, direction, WAVELENGTH)
    return pw.phased_array(pw.shapes.square(0.49 * WAVELENGTH), places, weights)


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
    with pytest.warns(PolywignerWarning, match="miss the beam"):
        found = _metrics(source, obliquity=obliquity)
    assert found.directivity == pytest.approx(levels.max(), abs=BETWEEN_SAMPLES / 10)
    assert found.directivity >= levels.max()
    assert found.theta == pytest.approx(dense["theta"].values[polar], abs=math.radians(0.1))
    assert found.phi == pytest.approx(about[around], abs=math.radians(0.1))
    assert max(cut.directivity for cut in found.cuts) < levels.max() - 5


def test_gain_and_eirp_are_those_of_the_beam_and_not_of_the_cuts():
    source = _steered(math.radians(45), math.radians(30))
    pattern = pw.radiation_pattern(source, WAVELENGTH, *CUTS)
    with pytest.warns(PolywignerWarning, match="miss the beam"):
        found = pw.beam_metrics(pattern, power=2.0, efficiency=0.5)
    assert found.radiated_power == 1.0 and "EIRP" in str(found) and "dBm" in str(found)
    around = pw.radiation_pattern(
        source, WAVELENGTH, np.radians(np.arange(0, 91)), np.radians([0.0, 30.0])
    )
    beam = pw.beam_metrics(around)
    assert found.gain == pytest.approx(beam.directivity - 10 * math.log10(2), abs=1e-9)
    assert found.eirp == pytest.approx(10 ** (beam.directivity / 10), rel=1e-9)


def test_of_equal_beams_the_first_around_the_axis_is_named():
    pair = pw.phased_array(
        pw.shapes.square(1.5e-3), [(-2e-3, 0.0), (2e-3, 0.0)], [1, -1]
    )  # two beams, towards +x and -x
    found = _metrics(pair, *CUTS)
    assert found.phi == pytest.approx(0.0, abs=1e-6)
    assert found.theta == pytest.approx(abs(found.cuts[0].theta), abs=1e-3)


def test_eirp_is_the_power_that_an_isotropic_source_would_need():
    """4 pi times the largest radiant intensity."""
    square = pw.shapes.square(10e-3)
    pattern = pw.radiation_pattern(square, WAVELENGTH, *CUTS)
    radiated = pattern.attrs["radiated_power"]
    found = pw.beam_metrics(pattern, power=radiated)
    intensity = float((np.abs(pattern["field"].values) ** 2).max())
    assert found.eirp == pytest.approx(4 * math.pi * intensity, rel=1e-9)
    share = pw.radiated_power(square, WAVELENGTH) / square.area
    assert found.front_share == pytest.approx(share, rel=1e-12)


@pytest.mark.parametrize("power", [pytest.param(None, marks=pytest.mark.slow), "10 dBm"])
def test_the_command_tells_eirp_of_a_power_alone(power, tmp_path, capsys):
    (tmp_path / "a.wkt").write_text("POLYGON ((0 0, 0.01 0, 0.01 0.01, 0 0.01, 0 0))")
    given = [] if power is None else ["--power", power]
    options = ["--frequency", "94 GHz", "--step", "3 deg", "--out", str(tmp_path / "a"), *given]
    assert main(["pattern", str(tmp_path / "a.wkt"), "--unit", "m", *options]) == 0
    shown = capsys.readouterr().out
    assert ("EIRP" in shown) == (power is not None)
    assert "directivity" in shown


def test_what_the_cut_does_not_reach_is_not_a_number():
    theta = np.radians(np.arange(-3, 3.5, 0.5))
    found = _metrics(pw.shapes.square(10e-3), theta)
    assert math.isnan(found.cuts[0].half_power_beamwidth)
    assert all(map(math.isnan, found.cuts[0].sidelobe_levels))
    assert "not in range" in str(found)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda p: pw.beam_metrics(pw.shapes.square(1.0)), "radiation_pattern"),
        (lambda p: pw.beam_metrics(p, efficiency=1.5), "efficiency"),
        (lambda p: pw.beam_metrics(p.isel(theta=slice(0, 2))), "three"),
        (lambda p: pw.beam_metrics(p.where(p.theta > 0.2)), "not a number"),
        (lambda p: pw.beam_metrics(p.isel(phi=slice(0, 0))), "no angles"),
        (lambda p: pw.write_pattern(p.isel(phi=slice(0, 0)), "a.cut"), "no angles"),
        (lambda p: pw.write_pattern(p, None), "path"),  # type: ignore[arg-type]
        (lambda p: draw_pattern(p, cuts="x"), "cuts"),  # type: ignore[arg-type]
        (lambda p: draw_pattern(p, cuts=[]), "cuts"),
        (lambda p: draw_hemispheres(p), "draw_pattern"),
        (lambda p: draw_pattern(p, panels=["map"]), "panels"),
        (lambda p: draw_pattern(p, panels=["uv"]), "phi"),
        (lambda p: draw_pattern(p, panels=[]), "one panel"),
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
    assert shown[:, 0].min() == -90.0 and shown[:, 0].max() == 90.0
    assert np.nanmax(shown[:, 1]) == pytest.approx(pattern.attrs["largest_directivity"])
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert any("directivity" in text for text in texts)
    figure.savefig(tmp_path / "sheet.png")


def test_cuts_go_through_a_beam_off_the_principal_planes() -> None:
    source = _steered(0.6, math.radians(40))
    angles = np.radians(np.arange(0, 90.5, 1)), np.radians(np.arange(0, 360, 2))
    pattern = pw.radiation_pattern(source, WAVELENGTH, *angles)
    beam, phi = pattern.attrs["peak_directivity"], pattern.attrs["peak_phi"]
    fine = np.radians(np.arange(-90, 90.25, 0.25))
    along = pw.radiation_pattern(source, WAVELENGTH, fine, phi)
    cone = pw.radiation_pattern(source, WAVELENGTH, pattern.attrs["peak_theta"], phi + fine)
    for cuts in (None, "beam", [along, cone]):
        axes = draw_pattern(pattern, panels="cuts", cuts=cuts).axes[0]
        assert "through the beam" in axes.get_title() and "40" in axes.get_title()
        meridian, across = (line.get_xydata() for line in axes.lines[:2])
        assert meridian[:, 1].max() == pytest.approx(beam, abs=0.05)
        assert meridian[meridian[:, 1].argmax(), 0] == pytest.approx(33.5, abs=1)
        assert across[across[:, 1].argmax(), 0] == pytest.approx(0, abs=1)
        assert across[:, 1].max() == pytest.approx(beam, abs=0.05)
    axes = draw_pattern(pattern, panels="cuts", cuts="principal").axes[0]
    assert "principal planes" in axes.get_title()
    assert max(line.get_ydata().max() for line in axes.lines[:2]) < beam - 10


def test_the_command_line_draws_the_cuts_that_are_named(tmp_path, capsys):
    """Through a steered beam unless it is told otherwise."""
    pw.write_source(_steered(0.6, math.radians(40)), tmp_path / "array.toml")
    call = ["pattern", str(tmp_path / "array.toml"), "--frequency", "94 GHz", "--step", "3 deg"]
    call += ["--out", f"{tmp_path}/"]
    pictures = []
    for cuts in ([], ["--cuts", "principal"]):
        assert main([*call, *cuts]) == 0
        pictures.append((tmp_path / "array_pattern.png").read_bytes())
    assert pictures[0] != pictures[1]
    assert main([*call, "--cuts", "all"]) == 2
    assert "principal" in capsys.readouterr().err


def test_modes_with_nulls_on_samples_have_numbers():
    """A parabola beside a null would overshoot by tens of dB."""
    theta, phi = np.radians(np.arange(0, 180.5, 0.5)), np.radians(np.arange(0, 360, 10))
    mode = pw.te_mode(14e-3, 11e-3, 2, 0)
    source = pw.shapes.rectangle(14e-3, 11e-3).with_illumination(mode)
    pattern = pw.radiation_pattern(source, WAVELENGTH, theta, phi)
    found = pw.beam_metrics(pattern)
    assert found.directivity == pytest.approx(pattern.attrs["largest_directivity"], abs=0.05)
    for cut in found.cuts:
        assert all(math.isnan(level) or level < 0.1 for level in cut.sidelobe_levels)


def test_a_lobe_that_runs_into_the_horizon_is_no_sidelobe():
    square = pw.shapes.square(1.4 * WAVELENGTH)
    theta = np.radians(np.arange(-180, 180.5, 0.5))
    for obliquity in ("rayleigh-sommerfeld-2", "kirchhoff", "rayleigh-sommerfeld-1"):
        for cut in _metrics(square, theta, obliquity=obliquity).cuts:
            assert all(math.isnan(level) or level < 0 for level in cut.sidelobe_levels)


def test_the_first_sidelobe_of_a_rippled_beam_is_the_first_beyond_half_power():
    """Half a turn at the rim: a bump of -2.3 dB at 10 degrees, half power at 13, a lobe at 24."""
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


def test_a_plane_in_which_the_field_cancels_has_no_numbers():
    places = [(-2e-3, 0.0), (2e-3, 0.0)]
    pair = pw.phased_array(pw.shapes.square(1.5e-3), places, [1, -1])
    found = _metrics(pair)
    assert found.cuts[1].directivity == -math.inf
    assert math.isnan(found.cuts[1].half_power_beamwidth)
    assert "nothing is radiated" in str(found)


def test_few_samples_in_a_beam_are_warned_of():
    theta = np.radians(np.arange(-90, 91, 5))
    with pytest.warns(PolywignerWarning, match="coarse for a half-power width"):
        _metrics(pw.shapes.square(10e-3), theta)


def test_axes_in_the_other_order_are_read_as_well():
    pattern = pw.radiation_pattern(pw.shapes.rectangle(9e-3, 12e-3), WAVELENGTH, *CUTS)
    assert pw.beam_metrics(pattern.transpose()) == pw.beam_metrics(pattern)
    one, other = (
        draw_pattern(found, panels=["cuts"]).axes[0].lines[0].get_xydata()
        for found in (pattern, pattern.transpose())
    )
    np.testing.assert_array_equal(one, other)
