"""Figures of fields on lines, planes and hemispheres, and of projections."""

import io

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError
from polywigner.figures import draw_hemispheres, draw_lines, draw_planes, draw_projections
from polywigner.figures.levels import difference_db, summary
from projected import KINDS

xarray = pytest.importorskip("xarray")

Z = np.geomspace(2e-3, 200e-3, 50)
TWICE = 10 * np.log10(2)
SOURCE = pw.shapes.chevron_pair(20e-3, 12e-3, 4e-3)


def line(**values):
    """Return a dataset along the z axis, like the result of `polywigner.line`."""
    return xarray.Dataset(
        {name: ("distance", v, {"units": "W m-2"}) for name, v in values.items()},
        coords={
            "distance": ("distance", Z - Z[0], {"units": "m"}),
            "x": ("distance", 0 * Z, {"units": "m"}),
            "y": ("distance", 0 * Z, {"units": "m"}),
            "z": ("distance", Z, {"units": "m"}),
        },
    )


def test_nulls_of_the_reference_and_negative_values_are_not_compared():
    true = np.array([1.0, 1e-2, 1e-4, 0.0, 0.5])
    result = np.array([2.0, 1e-2, 7.0, 3.0, -0.1])
    assert np.array_equal(
        np.isfinite(difference_db(result, true)), [True, True, False, False, False]
    )
    assert summary(result, true) == (pytest.approx(TWICE), pytest.approx(TWICE / 2**0.5), 2, 1)
    assert np.isnan(summary(0 * true, true).rms)


def test_a_line_shows_levels_and_differences_of_all_methods():
    true = 1 / Z**2
    figure = draw_lines(line(double=2 * true, exact=true), floor_db=-60)
    figure.savefig(io.BytesIO(), format="png")
    levels, differences = figure.axes
    curves = {curve.get_label(): curve for curve in levels.lines}
    np.testing.assert_allclose(curves["exact"].get_xdata(), Z * 1e3)
    np.testing.assert_allclose(curves["exact"].get_ydata(), 20 * np.log10(Z[0] / Z), atol=1e-9)
    np.testing.assert_allclose(
        curves["double"].get_ydata() - curves["exact"].get_ydata(), TWICE, rtol=1e-9
    )
    near = 10**1.5 * Z[0] * (1 + 1e-9) >= Z  # 30 dB below the peak
    (drawn,) = [c for c in differences.lines if len(c.get_ydata()) == Z.size]
    assert np.array_equal(np.isfinite(drawn.get_ydata()), near)
    np.testing.assert_allclose(drawn.get_ydata()[near], TWICE, rtol=1e-9)
    assert levels.get_xscale() == "log"  # two decades of distance
    assert differences.get_xlabel() == "$z$ (mm)"
    assert "minus exact" in differences.get_title(loc="left")
    assert "W/m²" in levels.get_title(loc="left")


def test_a_curve_has_gaps_where_there_is_no_power():
    values = 1 / Z**2
    values[10:12] = [0.0, -1.0]
    figure = draw_lines(line(rays=values, exact=1 / Z**2))
    curve = next(c for c in figure.axes[0].lines if c.get_label() == "rays")
    assert np.flatnonzero(np.isnan(curve.get_ydata())).tolist() == [10, 11]


def test_an_arc_is_drawn_over_degrees():
    angle = np.radians(np.linspace(-80, 80, 33))
    result = xarray.Dataset(
        {"kirchhoff": (("theta", "phi"), np.cos(angle)[:, None] ** 4)},
        coords={"theta": ("theta", angle, {"units": "rad", "long_name": "angle"}), "phi": [0.0]},
    )
    (axes,) = draw_lines(result).axes
    np.testing.assert_allclose(axes.lines[0].get_xdata(), np.degrees(angle))
    assert axes.get_xlabel() == "angle (degrees)"


X, Y = np.linspace(-3e-3, 3e-3, 7), np.linspace(-2e-3, 2e-3, 5)


