"""LLVM libraries and GPUs: where they are, how to get one, and whether it is usable.

Dr.Jit brings no LLVM of its own: it opens a shared library of the system at import. A bad library,
or driver, does not raise: it ends the process. So nothing is believed of it until a child process
has compiled and run a few kernels. The verdict on a library is kept in the user's cache folder
under a key that changes with the library, with Dr.Jit and with the machine.
"""

from __future__ import annotations

import contextlib
import glob
import hashlib
import importlib.util
import json
import os
import platform
import re
import shutil
import signal
import site
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from polywigner.interruption import atomic_path, temporary_folder

LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
"""The variable in which Dr.Jit looks for the library's path, once, when it is first imported."""

OFF_VARIABLE = "POLYWIGNER_NO_LLVM"
"""Set to 1, this makes polywigner act as on a machine without LLVM."""

NONE_USABLE = "/no usable LLVM library; see `polywigner doctor`"
"""Given to Dr.Jit as the path when no library is usable.

Left to itself Dr.Jit would open whatever libLLVM lies in the system's folders, a bad one too, and
its first kernel would end the process. It prints this text when it cannot open the "file".
"""

OLDEST_VERSION = (17,)
"""Older libraries are refused by name: 15.0.6 and 16.0.6 end the process when they compile a
minimum or a maximum ("Cannot select: fminimum"), and 14 lacks opaque pointers."""

LIBATOMIC = "libatomic.so.1"
"""Dr.Jit's Linux wheels need it, and bare Debian lacks it: then ``import drjit`` dies with a
``NameError`` that names neither."""

OPENING_ORDER = "order.txt"
"""A file in a native folder that lists an unpacked LLVM's dependencies, one name per line."""

_LINUX_FOLDERS = (
    "/usr/lib/*-linux-gnu*",  # Debian's multiarch folders
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib*",
    "/usr/lib",
    "/usr/local/lib",
)
_MACOS_FOLDERS = (
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
    "/opt/local/libexec/llvm-*/lib",  # MacPorts
)
_WINDOWS_FOLDERS = (r"C:\Program Files\LLVM\bin", r"C:\Program Files (x86)\LLVM\bin")


@dataclass(frozen=True)
class Candidate:
    """A file that may be a usable LLVM library."""

    path: str
    origin: str
    """``"variable"`` (named by DRJIT_LIBLLVM_PATH), ``"environment"`` or ``"system"``."""
    version: tuple[int, ...] | None
    """As far as the file's name tells."""


def candidates() -> list[Candidate]:
    """Every candidate, best first: the variable's, the environment's, the system's newest first."""
    found: dict[str, Candidate] = {}
    named = os.environ.get(LIBRARY_VARIABLE, "")
    if named and named != NONE_USABLE:
        # a link to a system library perhaps: one candidate per file
        own = Candidate(named, "variable", version_of_name(named))
        found[os.path.realpath(named)] = own
    library_folder = r"Library\bin" if sys.platform == "win32" else "lib"
    environment = [*native_folders(), Path(sys.prefix) / library_folder]
    for origin, paths in (
        ("environment", [p for folder in environment for p in _libraries_in(str(folder))]),
        ("system", _system_libraries()),
    ):
        group = [Candidate(path, origin, version_of_name(path)) for path in paths]
        for candidate in sorted(group, key=lambda c: c.version or (), reverse=True):
            found.setdefault(os.path.realpath(candidate.path), candidate)
    return list(found.values())


def native_folders() -> list[Path]:
    """The folders that ``polywigner doctor --install-llvm`` fills, the environment's first."""
    folders = [Path(sys.prefix) / "lib" / "polywigner" / "native"]
    if sys.prefix == sys.base_prefix:  # outside a virtual environment: the user's own folder
        base = getattr(site, "getuserbase", lambda: None)()
        folders += [Path(base) / "lib" / "polywigner" / "native"] if base else []
    return folders


def native_libatomic() -> list[str]:
    """The unpacked libatomic, if there is one."""
    files = (folder / LIBATOMIC for folder in native_folders())
    return [str(file) for file in files if file.is_file()][:1]


