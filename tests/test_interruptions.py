"""Ctrl-C ends a command with code 130 and one line, leaves nothing unfinished, and ends a call of
the library by KeyboardInterrupt; whatever Python, or C, is at."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from polywigner.interruption import postponed_interrupts
from polywigner.propagation.stores import write_dataset
from polywigner.propagation.stores_checks import Layout
from polywigner.toolchain.llvm_discovery import Candidate
from polywigner.toolchain.trials import judge
from polywigner.transforms.xarray_arguments import labelled_array

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of Unix")

# Seconds after which a process is taken to hang; an answer comes within two.
_HANGS = 20.0
_LINE = "polywigner: interrupted\n"
_CHEVRONS = Path(__file__).parent.parent / "examples" / "two_chevrons" / "chevrons.geojson"

_AT_AN_IMPORT = """
import os, signal, sys
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == MODULE:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupts())
from polywigner.cli import main
sys.exit(main())
"""

_DEAF = """
import os, signal, sys, time
from pathlib import Path
from polywigner.interruption import answer_interrupts, temporary_folder, unfinished
answer_interrupts()
with unfinished(Path("table.npz.1.partial")), temporary_folder(Path()) as folder:
    Path("table.npz.1.partial").write_text("half of it")
    Path(folder, "scratch").write_text("more")
    for _ in range(int(sys.argv[1])):
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(60)
        except KeyboardInterrupt:  # as code in C may do
            pass
    while True:
        time.sleep(60)
"""


def _run(script: str, *words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", script, *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=_HANGS,
    )


@pytest.mark.parametrize("name", ["numpy", "shapely.lib", "matplotlib.figure"])
def test_an_interrupted_import_ends_the_command_in_one_line(name: str, tmp_path: Path) -> None:
    words = ("transform", str(_CHEVRONS), "--frequency", "94 GHz")
    done = _run(_AT_AN_IMPORT.replace("MODULE", repr(name)), *words, folder=tmp_path)
    assert (done.returncode, done.stderr) == (130, _LINE)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("signals", ["1", "2"], ids=["after a while", "at the second"])
def test_code_that_swallows_the_interrupt_is_ended_with_its_scratch_files(
    signals: str, tmp_path: Path
) -> None:
    done = _run(_DEAF, signals, folder=tmp_path)
    assert (done.returncode, done.stderr) == (130, _LINE)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow  # some seconds: libraries and a plan for many points
def test_an_interrupted_volume_keeps_finished_chunks_only(tmp_path: Path) -> None:
    pytest.importorskip("zarr", reason="the extra `volume` is not installed")
    pytest.importorskip("dask", reason="the extra `volume` is not installed")
    command = [sys.executable, "-m", "polywigner", "volume", str(_CHEVRONS)]
    command += ["--frequency", "94 GHz", "--engine", "numpy", "--method", "kirchhoff"]
    command += ["--box", "-40 mm to 40 mm, -40 mm to 40 mm, 2 mm to 120 mm"]
    command += ["--shape", "500 x 500 x 500", "--out", "field"]
    store = tmp_path / "field.zarr"
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as run:
        while run.poll() is None and not store.exists():
            time.sleep(0.01)
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate(timeout=_HANGS)
    assert (run.returncode, errors) == (130, _LINE)
    assert not list(tmp_path.rglob("*.partial*"))


def test_an_interrupt_within_an_import_comes_after_it() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), postponed_interrupts():
        os.kill(os.getpid(), signal.SIGINT)
        done.append("all of it")
    assert done
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@dataclass(frozen=True)
class Endless:
    """A block that is computed in many calls, and interrupts the process in the first of them."""

    finished: list[int]

    def __call__(self, origin: tuple[int, ...], shape: tuple[int, ...]) -> np.ndarray:
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(100_000):
            pw.fourier(pw.shapes.square(1.0), (0.0, 0.0), engine="numpy")
        self.finished.append(1)
        return np.zeros(shape)


def test_a_store_that_is_interrupted_gives_up_the_chunks_it_has_begun(tmp_path: Path) -> None:
    pytest.importorskip("zarr", reason="the extra `volume` is not installed")
    pytest.importorskip("dask", reason="the extra `volume` is not installed")
    axis = labelled_array(np.arange(4.0), ("x",), {"units": "m"})
    layout = Layout("field", "float64", {"x": axis}, (1,), {}, {})
    finished: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        write_dataset(
            tmp_path / "field.zarr", layout, Endless(finished), {}, exclusive=False, threads=1
        )
    assert not finished and not list(tmp_path.iterdir())


def test_a_trial_of_a_library_that_ctrl_c_has_ended_is_not_remembered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    python, library = tmp_path / "python", tmp_path / "libLLVM-19.so"
    library.touch()
    python.write_text("#!/bin/sh\nkill -INT $$\n")
    python.chmod(0o755)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "executable", str(python))
    assert not judge(Candidate(str(library), "environment", (19,))).usable
    assert not (tmp_path / "cache").exists()
