"""The LLVM library is found, tried out in a child process, and chosen before Dr.Jit is imported.

What concerns a whole process (Dr.Jit opens one library, once) is tested in processes of its own.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from polywigner.toolchain import llvm as llvm_module
from polywigner.toolchain import trials as verdicts
from polywigner.toolchain.trials import Candidate, Verdict, judge, version_of_name

# Stands in for a library that compiles a minimum into nothing: what LLVM 15 and 16 print and do.
ABORTING_KERNELS = """
import os, sys
print("LLVM ERROR: Cannot select: 0x55: f32 = fminimum 0x56, 0x57", file=sys.stderr, flush=True)
os.abort()
"""


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """A cache folder of the test's own: no verdict is known, and none is left behind."""
    for variable in ("XDG_CACHE_HOME", "LOCALAPPDATA", "HOME"):
        monkeypatch.setenv(variable, str(tmp_path / "home"))
    return verdicts.cache_folder() / "llvm"


def python(code, **variables):
    """What a fresh Python process prints last, as JSON; it must end well."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    environment.pop(verdicts.OFF_VARIABLE, None)  # a whole run may have it set
    environment.update(variables)
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


def library(folder, name, content="not a library"):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(content)
    return str(path)


@pytest.fixture
def trials(tmp_path, monkeypatch):
    """How many processes have tried out a library so far; in each the kernels end the process."""
    log = tmp_path / "trials"
    note = f"with open({str(log)!r}, 'a') as log: log.write('.')\n"
    monkeypatch.setattr(verdicts, "_KERNELS", note + ABORTING_KERNELS)
    return lambda: len(log.read_text()) if log.exists() else 0


@pytest.fixture
def bare_system(tmp_path, monkeypatch):
    """A system folder and an environment of the test's own, both empty, and nothing named."""
    monkeypatch.delenv(verdicts.LIBRARY_VARIABLE, raising=False)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "environment"))
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(verdicts, "_LINUX_FOLDERS", (str(tmp_path / "system" / "*"),))
    monkeypatch.setattr(verdicts, "_linker_cache", list)
    return tmp_path / "system" / "x86_64-linux-gnu"


# --- discovery ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("/nowhere/libLLVM-15.so.1", (15,)),
        ("/nowhere/libLLVM-14.0.6.so.1", (14, 0, 6)),
        ("/nowhere/libLLVM.so.19.1", (19, 1)),
        ("/nowhere/llvm-18/lib/libLLVM.so.1", (18,)),
        ("/nowhere/libLLVM-18.so.18.1", (18,)),
        ("/nowhere/libLLVM.so.1", None),
        ("/nowhere/llvm@17/lib/libLLVM.dylib", (17,)),
    ],
)
def test_a_name_tells_the_version(name, version):
    assert version_of_name(name) == version


def test_of_a_link_and_its_target_the_one_with_a_version_tells(tmp_path):
    library(tmp_path, "libLLVM-16.so.1")
    (tmp_path / "libLLVM.so").symlink_to("libLLVM-16.so.1")
    assert version_of_name(str(tmp_path / "libLLVM.so")) == (16,)
    # as on Ubuntu 24.04, where libLLVM-18.so leads to llvm-18/lib/libLLVM.so.1
    library(tmp_path / "a", "libLLVM.so.1")
    (tmp_path / "libLLVM-18.so").symlink_to("a/libLLVM.so.1")
    assert version_of_name(str(tmp_path / "libLLVM-18.so")) == (18,)


def test_the_variable_comes_first_then_the_environment_then_the_newest_of_the_system(
    bare_system, tmp_path, monkeypatch
):
    old = library(bare_system, "libLLVM-15.so.1")
    new = library(bare_system, "libLLVM.so.19.1")
    middle = library(bare_system, "libLLVM-18.so.1")
    own = library(tmp_path / "environment" / "lib" / "polywigner" / "native", "libLLVM.so.17")
    named = library(tmp_path / "elsewhere", "anything.so")
    monkeypatch.setenv(verdicts.LIBRARY_VARIABLE, named)
    assert [c.path for c in verdicts.candidates()] == [named, own, new, middle, old]


@pytest.mark.parametrize(
    ("platform", "tools", "command"),
    [
        ("darwin", (), "brew install llvm"),
        ("win32", (), "winget install"),
        ("linux", ("apt-get",), "polywigner doctor --install-llvm"),
        ("linux", ("dnf",), "dnf install llvm-libs"),
        ("linux", (), verdicts.LIBRARY_VARIABLE),
    ],
)
def test_the_remedy_is_one_sentence_with_this_systems_command(
    platform, tools, command, monkeypatch
):
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(verdicts.shutil, "which", lambda tool: tool if tool in tools else None)
    text = verdicts.remedy()
    assert command in text
    assert text.endswith(".") and text.count(". ") == 0


