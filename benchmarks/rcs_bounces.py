"""What do two and three reflections cost compared with one, and compared with ray tracing?

    python benchmarks/rcs_bounces.py

CPU time of the process, the least of some rounds in turns. Mitsuba (Embree, LLVM) traces rays, one
at the centre of each of n x n cells across the body; NumPy adds up their waves, with fields, paths
and shadows (tests/oracles/bounces.py). Errors are rms over directions, relative to the amplitude of
a plate with the area of the body's shadow. The car is 4.4 m long: a shell with arches and
windscreens, four wheels of 24 sides, two mirrors; alone, and on a plate of 12 m x 8 m.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from oracles.bounces import scattered_field
from oracles.meshes import extruded, torus
from polywigner.scattering.facets import facets_of

ROUNDS = 2
WAVELENGTH = 0.0125


def directions(count: int) -> np.ndarray:
    """Return unit vectors, 5 to 45 degrees above the plane z = 0, not along an axis."""
    k = np.arange(count) + 0.3
    azimuth, elevation = 2 * np.pi * k / count, np.radians(5 + 20 * (np.arange(count) % 3))
    across = np.cos(elevation)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], 1)


def upright(ring: Any, y: float, width: float) -> pw.Polyhedron:
    """Return a prism over a ring in x and z, from y to y + width."""
    prism = extruded(ring, width)
    x, z, depth = prism.vertices.T
    return pw.Polyhedron(np.stack([x, y + width - depth, z], axis=1), prism.faces)


def car() -> list[Any]:
    angles = np.linspace(np.pi, 0, 12)
    arches = [
        [(x + 0.38 * math.cos(a), 0.25 + 0.38 * math.sin(a)) for a in angles] for x in (-1.35, 1.3)
    ]
    roof = [
        (2.1, 0.25), (2.15, 0.65), (1.9, 0.8), (0.95, 0.92), (0.35, 1.4), (-1.1, 1.45),
        (-1.9, 0.95), (-2.25, 0.9),
    ]  # fmt: skip
    parts = [upright([(-2.2, 0.25), *arches[0], *arches[1], *roof], -0.85, 1.7)]
    turns = 2 * np.pi * np.arange(24) / 24
    for x in (-1.35, 1.3):
        wheel = [(x + 0.31 * math.cos(a), 0.31 + 0.31 * math.sin(a)) for a in turns]
        parts += [upright(wheel, y, 0.22) for y in (-0.85, 0.63)]
    mirror = [(0.5, 0.95), (0.62, 0.95), (0.62, 1.08), (0.5, 1.08)]
    return [*parts, *(upright(mirror, y, 0.18) for y in (-1.05, 0.87))]


def trihedral() -> list[Any]:
    """Return three perpendicular squares of 20 wavelengths."""
    square = pw.shapes.square(20 * WAVELENGTH)
    poses = np.tile(np.eye(4), (3, 1, 1))
    for k, pose in enumerate(poses):
        pose[:3, :3] = np.roll(np.eye(3), k, axis=0)
        pose[:3, 3] = 10 * WAVELENGTH * np.roll([1, 1, 0], k)
    return [square.placed(pose) for pose in poses]


class Rays:
    """Triangles (n, 3, 3) in Mitsuba."""

    def __init__(self, corners: np.ndarray) -> None:
        from polywigner import llvm

        llvm.prepare()
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        mesh = mi.Mesh("body", 3 * len(corners), len(corners))
        params = mi.traverse(mesh)
        params["vertex_positions"] = corners.ravel().astype(np.float32)
        params["faces"] = np.arange(3 * len(corners), dtype=np.uint32)
        params.update()
        self.mi, self.scene, self.corners = mi, mi.load_dict({"type": "scene", "b": mesh}), corners

    def meet(self, start: np.ndarray, along: np.ndarray, last: np.ndarray) -> Any:
        """Return the first triangles that rays hit, -1 for none, and the distances."""
        if not len(start):
            return last, np.zeros(0)
        gap = np.where(last >= 0, 1e-4, 0.0)
        origin = self.mi.Point3f(*(start + gap[:, None] * along).T.astype(np.float32))
        ray = self.mi.Ray3f(origin, self.mi.Vector3f(*along.T.astype(np.float32)))
        result = self.scene.ray_intersect_preliminary(ray)
        met = np.array(result.is_valid())
        number = np.where(met, np.array(result.prim_index).astype(np.int64), -1)
        # in double precision, from the plane of the triangle
        a, b, c = np.moveaxis(self.corners[number], 1, 0)
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = ((a - start) * normal).sum(axis=1) / (along * normal).sum(axis=1)
        return number, np.where(met, distance, 0.0)

    def root(self, s: np.ndarray, across: int, bounces: int) -> tuple[float, float]:
        """Return the root of the cross section of plates for a field p that returns as p."""
        p = polarisation(s)
        field, area = scattered_field(self.corners, s, s, p, WAVELENGTH, bounces, across, self.meet)
        scale = math.sqrt(4 * math.pi) / WAVELENGTH
        return scale * abs(p @ field), scale * area


def polarisation(s: np.ndarray) -> np.ndarray:
    p = np.cross(s, (0.0, 0.6, 0.8))
    return np.asarray(p / np.linalg.norm(p))


def ours(body: Any, s: np.ndarray, bounces: int) -> np.ndarray:
    p = np.array([polarisation(one) for one in s])
    return np.asarray(np.sqrt(pw.rcs(body, s, WAVELENGTH, polarisation=(p, p), bounces=bounces)))


def fastest(*calls: Callable[[], Any]) -> list[float]:
    """Return the least seconds of each call, in turns."""
    times = [np.inf] * len(calls)
    for _ in range(ROUNDS):
        for k, call in enumerate(calls):
            start = time.process_time()
            call()
            times[k] = min(times[k], time.process_time() - start)
    return times


def bodies() -> list[tuple[str, Any, int]]:
    """Return names, bodies, and numbers of directions."""
    on_plate = [*car(), pw.shapes.rectangle(12.0, 8.0)]
    return [("trihedral", trihedral(), 100), ("car", car(), 4), ("car on a plate", on_plate, 4)]


def reflections() -> None:
    print("body                  triangles   ms a direction: 1, 2, 3 reflections")
    for name, body, count in [*bodies(), ("torus of 2000 facets", torus(50, 20), 2)]:
        s = directions(count)
        times = fastest(*(lambda n=n, b=body, s=s: ours(b, s, n) for n in (1, 2, 3)))
        each = "".join(f"{1e3 * seconds / count:12.1f}" for seconds in times)
        print(f"{name:22} {len(facets_of(body).corner):8} {each}", flush=True)


def by_rays() -> None:
    print("body, 3 reflections    rays, n x n   error of rays   ratio of times")
    for name, body, _ in bodies():
        rays, s = Rays(facets_of(body).corners), directions(4)
        exact = ours(body, s, 3)
        for across in (128, 512) if name == "trihedral" else (256, 1024):
            result = np.array([rays.root(one, across, 3) for one in s])
            error = np.abs(result[:, 0] - exact) / result[:, 1]
            own, other = fastest(
                lambda b=body, s=s: ours(b, s, 3),
                lambda r=rays, s=s, n=across: [r.root(one, n, 3) for one in s],
            )
            rms = np.sqrt((error**2).mean())
            print(f"{name:22} {across:11} {rms:15.1e} {other / own:16.2f}", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore", pw.errors.PolywignerWarning)
    reflections()
    by_rays()
