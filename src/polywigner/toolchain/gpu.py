"""Is there an NVIDIA GPU that Dr.Jit can use? Asked in child processes: drivers can crash."""

from __future__ import annotations

import shutil
from dataclasses import dataclass

from polywigner.toolchain.llvm_verdicts import run_probe

_KERNEL = """
import drjit as dr
if not dr.has_backend(dr.JitBackend.CUDA):
    raise SystemExit("no backend")
from drjit.cuda import Float
x = dr.arange(Float, 16) - 7.5
low = dr.minimum(x, 2.0)
if list(low) != [min(k - 7.5, 2.0) for k in range(16)]:
    raise SystemExit("its kernels return wrong numbers")
print("runs")
"""


@dataclass(frozen=True)
class GPUStatus:
    """Whether kernels can be compiled for an NVIDIA GPU, and if not, the remedy."""

    usable: bool
    name: str | None = None
    """The GPU and its driver's version, as nvidia-smi tells them."""
    problem: str | None = None
    remedy: str | None = None


def look_for_gpu() -> GPUStatus:
    """The state of the CUDA engine, found by running a kernel in a child process."""
    name = _name()
    code, output, errors = run_probe(_KERNEL)
    if code == 0 and output == "runs":
        return GPUStatus(True, name)
    if name is None:
        return GPUStatus(
            False,
            problem="no NVIDIA GPU answers",
            remedy="If there is one, bring its driver: `apt-get install nvidia-driver` on Debian.",
        )
    lines = errors.strip().splitlines()
    return GPUStatus(
        False,
        name,
        f"{name} is here, but its kernels do not run ({lines[-1] if lines else code}).",
        "Install an NVIDIA driver that Dr.Jit supports: 535 or newer.",
    )


def _name() -> str | None:
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return None
    import subprocess

    query = [tool, "--query-gpu=name,driver_version", "--format=csv,noheader"]
    try:
        done = subprocess.run(query, capture_output=True, text=True, timeout=30)
    except (OSError, subprocess.SubprocessError):
        return None
    lines = done.stdout.strip().splitlines() if done.returncode == 0 else []
    return ", driver ".join(part.strip() for part in lines[0].split(",")) if lines else None