# --- verdicts ----------------------------------------------------------------------------------


def test_libraries_too_old_by_their_names_or_gone_are_refused_without_a_trial(tmp_path, trials):
    for name in ("libLLVM-16.so.1", "libLLVM-14.0.6.so.1"):
        path = library(tmp_path, name)
        verdict = judge(Candidate(path, "system", version_of_name(path)))
        assert not verdict.usable
        assert "too old" in (verdict.reason or "")
    verdict = judge(Candidate(str(tmp_path / "libLLVM.so.19.1"), "variable", (19, 1)))
    assert verdict == Verdict(False, None, "there is no such file")
    assert trials() == 0


def test_a_bad_library_ends_the_trial_but_not_this_process(bad_llvm, monkeypatch):
    # Its name hidden, so that only the trial can tell.
    verdict = judge(Candidate(bad_llvm, "system", None))
    assert not verdict.usable
    assert "end the process" in (verdict.reason or "")


@pytest.mark.drjit
def test_a_file_that_is_no_library_is_refused_for_now(own_cache, tmp_path):
    path = library(tmp_path, "libLLVM.so.19.1")
    verdict = judge(Candidate(path, "system", (19, 1)))
    assert not verdict.usable
    assert verdict.reason and path not in verdict.reason.replace(f"{path}:", "")
    # What could not be opened may have lacked a library that will be there tomorrow.
    assert not own_cache.exists()


def test_a_verdict_is_remembered_until_the_library_changes(
    own_cache, tmp_path, trials, monkeypatch
):
    path = library(tmp_path, "libLLVM.so.19.1")
    candidate = Candidate(path, "system", (19, 1))
    first = judge(candidate)
    assert not first.usable and "fminimum" in (first.reason or "")
    assert judge(candidate) == first
    assert trials() == 1
    library(tmp_path, "libLLVM.so.19.1", content="another library")
    judge(candidate)
    assert trials() == 2
    monkeypatch.setattr(verdicts, "drjit_release", lambda: "another Dr.Jit")
    judge(candidate)
    assert trials() == 3


@pytest.mark.parametrize("spoilt", [b"{", b'{"usable": true, "colour": "red"}'])
def test_a_spoilt_cache_is_as_good_as_none(spoilt, own_cache, tmp_path, monkeypatch):
    monkeypatch.setattr(verdicts, "_KERNELS", ABORTING_KERNELS)
    candidate = Candidate(library(tmp_path, "libLLVM.so.19.1"), "system", (19, 1))
    expected = judge(candidate)
    (entry,) = own_cache.iterdir()
    entry.write_bytes(spoilt)
    assert judge(candidate) == expected
    assert json.loads(entry.read_bytes())["usable"] is False


def test_a_trial_that_takes_too_long_is_no_lasting_verdict(own_cache, tmp_path, monkeypatch):
    monkeypatch.setattr(verdicts, "_KERNELS", "import time; time.sleep(60)")
    monkeypatch.setattr(verdicts, "_SECONDS", 0.1)
    verdict = judge(Candidate(library(tmp_path, "libLLVM.so.19.1"), "system", (19, 1)))
    assert not verdict.usable and "longer than" in (verdict.reason or "")
    assert not own_cache.exists()


# --- choosing ----------------------------------------------------------------------------------

CHOOSE = """
import json, sys
from dataclasses import asdict
from polywigner.toolchain.llvm import prepare
assert "drjit" not in sys.modules
status = prepare()
assert prepare() is status and "drjit" not in sys.modules
"""


def test_dr_jit_opens_the_library_that_was_chosen(llvm):
    code = CHOOSE + (
        "import drjit as dr\n"
        "lines = open('/proc/self/maps') if sys.platform == 'linux' else []\n"
        "opened = {line.rstrip().split(maxsplit=5)[-1] for line in lines if 'libLLVM' in line}\n"
        "version = '.'.join(map(str, dr.detail.llvm_version()))\n"
        "print(json.dumps([asdict(status), sorted(opened), version]))"
    )
    status, opened, version = python(code)
    assert status["usable"] and status["problem"] is None and status["remedy"] is None
    if sys.platform == "linux":
        assert opened == [os.path.realpath(status["path"])]
    assert version == status["version"]


