"""Is this LLVM library usable? Found out by running kernels in a child process, and remembered.

A bad library does not raise: it ends the process. So nothing is believed about a library until a
child process has compiled and run a few kernels with it. The verdict is kept in the user's cache
folder under a key that changes with the library, with Dr.Jit and with the machine.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import json
import os
import platform
import signal
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from polywigner.interruption import atomic_path, temporary_folder
from polywigner.toolchain.llvm_discovery import (
    LIBRARY_VARIABLE,
    OLDEST_VERSION,
    Candidate,
    native_libatomic,
)

_PATIENCE = 120.0
"""Seconds that the child may take: Dr.Jit's first import from a cold disk can take many."""

_FROM_OUTSIDE = (signal.SIGINT, signal.SIGTERM, 1, 9)
"""Signals that end the child through no fault of the library; 1 and 9 have no names on Windows."""

_PREFACE = """
import json, sys
task = json.loads(sys.argv[1])
sys.path[:] = task["sys_path"]
try:
    import resource
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # an abort is an answer, not a crash report
except Exception:
    pass
import ctypes
for library in task["preload"]:
    ctypes.CDLL(library)
"""

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
print(".".join(str(figure) for figure in dr.detail.llvm_version()))
"""


@dataclass(frozen=True)
class Verdict:
    """Verdict on one library."""

    usable: bool
    version: str | None = None
    reason: str | None = None
    """Why it is not usable: half a sentence."""


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
    known = _recall(store)
    if known is not None:
        return known
    verdict, lasting = _try_out(candidate.path, preload)
    if lasting:
        _remember(store, verdict)
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


def _recall(store: Path | None) -> Verdict | None:
    if store is None:
        return None
    try:
        return Verdict(**json.loads(store.read_bytes()))
    except (OSError, ValueError, TypeError):
        return None


def _remember(store: Path | None, verdict: Verdict) -> None:
    """Keep a verdict. A cache that cannot be written costs a second next time, nothing else."""
    if store is None:
        return
    with contextlib.suppress(OSError):
        store.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(store) as scratch:  # another process sees all of it or nothing
            scratch.write_text(json.dumps(asdict(verdict)))


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
    script : the code; what is opened by ``preload`` is open when it starts.
    library : the LLVM library that Dr.Jit is told to open.
    preload : libraries to open first.

    Returns
    -------
    Exit status (None when no child could be run to its end), the last line of its stdout, and
    its stderr.
    """
    import subprocess  # costs 15 ms to import, which a remembered verdict saves

    # Dr.Jit itself needs libatomic, which may lie in the environment only.
    task = {"sys_path": sys.path, "preload": [*native_libatomic(), *preload]}
    try:
        with temporary_folder() as scratch:
            done = subprocess.run(
                [sys.executable, "-P", "-c", _PREFACE + script, json.dumps(task)],
                env={
                    **os.environ,
                    LIBRARY_VARIABLE: library,
                    # Empty: a remembered kernel proves nothing about the compiler.
                    "DRJIT_CACHE_DIR": scratch,
                    "POLYWIGNER_TRIAL": "1",  # see native_hook.py
                },
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_PATIENCE,
            )
    except subprocess.TimeoutExpired:
        return None, "", f"the trial took longer than {_PATIENCE:g} s"
    except (OSError, ValueError) as error:
        return None, "", f"the trial could not be started ({error})"
    lines = done.stdout.strip().splitlines()
    return done.returncode, lines[-1] if lines else "", done.stderr


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
    return lines[-1].strip() if lines else ""