def version_of_name(path: str) -> tuple[int, ...] | None:
    """The version that a library's file name, its link's target or its folder states.

    ``libLLVM-15.so.1`` is version 15 (the last figure counts ABI revisions), ``libLLVM.so.19.1``
    is 19.1, ``/usr/lib/llvm-18/lib/libLLVM.so.1`` is 18 (the file name tells nothing).
    """
    real = Path(os.path.realpath(path))
    for name in (real.name, Path(path).name):
        match = re.match(r"libLLVM-(\d+(?:\.\d+)*)", name) or re.match(
            r"libLLVM\.(?:so\.)?(\d\d+(?:\.\d+)*)", name
        )
        if match:
            return tuple(int(figure) for figure in match.group(1).split("."))
    folder = re.search(r"llvm[-@](\d+)", f"{real.parent} {Path(path).parent}")
    return (int(folder.group(1)),) if folder else None


def remedy() -> str:
    """One sentence: the command that brings a usable LLVM library to this machine."""
    if sys.platform == "darwin":
        return "Run `brew install llvm` to install one."
    if sys.platform == "win32":
        return f"Run `winget install LLVM.LLVM`, or set {LIBRARY_VARIABLE} to an LLVM-C.dll."
    if shutil.which("apt-get"):
        return "Run `polywigner doctor --install-llvm` to install one."
    oldest = OLDEST_VERSION[0]
    for tool, command in (
        ("dnf", "sudo dnf install llvm-libs"),
        ("pacman", "sudo pacman -S llvm-libs"),
        ("zypper", "sudo zypper install libLLVM19"),
        ("apk", "sudo apk add llvm19-libs"),
        ("conda", "conda install -c conda-forge libllvm19"),
    ):
        if shutil.which(tool):
            return f"Run `{command}` to install one, or set {LIBRARY_VARIABLE} to a libLLVM.so."
    return f"Install LLVM {oldest} or newer, or set {LIBRARY_VARIABLE} to its shared library."


def _libraries_in(folder: str) -> list[str]:
    patterns = {"darwin": ["libLLVM*.dylib"], "win32": ["LLVM-C.dll"]}
    names = patterns.get(sys.platform, ["libLLVM*.so", "libLLVM*.so.*"])
    # The folder may itself be a pattern; an environment's path is taken literally.
    base = folder if folder.startswith(_patterned_folders()) else glob.escape(folder)
    return sorted(path for name in names for path in glob.glob(os.path.join(base, name)))  # noqa: PTH118, PTH207


def _patterned_folders() -> tuple[str, ...]:
    return {"darwin": _MACOS_FOLDERS, "win32": _WINDOWS_FOLDERS}.get(sys.platform, _LINUX_FOLDERS)


def _system_libraries() -> list[str]:
    paths = [path for folder in _patterned_folders() for path in _libraries_in(folder)]
    if sys.platform == "win32":
        search = os.environ.get("PATH", "").split(os.pathsep)
        return paths + [path for folder in search if folder for path in _libraries_in(folder)]
    return paths + _linker_cache() if sys.platform == "linux" else paths


def _linker_cache() -> list[str]:
    """libLLVM files that the dynamic linker knows, as from /etc/ld.so.conf.d."""
    import subprocess  # slow to import, and not needed where a variable names the library

    tool = shutil.which("ldconfig") or "/sbin/ldconfig"
    try:
        listing = subprocess.run([tool, "-p"], capture_output=True, text=True, timeout=10).stdout
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError):
        return []
    return re.findall(r"^\s*libLLVM\S*\s.*=>\s*(/.*)$", listing, flags=re.MULTILINE)


_SECONDS = 120.0
"""Processor seconds of a trial; wall time may be six times as long: Dr.Jit's first import from a
cold disk is slow."""

_FROM_OUTSIDE = (signal.SIGINT, signal.SIGTERM, 1, 9)
"""Signals that end the child through no fault of the library; 1 and 9 have no names on Windows."""

_KERNELS = """
import drjit as dr
if not dr.has_backend(dr.JitBackend.LLVM):
    raise SystemExit("Dr.Jit does not accept the library")
from drjit.llvm import Float, Float64, UInt32
for kind in (Float, Float64):
    x = dr.arange(kind, 16) - 7.5
    low, high = dr.minimum(x, 2.0), dr.maximum(x, -2.0)
    root = dr.floor(dr.sqrt(dr.fma(x, x, 1.0)))
    turned = dr.gather(kind, x, UInt32(15) - dr.arange(UInt32, 16))
    dr.eval(low, high, root, turned)
    expected = [k - 7.5 for k in range(16)]
    if (
        list(low) != [min(v, 2.0) for v in expected]
        or list(high) != [max(v, -2.0) for v in expected]
        or list(root) != [int((v * v + 1) ** 0.5) for v in expected]
        or list(turned) != expected[::-1]
    ):
        raise SystemExit("a kernel compiled with the library returns wrong numbers")
answer = ".".join(str(figure) for figure in dr.detail.llvm_version())
"""