def test_a_bad_library_that_the_variable_names_is_passed_over(llvm, tmp_path):
    named = library(tmp_path, "libLLVM-15.so.1")
    native = tmp_path / "environment" / "lib" / "polywigner" / "native"
    native.mkdir(parents=True)
    for file in Path(llvm.path or "").parent.glob("*"):  # with what an unpacked one needs
        if file.name.startswith("libLLVM") or file.parent.name == "native":
            (native / file.name).symlink_to(file)
    code = f"import sys; sys.prefix = {str(tmp_path / 'environment')!r}" + CHOOSE
    code += "import drjit as dr, drjit.llvm as l\n"
    code += "two = dr.minimum(l.Float([1, 5]), 2)[1]\n"
    code += "print(json.dumps([status.path, status.passed_over, two]))"
    path, passed_over, two = python(code, DRJIT_LIBLLVM_PATH=named)
    assert os.path.realpath(path) == os.path.realpath(llvm.path or "")
    assert [refused for refused, _ in passed_over] == [named]
    assert two == 2


@pytest.mark.drjit
def test_without_llvm_the_transforms_run_and_kernels_are_refused():
    code = CHOOSE + (
        "import numpy as np, polywigner as pw\n"
        "from polywigner.toolchain.llvm import require\n"
        "from polywigner.errors import EngineError\n"
        "square = pw.Aperture([(-1, -1), (1, -1), (1, 1), (-1, 1)])\n"
        "many = np.zeros((100_000, 2))\n"
        "values = pw.wigner(square, many, (0.0, 0.0))\n"
        "complaints = []\n"
        "for ask in (require, lambda: pw.wigner(square, many, (0.0, 0.0), engine='llvm')):\n"
        "    try: ask()\n"
        "    except EngineError as error: complaints.append(str(error))\n"
        "import drjit as dr\n"
        "backend = bool(dr.has_backend(dr.JitBackend.LLVM))\n"
        "print(json.dumps([asdict(status), float(values[-1]), complaints, backend]))"
    )
    status, value, complaints, backend = python(code, POLYWIGNER_NO_LLVM="1")
    assert not status["usable"] and not backend
    # W(0, 0) of a square of side 2: the lag slice is twice the square, of area 16.
    assert value == pytest.approx(16.0, rel=1e-12)
    assert complaints == [f"{status['problem']} {status['remedy']}"] * 2


@pytest.mark.slow
def test_dr_jit_imported_first_with_a_bad_library_is_refused_before_any_kernel(
    bad_llvm, drjit_by_itself
):
    code = (
        "import json, drjit, numpy as np, polywigner as pw\n"
        "from polywigner.errors import EngineError\n"
        "square = pw.Aperture([(-1, -1), (1, -1), (1, 1), (-1, 1)])\n"
        "many = np.zeros((100_000, 2))\n"
        "value = float(pw.wigner(square, many, (0.0, 0.0))[0])\n"
        "try: pw.wigner(square, many, (0.0, 0.0), engine='llvm')\n"
        "except EngineError as error: print(json.dumps([value, str(error)]))"
    )
    value, message = python(code, DRJIT_LIBLLVM_PATH=bad_llvm)
    assert value == pytest.approx(16.0, rel=1e-12)  # by NumPy
    assert "imported before polywigner" in message
    assert "Import polywigner before drjit" in message


def test_a_missing_libatomic_is_named(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(llvm_module, "_opens", lambda library: "libatomic" not in library)
    monkeypatch.setattr(
        llvm_module, "drjit_imports", lambda: "NameError: name '_drjit_ext' is not defined"
    )
    status = llvm_module._find()
    assert not status.usable and not status.drjit_imports
    assert "libatomic1" in (status.remedy or "")


@pytest.mark.drjit
def test_without_llvm_dr_jit_is_imported_without_a_word_on_stderr():
    code = (
        "import sys; sys.stderr.write('before. ')\n"
        "from polywigner.toolchain.llvm import require_drjit\n"
        "usable = require_drjit().usable\n"
        "import drjit; sys.stderr.write('after.')\n"
        "print(usable)"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**environment, verdicts.OFF_VARIABLE: "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert (done.stdout.strip(), done.stderr) == ("False", "before. after.")


@pytest.mark.slow
def test_dr_jit_imported_first_without_a_library_is_told_of_the_usable_one(
    llvm, drjit_by_itself, tmp_path
):
    code = (
        "import json, os, drjit\n"
        f"os.environ['DRJIT_LIBLLVM_PATH'] = {llvm.path!r}\n"  # too late: Dr.Jit has looked
        "from polywigner.toolchain.llvm import prepare, require\n"
        "from polywigner.errors import EngineError\n"
        "try: require()\n"
        "except EngineError as error: print(json.dumps([prepare().usable, str(error)]))"
    )
    usable, message = python(code, DRJIT_LIBLLVM_PATH=str(tmp_path / "none.so"))
    assert not usable
    assert "imported before polywigner" in message
    assert f"(to {llvm.path})" in message
