"""Select a usable LLVM library before Dr.Jit is imported, and install one on Debian and Ubuntu.

An unsuitable library ends the process without an exception, so kernels test each library in a child
process, and the result is cached on disk. ``tools/bootstrap`` imports this module before anything
is installed, so it needs only the standard library.
"""

from __future__ import annotations

import contextlib
import ctypes
import glob
import hashlib
import importlib
import importlib.util
import json
import os
import platform
import re
import shutil
import signal
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from polywigner.errors import EngineError
from polywigner.interruption import atomic_path, temporary_folder

if TYPE_CHECKING:
    import subprocess

# Environment variable for the path of Dr.Jit's LLVM library.
LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"

# Environment variable that switches LLVM off if it is 1.
OFF_VARIABLE = "POLYWIGNER_NO_LLVM"

# Value of LIBRARY_VARIABLE if no LLVM library is usable. Without this value, Dr.Jit would open any
# libLLVM of the system. Dr.Jit may print the value.
NONE_USABLE = "/no usable LLVM library; see `polywigner doctor`"

# Oldest usable version. LLVM 15 and 16 abort on minima and maxima ("Cannot select: fminimum"), and
# LLVM 14 lacks opaque pointers.
OLDEST_VERSION = 17

# Library that Dr.Jit's Linux wheels require. Without it, as on bare Debian, the import raises an
# obscure NameError.
LIBATOMIC = "libatomic.so.1"

_SYSTEM_LIBRARIES = (
    # Multiarch folders of Debian, such as /usr/lib/x86_64-linux-gnu.
    "/usr/lib/*-linux-gnu*/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
    r"C:\Program Files*\LLVM\bin\LLVM-C.dll",
)
_ENVIRONMENT_LIBRARIES = ("lib/libLLVM*.so*", "lib/libLLVM*.dylib", "Library/bin/LLVM-C.dll")

# Time limit of a probe [s]; the first import from a cold disk is slow.
_TIME_LIMIT = 120.0
# Return codes of child processes that crashed; Ctrl-C and temporary failures have other codes.
_CRASHES = (-signal.SIGABRT, -signal.SIGSEGV, -signal.SIGILL, -signal.SIGFPE)

_KERNELS = """
import drjit as dr
if not dr.has_backend(dr.JitBackend.LLVM):
    raise SystemExit("Dr.Jit does not accept the library")
from drjit.llvm import Float, Float64, UInt32
for kind in (Float, Float64):
    x = dr.arange(kind, 16) - 7.5
    low, high = dr.minimum(x, 2.0), dr.maximum(x, -2.0)
    root = dr.floor(dr.sqrt(dr.fma(x, x, 1.0)))
    reverse = dr.gather(kind, x, UInt32(15) - dr.arange(UInt32, 16))
    dr.eval(low, high, root, reverse)
    expected = [k - 7.5 for k in range(16)]
    if (
        list(low) != [min(v, 2.0) for v in expected]
        or list(high) != [max(v, -2.0) for v in expected]
        or list(root) != [int((v * v + 1) ** 0.5) for v in expected]
        or list(reverse) != expected[::-1]
    ):
        raise SystemExit("a kernel compiled with the library returns wrong numbers")
print(".".join(str(number) for number in dr.detail.llvm_version()))
"""


@dataclass(frozen=True)
class LLVMStatus:
    """Whether this process can compile kernels with LLVM, and if not, a remedy."""

    usable: bool
    path: str | None = None
    version: str | None = None
    problem: str | None = None
    remedy: str | None = None
    drjit_imports: bool = True
    # Paths of unusable libraries, each with the reason.
    refused: tuple[tuple[str, str], ...] = ()


_OFF = LLVMStatus(
    usable=False,
    problem=f"LLVM is switched off by {OFF_VARIABLE}.",
    remedy=f"Unset {OFF_VARIABLE} to use LLVM again.",
)
_lock = threading.Lock()
_status: LLVMStatus | None = None


