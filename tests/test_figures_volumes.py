"""Isosurfaces and wall projections of volumes."""

import io

import numpy as np
import pytest
from matplotlib.figure import Figure

import polywigner as pw
from polywigner.errors import ArgumentError
from polywigner.figures import draw_volume, volumes

xarray = pytest.importorskip("xarray")
pytest.importorskip("skimage")


def ball(radius):
    """Return a field that decreases by 10 dB per ``radius`` from the centre of its box."""
    axes = {name: np.linspace(-2e-3, 2e-3, 41) for name in "xyz"}
    points = np.stack(np.meshgrid(*axes.values(), indexing="ij"), axis=-1)
    values = 10 ** (-np.linalg.norm(points, axis=-1) / radius)
    return xarray.Dataset({"wigner": (tuple(axes), values)}, coords=axes)


def surfaces_of(axes):
    """Return the triangles (n, 3, 3) of each drawn surface."""
    kinds = [c for c in axes.collections if type(c).__name__ == "Poly3DCollection"]
    return [np.asarray(c._faces) for c in kinds if c.get_rasterized()]


def test_the_surface_of_a_ball_lies_at_its_radius():
    figure = draw_volume(ball(1.5e-3), surfaces=(-10.0, -5.0))
    outer, inner = surfaces_of(figure.axes[0])
    for triangles, radius in ((outer, 1.5), (inner, 0.75)):  # mm
        distance = np.linalg.norm(triangles, axis=-1)
        np.testing.assert_allclose(distance, radius, atol=0.02)


def test_surfaces_are_closed_at_the_faces_of_the_box():
    figure = draw_volume(ball(4e-3), surfaces=(-6.0,))  # a radius of 2.4 mm, beyond all faces
    (triangles,) = surfaces_of(figure.axes[0])
    assert np.abs(triangles).max() == pytest.approx(2.0)
    edges = {}
    for triangle in np.round(triangles, 9):
        for k in range(3):
            ends = frozenset((tuple(triangle[k]), tuple(triangle[(k + 1) % 3])))
            edges[ends] = edges.get(ends, 0) + 1
    assert {count for ends, count in edges.items() if len(ends) == 2} <= {2, 4}


def test_the_inner_surface_is_visible_through_the_outer_one():
    pixels = []
    for surfaces in ((-10.0,), (-10.0, -5.0)):
        figure = draw_volume(ball(1.5e-3), surfaces=surfaces)
        figure.canvas.draw()
        pixels.append(np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int))
    changed = np.abs(pixels[0] - pixels[1]).max(axis=-1) > 30
    assert 0.002 < changed.mean() < 0.2


def test_a_flat_box_is_drawn_a_quarter_as_high_as_it_is_wide():
    flat = ball(1.5e-3).assign_coords(z=np.linspace(-1e-5, 1e-5, 41))
    aspect = np.sort(draw_volume(flat, surfaces=(-5.0,)).axes[0]._box_aspect)
    np.testing.assert_allclose(aspect / aspect[-1], [0.25, 1.0, 1.0])


def beam(count=24):
    """Return an asymmetric field in closed form."""
    axes = {
        "x": np.linspace(-3e-3, 5e-3, count),
        "y": np.linspace(-4e-3, 2e-3, count + 2),
        "z": np.linspace(1e-3, 9e-3, count + 4),
    }
    x, y, z = np.meshgrid(*axes.values(), indexing="ij")
    values = (
        7.0 * np.exp(-((x - 1e-3) ** 2 + (y + 1e-3) ** 2) / (1e-3 + z / 4) ** 2) / (1 + z / 1e-3)
    )
    return xarray.Dataset(
        {"wigner": (tuple(axes), values, {"units": "W m-2"})},
        coords={name: (name, places, {"units": "m"}) for name, places in axes.items()},
    )


SQUARE = pw.shapes.rectangle(2e-3, 1e-3)


@pytest.mark.parametrize(("projection", "reduced"), [("maximum", np.max), ("mean", np.mean)])
def test_walls_show_the_projections_of_the_values(projection, reduced, monkeypatch):
    walls = []
    draw = volumes._draw_wall
    monkeypatch.setattr(
        volumes, "_draw_wall", lambda *args: (walls.append(args[3]), draw(*args))[1]
    )
    result = beam()
    draw_volume(result.transpose("z", "x", "y"), projection=projection, floor_db=-25)
    values = result["wigner"].values
    for axis, wall in enumerate(walls):
        power = reduced(values, axis=axis) / values.max()
        np.testing.assert_allclose(wall, np.maximum(10 * np.log10(power), -25), atol=1e-9)


def test_the_aperture_is_drawn_in_its_plane():
    figure = draw_volume(beam(), SQUARE)
    lines = [c for c in figure.axes[0].collections if type(c).__name__ == "Line3DCollection"]
    corners = {tuple(end) for line in lines for ends in line._segments3d for end in ends}
    expected = {(*np.round(corner * 1e3, 9), 0.0) for corner in SQUARE.rings[0]}  # mm
    assert expected <= {tuple(np.round(corner, 9)) for corner in corners}


def test_the_picture_says_what_it_shows():
    figure = draw_volume(beam(), SQUARE, surfaces=(-15, -3), title="a beam")
    figure.savefig(io.BytesIO(), format="png")
    for name in "xyz":
        assert getattr(figure.axes[0], f"get_{name}label")() == f"${name}$ (mm)"
    label = figure.axes[1].get_ylabel()
    for words in ("irradiance", "W/m²", "maximum", "floor −40 dB"):
        assert words in label
    assert figure.axes[0].get_title() == "a beam"


def test_what_cannot_be_drawn_is_refused():
    result = beam(6)
    renamed = result.rename(x="s")
    uneven = result.assign_coords(x=("x", result["x"].values ** 3))
    unfinished = result.copy(deep=True)
    unfinished["wigner"][0, 0, 0] = np.nan
    cases = [
        (result, {"name": "kirchhoff"}, "kirchhoff"),
        (renamed, {}, "x, y and z"),
        (uneven, {}, "evenly"),
        (unfinished, {}, "NaN"),
        (result * -1.0, {}, "above zero"),
        (result.astype(complex), {}, "complex"),
        (result, {"surfaces": (-50.0,)}, "floor"),
        (result, {"projection": "sum"}, "projection"),
        (result, {"obstacles": np.zeros((2, 5))}, "obstacles"),
        (result, {"ax": Figure().add_subplot()}, "3d"),
    ]
    for volume, options, words in cases:
        with pytest.raises(ArgumentError, match=words):
            draw_volume(volume, **options)
