"""Progress bars on a terminal or on request."""

import io
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import polywigner as pw
from polywigner.execution import progress

SQUARE = pw.shapes.square(10e-3)
BOX = [(0.0, 0.0, 0.1), (0.0, 0.0, 0.2)]


class Terminal(io.StringIO):
    def isatty(self):
        return True


def terminal(monkeypatch):
    """Replace stderr by a terminal, and let calls draw a bar at once.

    This function is not a fixture, because pytest replaces stderr between set-up and test.
    """
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(progress, "_PATIENCE", 0.0)
    return screen


def test_each_slow_call_draws_a_bar_and_a_quick_one_does_not(monkeypatch):
    screen = terminal(monkeypatch)
    far = np.stack([np.zeros(300), np.zeros(300), np.linspace(0.1, 1.0, 300)], axis=1)
    poses = np.tile(np.diag([-1.0, 1.0, -1.0, 1.0]), (300, 1, 1))
    poses[:, 2, 3] = far[:, 2]
    calls = {
        "links": lambda: pw.coupling(SQUARE, SQUARE, poses, 3.2e-3, method="fraunhofer"),
        "radar cross sections": lambda: pw.rcs(pw.shapes.square(1.0), far / far[:, 2:], 0.3),
        "samples": lambda: pw.wigner(SQUARE, np.zeros((1 << 17, 2)), (0.0, 0.0), engine="numpy"),
    }
    monkeypatch.setattr("polywigner.scattering.facets._AT_ONCE", 64)
    for title, call in calls.items():
        call()
        assert title in screen.getvalue()
        screen.seek(screen.truncate(0))
    monkeypatch.setattr(progress, "_PATIENCE", 60.0)
    for call in calls.values():
        call()
    assert screen.getvalue() == ""


def test_slow_work_within_the_work_of_a_bar_draws_none(monkeypatch):
    screen = terminal(monkeypatch)
    with progress.progress_bar("outer", 2, show=True) as advance:
        with progress.with_progress("inner", range(3)) as parts:
            assert list(parts) == [0, 1, 2]
        advance(2)
    assert "outer" in screen.getvalue() and "inner" not in screen.getvalue()


def test_an_interruption_ends_the_bar_at_once(monkeypatch):
    screen = terminal(monkeypatch)
    with pytest.raises(KeyboardInterrupt), progress.with_progress("first", range(3)) as parts:
        for part in parts:
            if part == 2:
                raise KeyboardInterrupt
    with progress.with_progress("later", range(3)) as parts:
        list(parts)
    assert "later" in screen.getvalue()


@pytest.mark.parametrize("stderr", ["none", "closed", "no terminal"])
def test_without_a_terminal_the_work_runs_without_a_bar(stderr, monkeypatch):
    closed = io.StringIO()
    closed.close()
    files = {"none": None, "closed": closed, "no terminal": SimpleNamespace(write=len)}
    monkeypatch.setattr(sys, "stderr", files[stderr])
    monkeypatch.setattr(progress, "_PATIENCE", 0.0)
    with (
        progress.progress_bar("outer", 1) as advance,
        progress.with_progress("inner", range(3)) as parts,
    ):
        assert list(parts) == [0, 1, 2]
        advance()