def prepare(*, refresh: bool = False) -> LLVMStatus:
    """Select the LLVM library for Dr.Jit, before Dr.Jit is imported.

    ``DRJIT_LIBLLVM_PATH`` is set to the first usable library. The candidates are the previous value
    of the variable, and then the libraries of the Python environment and of the system, newest
    first. If there is no usable library, or if ``POLYWIGNER_NO_LLVM=1`` is set, the variable is set
    to a path that does not exist.

    The status is the same object on every call, unless ``refresh`` repeats the search. The first
    call takes some milliseconds, plus 0.2 s for each library without a cached result.
    """
    global _status
    with _lock:
        if _status is None or refresh:
            if "drjit" in sys.modules:
                _status = _status_of_loaded_drjit()
            else:
                _status = _find_usable_library()
                os.environ[LIBRARY_VARIABLE] = _status.path or NONE_USABLE
        return _status


def require() -> LLVMStatus:
    """Return the status of a usable LLVM library, or raise EngineError with the remedy."""
    status = prepare()
    if not status.usable:
        raise EngineError(f"{status.problem} {status.remedy}")
    return status


def require_drjit() -> LLVMStatus:
    """Import Dr.Jit, with or without an LLVM library, and return the status.

    Raises EngineError with the remedy if the import would fail.
    """
    status = prepare()
    if not status.drjit_imports:
        raise EngineError(f"{status.problem} {status.remedy}")
    with contextlib.nullcontext() if status.usable else _silent_stderr():
        importlib.import_module("drjit")
    return status


@contextlib.contextmanager
def _silent_stderr() -> Iterator[None]:
    """Discard the standard error output of the process, which contains messages of Dr.Jit."""
    sys.stderr.flush()
    saved = os.dup(2)
    try:
        with Path(os.devnull).open("w") as null:
            os.dup2(null.fileno(), 2)
            yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


def _find_usable_library() -> LLVMStatus:
    """Return the status with the first usable library, or with the reason if there is none."""
    # Some wheels of Dr.Jit do not need libatomic, so a test import decides.
    if not _has_libatomic() and run_in_child("import drjit").returncode != 0:
        return LLVMStatus(
            False,
            problem=f"Dr.Jit cannot be imported, because {LIBATOMIC} is missing.",
            remedy="Run `polywigner doctor --install-llvm` to install it.",
            drjit_imports=False,
        )
    if is_switched_off():
        return _OFF
    refused: list[tuple[str, str]] = []
    for path in libraries():
        version, problem = probe(path)
        if problem is None:
            return LLVMStatus(True, path, version, refused=tuple(refused))
        refused.append((path, problem))
    problem = "No LLVM library was found."
    if refused:
        others = f" and {len(refused) - 1} more" if len(refused) > 1 else ""
        problem = f"No LLVM library is usable: {refused[0][0]} ({refused[0][1]}){others}."
    return LLVMStatus(False, problem=problem, remedy=_remedy(), refused=tuple(refused))


def is_switched_off() -> bool:
    """Return whether the environment variable POLYWIGNER_NO_LLVM is neither empty nor 0."""
    return os.environ.get(OFF_VARIABLE, "") not in ("", "0")


def _has_libatomic() -> bool:
    """Return whether the library libatomic can be loaded; always true except on Linux."""
    if sys.platform != "linux":
        return True
    try:
        ctypes.CDLL(LIBATOMIC)
    except OSError:
        return False
    return True


def _status_of_loaded_drjit() -> LLVMStatus:
    """Return the status of the LLVM library that an imported Dr.Jit uses."""
    if is_switched_off():
        return _OFF
    drjit: Any = sys.modules["drjit"]
    problem = "Dr.Jit was imported before polywigner and found no usable LLVM library."
    if drjit.has_backend(drjit.JitBackend.LLVM):
        version = drjit.detail.llvm_version()
        text = ".".join(str(number) for number in version)
        if version[0] >= OLDEST_VERSION:
            return LLVMStatus(True, os.environ.get(LIBRARY_VARIABLE), text)
        problem = f"Dr.Jit was imported before polywigner and loaded LLVM {text}, which is too old."
    remedy = (
        f"Import polywigner before drjit or mitsuba, or set {LIBRARY_VARIABLE} to a library of "
        f"LLVM {OLDEST_VERSION} or newer before Python starts."
    )
    return LLVMStatus(False, problem=problem, remedy=remedy)


