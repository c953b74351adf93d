"""Bring a usable LLVM library, and libatomic, to a Debian or Ubuntu system.

As root the packages are installed. Without root they are downloaded and unpacked into the
environment, from where :func:`polywigner.toolchain.llvm.prepare` opens them.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from polywigner.errors import EngineError
from polywigner.interruption import is_running, temporary_folder
from polywigner.toolchain import debian
from polywigner.toolchain.llvm import LLVMStatus, prepare
from polywigner.toolchain.trials import (
    OFF_VARIABLE,
    OPENING_ORDER,
    Candidate,
    judge,
    native_folders,
    remedy,
    version_of_name,
)

_LIBATOMIC = ["libatomic1"]
# 19 first: the one the tests are run with. Ubuntu renamed some for its 64-bit time.
_LLVM = [f"libllvm{major}{suffix}" for major in (19, 20, 21, 22, 18, 17) for suffix in ("", "t64")]

_PARTIAL = ".partial-"
"""Start of the names of folders that are being filled; the process follows."""

_TRY_TO_OPEN = """
import ctypes, sys
waiting = sys.argv[1:]
while waiting:
    left = []
    for library in waiting:
        try:
            ctypes.CDLL(library)
            print(library)
        except OSError:
            left.append(library)
    if len(left) == len(waiting):
        break
    waiting = left
