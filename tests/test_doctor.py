"""``polywigner doctor`` says what works here, and for each thing missing the command for it."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
from pathlib import Path

import pytest

from polywigner.cli import doctor
from polywigner.toolchain.llvm import LLVMStatus
from polywigner.toolchain.trials import GPUStatus


def run(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    environment.pop("POLYWIGNER_NO_LLVM", None)  # a whole run may have it set
    return subprocess.run(
        [sys.executable, "-m", "polywigner.cli", "doctor", *arguments],
        env={**environment, **variables},
        capture_output=True,
        text=True,
        timeout=300,
    )


def row_of(output: str, subject: str) -> str:
    """The text of one row of the table, its lines joined."""
    rows: list[list[str]] = []
    for line in output.splitlines():
        cells = [cell.strip() for cell in line.split("│")]
        if len(cells) < 5:
            continue
        if cells[1]:
            rows.append(cells[1:4])
        else:
            rows[-1][2] += " " + cells[3]
    (found,) = [" ".join(cells) for cells in rows if cells[0] == subject]
    return found


def test_it_names_the_library_its_version_and_the_variants(llvm: LLVMStatus) -> None:
    done = run()
    assert done.returncode == 0, done.stderr
    row = row_of(done.stdout, "engine llvm")
    assert "yes" in row and f"LLVM {llvm.version} at {llvm.path}" in row
    assert "llvm_ad_mono" in row_of(done.stdout, "rendering")
    assert importlib.metadata.version("mitsuba") in row_of(done.stdout, "mitsuba")


@pytest.mark.drjit
def test_without_llvm_all_is_well_but_slow() -> None:
    done = run(POLYWIGNER_NO_LLVM="1")
    assert done.returncode == 0  # the transforms work
    assert "yes" in row_of(done.stdout, "engine numpy")
    assert "no" in row_of(done.stdout, "engine llvm").split()
    rendering = row_of(done.stdout, "rendering")
    assert "scalar_rgb" in rendering and "llvm_ad_mono" not in rendering
    assert "hundreds of times slower" in rendering
    assert done.stderr == ""


@pytest.mark.slow
@pytest.mark.drjit
def test_a_refused_library_is_listed_with_the_reason(tmp_path: Path) -> None:
    old = tmp_path / "libLLVM-15.so.1"
    old.touch()
    row = row_of(run(DRJIT_LIBLLVM_PATH=str(old)).stdout, "engine llvm")
    assert f"refused {old}: LLVM 15 is too old" in row


def test_a_library_that_cannot_be_brought_is_bad_input_not_a_crash() -> None:
    done = run("--install-llvm", POLYWIGNER_NO_LLVM="1")
    assert done.returncode == 2
    assert done.stderr.startswith("polywigner: error: ") and done.stderr.count("\n") == 1


def test_the_gpu_row_tells_a_broken_driver_from_no_gpu() -> None:
    none = doctor._gpu(GPUStatus(False, problem="no NVIDIA GPU answers", remedy="bring one"))
    broken = doctor._gpu(GPUStatus(False, "H100, driver 470", "its kernels do not run", "update"))
    fine = doctor._gpu(GPUStatus(True, "H100, driver 550"))
    assert [none.works, broken.works, fine.works] == ["-", "no", "yes"]
    assert broken.remedy == "update" and fine.found == "H100, driver 550"


def test_a_missing_extra_is_named_with_the_command_that_brings_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "mpmath" else "1.0")
    row = doctor._extra("test", ["pytest", "mpmath"])
    assert row.works == "-"
    assert row.found == "missing: mpmath"
    assert row.remedy == 'Run `pip install ".[test]"` in a clone of polywigner.'


def test_the_extras_are_those_of_the_package() -> None:
    subjects = {row.subject for row in doctor._extras()}
    provided = importlib.metadata.metadata("polywigner").get_all("Provides-Extra") or []
    assert subjects == {f"extra {name}" for name in provided}


def test_a_missing_library_is_named_with_its_version_bounds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "mitsuba" else "1.0")
    (row,) = [row for row in doctor._libraries() if row.subject == "mitsuba"]
    assert row.works == "no"
    assert "pip install 'mitsuba" in row.remedy and "<3.10" in row.remedy


def test_a_mitsuba_that_ends_its_process_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(doctor, "run_probe", lambda script: (-11, "", ""))
    row = doctor._mitsuba(LLVMStatus(True, "/x", "19"), GPUStatus(False))
    assert row.works == "no" and "status -11" in row.found


def test_transforms_that_do_not_work_are_a_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import polywigner as pw

    monkeypatch.setattr(pw, "fourier", lambda *args, **options: 3.9, raising=False)
    monkeypatch.setattr(doctor, "look_for_gpu", lambda: GPUStatus(False, problem="none"))
    monkeypatch.setattr(doctor, "run_probe", lambda script: (0, "scalar_rgb", ""))
    assert doctor.run_doctor(False) == 1
    assert "a square of area 4 transforms to 3.9" in capsys.readouterr().out