def _remedy() -> str:
    """Return advice on how to install LLVM on this computer."""
    if shutil.which("apt-get"):
        return "Run `polywigner doctor --install-llvm` to install one."
    return (
        f"Install LLVM {OLDEST_VERSION} or newer (`brew install llvm` on macOS), or set "
        f"{LIBRARY_VARIABLE} to its shared library."
    )


def libraries() -> list[str]:
    """Return the paths of the LLVM libraries on this computer, in the order of their tests."""
    named = os.environ.get(LIBRARY_VARIABLE, "")
    environment = [f"{glob.escape(sys.prefix)}/{pattern}" for pattern in _ENVIRONMENT_LIBRARIES]
    paths = [
        *([named] if named and named != NONE_USABLE else []),
        *_newest_first(environment),
        *_newest_first(_SYSTEM_LIBRARIES),
    ]
    by_file: dict[str, str] = {}
    for path in paths:
        by_file.setdefault(os.path.realpath(path), path)
    return list(by_file.values())


def _newest_first(patterns: Iterable[str]) -> list[str]:
    """Return the paths that match glob patterns, in descending order of their LLVM versions."""
    paths = sorted(path for pattern in patterns for path in glob.glob(pattern))  # noqa: PTH207
    return sorted(paths, key=lambda path: version_of_name(path) or (), reverse=True)


def version_of_name(path: str) -> tuple[int, ...] | None:
    """Return the version in the name of a library, of its link target, or of its folder.

    Examples: ``libLLVM-15.so.1`` is 15 (1 is the ABI revision), ``libLLVM.so.19.1`` is 19.1, and
    ``/usr/lib/llvm-18/lib/libLLVM.so.1`` is 18.
    """
    real = os.path.realpath(path)
    for pattern in (r"libLLVM(?:-|\.so\.|\.)(\d\d[\d.]*)[^/]*$", r"llvm[-@]?(\d\d)/"):
        match = re.search(pattern, real) or re.search(pattern, path)
        if match:
            return tuple(int(number) for number in match.group(1).strip(".").split("."))
    return None


def probe(path: str) -> tuple[str | None, str | None]:
    """Return the version of a library, and the reason why it is not usable; both may be None.

    The result comes from the name of the library, from the cache, or from a test in a child
    process. The key of the cache includes the machine, because machines with different processors
    may share a home folder. The version is None if a test finds the library unusable.
    """
    version = version_of_name(path)
    if version is not None and version[0] < OLDEST_VERSION:
        text = ".".join(str(number) for number in version)
        return text, f"LLVM {text} is too old; {OLDEST_VERSION} or newer is required"
    cache = _cache_path(path)
    with contextlib.suppress(OSError, ValueError, LookupError):
        content = json.loads(cache.read_bytes())
        return content["version"], content["problem"]
    child = run_in_child(_KERNELS, library=path)
    is_usable = child.returncode == 0
    tested = child.stdout.split()[-1] if is_usable else None
    problem = None if is_usable else _failure_reason(child)
    if is_usable or child.returncode in _CRASHES:
        # Other failures, such as missing dependencies, are not cached, because users may repair
        # them.
        with contextlib.suppress(OSError), atomic_path(cache) as scratch:
            scratch.parent.mkdir(parents=True, exist_ok=True)
            scratch.write_text(json.dumps({"version": tested, "problem": problem}))
    return tested, problem


def _cache_path(path: str) -> Path:
    """Return the path of the file that caches the test result of a library.

    The name changes with the library, with Dr.Jit, and with the computer.
    """
    spec = importlib.util.find_spec("drjit")
    facts: list[Any] = [_KERNELS, sys.implementation.cache_tag, platform.node()]
    for file in (os.path.realpath(path), str(spec and spec.origin)):
        facts.append(file)
        with contextlib.suppress(OSError):
            state = Path(file).stat()
            facts += [state.st_mtime_ns, state.st_size]
    digest = hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:32]
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    home = Path(os.path.expanduser("~"))  # noqa: PTH111 (Path.home raises if there is no home)
    return (Path(base) if base else home / ".cache") / "polywigner" / "llvm" / f"{digest}.json"


