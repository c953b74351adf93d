"""Test, selection and installation of LLVM libraries before Dr.Jit is imported."""

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from polywigner import llvm as module
from polywigner.errors import EngineError

# Simulates LLVM 15 and 16, which print this text and abort at a minimum.
ABORTING_KERNELS = """
import os, sys
print("LLVM ERROR: Cannot select: 0x55: f32 = fminimum 0x56, 0x57", file=sys.stderr, flush=True)
os.abort()
"""


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """An empty system, environment, home and cache."""
    monkeypatch.delenv(module.LIBRARY_VARIABLE, raising=False)
    monkeypatch.delenv(module.OFF_VARIABLE, raising=False)
    for variable in ("XDG_CACHE_HOME", "HOME"):
        monkeypatch.setenv(variable, str(tmp_path / "home"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "environment"))
    monkeypatch.setattr(module, "_SYSTEM_LIBRARIES", (str(tmp_path / "system" / "*"),))
    monkeypatch.setattr(module, "_status", None)
    return tmp_path


def library(folder, name, content="not a library"):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(content)
    return str(path)


@pytest.fixture
def probes(machine, monkeypatch):
    """Return the number of child processes, whose kernels abort."""
    log = machine / "probes"
    note = f"with open({str(log)!r}, 'a') as log: log.write('.')\n"
    monkeypatch.setattr(module, "_KERNELS", note + ABORTING_KERNELS)
    return lambda: len(log.read_text()) if log.exists() else 0


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
        ("/usr/lib64/llvm20/lib64/libLLVM.so", (20,)),
    ],
)
def test_the_name_of_a_library_contains_its_version(name, version):
    assert module.version_of_name(name) == version


def test_a_link_and_its_target_share_the_version_that_one_of_them_contains(tmp_path):
    library(tmp_path, "libLLVM-16.so.1")
    (tmp_path / "libLLVM.so").symlink_to("libLLVM-16.so.1")
    assert module.version_of_name(str(tmp_path / "libLLVM.so")) == (16,)
    # The links are those of Ubuntu 24.04, where libLLVM-18.so links to llvm-18/lib/libLLVM.so.1.
    library(tmp_path / "a", "libLLVM.so.1")
    (tmp_path / "libLLVM-18.so").symlink_to("a/libLLVM.so.1")
    assert module.version_of_name(str(tmp_path / "libLLVM-18.so")) == (18,)


def test_the_variable_comes_first_then_the_environment_then_the_newest_of_the_system(
    machine, monkeypatch
):
    system = [library(machine / "system", f"libLLVM-{n}.so.1") for n in (15, 19, 18)]
    in_environment = library(machine / "environment" / "lib", "libLLVM.so.17.0")
    named = library(machine / "elsewhere", "anything.so")
    monkeypatch.setenv(module.LIBRARY_VARIABLE, named)
    assert module.libraries() == [named, in_environment, system[1], system[2], system[0]]
    link = machine / "system" / "libLLVM-19.so"
    link.symlink_to(system[1])
    assert module.libraries() == [named, in_environment, str(link), system[2], system[0]]


def test_only_linux_needs_libatomic(monkeypatch):
    monkeypatch.setattr(module, "LIBATOMIC", "missing.so")
    monkeypatch.setattr(sys, "platform", "linux")
    assert not module._has_libatomic()
    monkeypatch.setattr(sys, "platform", "darwin")
    assert module._has_libatomic()


def test_a_library_of_an_old_version_is_refused_without_a_probe(machine, probes):
    for name in ("libLLVM-16.so.1", "libLLVM-14.0.6.so.1"):
        _, problem = module.probe(library(machine, name))
        assert "too old" in problem
    assert probes() == 0


def test_a_bad_library_ends_the_child_process_only(bad_llvm, machine, monkeypatch):
    monkeypatch.setattr(module, "version_of_name", lambda path: None)  # only kernels show the fault
    version, problem = module.probe(bad_llvm)
    assert version is None and "end the process: LLVM ERROR" in problem


def test_a_result_is_cached_until_the_library_or_dr_jit_changes(machine, probes, monkeypatch):
    path = library(machine, "libLLVM.so.19.1")
    first = module.probe(path)
    assert "fminimum" in first[1] and module.probe(path) == first
    assert probes() == 1
    (cache,) = (machine / "home").rglob("*.json")
    cache.write_text("{")
    assert module.probe(path) == module.probe(path) == first
    assert probes() == 2
    library(machine, "libLLVM.so.19.1", content="another library")
    module.probe(path)
    assert probes() == 3
    library(machine / "drjit", "__init__.py")
    monkeypatch.syspath_prepend(machine)
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    module.probe(path)
    assert probes() == 4


