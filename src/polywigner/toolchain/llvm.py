"""The LLVM library behind Dr.Jit: found, tried out, and chosen before Dr.Jit is imported.

Dr.Jit opens its library when it is first imported and never again. Whatever in this package
imports ``drjit`` or ``mitsuba`` therefore calls :func:`prepare` first.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from polywigner.errors import EngineError
from polywigner.toolchain.trials import (
    LIBATOMIC,
    LIBRARY_VARIABLE,
    NONE_USABLE,
    OFF_VARIABLE,
    OPENING_ORDER,
    Candidate,
    Verdict,
    candidates,
    drjit_imports,
    drjit_release,
    judge,
    native_folders,
    native_libatomic,
    remedy,
)


@dataclass(frozen=True)
class LLVMStatus:
    """Whether kernels can be compiled with LLVM in this process, and if not, the remedy."""

    usable: bool
    path: str | None = None
    version: str | None = None
    problem: str | None = None
    """One sentence; None when the library is usable."""
    remedy: str | None = None
    """One sentence with a command or a setting; None when the library is usable."""
    drjit_imports: bool = True
    """False when ``import drjit`` itself would fail (then Mitsuba cannot be imported either)."""
    passed_over: tuple[tuple[str, str], ...] = ()
    """(path, reason) of the libraries that were found and refused."""


_OFF = LLVMStatus(
    False,
    problem=f"LLVM is switched off by {OFF_VARIABLE}.",
    remedy=f"Unset {OFF_VARIABLE} to use LLVM again.",
)

_lock = threading.Lock()
_status: LLVMStatus | None = None


def prepare(*, afresh: bool = False) -> LLVMStatus:
    """Choose the LLVM library for Dr.Jit, before Dr.Jit is imported.

    Looks at ``DRJIT_LIBLLVM_PATH``, then into the environment, then into the system's folders
    (newest first), and sets ``DRJIT_LIBLLVM_PATH`` to the first library whose kernels have run in
    a child process. With none, the variable is set to a path that does not exist, so that Dr.Jit
    opens none either. ``POLYWIGNER_NO_LLVM=1`` asks for that.

    Parameters
    ----------
    afresh : look again, because a library has been installed since the last call.

    Returns
    -------
    The status; the same object on every call in one process. Never raises for a missing library:
    see :func:`require`. Costs 20 ms once the verdict is remembered, a second the first time.
    """
    global _status
    if (hook := sys.modules.get("polywigner_native")) is not None:
        hook.stand_down()  # see native_hook.py: it would call this function from within
    with _lock:
        if _status is None or afresh:
            _status = _loaded() if "drjit" in sys.modules else _choose()
        return _status


def require() -> LLVMStatus:
    """The status of a usable LLVM library.

    Raises
    ------
    EngineError when there is none, with the remedy; before any kernel is compiled, because a bad
    library ends the process at the first one.
    """
    status = prepare()
    if not status.usable:
        raise EngineError(f"{status.problem} {status.remedy}")
    return status


def require_drjit() -> LLVMStatus:
    """Import Dr.Jit, with an LLVM library or without, and return the status of :func:`prepare`.

    Raises
    ------
    EngineError when it would fail, with the remedy.
    """
    status = prepare()
    if not status.drjit_imports:
        raise EngineError(f"{status.problem} {status.remedy}")
    with contextlib.nullcontext() if status.usable else _silent_stderr():
        importlib.import_module("drjit")
    return status


@contextlib.contextmanager
def _silent_stderr() -> Iterator[None]:
    """Without a library Dr.Jit's import prints two lines about it; the status says it better.

    Both ways to stderr are closed, C++'s and Python's. Exceptions are not kept back.
    """
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stderr(nowhere):  # noqa: PTH123
            os.dup2(nowhere.fileno(), 2)
            yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def survey() -> list[tuple[Candidate, Verdict]]:
    """Every library found on this machine with its verdict, best first (for ``doctor``)."""
    return [(candidate, _judge(candidate)) for candidate in candidates()]


def _choose() -> LLVMStatus:
    status = _find()
    os.environ[LIBRARY_VARIABLE] = status.path if status.path else NONE_USABLE
    return status


def _find() -> LLVMStatus:
    """Return the first usable library, its own libraries already opened in this process."""
    if drjit_release() is None:
        return LLVMStatus(
            False,
            problem="Dr.Jit is not installed.",
            remedy="Run `pip install 'drjit>=1.5,<1.6'`.",
            drjit_imports=False,
        )
    complaint = _open_libatomic()
    if complaint is not None:
        return LLVMStatus(
            False,
            problem=f"Dr.Jit cannot be imported: {complaint}.",
            remedy="Run `polywigner doctor --install-llvm` (it brings libatomic1 too).",
            drjit_imports=False,
        )
    if _switched_off():
        return _OFF
    refused: list[tuple[str, str]] = []
    for candidate in candidates():
        verdict = _judge(candidate)
        if verdict.usable:
            _open_all(_companions(candidate))
            return LLVMStatus(True, candidate.path, verdict.version, passed_over=tuple(refused))
        refused.append((candidate.path, verdict.reason or "unusable"))
    return LLVMStatus(
        False, problem=_none_usable(refused), remedy=remedy(), passed_over=tuple(refused)
    )


def _switched_off() -> bool:
    return os.environ.get(OFF_VARIABLE, "") not in ("", "0")


def _none_usable(refused: Sequence[tuple[str, str]]) -> str:
    if not refused:
        return "No LLVM library was found."
    path, reason = refused[0]
    more = f" (nor {len(refused) - 1} more)" if len(refused) > 1 else ""
    return f"No usable LLVM library was found: {path} is not one{more}: {reason}."


def _judge(candidate: Candidate) -> Verdict:
    return judge(candidate, _companions(candidate))


def _loaded() -> LLVMStatus:
    """The status when Dr.Jit was imported before us: its library cannot be changed any more."""
    if _switched_off():
        return _OFF
    drjit: Any = sys.modules["drjit"]
    restart = "Import polywigner before drjit or mitsuba, or set DRJIT_LIBLLVM_PATH before Python"
    if not drjit.has_backend(drjit.JitBackend.LLVM):
        status = _find()
        if not status.usable:
            return replace(status, path=None)
        return LLVMStatus(
            False,
            problem="Dr.Jit was imported before polywigner and has found no usable LLVM library.",
            remedy=f"{restart} starts (to {status.path}).",
        )
    version = tuple(int(figure) for figure in drjit.detail.llvm_version())
    path = _mapped_library() or os.environ.get(LIBRARY_VARIABLE) or "libLLVM.so"
    verdict = _judge(Candidate(path, "loaded", version))
    text = ".".join(str(figure) for figure in version)
    if verdict.usable:
        return LLVMStatus(True, path, text)
    return LLVMStatus(
        False,
        version=text,
        problem=f"Dr.Jit was imported before polywigner and has loaded {path}: {verdict.reason}.",
        remedy=f"{restart} starts, or run `polywigner doctor` to see which libraries are usable.",
        passed_over=((path, verdict.reason or "unusable"),),
    )


def _mapped_library() -> str | None:
    """The libLLVM that this process has open, where the system tells (Linux)."""
    with contextlib.suppress(OSError, UnicodeDecodeError):
        for line in Path("/proc/self/maps").read_text().splitlines():
            path = line.split(maxsplit=5)[-1]
            if Path(path).name.startswith("libLLVM"):
                return path
    return None


# Libraries that `doctor --install-llvm` unpacked without root. The dynamic linker does not look
# into their folder, but it does not look for a library again that is already open.


def _companions(candidate: Candidate) -> list[str]:
    """Libraries that an unpacked LLVM needs and the system lacked, in loading order."""
    folder = Path(candidate.path).parent
    if folder not in native_folders():
        return []
    with contextlib.suppress(OSError):
        names = (folder / OPENING_ORDER).read_text().splitlines()
        return [str(folder / name) for name in names if name]
    return []


def _open_libatomic() -> str | None:
    """Open libatomic, which Dr.Jit's wheel needs and bare Debian lacks; None when all is well."""
    if sys.platform != "linux" or _opens(LIBATOMIC):
        return None
    _open_all(native_libatomic())
    # Wheels for other processors may do without it, so only a failing import counts.
    return None if _opens(LIBATOMIC) else drjit_imports()


def _opens(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _open_all(libraries: Sequence[str]) -> None:
    for library in libraries:
        _opens(library)