_GPU_KERNEL = """
import drjit as dr
if not dr.has_backend(dr.JitBackend.CUDA):
    raise SystemExit("no backend")
from drjit.cuda import Float
x = dr.arange(Float, 16) - 7.5
low = dr.minimum(x, 2.0)
if list(low) != [min(k - 7.5, 2.0) for k in range(16)]:
    raise SystemExit("its kernels return wrong numbers")
"""


@dataclass(frozen=True)
class Verdict:
    """Verdict on one library."""

    usable: bool
    version: str | None = None
    reason: str | None = None
    """Why it is not usable: half a sentence."""


@dataclass(frozen=True)
class GPUStatus:
    """Whether kernels can be compiled for an NVIDIA GPU, and if not, the remedy."""

    usable: bool
    name: str | None = None
    """The GPU and its driver's version, as nvidia-smi tells them."""
    problem: str | None = None
    remedy: str | None = None


def judge(candidate: Candidate, preload: Sequence[str] = ()) -> Verdict:
    """The verdict on a library: from its name, from the cache, or from a child process.

    Parameters
    ----------
    candidate : the library.
    preload : libraries that the child opens first, in this order (dependencies that the system
        lacks and the environment holds).
    """
    if candidate.version is not None and candidate.version < OLDEST_VERSION:
        text = ".".join(str(figure) for figure in candidate.version)
        return Verdict(
            False, text, f"LLVM {text} is too old (its kernels end the process; 17 or newer works)"
        )
    if os.path.isabs(candidate.path) and not os.path.exists(candidate.path):  # noqa: PTH110, PTH117
        return Verdict(False, None, "there is no such file")
    store = _store_of(candidate.path, preload)
    if store is not None:
        with contextlib.suppress(OSError, ValueError, TypeError):
            return Verdict(**json.loads(store.read_bytes()))
    verdict, lasting = _try_out(candidate.path, preload)
    if lasting and store is not None:
        # A cache that cannot be written costs a second next time, nothing else.
        with contextlib.suppress(OSError):
            store.parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(store) as scratch:  # another process sees all of it or nothing
                scratch.write_text(json.dumps(asdict(verdict)))
    return verdict


def drjit_imports() -> str | None:
    """None when a child process can import Dr.Jit, else half a sentence that says why not."""
    code, _, errors = run_probe("import drjit")
    if code == 0:
        return None
    return _reason(errors) or f"the import ends with status {code}"


def drjit_release() -> str | None:
    """The version of the installed Dr.Jit, found without importing it; None when there is none."""
    spec = importlib.util.find_spec("drjit") if "drjit" not in sys.modules else None
    origin = spec.origin if spec else getattr(sys.modules.get("drjit"), "__file__", None)
    if origin is None:
        return None
    # importlib.metadata would answer too, but costs 20 ms to import.
    for folder in Path(origin).parent.parent.glob("drjit-*.dist-info"):
        return folder.name.removeprefix("drjit-").removesuffix(".dist-info")
    return "unknown"


def cache_folder() -> Path:
    """The user's cache folder of polywigner (it need not exist)."""
    home = Path(os.path.expanduser("~"))  # noqa: PTH111 (Path.home raises where there is no home)
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = home / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return base / "polywigner"


def _store_of(path: str, preload: Sequence[str]) -> Path | None:
    """The file in which the verdict on a library is kept; None when the library is not there."""
    try:
        state = Path(path).stat()
    except OSError:
        return None
    # The machine's name is in the key for homes shared between machines of different CPU types.
    facts = [os.path.realpath(path), state.st_mtime_ns, state.st_size, drjit_release()]
    facts += [sys.implementation.cache_tag, platform.machine(), platform.node(), *preload, _KERNELS]
    digest = hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:32]
    return cache_folder() / "llvm" / f"{digest}.json"


