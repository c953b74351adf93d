"""The command ``polywigner doctor``: report which parts work, and how to install the others."""

from __future__ import annotations

import importlib.metadata
import platform
import re
import shutil
import sys
from typing import Annotated, NamedTuple

import typer

from polywigner import llvm
from polywigner.errors import install_command
from polywigner.llvm import LLVMStatus, prepare, run_in_child

_GOOD, _BAD, _OPTIONAL = "yes", "no", "-"
_COLOURS = {_GOOD: "green", _BAD: "red", _OPTIONAL: "yellow"}
_GPU_KERNEL = """
import drjit as dr
from drjit.cuda import Float
x = dr.minimum(dr.arange(Float, 16) - 7.5, 2.0)
assert list(x) == [min(k - 7.5, 2.0) for k in range(16)], "its kernels return wrong numbers"
"""


class Row(NamedTuple):
    """Result of one test in the report of :func:`doctor`.

    ``works`` is "yes", "no" or "-" (optional and missing).
    """

    subject: str
    works: str
    text: str
    remedy: str = ""


def doctor(
    install_llvm: Annotated[bool, "Install an LLVM library with apt-get, as root."] = False,
) -> None:
    """Report which parts work on this machine, and how to install the others.

    Tests the engines, the LLVM library, the GPU and the extras. The exit code is 1 if the NumPy
    engine does not work, otherwise 0.
    """
    if install_llvm:
        llvm.install_llvm()
    transforms, status, gpu = _numpy_row(), prepare(), _gpu_row()
    python = Row("python", _GOOD, f"{platform.python_version()} at {sys.executable}")
    rows = [
        transforms,
        _llvm_row(status),
        gpu,
        python,
        *(_library_row(name) for name in sorted({*_requirements()[""], "drjit"})),
        _rendering_row(status, gpu),
    ]
    _print_table(rows + _extras())
    raise typer.Exit(0 if transforms.works == _GOOD else 1)


def _numpy_row() -> Row:
    """Transform a square with NumPy, and report whether the result is correct."""
    try:
        import polywigner as pw

        area = pw.fourier(pw.Aperture([(0, 0), (2, 0), (2, 2), (0, 2)]), (0.0, 0.0), engine="numpy")
        if abs(area - 4.0) < 1e-12:
            version = importlib.metadata.version("numpy")
            return Row("engine numpy", _GOOD, f"NumPy {version}; no other requirements")
        problem = f"a square of area 4 transforms to {area}"
    except Exception as error:  # The report must still contain the other rows.
        problem = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return Row("engine numpy", _BAD, problem, f"Run {install_command()}.")


def _llvm_row(status: LLVMStatus) -> Row:
    """Report the LLVM library that Dr.Jit loads, and the libraries that were refused."""
    refused = [f"refused {path}: {reason}" for path, reason in status.refused]
    head = f"LLVM {status.version} at {status.path}" if status.usable else "no usable library"
    lines = [head, *refused] if status.usable or refused else [status.problem or ""]
    works = _GOOD if status.usable else _BAD
    return Row("engine llvm", works, "\n".join(lines), status.remedy or "")


def _gpu_row() -> Row:
    """Run a kernel in a child process, because a faulty driver can crash the process."""
    child = run_in_child(_GPU_KERNEL)
    if child.returncode == 0:
        return Row("engine cuda", _GOOD, "an NVIDIA GPU")
    if shutil.which("nvidia-smi") is None:
        remedy = "For a GPU, install its driver: `apt-get install nvidia-driver` on Debian."
        return Row("engine cuda", _OPTIONAL, "no NVIDIA driver", remedy)
    problem = f"kernels do not run on the GPU ({_last_line(child.stderr)})"
    return Row("engine cuda", _BAD, problem, "Install an NVIDIA driver 535 or newer.")


def _rendering_row(llvm: LLVMStatus, gpu: Row) -> Row:
    """Import Mitsuba in a child process, and report the variants that this machine can use."""
    # Importing Mitsuba can crash the process if the version of Dr.Jit does not match.
    child = run_in_child("import mitsuba; print(*mitsuba.variants())")
    if child.returncode != 0:
        requirement = _requirements()[""]["mitsuba"]
        remedy = f"Run `pip install --force-reinstall '{requirement}'`."
        if not llvm.drjit_imports:
            remedy = llvm.remedy or ""
        return Row("rendering", _BAD, _last_line(child.stderr), remedy)
    works = {"scalar": True, "llvm": llvm.usable, "cuda": gpu.works == _GOOD}
    variants = ", ".join(name for name in child.stdout.split() if works.get(name.split("_")[0]))
    if not (works["llvm"] or works["cuda"]):
        return Row("rendering", _GOOD, f"{variants}; hundreds of times slower", llvm.remedy or "")
    return Row("rendering", _GOOD, variants)


def _last_line(text: str) -> str:
    """Return the last line of the output of a process, or "no message"."""
    return (text.strip().splitlines() or ["no message"])[-1].strip()


def _requirements() -> dict[str, dict[str, str]]:
    """Return requirements such as "numpy>=2.0", with the extra and the library name as keys.

    The extra "" contains the libraries that are always required.
    """
    by_extra: dict[str, dict[str, str]] = {"": {}}
    for line in importlib.metadata.requires("polywigner") or []:
        requirement, _, marker = line.partition(";")
        extra = re.search(r"extra == ['\"](\w+)", marker)
        library = re.split(r"[^\w.-]", requirement)[0]
        if library != "polywigner":
            by_extra.setdefault(extra[1] if extra else "", {})[library] = requirement.strip()
    return by_extra


def _library_row(name: str) -> Row:
    """Return the version of a required library, or the command that installs it."""
    version = _version(name)
    if version is None:
        requirement = _requirements()[""].get(name, name)
        return Row(name, _BAD, "not installed", f"Run `pip install '{requirement}'`.")
    return Row(name, _GOOD, version)


def _extras() -> list[Row]:
    """Return one row per extra: its missing libraries, or all its libraries if none is missing."""
    rows = []
    for name, libraries in sorted(_requirements().items())[1:]:
        missing = ", ".join(library for library in libraries if _version(library) is None)
        row = Row(f"extra {name}", _GOOD, ", ".join(libraries))
        if missing:
            remedy = f"Run {install_command(name)}."
            row = row._replace(works=_OPTIONAL, text=f"missing: {missing}", remedy=remedy)
        rows.append(row)
    return rows


def _version(name: str) -> str | None:
    """Return the installed version of a distribution, or None if it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _print_table(rows: list[Row]) -> None:
    """Print the rows of the report as a table."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title="polywigner doctor", title_justify="left")
    for heading in ("", "works", "version or problem"):
        table.add_column(heading, overflow="fold")
    for row in rows:
        text = Text(row.text)
        if row.remedy:
            text.append(f"\n{row.remedy}", style="bold")
        table.add_row(row.subject, Text(row.works, style=_COLOURS[row.works]), text)
    console = Console()
    # In a pipe, rich would wrap paths and commands at 80 columns.
    Console(width=None if console.is_terminal else 160).print(table)
