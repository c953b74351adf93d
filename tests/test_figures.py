"""Levels in dB, rendered scenes and figures of transforms."""

import io

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError
from polywigner.figures import (
    draw_scene,
    draw_transforms,
    image_peak,
    level_db,
    transform_slices,
)

ROUNDING_DB = 1e-12  # log10 of exact powers of ten, float64
ROUNDING = 1e-12  # kernel error relative to the area


def test_ten_times_less_radiance_is_ten_decibels_less_down_to_the_floor():
    levels = level_db([500.0, 5.0, 0.5, 0.05], reference=5.0, floor_db=-40)
    np.testing.assert_allclose(levels, [20.0, 0.0, -10.0, -20.0], atol=ROUNDING_DB)
    with np.errstate(all="raise"):  # log10 of these values would raise
        levels = level_db([-3.0, 0.0, 1e-9, -0.0, 5e-324], reference=1.0, floor_db=-40)
    assert (levels == -40.0).all()


def test_a_floor_that_is_not_below_the_peak_is_refused():
    with pytest.raises(ArgumentError, match="floor_db to be a level below 0 dB"):
        level_db([1.0], 1.0, 3.0)


def test_single_outliers_do_not_move_the_peak_of_a_picture():
    y, x = np.mgrid[-20:21, -20:21]
    beam = np.exp(-(x**2 + y**2) / 200.0)
    noisy = beam.copy()
    noisy[3, 4] = 1e6
    noisy[30, 8] = -1e6
    noisy[0, 0] = 1e6
    peak = image_peak(beam)
    assert peak is not None
    assert image_peak(noisy) == peak
    # The median of the 3 x 3 neighbourhood is the value one pixel from the maximum.
    assert np.exp(-2 / 200.0) <= peak <= 1.0


def test_a_picture_without_positive_pixels_has_no_peak_and_lies_on_the_floor():
    dark = -np.ones((5, 7))
    assert image_peak(dark) is None
    assert (level_db(dark, None, -30) == -30).all()


def test_the_scene_picture_states_reference_unit_and_floor():
    figure = draw_scene(np.ones((4, 6)), reference=2.5e-3, floor_db=-35)
    figure.savefig(io.BytesIO(), format="png")
    label = figure.axes[1].get_ylabel()
    for part in ("dB", "0.0025 W/(m² sr)", "floor −35 dB"):
        assert part in label
    (picture,) = figure.axes[0].images
    assert picture.get_clim() == (-35.0, 0.0)
    assert picture.get_array().shape == (4, 6) and figure.axes[0].get_aspect() == 1.0
    assert picture.colorbar.extend == "max"  # 1 is above the reference
    (dark,) = draw_scene(np.ones((4, 6)), reference=2.0, floor_db=-35).axes[0].images
    assert dark.colorbar.extend == "neither"


def test_slices_agree_with_the_transforms_at_single_points():
    chevron = pw.shapes.chevron(10e-3, 12e-3, 3e-3)
    slices = transform_slices(chevron, x=(1e-3, 0.5e-3), xi=(0.5e-3, 1e-3), samples=9)
    i, j = 6, 2
    nu = np.array([slices.frequency[i], slices.frequency[j]])
    expected = (
        pw.fourier(chevron, nu),
        pw.wigner(chevron, np.array(slices.x), nu),
        pw.ambiguity(chevron, nu, np.array(slices.xi)),
    )
    got = (slices.fourier[j, i], slices.wigner[j, i], slices.ambiguity[j, i])
    np.testing.assert_allclose(got, expected, rtol=0, atol=ROUNDING * chevron.area)


def test_the_default_position_and_lag_lie_where_w_and_a_do_not_vanish():
    far_apart = pw.Aperture([[(0, 0), (1, 0), (1, 5), (0, 5)], [(9, 0), (9.5, 0), (9.5, 5)]])
    for aperture in (pw.shapes.chevron(10.0, 12.0, 1.0), far_apart, pw.shapes.disc(1.0, 7)):
        slices = transform_slices(aperture, samples=3)
        assert pw.position_marginal(aperture, np.array(slices.x)) > 0
        assert pw.lag_marginal(aperture, np.array(slices.xi)) > aperture.area / 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x": (1.0, 0.0)}, "outside the automean"),
        ({"xi": (1.0, 0.0)}, "overlap its copy shifted"),
        ({"xi": (1.0, 0.0, 0.0)}, "two.* coordinates"),
        ({"samples": 10**5}, "from 2 to 4096"),
    ],
)
def test_slices_that_would_be_empty_are_refused(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        transform_slices(pw.shapes.square(10e-3), **arguments)


def test_every_axis_and_colour_bar_of_the_transforms_is_labelled_with_its_unit():
    slices = transform_slices(pw.shapes.triangle(10e-3, 8e-3), wavelength=3e-3, samples=5)
    assert slices.frequency[-1] == -slices.frequency[0] == 1 / 3e-3
    figure = draw_transforms(slices, floor_db=-30, title="triangle")
    panels = [axes for axes in figure.axes if axes.get_xlabel()]
    bars = [axes for axes in figure.axes if not axes.get_xlabel()]
    assert len(panels) == 6
    assert len(bars) == 4
    assert all("mm" in axes.get_xlabel() and "mm" in axes.get_ylabel() for axes in panels)
    assert [axes.get_title(loc="left") for axes in panels] == [f"({c})" for c in "abcdef"]
    labels = " ".join(axes.get_ylabel() for axes in bars)
    assert "floor −30 dB" in labels
    assert labels.count("mm²") == 3
    assert "λ = 3 mm" in figure.get_suptitle()