def _try_out(path: str, preload: Sequence[str]) -> tuple[Verdict, bool]:
    """Run the kernels in a child; also say whether the answer will stay the same."""
    code, output, errors = run_probe(_KERNELS, library=path, preload=preload)
    if code == 0 and output:
        return Verdict(True, output), True
    if code is None:
        return Verdict(False, None, errors), False
    if code < 0 or code >= 128:
        line = next((text for text in errors.splitlines() if "LLVM ERROR" in text), "")
        told = f" ({line[:80].strip()})" if line else ""
        # Somebody else may have ended it: Ctrl-C reaches all processes of a terminal.
        lasting = -code not in _FROM_OUTSIDE
        return Verdict(False, None, f"its kernels end the process{told}"), lasting
    # A library that does not open may open tomorrow, when its dependency has been installed.
    return Verdict(False, None, _reason(errors) or f"the trial ended with status {code}"), False


def run_probe(
    script: str, *, library: str = os.devnull, preload: Sequence[str] = ()
) -> tuple[int | None, str, str]:
    """Run Python code in a child process with this process's module path.

    Parameters
    ----------
    script : the code; its variable ``answer`` is returned.
    library : the LLVM library that Dr.Jit is told to open.
    preload : libraries to open first.

    Returns
    -------
    Exit status (None when no child could be run to its end), the answer, and its stderr.
    """
    import subprocess

    # Dr.Jit itself needs libatomic, which may lie in the environment only.
    task = {"path": sys.path, "preload": [*native_libatomic(), *preload], "script": script}
    try:
        with temporary_folder() as scratch:
            answer = Path(scratch) / "answer"
            environment = {
                LIBRARY_VARIABLE: library,
                # Empty: a remembered kernel proves nothing about the compiler.
                "DRJIT_CACHE_DIR": scratch,
                "POLYWIGNER_TRIAL": "1",  # see native_hook.py
            }
            done = subprocess.run(
                [sys.executable, "-P", "-c", _CHILD],
                input=json.dumps({**task, "answer": str(answer)}),
                env={**os.environ, **environment},
                capture_output=True,
                text=True,
                timeout=_SECONDS,
            )
            return done.returncode, answer.read_text() if answer.exists() else "", done.stderr
    except subprocess.TimeoutExpired:
        return None, "", f"the trial took longer than {_SECONDS:g} s"
    except OSError as error:
        return None, "", f"the trial could not be started ({error})"


_CHILD = """
import ctypes, json, os, pathlib, sys
task = json.load(sys.stdin)
sys.path[:] = task["path"]
for library in task["preload"]:
    ctypes.CDLL(library)
names = {}
exec(task["script"], names)
pathlib.Path(task["answer"]).write_text(str(names.get("answer", "")))
os._exit(0)  # a library that ends badly after its work has still done it
"""


def look_for_gpu() -> GPUStatus:
    """The state of the CUDA engine, found by running a kernel in a child process."""
    name = _gpu_name()
    code, _, errors = run_probe(_GPU_KERNEL)
    if code == 0:
        return GPUStatus(True, name)
    if name is None:
        return GPUStatus(
            False,
            problem="no NVIDIA GPU answers",
            remedy="If there is one, bring its driver: `apt-get install nvidia-driver` on Debian.",
        )
    return GPUStatus(
        False,
        name,
        f"{name} is here, but its kernels do not run ({_last_line(errors) or code}).",
        "Install an NVIDIA driver that Dr.Jit supports: 535 or newer.",
    )


def _gpu_name() -> str | None:
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return None
    import subprocess

    query = [tool, "--query-gpu=name,driver_version", "--format=csv,noheader"]
    try:
        done = subprocess.run(query, capture_output=True, text=True, timeout=30)
    except (OSError, subprocess.SubprocessError):
        return None
    lines = done.stdout.strip().splitlines() if done.returncode == 0 else []
    return ", driver ".join(part.strip() for part in lines[0].split(",")) if lines else None


def _reason(errors: str) -> str:
    """The telling part of the child's output: the linker's complaint, or the last line."""
    for line in errors.splitlines():
        if "Unable to load" in line:
            return line.rsplit('": ', 1)[-1].strip().rstrip("!")
        if "too old" in line or "lacks" in line:
            return line.split("): ", 1)[-1].split(".", 1)[0].strip()
        if line.startswith(("ImportError: lib", "OSError: ")):
            # Dr.Jit hides what the linker said behind a NameError of its own.
            return line.split(": ", 1)[1].strip()
    return _last_line(errors)


def _last_line(errors: str) -> str:
    lines = errors.strip().splitlines()
    return lines[-1].strip().removeprefix("SystemExit: ") if lines else ""
