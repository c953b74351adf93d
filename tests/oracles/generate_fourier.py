"""Make tests/data/fourier_stability.npz: run ``python -m oracles.generate_fourier`` in tests/.

For each source of :mod:`oracles.sources`: real frequencies of every decade, complex ones of some,
and F by :mod:`oracles.simplices`, rounded once to float64. Takes half a minute on one core.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from oracles import simplices
from oracles.sources import DECADES, SOURCES, frequencies, points_of

SEED = 20220206
REAL, COMPLEX = 5, 2  # frequencies per decade
TARGET = Path(__file__).parents[1] / "data" / "fourier_stability.npz"


def exact(source: Any, nu: np.ndarray) -> np.ndarray:
    """F (n,), rounded once, at nu (n, d)."""
    tiling = simplices.simplices_of(source)
    return np.array([complex(simplices.fourier(tiling, row)) for row in nu])


def references(source: Any, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """All arrays of one source; its vertices tell whether it is still the same."""
    real = np.concatenate([frequencies(rng, source, d, REAL) for d in DECADES])
    growing = np.concatenate([frequencies(rng, source, d, COMPLEX, growing=True) for d in DECADES])
    return {
        "vertices": points_of(source),
        "nu": real,
        "F": exact(source, real),
        "complex_nu": growing,
        "complex_F": exact(source, growing),
    }


def main() -> None:
    """Write the file."""
    arrays = {}
    for number, (kind, sources) in enumerate(SOURCES.items()):
        for name, source in sources.items():
            rng = np.random.default_rng([SEED, number, len(arrays)])
            for key, value in references(source, rng).items():
                arrays[f"{kind}/{name}/{key}"] = value
        print(kind, file=sys.stderr, flush=True)
    np.savez_compressed(TARGET, **arrays)
    print(f"{TARGET.name}: {TARGET.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
