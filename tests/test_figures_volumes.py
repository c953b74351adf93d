"""Pictures of volumes: surfaces lie where the field has their level, and all has its place."""

import io

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError
from polywigner.figures import draw_volume
from polywigner.figures.volumes_layers import View, cast_layers, closed, shaded

xarray = pytest.importorskip("xarray")

LOWER, UPPER = np.array([-2e-3, -2e-3, 1e-3]), np.array([2e-3, 2e-3, 5e-3])
TOWARDS = (-0.62, 0.42, -0.66)
COUNT = 41

# Levels that are linear in the distance from a centre: linear interpolation between samples errs by
# the sagitta of a step, h^2/(8 r) = 1e-4 mm^2/(8 * 1 mm), 1 % of a step, far less than a pixel.
PIXEL = 2e-5
ANGLE = 0.02  # radians, of interpolated normals


def ball(radius, towards=TOWARDS):
    """The surfaces at -10 and -5 dB of a field that falls by 10 dB in each ``radius``."""
    levels, spacing = levels_of_a_ball(radius)
    view = View.of(LOWER, UPPER, towards)
    padded, before = closed(levels, -10.0, view)
    first = LOWER - before * spacing
    return cast_layers(padded, first, spacing, (-10.0, -5.0), view, PIXEL), view


def levels_of_a_ball(radius):
    axes = [np.linspace(a, b, COUNT) for a, b in zip(LOWER, UPPER, strict=True)]
    centre = (LOWER + UPPER) / 2
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1) - centre
    return -10 * np.linalg.norm(places, axis=-1) / radius, (UPPER - LOWER) / (COUNT - 1)


def places(layers):
    rows, columns = np.indices(layers.normals.shape[1:3])
    return layers.origin + rows[..., None] * layers.down + columns[..., None] * layers.along


@pytest.mark.parametrize("towards", [TOWARDS, (-0.2, 0.95, -0.3), (0.9, -0.1, 0.2)], ids=str)
def test_rays_meet_a_ball_where_it_is(towards):
    """From any side: its outline is a circle, its normals are its radii."""
    layers, view = ball(1.5e-3, towards)
    offset = places(layers) - view.on_page((LOWER + UPPER) / 2)
    distance = np.linalg.norm(offset, axis=-1)
    for normals, radius in zip(layers.normals, (1.5e-3, 0.75e-3), strict=True):
        met = np.any(normals != 0, axis=-1)
        assert np.all(met[distance < radius - 2 * PIXEL])
        assert not np.any(met[distance > radius + 2 * PIXEL])
        across = np.stack([normals @ view.right, normals @ view.up], axis=-1)
        seen = met & (distance < 0.95 * radius)
        np.testing.assert_allclose(across[seen], offset[seen] / radius, rtol=0, atol=ANGLE)
        assert np.all((normals @ view.towards)[seen] > 0)


def test_a_surface_lies_in_front_of_those_of_higher_levels_even_where_the_box_cuts_it():
    layers, _ = ball(4e-3)  # reaches beyond all faces
    outer, inner = (np.any(normals != 0, axis=-1) for normals in layers.normals)
    assert np.all(outer[inner]) and outer.sum() > inner.sum() > 0


def test_an_opaque_outer_surface_hides_the_inner_one_and_a_clear_one_does_not():
    layers, view = ball(1.5e-3)
    colours = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    middle = tuple(n // 2 for n in layers.normals.shape[1:3])
    hidden = shaded(layers, colours, np.array([1.0, 1.0]), view)[middle]
    clear = shaded(layers, colours, np.array([0.1, 1.0]), view)[middle]
    assert hidden[2] > 0.4 > hidden[0] and clear[0] > 0.4 > clear[2]
    assert hidden[3] == clear[3] == 1.0
    corner = shaded(layers, colours, np.array([0.1, 1.0]), view)[0, 0]
    assert corner[3] == 0.0


def beam(count=24):
    """A field of closed form in a box that is nowhere symmetric."""
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


@pytest.fixture(autouse=True)
def few_pixels(monkeypatch):
    """What is tested of whole pictures does not depend on how fine they are."""
    monkeypatch.setattr("polywigner.figures.volumes._PIXELS", 150)


SQUARE = pw.shapes.rectangle(2e-3, 1e-3)


def test_walls_show_the_projections_of_the_values():
    found = beam()
    values = found["wigner"].values
    for projection, reduced in (("maximum", np.max), ("mean", np.mean)):
        given = found.transpose("z", "x", "y")
        figure = draw_volume(given, projection=projection, renderer="matplotlib", floor_db=-25)
        walls = [
            image.get_array() for image in figure.axes[0].images if image.get_array().ndim == 2
        ]
        assert len(walls) == 3
        for axis, wall in enumerate(walls):
            power = reduced(values, axis=axis) / values.max()
            np.testing.assert_allclose(wall, np.maximum(10 * np.log10(power), -25), atol=1e-9)


def test_the_aperture_is_drawn_in_its_plane():
    from matplotlib.patches import PathPatch

    found = beam()
    figure = draw_volume(found, SQUARE, renderer="matplotlib")
    patch = next(p for p in figure.axes[0].patches if isinstance(p, PathPatch))
    front = np.array([-3e-3, -4e-3, 0.0])
    view = View.of(front, [5e-3, 2e-3, 9e-3], TOWARDS)
    ring = SQUARE.rings[0]
    expected = view.on_page(np.column_stack([ring, np.zeros(len(ring))]))
    drawn = patch.get_path().vertices
    for corner in expected:
        assert np.min(np.linalg.norm(drawn - corner, axis=-1)) < 1e-12


def test_the_picture_says_what_it_shows():
    figure = draw_volume(beam(), SQUARE, renderer="matplotlib", surfaces=(-15, -3), title="a beam")
    figure.savefig(io.BytesIO(), format="png")
    texts = [text.get_text() for text in figure.axes[0].texts]
    for name in "xyz":
        assert f"${name}$ (mm)" in texts
    label = figure.axes[1].get_ylabel()
    for words in ("irradiance", "W/m²", "maximum", "floor −40 dB"):
        assert words in label
    assert figure.axes[0].get_title() == "a beam"


def test_what_cannot_be_drawn_is_refused():
    found = beam(6)
    renamed = found.rename(x="s")
    uneven = found.assign_coords(x=("x", found["x"].values ** 3))
    unfinished = found.copy(deep=True)
    unfinished["wigner"][0, 0, 0] = np.nan
    cases = [
        (found, {"name": "kirchhoff"}, "kirchhoff"),
        (found.assign(kirchhoff=found["wigner"]), {}, "wigner, kirchhoff"),
        (renamed, {}, "x, y, z"),
        (uneven, {}, "evenly"),
        (unfinished, {}, "nan"),
        (found.isel(x=[0]), {}, "two samples"),
        (found * -1.0, {}, "above zero"),
        (found.astype(complex), {}, "complex"),
        (found, {"surfaces": (-50.0,)}, "floor"),
        (found, {"surfaces": (0.0,)}, "floor"),
        (found, {"surfaces": ()}, "floor"),
        (found, {"floor_db": 3.0}, "floor"),
        (found, {"reference": 0.0}, "reference"),
        (found, {"projection": "sum"}, "projection"),
        (found, {"renderer": "vtk"}, "renderer"),
        (found, {"obstacles": np.zeros((2, 5))}, "obstacles"),
    ]
    for volume, options, words in cases:
        with pytest.raises(ArgumentError, match=words):
            draw_volume(volume, **options)