@pytest.mark.drjit
@pytest.mark.parametrize(
    "kernels", [None, "import time; time.sleep(60)", "import os; os.kill(0, 2)"]
)
def test_a_probe_that_is_interrupted_or_opens_no_library_is_not_cached(
    kernels, machine, monkeypatch
):
    if kernels:
        monkeypatch.setattr(module, "_KERNELS", f"import os; os.setsid(); {kernels}")
        monkeypatch.setattr(module, "_TIME_LIMIT", 0.3)
    version, problem = module.probe(library(machine, "libLLVM.so.19.1"))
    assert version is None and ("Unable to load" in problem if kernels is None else problem)
    assert not list((machine / "home").rglob("*.json"))


def python(code, **variables):
    """Return the last output line of a new Python process, parsed as JSON, and its stderr."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    environment.pop(module.OFF_VARIABLE, None)  # may be set for all tests
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**environment, **variables},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1]), done.stderr


def test_a_bad_library_in_the_variable_is_refused_and_a_good_one_opened(llvm, tmp_path):
    code = """
import json, sys
from dataclasses import asdict
from polywigner.llvm import prepare
assert "drjit" not in sys.modules
status = prepare()
assert prepare() is status and "drjit" not in sys.modules
import drjit as dr, drjit.llvm
version = ".".join(map(str, dr.detail.llvm_version()))
print(json.dumps([asdict(status), version, dr.minimum(drjit.llvm.Float([1, 5]), 2)[1]]))
"""
    named = library(tmp_path, "libLLVM-15.so.1")
    (status, version, two), _ = python(code, DRJIT_LIBLLVM_PATH=named)
    assert status["usable"] and status["problem"] is None and status["remedy"] is None
    assert status["refused"][0][0] == named
    assert (version, two) == (status["version"], 2)


@pytest.mark.drjit
def test_without_llvm_the_transforms_run_and_kernels_are_refused():
    code = """
import json, sys, numpy as np, polywigner as pw
from polywigner.llvm import prepare, require_drjit
square = pw.Aperture([(-1, -1), (1, -1), (1, 1), (-1, 1)])
value = pw.wigner(square, np.zeros((100_000, 2)), (0.0, 0.0))[-1]
try: pw.wigner(square, np.zeros((9, 2)), (0.0, 0.0), engine='llvm')
except pw.errors.EngineError as error: message = str(error)
require_drjit()
print('ready', file=sys.stderr)
import drjit as dr
backend = bool(dr.has_backend(dr.JitBackend.LLVM))
print(json.dumps([prepare().usable, float(value), message, backend]))
"""
    (usable, value, message, backend), errors = python(code, POLYWIGNER_NO_LLVM="1")
    assert not usable and not backend and errors.strip() == "ready"
    # W(0, 0) of a square of side 2: the lag slice has an area of 16.
    assert value == pytest.approx(16.0, rel=1e-12)
    assert "switched off by POLYWIGNER_NO_LLVM. Unset" in message


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bad", "missing"])
def test_dr_jit_imported_first_with_no_good_library_is_refused_before_any_kernel(name, request):
    path = request.getfixturevalue("bad_llvm") if name == "bad" else "/missing.so"
    code = """
