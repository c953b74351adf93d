"""``polywigner doctor``: parts that work on this machine, and commands that bring the others."""

from __future__ import annotations

import importlib.metadata
import platform
import re
import sys
from dataclasses import dataclass

from polywigner.errors import EngineError, install_command
from polywigner.toolchain.llvm import LLVMStatus, prepare
from polywigner.toolchain.llvm_install import install_llvm
from polywigner.toolchain.trials import GPUStatus, look_for_gpu, run_probe

_GOOD, _BAD, _OPTIONAL = "yes", "no", "-"
_CORE = ("numpy", "shapely", "drjit", "mitsuba", "matplotlib", "typer", "rich")


@dataclass(frozen=True)
class Finding:
    """Row of the report: subject, whether it works, its version, the command that brings it."""

    subject: str
    works: str
    found: str
    remedy: str = ""


def run_doctor(install_llvm_first: bool, is_agreed: bool = False) -> int:
    """Print the findings; 0 when the transforms work at all, else 1."""
    if install_llvm_first:
        install_llvm(agreed=None if is_agreed else _ask)
    transforms = _transforms()
    llvm, gpu = prepare(), look_for_gpu()
    findings = [transforms, _llvm(llvm), _gpu(gpu), *_libraries(), _mitsuba(llvm, gpu)]
    _print(findings + _extras())
    return 0 if transforms.works == _GOOD else 1


def _ask(what: str) -> None:
    if not sys.stdin.isatty():
        raise EngineError(
            f"expected --yes, since without a terminal nobody can be asked whether to install "
            f"{what}; add it, or run this as another user, to unpack the library into the "
            "environment"
        )
    sys.stderr.write(f"polywigner: will install {what}. Go on? [y/N] ")
    sys.stderr.flush()
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise EngineError("expected yes, got no: nothing has been installed")


def _transforms() -> Finding:
    """The NumPy engine, asked for a value that is known: the area of a square, F(0)."""
    subject = "engine numpy"
    try:
        import polywigner as pw

        area = pw.fourier(pw.Aperture([(0, 0), (2, 0), (2, 2), (0, 2)]), (0.0, 0.0), engine="numpy")
    except Exception as error:  # whatever is wrong, the other rows are still worth printing
        message = " ".join(str(error).split())
        return Finding(subject, _BAD, f"{type(error).__name__}: {message}", _REINSTALL)
    if abs(area - 4.0) > 1e-12:
        return Finding(subject, _BAD, f"a square of area 4 transforms to {area}", _REINSTALL)
    version = importlib.metadata.version("numpy")
    return Finding(subject, _GOOD, f"NumPy {version}; needs nothing else")


_REINSTALL = f"Run {install_command()}."


def _llvm(status: LLVMStatus) -> Finding:
    refused = [f"refused {path}: {reason}" for path, reason in status.passed_over]
    if status.usable:
        found = [f"LLVM {status.version} at {status.path}", *refused]
        return Finding("engine llvm", _GOOD, "\n".join(found))
    found = ["no usable library", *refused] if refused else [status.problem or ""]
    return Finding("engine llvm", _BAD, "\n".join(found), status.remedy or "")


def _gpu(status: GPUStatus) -> Finding:
    if status.usable:
        return Finding("engine cuda", _GOOD, status.name or "an NVIDIA GPU")
    works = _OPTIONAL if status.name is None else _BAD
    return Finding("engine cuda", works, status.problem or "", status.remedy or "")


def _mitsuba(llvm: LLVMStatus, gpu: GPUStatus) -> Finding:
    """The variants that the installed Mitsuba has and this machine can run."""
    if not llvm.drjit_imports:
        found = "Mitsuba needs a Dr.Jit that can be imported"
        return Finding("rendering", _BAD, found, llvm.remedy or "")
    # In a child: a Mitsuba and a Dr.Jit that do not fit each other can end the process.
    code, variants, errors = run_probe("import mitsuba; answer = ' '.join(mitsuba.variants())")
    if code != 0:
        complaint = (errors.strip().splitlines() or [f"the import ends with status {code}"])[-1]
        remedy = f"Run `pip install --force-reinstall '{_requirement('mitsuba')}'`."
        return Finding("rendering", _BAD, complaint, remedy)
    works = {"scalar": True, "llvm": llvm.usable, "cuda": gpu.usable}
    found = ", ".join(name for name in variants.split() if works.get(name.split("_")[0]))
    if llvm.usable or gpu.usable:
        return Finding("rendering", _GOOD, found)
    return Finding("rendering", _GOOD, f"{found}; hundreds of times slower", llvm.remedy or "")


def _libraries() -> list[Finding]:
    python = Finding("python", _GOOD, f"{platform.python_version()} at {sys.executable}")
    return [python] + [
        Finding(name, _GOOD, version)
        if (version := _version(name))
        else Finding(name, _BAD, "not installed", f"Run `pip install '{_requirement(name)}'`.")
        for name in _CORE
    ]


def _extras() -> list[Finding]:
    """One row per extra of the installed package, from its own metadata."""
    members: dict[str, list[str]] = {}
    for line in importlib.metadata.requires("polywigner") or []:
        match = re.fullmatch(r"([\w.-]+).*;.*extra == ['\"](\w+)['\"].*", line)
        if match and match.group(1) != "polywigner":
            members.setdefault(match.group(2), []).append(match.group(1))
    return [_extra(name, libraries) for name, libraries in sorted(members.items())]


def _extra(name: str, libraries: list[str]) -> Finding:
    missing = [library for library in libraries if _version(library) is None]
    if not missing:
        return Finding(f"extra {name}", _GOOD, ", ".join(libraries))
    found = f"missing: {', '.join(missing)}"
    return Finding(f"extra {name}", _OPTIONAL, found, f"Run {install_command(name)}.")


def _requirement(name: str) -> str:
    for line in importlib.metadata.requires("polywigner") or []:
        if re.match(rf"{name}\b", line) and ";" not in line:
            return line
    return name


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _print(findings: list[Finding]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    colours = {_GOOD: "green", _BAD: "red", _OPTIONAL: "yellow"}
    table = Table(title="polywigner doctor", title_justify="left")
    for heading in ("", "works", "found"):
        table.add_column(heading, overflow="fold")
    for row in findings:
        found = Text(row.found)
        if row.remedy:
            found.append(f"\n{row.remedy}", style="bold")
        table.add_row(row.subject, Text(row.works, style=colours[row.works]), found)
    console = Console()
    # A pipe or a file has no width of its own: paths and commands should not be broken there.
    Console(width=None if console.is_terminal else 160).print(table)
