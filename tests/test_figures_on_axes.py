"""Figures on the axes and figures of a caller."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure, SubFigure

import polywigner as pw
from polywigner import figures
from polywigner.errors import ArgumentError

pytest.importorskip("xarray", reason="the extra datasets is not installed")

WAVELENGTH = 3e-3
SQUARE = pw.shapes.square(10e-3)
METHODS: dict[str, Any] = {"method": ("fraunhofer", "fresnel")}
ANGLES = np.linspace(0.0, 1.4, 8), np.linspace(0.0, 2 * np.pi, 8, endpoint=False)


@cache
def _line(x: float) -> Any:
    return pw.line(SQUARE, ((x, 0, 0.05), (x, 0, 0.2)), 9, WAVELENGTH, **METHODS)


@cache
def _slices() -> Any:
    return figures.transform_slices(SQUARE, samples=17)


def _channel(count: int = 65) -> Any:
    """Return a channel over 64 GHz with two paths, 0.2 ns and 20 dB apart."""
    import xarray

    frequencies = np.linspace(60e9, 124e9, count)
    delays, sizes = np.array([0.5e-9, 0.7e-9]), np.array([1.0, 0.1])
    ways = sizes * np.exp(2j * np.pi * frequencies[:, None] * delays)
    dims = "receiver", "emitter", "path"
    return xarray.Dataset(
        {
            "h": (("frequency", *dims[:2]), ways.sum(axis=-1)[:, None, None]),
            "amplitude": (("frequency", *dims), ways[:, None, None]),
            "delay": (dims, delays[None, None]),
            "mirrors": (("path",), ["", "floor"]),
        },
        {"frequency": frequencies, "receiver": ["rx"], "emitter": ["tx"]},
    )


def test_impulse_responses_peak_at_each_way_by_its_own_level() -> None:
    _, response = figures.draw_channel(_channel()).axes
    times, levels = (np.asarray(values) for values in response.lines[0].get_data())
    for delay, level in ((0.5, 0.0), (0.7, -20.0)):
        near = np.abs(times - delay) < 0.05
        top = np.argmax(np.where(near, levels, -np.inf))
        assert times[top] == pytest.approx(delay, abs=2e-3)
        assert levels[top] == pytest.approx(level, abs=0.1)


def test_few_frequencies_have_no_impulse_response() -> None:
    _, response = figures.draw_channel(_channel(1)).axes
    assert all(len(line.get_xdata()) == 1 for line in response.lines)
    with pytest.raises(ArgumentError, match=r"polywigner\.mitsuba\.channel"):
        figures.draw_channel({"h": 1})


SEVERAL: dict[str, Callable[..., Any]] = {
    "lines": lambda **how: figures.draw_lines(_line(0.0), **how),
    "columns of lines": lambda **how: figures.draw_lines(
        {name: _line(x) for name, x in (("axis", 0.0), ("beside", 0.01))},
        **how,
    ),
    "planes": lambda **how: figures.draw_planes(
        pw.plane(SQUARE, ((-0.1, 0, 0.05), (0.1, 0, 0.2)), (9, 8), WAVELENGTH, **METHODS), **how
    ),
    "hemispheres": lambda **how: figures.draw_hemispheres(
        pw.hemisphere(SQUARE, 1.0, *ANGLES, WAVELENGTH, method="fraunhofer"), **how
    ),
    "pattern": lambda **how: figures.draw_pattern(
        pw.radiation_pattern(SQUARE, WAVELENGTH, *ANGLES), **how
    ),
    "rcs": lambda **how: figures.draw_rcs(pw.rcs_pattern(SQUARE, WAVELENGTH, *ANGLES[::-1]), **how),
    "projections": lambda **how: figures.draw_projections(pw.projections(SQUARE, samples=9), **how),
    "transforms": lambda **how: figures.draw_transforms(_slices(), -30.0, **how),
    "channel": lambda **how: figures.draw_channel(_channel(), **how),
}
ONE: dict[str, Callable[..., Any]] = {
    "scene": lambda **how: figures.draw_scene(np.ones((4, 6)), 2.0, -40.0, **how),
    "volume": lambda **how: figures.draw_volume(
        pw.volume(SQUARE, ((-0.1, -0.1, 0.05), (0.1, 0.1, 0.2)), (6, 6, 6), WAVELENGTH,
                  method="fraunhofer"),
        surfaces=(-1.0,), **how,
    ),
}  # fmt: skip


def _panels(figure: Any) -> list[str]:
    """Return the titles and labels of all axes."""
    return [
        " ".join((a.get_title(), a.get_title(loc="left"), a.get_xlabel(), a.get_ylabel()))
        for a in figure.axes
    ]


@pytest.mark.parametrize("name", SEVERAL)
def test_several_panels_are_drawn_on_a_figure_and_on_a_part_of_one(name: str) -> None:
    draw, before = SEVERAL[name], dict(mpl.rcParams)
    alone = draw(title="alone")
    assert isinstance(alone, Figure)
    own = Figure(figsize=(8, 6))
    assert draw(figure=own, title="own") is own
    assert dict(mpl.rcParams) == before  # the caller's settings are restored
    assert _panels(own) == _panels(alone)
    assert own.get_suptitle() == "own"
    assert own.get_layout_engine() is not None  # colour bars would overlap without a layout engine
    whole = Figure(figsize=(14, 6), layout="constrained")
    whole.suptitle("both")
    left, right = whole.subfigures(1, 2)
    right.suptitle("mine")
    assert isinstance(right, SubFigure)
    assert draw(figure=right) is right
    assert _panels(right) == _panels(alone)
    assert not left.axes
    assert right.get_suptitle() == "mine"  # no new title
    assert whole.get_suptitle() == "both"


@pytest.mark.parametrize("name", ONE)
def test_one_panel_is_drawn_on_axes(name: str) -> None:
    alone = ONE[name]()
    assert isinstance(alone, Figure)
    whole = Figure(figsize=(10, 4), layout="constrained")
    kind = {"projection": "3d"} if name == "volume" else {}
    left, right = whole.subplots(1, 2, subplot_kw=kind)
    assert ONE[name](ax=right) is right
    assert not left.has_data()
    assert len(whole.axes) == 3  # including the colour bar
    assert whole.axes[2].get_ylabel() == alone.axes[1].get_ylabel()


def test_anything_else_is_refused() -> None:
    axes = Figure().subplots()
    for draw in SEVERAL.values():
        with pytest.raises(ArgumentError, match="Figure or SubFigure, got Axes"):
            draw(figure=axes)
    for draw in ONE.values():
        with pytest.raises(ArgumentError, match="expected ax to be matplotlib Axes, got Figure"):
            draw(ax=axes.figure)
