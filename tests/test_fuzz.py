"""Seventy damaged files of all formats: each is read, or refused with one clear error.

`make fuzz` makes ten thousand.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).resolve().parent.parent / "tools" / "fuzz"
COUNT = 70

pytest.importorskip("ezdxf")
pytest.importorskip("trimesh")


@pytest.mark.slow
def test_a_case_is_the_same_file_each_time():
    code = (
        "import hashlib, sys; sys.path.insert(0, sys.argv[1]);"
        "from fuzz_files import FORMATS, case;"
        "files = [case(1, n, list(FORMATS))[2] for n in range(30)];"
        "print(hashlib.sha256(b''.join(files)).hexdigest())"
    )
    command = [sys.executable, "-c", code, str(FUZZ.parent)]
    first, second = (
        subprocess.run(
            command, capture_output=True, text=True, env={**os.environ, "PYTHONHASHSEED": order}
        )
        for order in ("1", "2")
    )
    assert first.returncode == 0, first.stderr
    assert first.stdout == second.stdout


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="limits of time and memory are Unix's")
def test_damaged_files_are_read_or_refused_but_break_nothing(tmp_path):
    command = [sys.executable, str(FUZZ), "--count", str(COUNT), "--keep", str(tmp_path)]
    command += ["--hostile", "toml long key"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"\n{COUNT} files in " in done.stdout
    assert not list(tmp_path.iterdir())
