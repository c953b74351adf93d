"""Engine and precision of a call, and the counts that its plan is made from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from typing import Any, Literal, get_args

from polywigner.errors import EngineError
from polywigner.geometry.arguments import checked_choice
from polywigner.kernels import Kernel
from polywigner.kernels.arrays.repeated import ElementSum, RepeatedTables
from polywigner.kernels.cut.slice_sums import SliceSum
from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.outline.tables import Tables
from polywigner.kernels.outline.waves import UNIFORM
from polywigner.plans import Outline, Plan, Request, plan
from polywigner.toolchain import llvm

Engine = Literal["auto", "numpy", "llvm", "cuda"]
Precision = Literal["double", "single"] | None
_PRECISIONS = ("double", "single")


_is_uncompiled: ContextVar[bool] = ContextVar("_is_uncompiled", default=False)


def checked_engine(engine: str) -> str:
    """``engine`` if it is a known name. Raises ArgumentError otherwise."""
    return checked_choice(engine, "engine", get_args(Engine))


def checked_precision(precision: str | None) -> str | None:
    """``precision`` if it is a known name or None. Raises ArgumentError otherwise."""
    return None if precision is None else checked_choice(precision, "precision", _PRECISIONS)


def resolved(engine: str, samples: int, terms: int = 1) -> str:
    """The engine that sums so many terms for each of so many samples, given as NumPy arrays.

    ``"auto"`` is planned; CUDA only when asked for.

    Raises
    ------
    EngineError when the engine asked for cannot be had, with the remedy.
    """
    return planned(Request("sum", samples, terms=terms, engine=engine)).engine


def planned(request: Request) -> Plan:
    """The plan for a request on this machine.

    Raises
    ------
    EngineError when the engine asked for cannot be had, with the remedy.
    """
    if checked_engine(request.engine) == "llvm":
        llvm.require()
    elif request.engine == "cuda":
        _require_cuda()
    if _is_uncompiled.get() and request.engine == "auto":
        return plan(replace(request, compiles=False))
    found = plan(request)
    if found.engine in ("numpy", "cuda") or llvm.prepare().usable:
        return found
    return plan(replace(request, compiles=False))


@contextmanager
def uncompiled() -> Iterator[None]:
    """Within, ``"auto"`` is NumPy: where code runs in a thread that belongs to Dr.Jit itself.

    Mitsuba loads scenes in Dr.Jit's threads. One that waits there for a kernel has ended a process.
    """
    token = _is_uncompiled.set(True)
    try:
        yield
    finally:
        _is_uncompiled.reset(token)


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


def takes_data(kernel: Kernel, tables: Any) -> bool:
    """Whether there is such a kernel: for F, and for sums over pairs of edges."""
    if isinstance(tables, OutlineTables):
        return kernel.name == "fourier"
    return kernel.slices is not None and isinstance(tables, Tables) and tables.fits_pairs


def is_uniform(kernel: Kernel, tables: Any) -> bool:
    """Whether one kernel serves all sources of this kind."""
    if not isinstance(tables, Tables):
        return True
    is_plain = tables.groups == (UNIFORM,) and tables.uniform and tables.coherence is None
    return is_plain and kernel.slices is not None and kernel.slices.serves_all


def request_for(
    kernel: Kernel,
    tables: Any,
    samples: int,
    *,
    double: bool,
    engine: str,
    families: int | None = None,
) -> Request:
    """Request of a kernel for a number of samples at any places."""
    outline, is_array = None, False
    terms = getattr(tables, "terms", 0) or len(tables.edges)
    if kernel.slices is not None:
        outline = _outline_of(kernel, tables)
    elif isinstance(tables, RepeatedTables) and isinstance(tables.element, Tables):
        outline, is_array = _outline_of(kernel, tables.element), True
    return Request(
        kernel.name,
        samples,
        outline,
        terms,
        is_array,
        families=families,
        double=double,
        engine=engine,
        takes_data=takes_data(kernel, tables),
    )


def _outline_of(kernel: Kernel, tables: Tables) -> Outline:
    cut, slices = kernel.edge_sum, kernel.slices
    exact = sum(line.exact for line in tables.lines)
    return Outline(
        max(1, len(tables.edges)),
        max(1, len(tables.pieces)),
        max(1, tables.clips),
        max(1, len(tables.lines)),
        exact / max(1, len(tables.lines)),
        tables.waves_per_cut,
        len(cut.views) if isinstance(cut, (SliceSum, ElementSum)) else 0,
        is_uniform=is_uniform(kernel, tables),
        allows_lists=slices is not None and slices.listed is not None,
        weighs_lags=tables.coherence is not None,
    )
