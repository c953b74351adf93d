"""Functions called in processes of their own: nothing that happens there reaches the caller."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polywigner.apart import ChildError, run_apart
from polywigner.errors import GeometryError

SECONDS, MEMORY = 20.0, 1 << 29
# Of a start on a machine that does other work.
PATIENCE = 10.0


def _ones(count: int) -> np.ndarray:
    print("no part of the answer", flush=True)
    return np.ones(count)


def _segmentation_fault() -> None:
    print("last words", file=sys.stderr, flush=True)
    ctypes.string_at(0)


def _loop() -> None:
    while True:
        pass


def _sleep() -> None:
    time.sleep(1000)


def _fill_memory() -> None:
    np.ones(1 << 30).sum()


def _refuse() -> None:
    raise GeometryError("expected a polygon, got a line; add a vertex")


def _divide(by: int) -> float:
    return 1 / by


def _leave(pid: str) -> None:
    Path(pid).write_text(str(subprocess.Popen([sys.executable, "-c", "input()"]).pid))
    _sleep()


def _variable(name: str) -> str | None:
    return os.environ.get(name)


def test_a_value_comes_back_however_large_and_whatever_is_printed() -> None:
    for modules in ((), ("numpy",), ("numpy",)):
        found = run_apart(partial(_ones, 1 << 22), SECONDS, MEMORY, modules=modules)
        assert found.shape == (1 << 22,) and (found == 1).all()


def test_an_error_of_the_package_comes_back_as_it_was_raised() -> None:
    with pytest.raises(GeometryError, match="add a vertex"):
        run_apart(_refuse, SECONDS, MEMORY)


@pytest.mark.parametrize("modules", [(), ("numpy",)], ids=["fresh", "forked"])
@pytest.mark.parametrize(
    ("function", "seconds", "failure", "text"),
    [
        pytest.param(_segmentation_fault, SECONDS, "end", "last words", id="dies"),
        pytest.param(_loop, 1.0, "time", "1 s", id="computes for ever"),
        pytest.param(_sleep, 0.1, "time", "0.1 s", id="waits for ever"),
        pytest.param(_fill_memory, SECONDS, "memory", str(MEMORY), id="fills memory"),
        pytest.param(partial(_divide, 0), SECONDS, "error", "ZeroDivisionError", id="raises"),
    ],
)
def test_what_goes_wrong_in_the_child_is_one_error_here(
    function: Any, seconds: float, failure: str, text: str, modules: tuple[str, ...]
) -> None:
    begin = time.monotonic()
    with pytest.raises(ChildError, match=text) as caught:
        run_apart(function, seconds, MEMORY, modules=modules)
    assert caught.value.failure == failure
    assert time.monotonic() - begin < PATIENCE


def _run_again() -> int:
    return run_apart(partial(int, "3"), SECONDS, MEMORY, modules=("numpy",))


@pytest.mark.skipif(sys.platform == "win32", reason="limits are Unix's")
def test_a_limited_process_starts_no_other() -> None:
    assert run_apart(_run_again, SECONDS, MEMORY, modules=("numpy",)) == 3


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_nothing_is_left_of_a_child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    before = _children()
    with pytest.raises(ChildError):
        run_apart(partial(_leave, str(tmp_path / "pid")), 0.5, MEMORY)
    grandchild = int((tmp_path / "pid").read_text())
    deadline = time.monotonic() + PATIENCE  # init may take a moment to collect it
    while _is_alive(grandchild) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not _is_alive(grandchild)
    assert [path.name for path in tmp_path.iterdir()] == ["pid"]
    assert _children() == before


def _children() -> set[str]:
    lists = Path("/proc/self/task").glob("*/children")
    return {child for found in lists for child in found.read_text().split()}


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_variables_are_set_for_the_child_alone() -> None:
    environment = {"POLYWIGNER_APART": "here"}
    found = run_apart(partial(_variable, "POLYWIGNER_APART"), SECONDS, MEMORY, environment)
    assert found == "here" and "POLYWIGNER_APART" not in os.environ
