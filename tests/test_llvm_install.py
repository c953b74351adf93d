"""``doctor --install-llvm`` on Debian and Ubuntu, with root and without, against a stand-in for
apt that behaves like the real one: it offers nothing until its lists have been fetched, and it
keeps a diary of what it was asked for."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from polywigner.toolchain.trials import LIBRARY_VARIABLE, native_folders

pytestmark = pytest.mark.slow  # each installs into a system of its own, and tries the library

APT = r"""#!/bin/sh
echo "$(basename "$0") $* [${DEBIAN_FRONTEND}]" >> "$DIARY"
lists=$SYSTEM/lists
for word in "$@"; do
  case "$word" in Dir::State::lists=*) lists=${word#*=} ;; esac
done
case "$*" in
  *update*)
    if [ -e "$SYSTEM/offline" ]; then echo "E: Could not resolve the mirror" >&2; exit 100; fi
    mkdir -p "$lists" && touch "$lists/fetched" ;;
  *madison*)
    if [ -e "$lists/fetched" ]; then
      if [ ! -e "$SYSTEM/old" ]; then
        echo "  libllvm18 | 1:18.1 | mirror"; echo "  libllvm19 | 1:19.1 | mirror"
      fi
      echo " libatomic1 | 14.2 | mirror"
    fi ;;
  *" -s install"*)
    echo "Inst libatomic1 (14.2 Debian [amd64])"
    echo "Inst libc6 [2.36] (2.41 Debian [amd64])"
    case "$*" in *libllvm19*) echo "Inst libllvm19 (1:19.1 Debian [amd64])" ;; esac ;;
  *download*) for word in "$@"; do
      case "$word" in lib*) touch "$word.deb" ;; esac
    done ;;
  *install*) cp "$LIBRARY" "$SYSTEM/usr/libLLVM.so.19.1" ;;
esac
"""

DPKG_DEB = r"""#!/bin/sh
tree=$(mktemp -d)
folder=$tree/usr/lib/x86_64-linux-gnu
mkdir -p "$folder"
case "$2" in
  *libllvm19*)
    cp "$LIBRARY" "$folder/libLLVM.so.19.1"
    ln -s libLLVM.so.19.1 "$folder/libLLVM-19.so"
    ln -s ../../../../gone.so "$folder/libdangling.so" ;;
  *libatomic1*)
    # Where these tests themselves run on unpacked libraries, those are needed here too.
    for file in "$NATIVE"/lib*; do
      case "$file" in *libLLVM*|*"*") ;; *) cp -P "$file" "$folder" ;; esac
    done ;;
  *) echo "E: not asked for: $2" >&2; exit 1 ;;
esac
tar -C "$tree" -cf - .
rm -r "$tree"
"""

# polywigner as it would run in another environment, on another system.
INSTALL = """
import json, os, sys
from dataclasses import asdict
from pathlib import Path
sys.prefix = os.environ["ENVIRONMENT"]
from polywigner.toolchain import debian, trials
from polywigner.toolchain.llvm_install import install_llvm
from polywigner.errors import EngineError
system = os.environ["SYSTEM"]
trials._LINUX_FOLDERS = (f"{system}/usr*",)
trials._linker_cache = list
debian.is_root = lambda: bool(os.environ["ROOT"])
if os.environ["LIBATOMIC"] == "missing":
    from polywigner.toolchain import llvm
    llvm._opens = lambda library: "libatomic" not in library
    llvm.drjit_imports = lambda: "libatomic.so.1: cannot open shared object file"
lines = []
try:
    print(json.dumps([asdict(install_llvm(lines.append)), lines]))
except EngineError as error:
    print(json.dumps([str(error), lines]))
