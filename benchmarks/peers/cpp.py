"""Hand-written C++ kernels, compiled for this processor.

The outline is a header of constants, so that the compiler has the same information as Dr.Jit.
"""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw

__all__ = [
    "UNROLLED_CLIPS",
    "compiler",
    "compiler_version",
    "header_of",
    "multiply_adds",
    "wigner_kernel",
]

SOURCES = Path(__file__).resolve().parent.parent / "cpp"
# Largest number of clips (edges times sides of pieces) with unrolled code; the chevrons have 192.
UNROLLED_CLIPS = 256
PARALLEL = 1e-12
ROUNDS = 2_000_000  # iterations of the loop of multiply-adds, some hundredths of a second
FLAGS = ["-std=c++20", "-O3", "-ffp-contract=fast", "-shared", "-fPIC"]


@lru_cache(maxsize=1)
def compiler() -> list[str] | None:
    """Return the command of a working C++ compiler, $CXX or the first that exists, or None."""
    try:
        named = shlex.split(os.environ.get("CXX", ""))
    except ValueError:  # unbalanced quotes
        return None
    names = [named] if named else [["c++"], ["g++"], ["clang++"]]
    return next((name for name in names if shutil.which(name[0]) and _works(name)), None)


def _works(command: Sequence[str]) -> bool:
    """Return whether a command compiles C++ of the required standard."""
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "any.cpp"), Path(folder, "any.so")
        source.write_text('extern "C" int any() { return 0; }\n')
        done = subprocess.run(
            [*command, *FLAGS, str(source), "-o", str(library)], capture_output=True
        )
        return done.returncode == 0 and library.exists()


def compiler_version() -> str | None:
    """Return the first line of the compiler's version."""
    if (command := compiler()) is None:
        return None
    done = subprocess.run([*command, "--version"], capture_output=True, text=True)
    return done.stdout.splitlines()[0] if done.returncode == 0 and done.stdout else None


def compiled(source: str, precision: str, *options: str, header: str = "") -> ctypes.CDLL:
    """Compile a source for this processor; raise RuntimeError if this fails."""
    command = compiler()
    if command is None:
        raise RuntimeError("no C++ compiler")
    real, suffix = ("float", "ps") if precision == "single" else ("double", "pd")
    options = (f"-DREAL={real}", f"-DSUFFIX={suffix}", *options)
    with tempfile.TemporaryDirectory() as folder:
        outline, library = Path(folder, "outline.h"), Path(folder, "kernel.so")
        outline.write_text(header)
        files = [f'-DOUTLINE="{outline}"', str(SOURCES / source), "-o", str(library)]
        for machine in (["-march=native"], ["-mcpu=native"], []):
            done = subprocess.run(
                [*command, *FLAGS, *machine, *options, *files], capture_output=True, text=True
            )
            if done.returncode == 0:
                return ctypes.CDLL(str(library))
    reason = (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1]
    raise RuntimeError(f"the C++ compiler failed: {reason}")


def _array(name: str, kind: str, values: Any) -> str:
    array = np.asarray(values)
    sizes = "".join(f"[{n}]" for n in array.shape)
    text = ", ".join(repr(v) for v in array.ravel().tolist())
    return f"constexpr {kind} {name}{sizes} = {{{text}}};\n"


class _Directions:
    """Unit vectors, one for all parallel segments."""

    def __init__(self) -> None:
        self.units: list[np.ndarray] = []

    def of(self, vector: np.ndarray) -> tuple[int, float]:
        """Return the index of a vector's direction, and its signed length."""
        length = float(np.hypot(*vector))
        for number, unit in enumerate(self.units):
            if abs(unit[0] * vector[1] - unit[1] * vector[0]) < PARALLEL * length:
                return number, float(unit @ vector)
        self.units.append(vector / length)
        return len(self.units) - 1, length


def _segments(ring: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    return list(zip(ring, np.roll(ring, -1, axis=0) - ring, strict=True))


def header_of(source: pw.Aperture) -> tuple[str, int]:
    """Return the constants of an outline in normalised units, and the number of clips."""
    directions = _Directions()
    edges, edge_directions = [], []
    for start, vector in (segment for ring in source.rings for segment in _segments(ring)):
        number, length = directions.of(vector)
        edges.append([*start.tolist(), length])
        edge_directions.append(number)
    offsets, side_directions, signs, first = [], [], [], [0]
    for piece in source.convex_cover:
        for start, vector in _segments(piece):
            number, length = directions.of(vector)
            ux, uy = directions.units[number]
            offsets.append(float(ux * start[1] - uy * start[0]))
            side_directions.append(number)
            signs.append(1 if length > 0 else -1)
        first.append(len(offsets))
    header = (
        _array("DIRECTION", "double", directions.units)
        + _array("EDGE", "double", edges)
        + _array("EDGE_DIRECTION", "int", edge_directions)
        + _array("SIDE", "double", offsets)
        + _array("SIDE_DIRECTION", "int", side_directions)
        + _array("SIDE_SIGN", "int", signs)
        + _array("FIRST_SIDE", "int", first)
    )
    return header, len(edges) * len(offsets)


@lru_cache(maxsize=8)
def wigner_kernel(source: pw.Aperture, precision: str, threads: int = 1) -> Callable[..., Any]:
    """Return a function of (x, y, nu_x, nu_y, out) for W, with arrays of one length and type."""
    header, clips = header_of(source)
    options = ["-DUNROLLED"] if clips <= UNROLLED_CLIPS else []
    function = compiled("wigner.cpp", precision, *options, header=header).wigner
    function.argtypes = [ctypes.c_void_p] * 5 + [ctypes.c_size_t]
    function.restype = None
    if threads == 1:
        return lambda *arrays: _call(function, arrays)
    pool = ThreadPoolExecutor(threads)

    def split(*arrays: np.ndarray) -> None:
        parts = zip(*(np.array_split(array, threads) for array in arrays), strict=True)
        list(pool.map(lambda part: _call(function, part), parts))  # ctypes releases the lock

    return split


def _call(function: Any, arrays: Sequence[np.ndarray]) -> None:
    function(*(array.ctypes.data for array in arrays), len(arrays[0]))


def multiply_adds(precision: str) -> Callable[[], float]:
    """Return a loop of fused multiply-adds in registers on one core, which returns their number."""
    real = ctypes.c_float if precision == "single" else ctypes.c_double
    function = compiled("peak.cpp", precision).multiply_add
    function.argtypes = [ctypes.c_size_t, real, real, ctypes.POINTER(real)]
    function.restype = ctypes.c_double
    out = real()
    return lambda: float(function(ROUNDS, 0.999, 0.001, ctypes.byref(out)))
