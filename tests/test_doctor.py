"""Report of ``polywigner doctor``."""

import importlib.metadata
import os
import re
import subprocess
import sys

import pytest

from polywigner.cli import doctor, main
from polywigner.errors import EngineError


def run(**variables):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    environment.pop("POLYWIGNER_NO_LLVM", None)  # may be set for all tests
    return subprocess.run(
        [sys.executable, "-m", "polywigner", "doctor"],
        env={**environment, **variables},
        capture_output=True,
        text=True,
        timeout=300,
    )


def rows_of(output):
    """Return the text of the table in one line, without its borders."""
    return re.sub(r"[^\w/.,:;()<>+='\[\]-]+", " ", output)


def test_it_names_the_libraries_their_versions_and_the_variants(llvm, tmp_path):
    old = tmp_path / "libLLVM-15.so.1"
    old.touch()
    done = run(DRJIT_LIBLLVM_PATH=str(old))
    assert done.returncode == 0, done.stderr
    rows = rows_of(done.stdout)
    assert f"engine llvm yes LLVM {llvm.version} at " in rows
    assert f"refused {old}: LLVM 15 is too old" in rows
    assert re.search("rendering yes .*llvm_ad_mono", rows)
    assert f"mitsuba yes {importlib.metadata.version('mitsuba')}" in rows


@pytest.mark.drjit
def test_without_llvm_all_is_well_but_slow():
    done = run(POLYWIGNER_NO_LLVM="1")
    assert done.returncode == 0  # the transforms work
    rows = rows_of(done.stdout)
    assert "engine numpy yes" in rows and "engine llvm no" in rows and done.stderr == ""
    assert re.search("rendering yes .*scalar_rgb.* hundreds of times slower", rows)
    assert "llvm_ad_mono" not in rows


def test_a_library_that_cannot_be_installed_is_bad_input(monkeypatch, capsys):
    def refuse():
        raise EngineError("no package")

    monkeypatch.setattr(doctor.llvm, "install_llvm", refuse)
    assert main(["doctor", "--install-llvm"]) == 2
    assert capsys.readouterr().err == "polywigner: error: no package\n"


def test_the_extras_are_those_of_the_package():
    subjects = {row.subject for row in doctor._extras()}
    provided = importlib.metadata.metadata("polywigner").get_all("Provides-Extra") or []
    assert subjects == {f"extra {name}" for name in provided}


def test_transforms_that_do_not_work_are_a_failure(monkeypatch, capsys):
    import polywigner as pw

    monkeypatch.setattr(pw, "fourier", lambda *args, **options: 3.9, raising=False)
    child = subprocess.CompletedProcess([], 0, "scalar_rgb", "")
    monkeypatch.setattr(doctor, "run_in_child", lambda script: child)
    assert main(["doctor"]) == 1
    assert "a square of area 4 transforms to 3.9" in capsys.readouterr().out
