"""Labels, scales and views of figures."""

from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

import polywigner as pw
from polywigner.cli.sources import short_name
from polywigner.errors import ArgumentError
from polywigner.figures import draw_planes, draw_scene
from polywigner.figures.scene_plots import DirectArrival, draw_arrivals, draw_radar_map

WAVELENGTH = 3.19e-3


@pytest.mark.parametrize("shape", [(60, 600), (600, 60)])
def test_the_label_of_the_colour_bar_lies_within_the_figure(shape):
    figure = draw_scene(np.full(shape, 4.25e-8), 4.25e-8, -40.0, title="corridor, 77 GHz")
    figure.draw_without_rendering()
    frame, text = figure.bbox, figure.axes[-1].yaxis.label.get_window_extent()
    assert frame.x0 <= text.x0 and text.x1 <= frame.x1
    assert frame.y0 <= text.y0 and text.y1 <= frame.y1


def test_a_file_of_the_name_scene_is_named_after_its_folder(tmp_path):
    assert short_name(str(tmp_path / "street" / "scene.xml")) == "street"
    assert short_name(str(tmp_path / "street" / "link.xml")) == "link.xml"


def arrivals(power, direct=(), **options):
    figure = draw_arrivals(power, direct, -40.0, **options)
    figure.draw_without_rendering()
    return figure.axes[0]


@pytest.mark.parametrize("direct", [-40.0, [(0.1, 0.2)]])
def test_direct_paths_of_another_type_are_refused(direct):
    with pytest.raises(ArgumentError, match="DirectArrival"):
        arrivals(np.ones((4, 4)), direct)


def test_a_receive_map_shows_the_bright_directions_and_the_direct_paths():
    power = np.zeros((64, 64))
    power[30:34, 20:24] = 1e-9
    power[31, 22] = 5e-8  # a single bright pixel
    axes = arrivals(power)
    assert axes.images[0].get_clim()[1] == pytest.approx(10 * np.log10(5e-8 / 1e-3))
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    assert left > right  # the receiver's +x points to the left
    assert left - right == pytest.approx(high - low)
    assert left - right < 0.3
    assert right < 20 / 32 - 1 and left > 24 / 32 - 1
    assert low < 30 / 32 - 1 and high > 34 / 32 - 1
    axes = arrivals(power, [DirectArrival((0.7, 0.2), 1e-6, "tx")])
    assert axes.get_xlim()[0] > 0.7 and axes.get_ylim()[1] > 0.2


def test_labels_of_a_receive_map_do_not_overlap():
    power = np.zeros((64, 64))
    power[20:44, 20:44] = 1e-9
    marks = [DirectArrival((0.05 * k, 0.02 * k), 1e-6, f"tx {k} by wall") for k in range(4)]
    axes = arrivals(power, marks, names={"car": (0.0, 0.0), "wall": (0.01, 0.01)})
    boxes = [text.get_window_extent() for text in axes.texts if "°" not in text.get_text()]
    assert len(boxes) == 6
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


def fresnel_plane():
    corners = np.array([(-12, -12, 60), (12, 12, 60)]) * WAVELENGTH
    square = pw.shapes.square(20 * WAVELENGTH)
    return pw.plane(square, corners, (41, 41), WAVELENGTH, method="fresnel")


def test_the_default_floor_of_a_plane_leaves_out_one_percent_of_the_power():
    result = fresnel_plane()
    low, high = draw_planes(result).axes[0].images[0].get_clim()
    power = result["fresnel"].values
    share = [power[power < power.max() * 10 ** (level / 10)].sum() for level in (low, low + 5)]
    assert high == 0.0 and -40 < low < -5 and low % 5 == 0
    assert share[0] <= 0.01 * power.sum() < share[1]


def test_a_radar_map_is_drawn_from_its_floor_to_its_peak_and_profiles_are_refused():
    power = np.full((3, 4), 1e-12)
    power[1, 2] = 1e-6
    dims = ("range_rate", "range")
    image = xr.DataArray(
        power, {"range_rate": [-1.0, 0.0, 1.0], "range": np.arange(4.0)}, dims,
        attrs={"noise_floor": [1e-12]},
    )  # fmt: skip
    axes = draw_radar_map(image, floor_db=-40.0, ax=plt.subplots()[1])
    assert axes.collections or axes.images
    drawn = (axes.images or axes.collections)[0]
    assert drawn.get_clim() == pytest.approx((-70.0, -30.0))
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("range (m)", "range rate (m/s)")
    with pytest.raises(ArgumentError, match="range_doppler"):
        draw_radar_map(image[0])
