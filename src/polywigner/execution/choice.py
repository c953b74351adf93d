"""Choice of the engine (NumPy, LLVM or CUDA) and the strategy for a call."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Literal, get_args

from polywigner import llvm
from polywigner.errors import EngineError
from polywigner.geometry.arguments import checked_choice
from polywigner.kernels import Kernel
from polywigner.kernels.element_pairs import RepeatedTables
from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.outline import Tables

Engine = Literal["auto", "numpy", "llvm", "cuda"]
Precision = Literal["double", "single"] | None
_PRECISIONS = ("double", "single")

# Names of the strategies that `pw.explain` prints. docs/performance.md explains them.
GRID = "grid from its axes"
LISTED = "slices listed"
PAIRS = "pairs of edges"
DATA = "edges as data"
CODE = "edges as code"
SUM = "sum of terms"

# Smallest number of samples for which compiled code that reads the source from memory is faster
# than NumPy. benchmarks/default_regret.py measures all thresholds of this module.
_LEAST_SAMPLES = 1000
# Smallest number of terms (samples × edges × waves × copies) for which a kernel compiled for one
# source is faster than NumPy.
_LEAST_TERMS = 1 << 18
# Smallest number of samples (for F), and smallest number of samples per clipped edge (for W and A),
# at which compiled code with edges as constants is faster than compiled code that reads edges from
# memory. Many constants take longer to compile.
_LEAST_SAMPLES_AS_CODE, _LEAST_SAMPLES_PER_EDGE = 1 << 18, 1 << 14
# Smallest number of frequencies per position, and smallest number of edges, for which compiled code
# reads the clipped edges of each slice from a list. With fewer edges, clipping the edges again is
# as fast.
_LEAST_COLUMNS, _LEAST_LISTED_EDGES = 256, 5
# Smallest number of terms per family of parallel edges for which a Fourier transform on a grid is
# computed from the axes of the grid with equation (F4).
_TERMS_PER_FAMILY = 1 << 10


@dataclass(frozen=True)
class Plan:
    """Strategy and engine of a call, its number of samples, and the number of terms per sample."""

    strategy: str
    engine: str
    """Engine of the call: ``"numpy"``, ``"llvm"`` or ``"cuda"``."""
    samples: int
    terms: int
    requested: str = "auto"
    """Requested engine, or "auto"."""
    detail: str = ""

    @property
    def reason(self) -> str:
        """Numbers of samples and terms, and other conditions that determine the strategy."""
        parts = [f"{self.samples} samples of {self.terms} terms"]
        parts += [f"engine={self.requested!r}"] if self.requested != "auto" else []
        return ", ".join([*parts, self.detail] if self.detail else parts)

    def __str__(self) -> str:
        """Return three lines: strategy, engine and reason."""
        return f"strategy: {self.strategy}\nengine: {self.engine}\nbecause: {self.reason}"


_is_uncompiled: ContextVar[bool] = ContextVar("_is_uncompiled", default=False)


def checked_engine(engine: str) -> str:
    """Return the name of an engine. Raises ArgumentError if the name is invalid."""
    return checked_choice(engine, "engine", get_args(Engine))


def checked_precision(precision: str | None) -> str | None:
    """Return "double", "single" or None. Raises ArgumentError for other values."""
    return None if precision is None else checked_choice(precision, "precision", _PRECISIONS)


def resolved(engine: str, samples: int, terms: int = 1) -> str:
    """Return the engine for a number of samples with ``terms`` terms each.

    The engine ``"auto"`` becomes NumPy or LLVM. Raises EngineError if the requested engine is not
    available.
    """
    return _engine_for(engine, samples * terms >= _LEAST_TERMS)


def planned(
    kernel: Kernel,
    tables: Any,
    samples: int,
    *,
    engine: str,
    shape: tuple[int, int] | None = None,
    families: int | None = None,
) -> Plan:
    """Return the strategy and the engine of a call on this machine.

    ``shape`` contains the numbers of positions and frequencies if the call requires all
    combinations of both. ``families`` is the number of families of parallel edges if the
    frequencies of F form a grid. Raises EngineError if the requested engine is not available.
    """
    per_sample, as_data = terms_of(kernel, tables), takes_data(kernel, tables)
    terms = samples * per_sample
    # NumPy takes ten times as long for W and A of arrays, so compiled kernels are faster even for
    # fewer samples.
    by_samples = as_data or isinstance(tables, RepeatedTables)
    is_large = samples >= _LEAST_SAMPLES if by_samples else terms >= _LEAST_TERMS
    actual = _engine_for(engine, is_large)
    sizes = samples, per_sample, engine
    if families is not None:
        is_short = 2 * families <= per_sample or actual == "numpy"
        if is_short and _TERMS_PER_FAMILY * families <= terms:
            detail = f"{families} families of parallel edges on a grid"
            return Plan(GRID, "numpy", *sizes, detail)
    if kernel.slices is None:
        is_outline = as_data and actual != "numpy" and samples < _LEAST_SAMPLES_AS_CODE
        return Plan(DATA if is_outline else SUM, actual, *sizes)
    if shape is not None:
        is_wide = shape[1] >= _LEAST_COLUMNS and len(tables.edges) >= _LEAST_LISTED_EDGES
        if actual == "numpy" or is_wide:
            detail = f"{shape[0]} positions x {shape[1]} frequencies"
            return Plan(LISTED, actual, *sizes, detail)
    if actual == "numpy":
        return Plan(PAIRS, actual, *sizes)
    is_code = tables.fits_code and samples >= _LEAST_SAMPLES_PER_EDGE * len(tables.edges)
    return Plan(CODE if is_code else DATA, actual, *sizes)


def _engine_for(engine: str, is_large: bool) -> str:
    """Return the engine of a call. "auto" selects LLVM for a large call, if LLVM is usable.

    Raises EngineError if the requested engine is not available.
    """
    if checked_engine(engine) == "llvm":
        llvm.require()
    elif engine == "cuda":
        _require_cuda()
    if engine != "auto":
        return engine
    return "llvm" if is_large and not _is_uncompiled.get() and llvm.prepare().usable else "numpy"


def terms_of(kernel: Kernel, tables: Any) -> int:
    """Return the number of terms that a kernel sums for each sample."""
    if kernel.slices is not None:
        return max(1, len(tables.edges)) * tables.waves_per_cut * len(kernel.slices.views)
    if isinstance(tables, RepeatedTables):
        return tables.terms * max(1, tables.element.clips)
    return int(getattr(tables, "terms", 0)) or len(tables.edges)


def takes_data(kernel: Kernel, tables: Any) -> bool:
    """Return whether compiled code can read the source from memory."""
    if isinstance(tables, OutlineTables):
        return kernel.name == "fourier"
    return kernel.slices is not None and isinstance(tables, Tables)


@contextmanager
def uncompiled() -> Iterator[None]:
    """Within the block, use NumPy for the engine ``"auto"`` in the calling thread.

    Mitsuba loads scenes in Dr.Jit's threads. A Dr.Jit thread that waits for a kernel can crash the
    process.
    """
    token = _is_uncompiled.set(True)
    try:
        yield
    finally:
        _is_uncompiled.reset(token)


def _require_cuda() -> None:
    """Raise EngineError if Dr.Jit finds no usable NVIDIA GPU."""
    llvm.require_drjit()
    import drjit

    if not drjit.has_backend(drjit.JitBackend.CUDA):
        raise EngineError(
            "expected an NVIDIA GPU and its driver for engine='cuda', but Dr.Jit finds no usable "
            "GPU; run `polywigner doctor`, or use engine='auto'."
        )


def drjit_float(engine: str, double: bool) -> type:
    """Return Dr.Jit's ``Float64`` (if ``double`` is true) or ``Float32`` for "llvm" or "cuda"."""
    import importlib

    # This import waits until another thread has completed its import of Dr.Jit.
    import drjit  # noqa: F401

    module = importlib.import_module(f"drjit.{engine}")
    kind: type = module.Float64 if double else module.Float32
    return kind
