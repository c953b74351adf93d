"""Which engine and precision a call runs on."""

from __future__ import annotations

from typing import Any, Literal, get_args

from polywigner.engines import llvm
from polywigner.errors import ArgumentError, EngineError

__all__ = ["Engine", "Precision", "checked_engine", "checked_precision", "drjit_float", "resolved"]

Engine = Literal["auto", "numpy", "llvm", "cuda"]
Precision = Literal["double", "single"] | None

# Compiling a kernel the first time costs as much as NumPy takes for some tens of thousands of
# samples, whatever the polygon: both grow with its number of edges.
_WORTH_COMPILING = 1 << 16
# Where a sum of many terms is one loop, it compiles in no time. Then loading Dr.Jit counts, 0.15 s,
# in which NumPy does about so many terms (130 ns each in float64, against 3 ns on two cores).
_WORTH_LOADING = 1 << 20


def checked_engine(engine: str) -> str:
    """``engine`` if it is a known name. Raises ArgumentError otherwise."""
    if engine not in get_args(Engine):
        names = ", ".join(f'"{name}"' for name in get_args(Engine))
        raise ArgumentError(f"expected engine to be one of {names}, got {engine!r}")
    return engine


def checked_precision(precision: str | None) -> str | None:
    """``precision`` if it is a known name or None. Raises ArgumentError otherwise."""
    if precision not in (None, "double", "single"):
        raise ArgumentError(
            f'expected precision to be "double", "single" or None, got {precision!r}'
        )
    return precision


def resolved(engine: str, samples: int, terms: int = 1) -> str:
    """The engine that runs ``samples`` samples given as NumPy arrays.

    ``"auto"`` takes LLVM where it is usable and there are enough samples, or enough terms, so many
    in a sample's sum; else NumPy; CUDA only when asked for.

    Raises
    ------
    EngineError when the engine asked for cannot be had, with the remedy.
    """
    engine = checked_engine(engine)
    if engine == "auto":
        worth = samples >= _WORTH_COMPILING or samples * terms >= _WORTH_LOADING
        return "llvm" if worth and llvm.prepare().usable else "numpy"
    if engine == "llvm":
        llvm.require()
    elif engine == "cuda":
        _require_cuda()
    return engine


def _require_cuda() -> None:
    llvm.require_drjit()
    import drjit

    if not drjit.has_backend(drjit.JitBackend.CUDA):
        raise EngineError(
            "expected an NVIDIA GPU with its driver for engine='cuda', got none that Dr.Jit can "
            "use; run `polywigner doctor`, or use engine='auto'."
        )


def drjit_float(engine: str, double: bool) -> Any:
    """Dr.Jit's array type of an engine that :func:`resolved` has accepted."""
    import importlib

    # Only this import waits for another thread's: a submodule is there before it is filled.
    import drjit  # noqa: F401

    module = importlib.import_module(f"drjit.{engine}")
    return module.Float64 if double else module.Float32