def plane(quantity, units, **values):
    about = {"units": units, "quantity": quantity}
    return xarray.Dataset(
        {name: (("x", "y"), v, about) for name, v in values.items()}, coords={"x": X, "y": Y}
    )


def test_a_plane_shows_levels_and_differences_at_their_places():
    true = np.add.outer(np.arange(7.0), 10 * np.arange(5.0)) + 1
    figure = draw_planes(plane("irradiance", "W m-2", double=2 * true, exact=true), floor_db=-40)
    figure.savefig(io.BytesIO(), format="png")
    panels = {axes.get_title(): axes for axes in figure.axes if axes.get_title()}
    (image,) = panels["exact"].images
    assert image.get_extent() == pytest.approx([-3.5, 3.5, -2.5, 2.5])
    np.testing.assert_allclose(
        image.get_array(), np.maximum(10 * np.log10(true.T / true.max()), -40), atol=1e-9
    )
    below = panels["minus exact"]
    np.testing.assert_allclose(below.images[0].get_array(), TWICE, rtol=1e-9)
    assert below.get_xlabel() == "$x$ (mm)" and below.get_ylabel() == "$y$ (mm)"


def test_a_complex_field_shows_its_phase():
    phase = np.add.outer(np.linspace(-2, 2, 7), np.linspace(-1, 1, 5))
    figure = draw_planes(plane("amplitude", "1", exact=np.exp(1j * phase)))
    figure.savefig(io.BytesIO(), format="png")
    levels, phases = (a.images[0].get_array() for a in figure.axes if a.images)
    np.testing.assert_allclose(levels, 0, atol=1e-9)
    np.testing.assert_allclose(phases, np.degrees(phase).T, atol=1e-9)
    assert any(axes.get_ylabel() == "phase (degrees)" for axes in figure.axes)


def test_beams_go_across_a_plane_along_z():
    values = np.add.outer(np.arange(7.0), np.arange(5.0)) + 1
    result = plane("irradiance", "W m-2", exact=values).rename(y="z")
    (axes, _) = draw_planes(result).axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("$z$ (mm)", "$x$ (mm)")
    assert axes.images[0].get_array().shape == (7, 5)


def test_rays_are_labelled_with_their_obliquity():
    result = line(rays=1 / Z, kirchhoff=1 / Z)
    result["rays"].attrs |= {"method": "wigner", "obliquity": "kirchhoff"}
    labels = [text.get_text() for text in draw_lines(result).axes[0].get_legend().get_texts()]
    assert labels == ["Wigner, obliquity Kirchhoff", "Kirchhoff"]


def test_a_hemisphere_is_drawn_over_direction_cosines_all_around():
    theta, phi = np.radians(np.linspace(0, 90, 10)), np.radians(np.arange(0, 360, 30.0))
    values = np.cos(theta)[:, None] ** 2 * (1 + 0.5 * np.cos(phi))
    result = xarray.Dataset(
        {"fraunhofer": (("phi", "theta"), values.T)}, coords={"theta": theta, "phi": phi}
    )
    figure = draw_hemispheres(result)
    figure.savefig(io.BytesIO(), format="png")
    (mesh,) = figure.axes[0].collections
    nodes = mesh.get_coordinates()
    assert nodes.shape == (10, 13, 2)
    np.testing.assert_allclose(nodes[:, 0], nodes[:, -1], atol=1e-12)
    np.testing.assert_allclose(nodes[3, 1], [0.5 * np.cos(phi[1]), 0.5 * np.sin(phi[1])])
    levels = mesh.get_array().reshape(10, 13)
    expected = 10 * np.log10(np.maximum(values / values.max(), 1e-4))
    np.testing.assert_allclose(levels[:, :-1], expected, atol=1e-9)