def run_in_child(script: str, library: str = NONE_USABLE) -> subprocess.CompletedProcess[str]:
    """Run Python code in a child process, with an LLVM library or without one.

    If the process does not start or runs longer than two minutes, the return code is 1 and
    ``stderr`` contains the reason.
    """
    # Importing subprocess takes 10 ms and is rarely needed.
    import subprocess

    command = [sys.executable, "-P", "-c", script]
    try:
        # The folder receives core dumps and an empty kernel cache, which forces Dr.Jit to compile
        # kernels.
        with temporary_folder() as folder:
            environment = {
                **os.environ,
                LIBRARY_VARIABLE: library,
                "DRJIT_CACHE_DIR": folder,
                "PYTHONPATH": os.pathsep.join(os.path.abspath(p) for p in sys.path),  # noqa: PTH100
            }
            return subprocess.run(
                command,
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_TIME_LIMIT,
            )
    except (OSError, subprocess.TimeoutExpired) as error:
        return subprocess.CompletedProcess(command, 1, "", f"the test could not be run ({error})")


def _failure_reason(child: subprocess.CompletedProcess[str]) -> str:
    """Return why a child process failed, in one short line."""
    lines = child.stderr.strip().splitlines() or [f"status {child.returncode}"]
    text = lines[-1] if lines[0].startswith("Traceback") else lines[0]
    end = "its kernels end the process: " if child.returncode in _CRASHES else ""
    return f"{end}{text[:120].strip(' .!')}"


# Names of LLVM packages in order of preference; on Ubuntu, names may end with t64.
_LLVM = [f"libllvm{major}{suffix}" for major in (19, 20, 21, 22, 18, 17) for suffix in ("", "t64")]
_LIBATOMIC = ["libatomic1"]


def install_llvm() -> LLVMStatus:
    """Install missing packages that Dr.Jit needs for LLVM, and return the new status.

    Raises EngineError if the packages cannot be installed, or LLVM is not usable afterwards.
    """
    status = prepare()
    packages = [] if status.drjit_imports else [_LIBATOMIC]
    if not (status.usable or is_switched_off()):
        packages.append(_LLVM)
    if packages:
        try:
            install_packages(packages)
        except EngineError as error:
            raise EngineError(f"{status.problem} {error}") from error
        prepare(refresh=True)
    return require()


def install_packages(packages: Sequence[Sequence[str]]) -> None:
    """Install the first available alternative of each Debian package with apt-get, as root.

    Raises EngineError with the names of the packages if this is not possible.
    """
    if not shutil.which("apt-get"):
        names = " and ".join(alternatives[0] for alternatives in packages)
        raise EngineError(f"Install {names}, or the packages of your system that replace them.")
    names = " ".join(map(_available_package, packages))
    if os.geteuid() != 0:
        raise EngineError(f"Run `apt-get install {names}` as root.")
    for alternatives in packages:
        problem = _install(alternatives)
        # Package lists may be missing or old, so a failed installation is repeated with new lists.
        if problem:
            _apt("apt-get", "update")
            problem = _install(alternatives)
        if problem:
            raise EngineError(f"`apt-get install` failed: {problem}.")


def _install(alternatives: Sequence[str]) -> str:
    """Install one of several packages; return apt-get's error message, empty on success."""
    name = _available_package(alternatives)
    print(f"polywigner: installing {name} (apt-get install) ...", file=sys.stderr, flush=True)
    options = ["-o", "DPkg::Lock::Timeout=300", "-y", "--no-install-recommends"]
    done = _apt("apt-get", "install", *options, name)
    errors = re.findall(r"^E: (.*?)\.?$", done.stderr, flags=re.MULTILINE) or ["unknown error"]
    return errors[-1] if done.returncode != 0 else ""


def _available_package(alternatives: Sequence[str]) -> str:
    """Return the first Debian package that apt offers; if it offers none, the first name."""
    listing = _apt("apt-cache", "madison", *alternatives).stdout
    offered = {line.split("|")[0].strip() for line in listing.splitlines()}
    return next((name for name in alternatives if name in offered), alternatives[0])


def _apt(tool: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run apt-get or apt-cache without prompts, and return its exit status and output."""
    import subprocess

    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"}
    return subprocess.run(
        [tool, *arguments],
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
    )


# tools/bootstrap runs this file as a script.
if __name__ == "__main__":
    try:
        print(f"polywigner: LLVM {install_llvm().version} is usable.", file=sys.stderr)
    except EngineError as problem:
        sys.exit(f"polywigner: {problem}")