"""


@dataclass(frozen=True)
class Machine:
    """A system with the stand-in for apt, and an environment on it."""

    folder: Path
    library: str

    @property
    def native(self):
        return self.folder / "environment" / "lib" / "polywigner" / "native"

    @property
    def diary(self):
        path = self.folder / "diary"
        return path.read_text().splitlines() if path.exists() else []

    def install(self, *, root, apt=True, libatomic="present"):
        """The status, or the error's text, and what was said on the way."""
        tools = self.folder / "bin"
        tools.mkdir(exist_ok=True)
        for name, script in (("apt-get", APT), ("apt-cache", APT), ("dpkg-deb", DPKG_DEB)):
            if apt:
                (tools / name).write_text(script)
                (tools / name).chmod(0o755)
        (self.folder / "usr").mkdir(exist_ok=True)
        variables = {
            "PATH": f"{tools}{os.pathsep}/usr/bin{os.pathsep}/bin" if apt else str(tools),
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
            "HOME": str(self.folder / "home"),
            "SYSTEM": str(self.folder),
            "ENVIRONMENT": str(self.folder / "environment"),
            "DIARY": str(self.folder / "diary"),
            "LIBRARY": self.library,
            "NATIVE": str(native_folders()[0]),
            "ROOT": "1" if root else "",
            "LIBATOMIC": libatomic,
        }
        done = subprocess.run(
            [sys.executable, "-c", INSTALL],
            env=variables,
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        result, lines = json.loads(done.stdout.splitlines()[-1])
        return result, lines


@pytest.fixture
def machine(tmp_path, llvm):
    return Machine(tmp_path / "with a space", os.path.realpath(llvm.path or ""))


@pytest.fixture(autouse=True)
def folders(tmp_path):
    (tmp_path / "with a space").mkdir()


def test_without_root_the_library_is_unpacked_into_the_environment(machine):
    status, lines = machine.install(root=False)
    assert isinstance(status, dict)
    assert status["usable"]
    assert Path(str(status["path"])).parent == machine.native
    assert any("libatomic1 libllvm19" in line for line in lines)
    # The library, its links that lead somewhere, and the order in which its dependencies open.
    names = {path.name for path in machine.native.iterdir()}
    assert names >= {"libLLVM.so.19.1", "libLLVM-19.so", "order.txt"}
    assert "libdangling.so" not in names
    assert [p.name for p in machine.native.parent.iterdir()] == ["native"]  # nothing half-done


def test_without_root_nothing_of_the_system_is_touched(machine):
    machine.install(root=False)
    installs = [line for line in machine.diary if " install" in line]
    assert installs and all(" -s install" in line for line in installs)
    # Empty lists are fetched into a folder of our own, and the system's libc is left alone.
    (update,) = [line for line in machine.diary if " update" in line]
    assert "Dir::State::lists=" in update and str(machine.folder) not in update
    (download,) = [line for line in machine.diary if " download" in line]
    assert "libc6" not in download


IMPORT_DRJIT_FIRST = """
import json, os, site, sys
sys.prefix = os.environ["ENVIRONMENT"]
from polywigner.toolchain import trials
trials._LINUX_FOLDERS = ()
trials._linker_cache = list
site.addsitedir(os.environ["PACKAGES"])
import drjit as dr
from drjit.llvm import Float
print(json.dumps([os.environ["DRJIT_LIBLLVM_PATH"], dr.minimum(Float([1, 5]), 2)[1]]))
"""


def test_without_root_dr_jit_may_be_imported_before_polywigner(machine):
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = machine.folder / "environment" / "lib" / version / "site-packages"
    packages.mkdir(parents=True)
    machine.install(root=False)
    variables = {name: value for name, value in os.environ.items() if name != LIBRARY_VARIABLE}
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_DRJIT_FIRST],
        env={
            **variables,
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
            "ENVIRONMENT": str(machine.folder / "environment"),
            "PACKAGES": str(packages),
        },
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    path, two = json.loads(done.stdout.splitlines()[-1])
    assert Path(path).parent == machine.native
    assert two == 2


def test_as_root_the_packages_are_installed(machine, drjit_by_itself):
    status, _ = machine.install(root=True)
    assert isinstance(status, dict)
    assert status["usable"]
    assert status["path"] == str(machine.folder / "usr" / "libLLVM.so.19.1")
    asked = [line for line in machine.diary if "install -y" in line]
    assert asked[-1].endswith("libllvm19 libatomic1 [noninteractive]")
    assert not machine.native.exists()


@pytest.mark.drjit
def test_a_library_that_is_not_usable_leaves_everything_as_it_was(tmp_path, drjit_by_itself):
    rubbish = tmp_path / "rubbish"
    rubbish.write_text("not a library")
    machine = Machine(tmp_path / "with a space", str(rubbish))
    machine.native.mkdir(parents=True)
    (machine.native / "kept").touch()
    message, _ = machine.install(root=False)
    assert isinstance(message, str)
    assert "libLLVM.so.19.1 was unpacked but" in message
    assert [p.name for p in machine.native.iterdir()] == ["kept"]
    assert [p.name for p in machine.native.parent.iterdir()] == ["native"]


@pytest.mark.drjit
@pytest.mark.parametrize("root", [False, True])
def test_a_machine_that_is_offline_is_told_what_can_be_done_without(root, tmp_path):
    machine = Machine(tmp_path / "with a space", os.devnull)
    (machine.folder / "offline").touch()
    message, _ = machine.install(root=root)
    assert isinstance(message, str)
    assert "Could not resolve the mirror" in message
    assert "scalar_rgb" in message and "NumPy" in message


@pytest.mark.drjit
def test_a_system_whose_llvm_is_too_old_gets_libatomic_at_least(tmp_path):
    machine = Machine(tmp_path / "with a space", os.devnull)
    (machine.folder / "old").touch()
    message, lines = machine.install(root=True, libatomic="missing")
    assert isinstance(message, str)
    assert message.startswith("no LLVM library could be brought: apt offers no libllvm19")
    assert "Installed libatomic1." in lines
