"""Figures of projections: neighbours share axes, and every panel says what it shows."""

from __future__ import annotations

import io

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError
from polywigner.figures import draw_projections
from projected import KINDS

SOURCE = pw.shapes.chevron_pair(20e-3, 12e-3, 4e-3)
COUNTS = {"paper": 4, "all": 6}


def _panels(figure):  # type: ignore[no-untyped-def]
    """Panels with a picture, not colour bars."""
    return [a for a in figure.axes if a.get_title()]


@pytest.mark.slow
@pytest.mark.parametrize("layout", COUNTS)
@pytest.mark.parametrize("kind", KINDS)
def test_every_tile_is_drawn_with_unit_scale_and_meaning(kind: str, layout: str) -> None:
    figure = draw_projections(pw.projections(SOURCE, kind, samples=9), layout, title="chevrons")
    figure.savefig(io.BytesIO(), format="png")
    panels = _panels(figure)
    assert len(panels) == COUNTS[layout]
    assert figure.get_suptitle() == "chevrons"
    titles = [a.get_title() for a in panels]
    assert len(set(titles)) == len(titles) and all(r"\iint" in title for title in titles)
    for axes in panels:
        assert axes.get_xlabel().endswith(("(mm)", "(1/mm)"))
    bars = [a.get_ylabel() for a in figure.axes if not a.get_title() and a.get_ylabel()]
    assert any("mm²" in bar for bar in bars)


@pytest.mark.parametrize("layout", COUNTS)
@pytest.mark.parametrize("kind", KINDS)
def test_panels_of_a_column_share_the_axis_across_and_those_of_a_row_that_upwards(
    kind: str, layout: str
) -> None:
    panels = _panels(draw_projections(pw.projections(SOURCE, kind, samples=9), layout))
    specs = [(axes, axes.get_subplotspec()) for axes in panels]
    for axes, spec in specs:
        for other, place in specs:
            if spec.colspan == place.colspan:
                assert axes.get_xlabel() == other.get_xlabel()
                assert axes.get_xlim() == other.get_xlim()
            if spec.rowspan == place.rowspan:
                assert axes.get_ylim() == other.get_ylim()


def test_values_stand_at_their_coordinates() -> None:
    found = pw.projections(
        SOURCE, "wigner", samples={"x": 9, "y": 8, "nu_x": 7, "nu_y": 6}, tiles=None
    )
    corner = _panels(draw_projections(found))[0]
    mesh = corner.collections[0]
    values = np.asarray(mesh.get_array()).reshape(8, 9)  # y upwards, x across
    assert (values == found["x_y"].values.T).all()
    centres = (mesh.get_coordinates()[0, :-1, 0] + mesh.get_coordinates()[0, 1:, 0]) / 2
    assert np.allclose(centres, found["x"].values * 1e3)  # mm


def test_slits_have_one_panel() -> None:
    slits = pw.shapes.slit_pair((1e-3, 2e-3), (-2e-3, 3e-3))
    figure = draw_projections(pw.projections(slits, "wigner", samples=9))
    assert [axes.get_title() for axes in _panels(figure)] == ["$W$"]


def test_what_cannot_be_drawn_is_refused() -> None:
    found = pw.projections(SOURCE, samples=5)
    with pytest.raises(ArgumentError, match='expected layout to be "paper" or "all"'):
        draw_projections(found, "round")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="expected a floor below 0 dB"):
        draw_projections(found, floor_db=3.0)
    with pytest.raises(ArgumentError, match="with all their tiles"):
        draw_projections(pw.projections(SOURCE, samples=5, tiles=["x_y", "x_nu_x"]))
    with pytest.raises(ArgumentError, match="two samples along x"):
        draw_projections(pw.projections(SOURCE, samples=5, coordinates={"x": [0.0]}))
