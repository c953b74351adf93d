"""What does a cross section cost beside a sum over facets, one after the other, in NumPy?

    python benchmarks/rcs_cost.py

The sum is the textbook's: for each lit facet, Gordon's formula over its edges, for all directions
at once; it knows no shadows but those of faces turned away, and divides by the part of nu in the
facet's plane. Both in turns in one process; ratios above 1: `pw.rcs` is faster. Of bodies that cast
shadows on themselves: time and memory alone.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from oracles.meshes import extruded, sphere, torus

ROUNDS = 5


def directions(count: int) -> np.ndarray:
    """Unit vectors spread over the sphere, none along an axis."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, k * np.pi * (1 + 5**0.5)
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=1)


def facet_by_facet(body: pw.Polyhedron, s: np.ndarray, wavelength: float) -> np.ndarray:
    """Monostatic physical optics of a convex body."""
    nu = 2 * s / wavelength
    total = np.zeros(len(s), complex)
    for face in body.faces:
        corners = body.vertices[list(face)]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal /= np.linalg.norm(normal)
        cosine = s @ normal
        lit = cosine > 0
        if not lit.any():
            continue
        some = nu[lit]
        across = np.cross(normal, some)
        sums = np.zeros(len(some), complex)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            edge = b - a
            wave = np.sinc(some @ edge) * np.exp(-1j * np.pi * (some @ (a + b)))
            sums += across @ edge * wave
        total[lit] += cosine[lit] * 1j * sums / (2 * np.pi * (across**2).sum(axis=1))
    return np.asarray(4 * np.pi / wavelength**2 * np.abs(total) ** 2)


def fastest(*calls: Callable[[], Any]) -> list[float]:
    """Least seconds of each, in turns; of the process, since others may have the cores as well."""
    times = [np.inf] * len(calls)
    for _ in range(ROUNDS):
        for k, call in enumerate(calls):
            start = time.process_time()
            call()
            times[k] = min(times[k], time.process_time() - start)
    return times


def convex() -> None:
    box = extruded([(0, 0), (3, 0), (3, 2), (0, 2)], 1.0)
    print("convex body, directions            pw.rcs, us a direction   ratio to the facet sum")
    for name, body, count in (
        ("box of 6 faces, 1", box, 1),
        ("box of 6 faces, 1000", box, 1000),
        ("sphere of 1280 facets, 1", sphere(3), 1),
        ("sphere of 1280 facets, 100", sphere(3), 100),
        ("sphere of 20480 facets, 1", sphere(5), 1),
        ("sphere of 20480 facets, 20", sphere(5), 20),
    ):
        s = directions(count)
        ours, theirs = (f(body, s, 0.13) for f in (pw.rcs, facet_by_facet))
        assert np.allclose(np.sqrt(ours), np.sqrt(theirs), atol=1e-6 * np.sqrt(theirs).max())
        own, other = fastest(
            lambda b=body, s=s: pw.rcs(b, s, 0.13), lambda b=body, s=s: facet_by_facet(b, s, 0.13)
        )
        print(f"{name:34} {own / count * 1e6:14.0f} {other / own:24.1f}")


def with_shadows() -> None:
    print("body with shadows        first call, s    ms a direction    memory of process, MB")
    stairs = [(0, 0), (3, 0), (3, 1), (2, 1), (2, 2), (1, 2), (1, 3), (0, 3)]
    for name, body in (
        ("stairs of 10 faces", extruded(stairs, 2.0)),
        ("torus of 2000 facets", torus(50, 20)),
        ("torus of 20000 facets", torus(200, 50)),
    ):
        s = directions(10)
        start = time.perf_counter()
        pw.rcs(body, s[0], 0.05)
        first = time.perf_counter() - start
        (own,) = fastest(lambda b=body, s=s: pw.rcs(b, s, 0.05))
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{name:24} {first:13.2f} {own / len(s) * 1e3:17.0f} {memory:24.0f}")


if __name__ == "__main__":
    convex()
    with_shadows()
