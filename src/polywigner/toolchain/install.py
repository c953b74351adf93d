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
from collections.abc import Sequence

from polywigner.errors import EngineError
from polywigner.toolchain.llvm import LLVMStatus, is_switched_off, prepare

# Alternatives, best first. The tests run with 19. The names of Ubuntu end with t64 (64-bit time).
_LLVM = [f"libllvm{major}{suffix}" for major in (19, 20, 21, 22, 18, 17) for suffix in ("", "t64")]
_LIBATOMIC = ["libatomic1"]


def install_llvm() -> LLVMStatus:
    """Install the packages that Dr.Jit needs to compile kernels with LLVM, if they are missing.

    Returns
    -------
    LLVMStatus
        The status after the installation: usable.

    Raises
    ------
    EngineError
        If the packages cannot be installed, or LLVM is not usable afterwards.
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
        status = prepare(refresh=True)
    if not status.usable:
        raise EngineError(f"{status.problem} {status.remedy}")
    return status


def install_packages(packages: Sequence[Sequence[str]]) -> None:
    """Install Debian packages with apt-get, as root.

    Parameters
    ----------
    packages : sequence of sequences of str
        Alternatives for each package, best first. The first one that apt offers is installed.

    Raises
    ------
    EngineError
        If this user or this system cannot install packages; the message names the packages.
    """
    if not shutil.which("apt-get"):
        names = " and ".join(alternatives[0] for alternatives in packages)
        raise EngineError(f"Install {names}, or the packages of your system that replace them.")
    names = " ".join(map(_offered, packages))
    if os.geteuid() != 0:
        raise EngineError(f"Run `apt-get install {names}` as root.")
    for alternatives in packages:
        problem = _install(alternatives)
        if problem:  # the package lists may be missing or old
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
    """Return the first package in the lists of apt, or the first alternative."""
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
