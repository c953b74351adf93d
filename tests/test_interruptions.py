"""Ctrl-C ends a command with code 130 and one line, leaves nothing unfinished, and ends a call of
the library by KeyboardInterrupt; whatever Python, or C, is at."""

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
from polywigner.interruption import atomic_path, postponed_interrupts
from polywigner.propagation.stores import write_dataset
from polywigner.propagation.stores_checks import Layout
from polywigner.toolchain.trials import Candidate, judge
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


def _run(script, *words, folder):
    return subprocess.run(
        [sys.executable, "-c", script, *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=_HANGS,
    )


_KILLED = """
import os, signal
from pathlib import Path
from polywigner.interruption import atomic_path
with atomic_path(Path("record.json")) as scratch:
    scratch.write_text("half of it")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_scratch_file_of_a_killed_run_goes_with_the_next_and_of_a_running_one_stays(tmp_path):
    record = tmp_path / "record.json"
    with atomic_path(record) as ours:
        ours.write_text("whole")
        for _ in range(2):
            _run(_KILLED, folder=tmp_path)
            (left,) = set(tmp_path.iterdir()) - {ours}  # one: the second has removed the first
        other = tmp_path / left.name.replace("record", "records")
        other.touch()
        with atomic_path(record) as scratch:
            assert not left.exists() and ours.exists()
            scratch.write_text("whole")
        ours.write_text("whole")
    assert set(tmp_path.iterdir()) == {record, other}


@pytest.mark.parametrize(
    "name", ["shapely.lib", pytest.param("matplotlib.figure", marks=pytest.mark.slow)]
)
def test_an_interrupted_import_ends_the_command_in_one_line(name, tmp_path):
    words = ("transform", str(_CHEVRONS), "--frequency", "94 GHz")
    done = _run(_AT_AN_IMPORT.replace("MODULE", repr(name)), *words, folder=tmp_path)
    assert (done.returncode, done.stderr) == (130, _LINE)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("signals", ["1", "2"], ids=["after a while", "at the second"])
def test_code_that_swallows_the_interrupt_is_ended_with_its_scratch_files(signals, tmp_path):
    done = _run(_DEAF, signals, folder=tmp_path)
    assert (done.returncode, done.stderr) == (130, _LINE)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow  # some seconds: libraries and a plan for many points
def test_an_interrupted_volume_keeps_finished_chunks_only(tmp_path):
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


def test_an_interrupt_within_an_import_comes_after_it():
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

    def __call__(self, origin, shape):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(100_000):
            pw.fourier(pw.shapes.square(1.0), (0.0, 0.0), engine="numpy")
        self.finished.append(1)
        return np.zeros(shape)


def test_a_store_that_is_interrupted_gives_up_the_chunks_it_has_begun(tmp_path):
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


def test_a_trial_of_a_library_that_ctrl_c_has_ended_is_not_remembered(tmp_path, monkeypatch):
    python, library = tmp_path / "python", tmp_path / "libLLVM-19.so"
    library.touch()
    python.write_text("#!/bin/sh\nkill -INT $$\n")
    python.chmod(0o755)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "executable", str(python))
    assert not judge(Candidate(str(library), "environment", (19,))).usable
    assert not (tmp_path / "cache").exists()