import json, drjit, numpy as np, polywigner as pw
square, many = pw.shapes.square(2.0), np.zeros((100_000, 2))
value = float(pw.wigner(square, many, (0.0, 0.0))[0])
try: pw.wigner(square, many, (0.0, 0.0), engine='llvm')
except pw.errors.EngineError as error: print(json.dumps([value, str(error)]))
"""
    (value, message), _ = python(code, DRJIT_LIBLLVM_PATH=path)
    assert value == pytest.approx(16.0, rel=1e-12)  # from NumPy
    assert "imported before polywigner" in message and "Import polywigner before drjit" in message


@pytest.mark.parametrize("tool", ["apt-get", "dnf"])
def test_without_a_usable_library_the_status_names_the_reason_and_the_remedy(
    tool, machine, monkeypatch
):
    Path(library(machine / "bin", tool)).chmod(0o755)
    monkeypatch.setenv("PATH", str(machine / "bin"))
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    monkeypatch.setattr(module, "_has_libatomic", lambda: True)
    paths = [library(machine / "system", f"libLLVM-{n}.so.1") for n in (16, 15)]
    status = module.prepare()
    reason = "LLVM 16 is too old; 17 or newer is required"
    assert not status.usable
    assert status.problem == f"No LLVM library is usable: {paths[0]} ({reason}) and 1 more."
    assert ("--install-llvm" in status.remedy) == (tool == "apt-get")
    assert [path for path, _ in status.refused] == paths
    assert os.environ[module.LIBRARY_VARIABLE] == module.NONE_USABLE


@pytest.fixture
def bare_machine(machine, monkeypatch):
    """A machine without libatomic and LLVM, before Dr.Jit is imported."""
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    monkeypatch.setattr(module, "_has_libatomic", lambda: (machine / "libatomic1").exists())
    monkeypatch.setattr(module, "run_in_child", failing_child)
    return machine


def failing_child(script, library=""):
    return subprocess.CompletedProcess([], 1, "", "NameError: name '_drjit_ext' is not defined")


@pytest.mark.parametrize(("version", "usable"), [((20, 1, 8), True), ((16, 19, 0), False)])
def test_the_library_of_a_loaded_drjit_is_judged_by_its_version(
    machine, monkeypatch, version, usable
):
    loaded = SimpleNamespace(
        has_backend=lambda backend: True,
        JitBackend=SimpleNamespace(LLVM=1),
        detail=SimpleNamespace(llvm_version=lambda: version),
    )
    monkeypatch.setitem(sys.modules, "drjit", loaded)
    status = module.prepare()
    assert status.usable == usable
    assert (status.version if usable else status.problem) is not None
    assert usable or "loaded LLVM 16.19.0, which is too old" in status.problem


def test_the_version_is_the_last_word_that_the_kernels_print(machine, monkeypatch):
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    library(machine / "system", "libLLVM.so")
    child = subprocess.CompletedProcess([], 0, "jit_init(): 1 warning\n20.1.8\n", "")
    monkeypatch.setattr(module, "run_in_child", lambda script, library: child)
    assert module.prepare().version == "20.1.8"
    monkeypatch.setattr(module, "run_in_child", failing_child)
    monkeypatch.setattr(module, "_status", None)
    assert module.prepare().version == "20.1.8"  # as remembered


# --- installation ------------------------------------------------------------------------------


def test_each_supported_version_may_be_installed():
    supported = range(module.OLDEST_VERSION, 22)
    assert {f"libllvm{number}" for number in supported} <= set(module._LLVM)


# Simulates apt-get: finds packages after `update` only, and copies LLVM from a file $LLVM.
APT = """#!/bin/sh
echo "$(basename "$0") $* [$DEBIAN_FRONTEND]" >> "$SYSTEM/diary"
case "$*" in
  update) touch "$SYSTEM/lists" ;;
  madison*)
    if [ -e "$SYSTEM/lists" ]; then
      echo " libatomic1 | 14.2 | mirror"
      if [ "$LLVM" != none ]; then echo "  $LLVM | 1:20.1 | mirror"; fi
    fi ;;
  install*)
    if [ ! -e "$SYSTEM/lists" ]; then echo "E: Unable to locate package." >&2; exit 100; fi
    case "$*" in
      *libatomic1) touch "$SYSTEM/libatomic1" ;;
      *"$LLVM") mkdir -p "$SYSTEM/system" && touch "$SYSTEM/system/libLLVM.so.20" ;;
      *) echo "E: Unable to locate package." >&2; exit 100 ;;
    esac ;;
esac
"""


@pytest.fixture
def apt(bare_machine, monkeypatch):
    """Return the log of the simulated apt-get on a bare machine."""
    for tool in ("apt-get", "apt-cache"):
        Path(library(bare_machine / "bin", tool, APT)).chmod(0o755)
    monkeypatch.setenv("PATH", f"{bare_machine / 'bin'}{os.pathsep}/usr/bin{os.pathsep}/bin")
    monkeypatch.setenv("SYSTEM", str(bare_machine))
    monkeypatch.setenv("LLVM", "libllvm20")
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(module, "probe", lambda path: ("20.1", None))
    diary = bare_machine / "diary"
    return lambda: diary.read_text().splitlines() if diary.exists() else []


def test_root_installs_libatomic_and_the_llvm_that_apt_offers(apt):
    status = module.install_llvm()
    assert status.usable and status.drjit_imports and status.path.endswith("libLLVM.so.20")
    installed = [line for line in apt() if " install " in line]
    assert installed[-1].endswith("libllvm20 [noninteractive]")
    count = len(apt())
    assert module.install_llvm().usable and len(apt()) == count


def test_other_users_get_the_command_for_root(apt, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(EngineError, match=r"libatomic.* `apt-get install libatomic1 libllvm19` as"):
        module.install_llvm()
    assert not any(" install " in line for line in apt())


def test_a_system_without_a_good_llvm_gets_libatomic_at_least(apt, bare_machine, monkeypatch):
    monkeypatch.setenv("LLVM", "none")
    with pytest.raises(EngineError, match="Unable to locate package"):
        module.install_llvm()
    assert (bare_machine / "libatomic1").exists()


def test_a_system_without_apt_is_refused(bare_machine, monkeypatch):
    monkeypatch.setenv("PATH", str(bare_machine))
    with pytest.raises(EngineError, match="Install libatomic1 and libllvm19, or"):
        module.install_llvm()


def test_llvm_that_is_switched_off_is_not_installed(apt, monkeypatch):
    monkeypatch.setenv(module.OFF_VARIABLE, "1")
    with pytest.raises(EngineError, match="Unset POLYWIGNER_NO_LLVM"):
        module.install_llvm()
    assert [line.split()[-2] for line in apt() if " install " in line][-1] == "libatomic1"
