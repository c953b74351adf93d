"""Bars of long work: drawn where they can be wiped out, and then gone."""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import polywigner as pw
from polywigner.radiometry import progress

SQUARE = pw.shapes.square(10e-3)
BOX = [(0.0, 0.0, 0.1), (0.0, 0.0, 0.2)]


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, str]]:
    """The states of the one output of a notebook's cell, whose kernel is a stand-in."""
    states: list[dict[str, str]] = []

    def display(data: dict[str, str], *, raw: bool, display_id: bool) -> Any:
        assert raw and display_id and not states
        states.append(data)
        return SimpleNamespace(update=lambda data, raw: states.append(data))

    ipython, shown = ModuleType("IPython"), ModuleType("IPython.display")
    ipython.get_ipython = lambda: SimpleNamespace(kernel=object())  # type: ignore[attr-defined]
    shown.display = display  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", shown)
    monkeypatch.setattr(progress, "_INTERVAL", 0.0)
    return states


def test_a_bar_in_a_notebook_leaves_nothing(
    cell: list[dict[str, str]], capfd: pytest.CaptureFixture[str]
) -> None:
    pw.line(SQUARE, BOX, 3, 3.2e-3, method="fraunhofer", progress=True)
    assert "fraunhofer" in cell[0]["text/plain"] and "0/1" in cell[0]["text/plain"]
    assert "1/1" in cell[-2]["text/plain"]
    assert cell[-1] == {}  # an output without data has no area
    assert capfd.readouterr() == ("", "")


def test_a_bar_of_work_that_fails_leaves_nothing_either(cell: list[dict[str, str]]) -> None:
    with pytest.raises(ZeroDivisionError), progress.progress_bar("work", 2, show=True):
        raise ZeroDivisionError
    assert cell[-1] == {}


def test_a_notebook_that_does_not_ask_has_no_bar(cell: list[dict[str, str]]) -> None:
    pw.line(SQUARE, BOX, 3, 3.2e-3, method="fraunhofer")
    assert not cell
