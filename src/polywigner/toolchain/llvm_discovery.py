"""Where LLVM libraries are found on this machine, and how to get one where there is none.

Dr.Jit brings no LLVM of its own: it opens a shared library of the system at import. This module
only looks at file names; :mod:`polywigner.toolchain.trials` tries the libraries out.
"""

from __future__ import annotations

import glob
import os
import re
import shutil
import site
import sys
from dataclasses import dataclass
from pathlib import Path

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
        found[named] = Candidate(named, "variable", version_of_name(named))
    environment = [*native_folders(), Path(sys.prefix) / _library_folder()]
    for origin, paths in (
        ("environment", [p for folder in environment for p in _libraries_in(str(folder))]),
        ("system", _system_libraries()),
    ):
        group = [Candidate(path, origin, version_of_name(path)) for path in paths]
        for candidate in sorted(group, key=lambda c: c.version or (), reverse=True):
            found.setdefault(os.path.realpath(candidate.path), candidate)
    return _without_repeats(found)


def _without_repeats(found: dict[str, Candidate]) -> list[Candidate]:
    """One candidate per file: the variable's name may be a link to a system library."""
    unique: dict[str, Candidate] = {}
    for candidate in found.values():
        unique.setdefault(os.path.realpath(candidate.path), candidate)
    return list(unique.values())


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


def _library_folder() -> str:
    return r"Library\bin" if sys.platform == "win32" else "lib"


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
