"""What does a cross section cost compared with sums over facets in NumPy, and with ray tracing?

    python benchmarks/rcs_cost.py

The sum is the textbook method: for each illuminated facet, Gordon's formula over its edges, for all
directions at once. It has no shadows except of faces turned away, and divides by the part of nu in
the plane of the facet. Both in turns in one process; ratios above 1: `pw.rcs` is faster. For bodies
that cast shadows on themselves: time and memory, and rays. Mitsuba (Embree, LLVM, all cores) traces
a random ray in each of n x n cells across the body, and each illuminated point adds its wave:
physical optics with an error relative to the amplitude of all illuminated parts in phase.
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
from polywigner.scattering.facets import facets_of, visible_along, visible_pieces

ROUNDS = 5


def directions(count: int) -> np.ndarray:
    """Return unit vectors spread over the sphere, not along an axis."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, k * np.pi * (1 + 5**0.5)
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=1)


def facet_by_facet(body: pw.Polyhedron, s: np.ndarray, wavelength: float) -> np.ndarray:
    """Return monostatic physical optics of a convex body."""
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
    """Return the least CPU seconds of each call, in turns."""
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


class Rays:
    """A body in Mitsuba."""

    def __init__(self, body: pw.Polyhedron) -> None:
        from polywigner import llvm

        llvm.prepare()
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        mesh = mi.Mesh("body", len(body.vertices), len(body.triangles))
        params = mi.traverse(mesh)
        params["vertex_positions"] = body.vertices.ravel().astype(np.float32)
        params["faces"] = body.triangles.ravel().astype(np.uint32)
        params.update()
        self.mi, self.scene = mi, mi.load_dict({"type": "scene", "body": mesh})
        self.points = body.vertices

    def lit(self, s: np.ndarray, across: int) -> tuple[np.ndarray, np.ndarray, float]:
        """Return illuminated points (m, 3), cosines there, and the area of a cell."""
        mi, random = self.mi, np.random.default_rng(1)
        axes = np.array([[0.8, 0.6], [-0.6, 0.8]]) @ np.linalg.svd(s[None])[2][1:]
        flat = self.points @ axes.T
        low, size = flat.min(axis=0), np.ptp(flat, axis=0)
        cells = np.stack(np.meshgrid(*2 * [np.arange(across)], indexing="ij"), -1).reshape(-1, 2)
        places = low + (cells + random.random(cells.shape)) / across * size
        start = places @ axes + (self.points @ s).max() * s + s
        origin = mi.Point3f(*start.T.astype(np.float32))
        result = self.scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(*(-s).tolist())))
        distance, normal = np.array(result.t), np.array(result.n)
        met = np.isfinite(distance)
        lit = start[met] - distance[met, None] * s
        return lit, np.abs(normal.T[met] @ s), float(np.prod(size)) / across**2

    def rcs(self, s: np.ndarray, wavelength: float, across: int) -> tuple[float, float]:
        """Return the cross section, and the cross section of all illuminated parts in phase."""
        lit, _, cell = self.lit(s, across)
        waves = np.exp(4j * np.pi / wavelength * (lit @ s))
        scale = 4 * np.pi * (cell / wavelength) ** 2
        return scale * abs(waves.sum()) ** 2, scale * len(lit) ** 2


def by_rays() -> None:
    print("body, 20 directions             rays, n x n   error, of all in phase   ratio of times")
    for name, body in (("sphere of 20480 facets", sphere(5)), ("torus of 20000", torus(200, 50))):
        rays, s = Rays(body), directions(20)
        exact = pw.rcs(body, s, 0.13)
        for across in (256, 1024):
            result = np.array([rays.rcs(one, 0.13, across) for one in s])
            error = np.abs(np.sqrt(result[:, 0]) - np.sqrt(exact)) / np.sqrt(result[:, 1])
            own, other = fastest(
                lambda b=body, s=s: pw.rcs(b, s, 0.13),
                lambda r=rays, s=s, n=across: [r.rcs(one, 0.13, n) for one in s],
            )
            print(f"{name:30} {across:12} {np.sqrt((error**2).mean()):24.1e} {other / own:16.1f}")


def lit_areas() -> None:
    print("torus of 20000 facets: lit area, exact polygons over rays, 3000 x 3000")
    body = torus(200, 50)
    facets, rays = facets_of(body), Rays(body)
    for s in directions(6):
        pieces = visible_pieces(facets, visible_along(facets, -s))
        # Faces are convex and towards the radar.
        ours = (np.linalg.norm(pieces.vector, axis=1) * np.sign(pieces.vector @ s)).sum() / 2
        _, cosine, cell = rays.lit(s, 3000)
        covered = (pieces.vector @ s).sum() / 2
        print(
            f"{ours / (cell / cosine).sum() - 1:12.1e} {covered / (cell * len(cosine)) - 1:12.1e}"
        )


def spheres() -> None:
    print("sphere of 81920 facets: ka, dB from the closed form, ms a direction")
    body, s = sphere(6), np.array([0.36, 0.48, 0.8])
    for ka in (20.0, 50.0):
        turn = 2j * ka
        exact = np.pi * abs(np.exp(-turn) - (1 - np.exp(-turn)) / turn) ** 2
        wavelength = 2 * np.pi / ka
        result = pw.rcs(body, s, wavelength)
        (own,) = fastest(lambda w=wavelength: pw.rcs(body, s, w))
        print(f"{ka:6} {10 * np.log10(result / exact):10.4f} {own * 1e3:10.1f}")


def near() -> None:
    print("near field of a 10 cm square, 24 GHz: plate of 30 cm; box of 30 x 20 x 10 cm")
    source, wavelength = pw.shapes.square(0.1), 0.0125
    box = extruded([(0, 0), (0.3, 0), (0.3, 0.2), (0, 0.2)], 0.1)
    for name, body in (("plate", pw.shapes.square(0.3)), ("box", box)):
        for distance in (1.0, 3.0, 10.0, 100.0):
            at = distance * np.array([0.1, 0.2, 1.0]) / np.sqrt(1.05)
            (own,) = fastest(lambda b=body, at=at: pw.rcs(b, at, wavelength, source=source))
            print(f"{name:8} {distance:8} m {own * 1e3:10.0f} ms")


if __name__ == "__main__":
    spheres()
    convex()
    with_shadows()
    by_rays()
    lit_areas()
    near()