"""


def install_llvm(
    say: Callable[[str], None] = print, agreed: Callable[[str], None] | None = None
) -> LLVMStatus:
    """Make an LLVM library usable in this environment.

    Parameters
    ----------
    say : told what is being done, one line at a time.
    agreed : as root, told what would be installed into the system before that is done; raises an
        EngineError where that is not wanted.

    Returns
    -------
    The status afterwards: usable.

    Raises
    ------
    EngineError when no library could be brought, or when the one brought is not usable; whatever
    was there before is then unchanged.
    """
    status = prepare()
    if status.usable:
        say(f"LLVM {status.version} is usable already: {status.path}")
        return status
    if not debian.is_debian():
        raise EngineError(
            f"expected a Debian or Ubuntu system (with apt-get and dpkg-deb), got {sys.platform}; "
            f"--install-llvm cannot help here. {remedy()}"
        )
    bring = _unpack_into_environment
    if debian.is_root():
        bring = _install_into_system
        if agreed is not None:
            agreed(_announced([_LLVM, _LIBATOMIC]))
    if os.environ.get(OFF_VARIABLE, "") in ("", "0"):
        try:
            bring([_LLVM, _LIBATOMIC], say)
        except debian.PackageError as error:
            if not status.drjit_imports:
                _bring_libatomic(bring, say)
            raise EngineError(
                f"no LLVM library could be brought: {error}. Install LLVM 17 or newer and "
                "libatomic1, or go on without: transforms run on NumPy and scenes in scalar_rgb, "
                "both slower."
            ) from error
    elif not status.drjit_imports:
        _bring_libatomic(bring, say)
    status = prepare(afresh=True)
    if not status.usable:
        raise EngineError(f"{status.problem} {status.remedy}")
    say(f"LLVM {status.version} is usable: {status.path}")
    return status


_Bring = Callable[[Sequence[list[str]], Callable[[str], None]], None]


def _bring_libatomic(bring: _Bring, say: Callable[[str], None]) -> None:
    """Dr.Jit and Mitsuba can at least be imported then, for scalar rendering."""
    try:
        bring([_LIBATOMIC], say)
    except debian.PackageError as error:
        say(f"libatomic1 could not be brought, so that nothing can be rendered: {error}.")


def _announced(wanted: Sequence[list[str]]) -> str:
    names = debian.planned(wanted)
    listed = f" ({' '.join(names)})" if names else ""
    return f"{_named(wanted)}{listed} by apt-get, for all users of this system"


def _install_into_system(wanted: Sequence[list[str]], say: Callable[[str], None]) -> None:
    say(f"Installing {_named(wanted)} (apt-get install) ...")
    say(f"Installed {' '.join(debian.install(wanted))}.")


def _unpack_into_environment(wanted: Sequence[list[str]], say: Callable[[str], None]) -> None:
    """Fill a folder beside the final one, try it out there, and only then put it in place."""
    folder = native_folders()[-1]
    say(f"Downloading {_named(wanted)} into {folder} (no root needed) ...")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        _sweep(folder.parent)
        with temporary_folder(folder.parent, f"{_PARTIAL}{os.getpid()}-") as scratch:
            tree, fresh = Path(scratch) / "tree", Path(scratch) / "native"
            tree.mkdir()
            fresh.mkdir()
            names = debian.unpack(wanted, tree)
            _gather_libraries(tree, fresh)
            _try_out(fresh)
            _put_in_place(fresh, folder)
        _hook_into(folder.parent.parent)
    except OSError as error:
        raise EngineError(
            f"expected a folder that can be written, got {folder} ({error.strerror}); work in a "
            "virtual environment (`python3 -m venv .venv`) and run this again there."
        ) from error
    say(f"Unpacked {' '.join(names)}." if names else "The system has all packages already.")


def _sweep(folder: Path) -> None:
    """Remove files of killed runs, but not of runs that go on."""
    for path in folder.glob(f"{_PARTIAL}*"):
        if not is_running(path.name.removeprefix(_PARTIAL).partition("-")[0]):
            shutil.rmtree(path, ignore_errors=True)


def _named(wanted: Sequence[list[str]]) -> str:
    return "an LLVM library and libatomic1" if _LLVM in wanted else "libatomic1"


def _gather_libraries(tree: Path, folder: Path) -> None:
    """Move the shared libraries of unpacked packages into one flat folder, and note how to open
    them."""
    for path in sorted(tree.rglob("lib*.so*")):
        in_library_folder = path.parent.name in ("lib", "lib64") or "-linux-" in path.parent.name
        if not in_library_folder or path.is_dir():
            continue
        target = folder / path.name
        if path.is_symlink():
            if not target.exists() and not target.is_symlink():
                target.symlink_to(path.readlink().name)
        else:
            path.replace(target)
    for link in folder.iterdir():  # such as links into folders that were not taken
        if link.is_symlink() and not link.exists():
            link.unlink()
    needed = [str(p) for p in sorted(folder.iterdir()) if not p.is_symlink() and not _is_llvm(p)]
    opened = subprocess.run(
        [sys.executable, "-I", "-c", _TRY_TO_OPEN, *needed], capture_output=True, text=True
    ).stdout.splitlines()
    (folder / OPENING_ORDER).write_text("".join(f"{Path(name).name}\n" for name in opened))


def _try_out(folder: Path) -> None:
    names = (folder / OPENING_ORDER).read_text().splitlines()
    for path in sorted(folder.iterdir()):
        if _is_llvm(path) and not path.is_symlink():
            candidate = Candidate(str(path), "environment", version_of_name(str(path)))
            verdict = judge(candidate, [str(folder / name) for name in names])
            if not verdict.usable:
                raise debian.PackageError(f"{path.name} was unpacked but {verdict.reason}")


def _is_llvm(path: Path) -> bool:
    return path.name.startswith("libLLVM")


def _put_in_place(fresh: Path, folder: Path) -> None:
    old = fresh.with_name("old")
    if folder.exists():
        folder.rename(old)
    try:
        fresh.rename(folder)
    except OSError:
        if old.exists():
            old.rename(folder)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _hook_into(libraries: Path) -> None:
    """Let ``import drjit`` find the unpacked library, also before polywigner is imported.

    ``libraries`` is the environment's ``lib`` folder.
    """
    packages = libraries / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    if not packages.is_dir():
        return
    hook = Path(__file__).with_name("native_hook.py").read_text(encoding="utf-8")
    (packages / "polywigner_native.py").write_text(hook, encoding="utf-8")
    # Python runs the lines of *.pth files when it starts; this one costs half a millisecond.
    (packages / "polywigner_native.pth").write_text("import polywigner_native\n")


def _main() -> int:
    try:
        install_llvm(lambda line: print(f"polywigner: {line}", file=sys.stderr, flush=True))
    except EngineError as error:
        print(f"polywigner: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":  # for tools/bootstrap, which has no terminal tables to show
    sys.exit(_main())
