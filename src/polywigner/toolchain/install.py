"""Install LLVM and libatomic on Debian and Ubuntu: for ``doctor`` and ``tools/bootstrap``.

``tools/bootstrap`` imports this module before anything is installed, so it needs the standard
library only.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence

from polywigner.errors import EngineError
from polywigner.toolchain.llvm import LLVMStatus, is_switched_off, prepare

# Alternatives, best first. The tests run with 19. Ubuntu has renamed some for its 64-bit time.
_LLVM = [f"libllvm{major}{suffix}" for major in (19, 20, 21, 22, 18, 17) for suffix in ("", "t64")]
_LIBATOMIC = ["libatomic1"]


def install_llvm(confirm: Callable[[str], None] | None = None) -> LLVMStatus:
    """Install the packages that Dr.Jit needs to compile kernels with LLVM, if they are missing.

    Parameters
    ----------
    confirm : called with the names of the packages before they are installed; raises an EngineError
        to prevent the installation.

    Returns
    -------
    The status afterwards: usable.

    Raises
    ------
    EngineError if the packages cannot be installed, or if LLVM is not usable afterwards.
    """
    status = prepare()
    wanted = [] if status.drjit_imports else [_LIBATOMIC]
    if not (status.usable or is_switched_off()):
        wanted.append(_LLVM)
    if wanted:
        try:
            install_packages(wanted, confirm)
        except EngineError as error:
            raise EngineError(f"{status.problem} {error}") from error
        status = prepare(afresh=True)
    if not status.usable:
        raise EngineError(f"{status.problem} {status.remedy}")
    return status


def install_packages(
    wanted: Sequence[Sequence[str]], confirm: Callable[[str], None] | None = None
) -> None:
    """Install Debian packages with apt-get, as root.

    Parameters
    ----------
    wanted : alternatives for each package, best first. The first that apt offers is installed.
    confirm : as for :func:`install_llvm`.

    Raises
    ------
    EngineError if this user or this system cannot install packages, with the packages to install.
    """
    if not shutil.which("apt-get"):
        names = " and ".join(alternatives[0] for alternatives in wanted)
        raise EngineError(f"Install {names}, or the packages of your system that replace them.")
    names = " ".join(map(_offered, wanted))
    if os.geteuid() != 0:
        raise EngineError(f"Run `apt-get install {names}` as root.")
    if confirm is not None:
        confirm(names)
    for alternatives in wanted:
        problem = _install(alternatives)
        if problem:  # without package lists, or with old ones
            _apt("apt-get", "update")
            problem = _install(alternatives)
        if problem:
            raise EngineError(f"`apt-get install` failed: {problem}.")


def _install(alternatives: Sequence[str]) -> str:
    """Return the error message of apt-get; empty if the package was installed."""
    name = _offered(alternatives)
    print(f"polywigner: installing {name} (apt-get install) ...", file=sys.stderr, flush=True)
    options = ["-o", "DPkg::Lock::Timeout=300", "-y", "--no-install-recommends"]
    done = _apt("apt-get", "install", *options, name)
    errors = re.findall(r"^E: (.*?)\.?$", done.stderr, flags=re.MULTILINE) or ["unknown error"]
    return errors[-1] if done.returncode != 0 else ""


def _offered(alternatives: Sequence[str]) -> str:
    """Return the first package that the lists of apt contain, or the first one."""
    listing = _apt("apt-cache", "madison", *alternatives).stdout
    offered = {line.split("|")[0].strip() for line in listing.splitlines()}
    return next((name for name in alternatives if name in offered), alternatives[0])


def _apt(tool: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"}
    return subprocess.run(
        [tool, *arguments],
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
    )


if __name__ == "__main__":  # for tools/bootstrap
    try:
        print(f"polywigner: LLVM {install_llvm().version} is usable.", file=sys.stderr)
    except EngineError as problem:
        sys.exit(f"polywigner: {problem}")
