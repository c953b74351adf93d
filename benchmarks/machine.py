"""Facts about the machine and its software, without identifying data."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmarks.peers import cpp
from benchmarks.timing import cores

__all__ = ["LIBRARIES", "facts", "processor"]

LIBRARIES = (
    "polywigner", "numpy", "shapely", "drjit", "mitsuba", "jax", "finufft", "coxeter", "diffractio",
    "bornagain",
)  # fmt: skip
# In descending width; compilers use the first instruction set that the processor has.
_INSTRUCTIONS = ("avx512f", "avx2", "avx", "sse2")


def processor() -> str:
    names = _cpuinfo("model name")
    if names:
        return names[0]
    if sys.platform == "darwin":
        command = ["sysctl", "-n", "machdep.cpu.brand_string"]
        done = subprocess.run(command, capture_output=True, text=True)
        return done.stdout.strip() or platform.machine()
    return platform.processor() or platform.machine()


def instructions() -> str:
    """Return the widest vector instructions that compilers use."""
    flags = " ".join(_cpuinfo("flags")[:1]).split()
    result = next((name for name in _INSTRUCTIONS if name in flags), None)
    return result or {"arm64": "neon", "aarch64": "neon"}.get(platform.machine(), "unknown")


def facts() -> dict[str, str | int | float | None]:
    """Return the facts that affect the results."""
    result: dict[str, str | int | float | None] = {
        "processor": processor(),
        "architecture": platform.machine(),
        "instructions": instructions(),
        "cores": cores(),
        "system": platform.system(),
        "python": platform.python_version(),
        "compiler": cpp.compiler_version(),
        "llvm": _llvm(),
        "load before": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
    }
    return result | {name: _version(name) for name in LIBRARIES}


def _cpuinfo(key: str) -> list[str]:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    return [line.split(":", 1)[1].strip() for line in lines if line.startswith(key)]


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _llvm() -> str | None:
    from polywigner.llvm import prepare

    state = prepare()
    return str(state.version) if state.usable and getattr(state, "version", None) else None
