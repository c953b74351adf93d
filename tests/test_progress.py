"""Bars of long work: drawn where they can be wiped out, and then gone."""

import contextlib
import io
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import polywigner as pw
from polywigner.execution import progress

SQUARE = pw.shapes.square(10e-3)
BOX = [(0.0, 0.0, 0.1), (0.0, 0.0, 0.2)]


@pytest.fixture
def cell(monkeypatch):
    """The states of the one output of a notebook's cell, whose kernel is a stand-in."""
    states: list[dict[str, str]] = []

    def display(data, *, raw, display_id):
        assert raw and display_id and not states
        states.append(data)
        return SimpleNamespace(update=lambda data, raw: states.append(data))

    ipython, shown = ModuleType("IPython"), ModuleType("IPython.display")
    ipython.get_ipython = lambda: SimpleNamespace(kernel=object())
    shown.display = display
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", shown)
    monkeypatch.setattr(progress, "_INTERVAL", 0.0)
    return states


def test_a_bar_in_a_notebook_leaves_nothing(cell, capfd):
    pw.line(SQUARE, BOX, 3, 3.2e-3, method="fraunhofer", progress=True)
    assert "fraunhofer" in cell[0]["text/plain"] and "0/1" in cell[0]["text/plain"]
    assert "1/1" in cell[-2]["text/plain"]
    assert cell[-1] == {}  # an output without data has no area
    assert capfd.readouterr() == ("", "")


class Terminal(io.StringIO):
    def isatty(self):
        return True


def terminal(monkeypatch):
    """A terminal as stderr, before somebody without any patience.

    No fixture: between set-up and test pytest puts its own stderr in place.
    """
    made = Terminal()
    monkeypatch.setattr(sys, "stderr", made)
    monkeypatch.setattr(progress, "_PATIENCE", 0.0)
    return made


def test_every_long_call_tells_of_its_parts_and_a_quick_one_does_not(monkeypatch):
    screen = terminal(monkeypatch)
    far = np.stack([np.zeros(300), np.zeros(300), np.linspace(0.1, 1.0, 300)], axis=1)
    poses = np.tile(np.diag([-1.0, 1.0, -1.0, 1.0]), (300, 1, 1))
    poses[:, 2, 3] = far[:, 2]
    calls = {
        "links": lambda: pw.coupling(SQUARE, SQUARE, poses, 3.2e-3, method="fraunhofer"),
        "radar cross sections": lambda: pw.rcs(pw.shapes.square(1.0), far / far[:, 2:], 0.3),
        "samples": lambda: pw.wigner(SQUARE, np.zeros((1 << 17, 2)), (0.0, 0.0), engine="numpy"),
    }
    monkeypatch.setattr("polywigner.scattering.surface_sums._BLOCK", 64)
    for title, call in calls.items():
        call()
        assert title in screen.getvalue()
        screen.seek(screen.truncate(0))
    monkeypatch.setattr(progress, "_PATIENCE", 60.0)
    for call in calls.values():
        call()
    assert screen.getvalue() == ""


def test_the_work_of_a_part_draws_no_bar_of_its_own(monkeypatch):
    screen = terminal(monkeypatch)
    with progress.progress_bar("whole", 2, show=True) as advance:
        with progress.told("inner", range(3)) as each:
            assert list(each) == [0, 1, 2]
        advance(2)
    assert "whole" in screen.getvalue() and "inner" not in screen.getvalue()


def is_told():
    with progress.told("later", range(3)) as each:
        list(each)
    return "later" in sys.stderr.getvalue()


def test_what_ends_the_work_ends_its_bar(monkeypatch):
    terminal(monkeypatch)
    with pytest.raises(KeyboardInterrupt) as kept, progress.told("first", range(3)) as each:
        for part in each:
            if part == 2:
                raise KeyboardInterrupt
    assert kept.traceback  # as a console keeps it, with all that stood in its frames
    assert is_told()


def test_bars_of_threads_end_in_any_order(monkeypatch):
    terminal(monkeypatch)
    first = progress.progress_bar("one", 2, show=True)
    second = progress.progress_bar("another", 2)
    monkeypatch.setattr(progress, "_drawn", lambda *_: contextlib.nullcontext(lambda parts=1: None))
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    second.__exit__(None, None, None)
    monkeypatch.undo()
    terminal(monkeypatch)
    assert is_told()


@pytest.mark.parametrize("stderr", ["none", "closed", "no terminal's"])
def test_whatever_stderr_is_the_work_goes_on(stderr, monkeypatch):
    closed = io.StringIO()
    closed.close()
    odd = {"none": None, "closed": closed, "no terminal's": SimpleNamespace(write=len)}
    monkeypatch.setattr(sys, "stderr", odd[stderr])
    monkeypatch.setattr(progress, "_PATIENCE", 0.0)
    with progress.progress_bar("outer", 1) as advance, progress.told("inner", range(3)) as each:
        assert list(each) == [0, 1, 2]
        advance()


def test_without_a_terminal_commands_write_the_time_that_is_left_once(monkeypatch, capsys):
    monkeypatch.setattr(progress, "_AT_ONCE", 2)
    clock = iter(range(0, 1000, 10))
    monkeypatch.setattr(progress.time, "monotonic", lambda: float(next(clock)))
    with progress.progress_bar("quiet", 100) as advance:
        advance(50)
    assert capsys.readouterr().err == ""
    with progress.time_left_written(), progress.progress_bar("work", 30, 10) as advance:
        for _ in range(20):
            advance()
    # parts take 10 s each
    expected = "polywigner: about 3 min left, 12 of 30 parts are done\n"
    assert capsys.readouterr().err == expected