def test_fields_that_cannot_be_drawn_are_refused():
    flat = plane("irradiance", "W m-2", exact=np.ones((7, 5)))
    cases = [
        (draw_lines, flat, {}, "along a single axis"),
        (draw_lines, line(exact=1 / Z), {"against": "kirchhoff"}, "kirchhoff"),
        (draw_lines, line(exact=0 / Z), {}, "above zero"),
        (draw_planes, line(exact=1 / Z), {}, "two axes"),
        (draw_planes, flat, {"floor_db": 0.0}, "floor"),
        (draw_hemispheres, flat, {}, "theta and phi"),
        (
            draw_projections,
            pw.projections(SOURCE, samples=5),
            {"layout": "round"},
            '"paper", "all"',
        ),
        (draw_projections, pw.projections(SOURCE, coordinates={"x": [0.0]}), {}, "two samples"),
    ]
    for draw, result, options, words in cases:
        with pytest.raises(ArgumentError, match=words):
            draw(result, **options)


def cuts_drawn(result, obstacles):
    """Return the ends of the drawn intersections, in the units of the axes."""
    figure = draw_planes(result, obstacles=obstacles)
    return {
        tuple(np.round(line[[0, -1]].ravel(), 6))
        for drawn in figure.axes[0].collections
        for line in drawn.get_segments()
    }


def test_the_lines_where_a_plane_cuts_obstacles_are_drawn():
    box = pw.Polyhedron(
        [(x, y, z) for z in (0.02, 0.03) for y in (-0.01, 0.02) for x in (-0.01, 0.01)],
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]],
    )
    square, method = pw.shapes.square(10e-3), {"method": "fraunhofer"}
    result = pw.plane(square, [(-0.02, 0, 0.01), (0.02, 0, 0.05)], (3, 4), 3e-3, **method)
    # z is horizontal, x vertical.
    ends = np.array(list(cuts_drawn(result, box))).reshape(-1, 2)
    assert set(map(tuple, ends)) >= {(20, -10), (20, 10), (30, -10), (30, 10)}
    assert ends.min(axis=0).tolist() == [20, -10] and ends.max(axis=0).tolist() == [30, 10]
    pose = np.eye(4)
    pose[2, 3] = 0.04
    corners = [(-0.02, -0.02, 0.04), (0.02, 0.02, 0.04)]
    result = pw.plane(square, corners, (3, 4), 3e-3, **method)
    ends = np.array(list(cuts_drawn(result, square.placed(pose)))).reshape(-1, 2)
    assert set(map(tuple, ends)) == {(-5, -5), (-5, 5), (5, -5), (5, 5)}
    assert not cuts_drawn(result, box)


def _panels(figure):
    """Return the panels without colour bars."""
    return [a for a in figure.axes if a.get_title()]


@pytest.mark.parametrize(("kind", "layout"), list(zip(KINDS, ("paper", "all", "all"), strict=True)))
def test_panels_of_a_column_share_the_axis_across_and_those_of_a_row_that_upwards(kind, layout):
    panels = _panels(draw_projections(pw.projections(SOURCE, kind, samples=9), layout))
    specs = [(axes, axes.get_subplotspec()) for axes in panels]
    for axes, spec in specs:
        for other, place in specs:
            if spec.colspan == place.colspan:
                assert axes.get_xlabel() == other.get_xlabel()
                assert axes.get_xlim() == other.get_xlim()
            if spec.rowspan == place.rowspan:
                assert axes.get_ylim() == other.get_ylim()


def test_values_stand_at_their_coordinates():
    slits = pw.shapes.slit_pair((1e-3, 2e-3), (-2e-3, 3e-3))
    figure = draw_projections(pw.projections(slits, "wigner", samples=9))
    assert [axes.get_title() for axes in _panels(figure)] == ["$W$"]
    axes = {"x": np.linspace(0.0, 1e-2, 9), "y": np.linspace(-1e-3, 1e-2, 8)}
    result = pw.projections(SOURCE, "wigner", samples=7, coordinates=axes)
    corner = _panels(draw_projections(result))[0]
    mesh = corner.collections[0]
    values = np.asarray(mesh.get_array()).reshape(8, 9)  # axes (y, x)
    assert (values == result["x_y"].values.T).all()
    centres = (mesh.get_coordinates()[0, :-1, 0] + mesh.get_coordinates()[0, 1:, 0]) / 2
    assert np.allclose(centres, result["x"].values * 1e3)  # mm
