"""How far are shadows by silhouettes from the field behind a real box?

Run ``python benchmarks/fdtd_bodies.py``; takes ten to thirty minutes of CPU. Finite differences in
time (FDTD) solve the wave equation around a cube of three wavelengths in a plane wave at normal or
oblique incidence, for comparison with ``pw.amplitude(obstacles=)`` behind the cube, at points above
-20 dB of the free field. Prints a Markdown table. Lengths are in wavelengths.

The cube, or a plate a quarter of a wavelength thick, has one of these boundary conditions:

    jumps:   u and its slope jump by those of the incident wave on the illuminated faces:
             Kirchhoff's black body, for which silhouettes are exact except for the lattice.
    matched: u/v of a wave at normal incidence: a thin absorber, which reflects at oblique
             incidence.
    soft, hard: u = 0, or du/dn = 0.

``--store FILE`` writes the levels of the finest grid for tests/test_shadow_physics.py.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np

import polywigner as pw

__all__ = ["CASES", "SHAPES", "Body", "Waves", "field_around", "silhouette_field"]

Body = Literal["jumps", "matched", "soft", "hard"]
HALF = 1.5  # half a side of the cube, which is centred at the origin
THIN = 0.125  # half of the plate's thickness
SHAPES = {"cube": HALF, "plate": THIN}
CASES: tuple[tuple[Body, str], ...] = (
    ("jumps", "cube"), ("jumps", "plate"), ("matched", "plate"), ("matched", "cube"),
    ("soft", "cube"), ("hard", "cube"),
)  # fmt: skip
ANGLES = (0.0, 30.0)  # degrees from the z axis towards x, of the incident wave
CELLS = (16, 24)  # per wavelength: a coarse and a fine grid
# Extents of the grid: |x| and y from 0, a mirror plane, to WIDE; z from NEAR to FAR.
WIDE, NEAR, FAR = 4.0, -2.0, 6.0
PLANES = (2.5, 4.0, 5.5)  # planes of comparison
STRIDE = 0.25  # distance of compared points
STORED = 4  # every fourth value is stored for the tests
FLOOR = -20.0  # dB of the free field
RAMP = 4.0  # rise time of the incident wave in periods
SETTLING = 6.0  # decay time of waves around the cube in periods
# Absorbing layers: thickness, and reflected amplitude at normal incidence.
LAYER, REFLECTION = 1.0, 1e-4
# Distance of a point source in place of a plane wave, with a curvature of 1e-5.
DISTANCE = 1e6

Array = np.ndarray


class Room:
    """Leapfrog steps of p at cell centres and v at cell faces; all ends absorb except y = 0.

    v is scaled to decrease by the difference of p in a step.
    """

    def __init__(self, shape: tuple[int, int, int], courant: float, layer: int) -> None:
        self.courant = courant
        self.p = np.zeros(shape, np.float32)
        self.v = [np.zeros(_longer(shape, axis), np.float32) for axis in range(3)]
        self.spare = [np.empty(shape, np.float32) for _ in range(3)]
        self.layers = [list(self._absorbing(axis, layer)) for axis in range(3)]

    def _absorbing(self, axis: int, layer: int) -> Iterator[list[Any]]:
        """Yield positions, factors and memories of convolutional absorbing layers."""
        n = self.p.shape[axis]
        for is_v, start in product((True, False), (True, False)):
            if start and axis == 1:
                continue  # mirror plane
            depth = (np.arange(layer) + (0.0 if is_v else 0.5)) / layer  # 0 at its start
            depth = (depth + (1 / layer if is_v else 0.0))[:: -1 if start else 1]
            strength = -2.0 * np.log(REFLECTION) / layer * self.courant * depth**3
            factor = np.exp(-strength).reshape([-1 if k == axis else 1 for k in range(3)])
            inner = n - 1 if is_v else n
            place = _along(axis, slice(0, layer) if start else slice(inner - layer, inner))
            memory = np.zeros([layer if k == axis else m for k, m in enumerate(self.p.shape)])
            yield [is_v, place, factor.astype(np.float32), memory.astype(np.float32)]

    def step_v(self) -> None:
        for axis in range(3):
            inner = _along(axis, slice(1, -1))
            low, high = _along(axis, slice(-1)), _along(axis, slice(1, None))
            change = self.spare[axis][low]
            np.subtract(self.p[high], self.p[low], out=change)
            self._absorb(axis, change, True)
            self.v[axis][inner] -= change

    def step_p(self) -> None:
        for axis in range(3):
            low, high = _along(axis, slice(-1)), _along(axis, slice(1, None))
            change = self.spare[axis]
            np.subtract(self.v[axis][high], self.v[axis][low], out=change)
            self._absorb(axis, change, False)
            change *= np.float32(self.courant**2)
            self.p -= change

    def _absorb(self, axis: int, change: Array, is_v: bool) -> None:
        for of_v, place, factor, memory in self.layers[axis]:
            if of_v == is_v:
                memory *= factor
                memory += (factor - 1) * change[place]
                change[place] += memory


def _longer(shape: tuple[int, ...], axis: int) -> tuple[int, ...]:
    return tuple(n + (k == axis) for k, n in enumerate(shape))


def _along(axis: int, index: Any) -> tuple[Any, ...]:
    return (*(slice(None) for _ in range(axis)), index)


@dataclass(frozen=True)
class Waves:
    """Field around a cube at cell centres."""

    x: Array
    y: Array
    z: Array
    values: Array
    """u (x, y, z), complex: 1 without the cube."""


@dataclass(frozen=True)
class _Face:
    """A face of the cube: its slice of v, the cells on both sides, and the waves there."""

    axis: int
    inwards: int
    v: tuple[Any, ...]
    outside: tuple[Any, ...]
    inside: tuple[Any, ...]
    flow: Array
    wave: Array
    wave_outside: Array


def field_around(
    body: Body, angle: float, cells: int = CELLS[-1], depth: float = HALF, half: float = HALF,
    wide: float = WIDE, near: float = NEAR, far: float = FAR,
) -> Waves:  # fmt: skip
    """Return u around |x|, |y| < half, |z| < depth in a plane wave."""
    sides = np.array([round(half * cells), round(half * cells), round(depth * cells)])
    h, layer = 1.0 / cells, round(LAYER * cells)
    low = np.array([-round(wide * cells) - layer, 0, round(near * cells) - layer])
    high = np.array([round(wide * cells), round(wide * cells), round(far * cells)]) + layer
    centres = [(np.arange(a, b) + 0.5) * h for a, b in zip(low, high, strict=True)]
    direction = np.array([np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))])
    steps, courant, k = _time_steps(h, direction)
    room = Room(tuple(high - low), courant, layer)
    faces = [
        _face(axis, side, sides, low, h, k * direction, steps)
        for axis, side in ((0, -1), (0, 1), (1, 1), (2, -1), (2, 1))
    ]
    if body == "jumps":
        faces = [face for face in faces if direction[face.axis] * face.inwards > 1e-9]
    totals = [np.zeros_like(face.flow.real) for face in faces]
    periods = RAMP + SETTLING + np.sqrt(2 * wide**2 + (far - near) ** 2) + half
    start = int(np.ceil(periods)) * steps
    result = np.zeros(room.p.shape, np.complex64)
    for n in range(start + steps):
        room.step_v()
        before, now = _phase(n / steps), _phase((n + 0.5) / steps)
        for face, total in zip(faces, totals, strict=True):
            v = room.v[face.axis]
            if body == "jumps":
                v[face.v] += face.inwards * (face.wave * before).real
                continue
            p = room.p[face.outside] + (face.wave_outside * before).real
            if body == "soft":
                total += 2 * face.inwards * p
            elif body == "matched":
                # u/v of the mean of this step and the next step, solved below.
                p += (face.wave_outside * _phase((n + 1) / steps)).real
                total[:] = face.inwards * p / (2 * courant)
            v[face.v] = total - (face.flow * now).real
        room.step_p()
        if body == "matched":
            for face in faces:
                room.p[face.outside] /= 1 + courant / 2
        if body == "jumps":
            for face in faces:
                half_flow = 0.5 * courant**2 * face.inwards * (face.flow * now).real
                room.p[face.outside] += half_flow
                room.p[face.inside] += half_flow
        if n >= start:
            result += room.p * (np.exp(2j * np.pi * (n + 1) / steps) * 2 / steps).astype(
                np.complex64
            )
    phase = np.exp(1j * k * (centres[0] * direction[0])[:, None, None])
    incident = phase * np.exp(1j * k * (centres[2] * direction[2]))
    kept = (slice(layer, -layer), slice(0, -layer), slice(layer, -layer))
    values = (incident + (-result if body == "jumps" else result))[kept]
    x, y, z = (c[s] for c, s in zip(centres, kept, strict=True))
    return Waves(x, y, z, values)


def _face(axis: int, side: int, sides: Array, low: Array, h: float, k: Array, steps: int) -> _Face:
    """Return the face of the cube at ``side`` of an axis, with the incident wave's v and p."""
    spans: list[Any] = [slice(max(-m, n) - n, m - n) for m, n in zip(sides, low, strict=True)]
    at_v, outside, inside = (list(spans) for _ in range(3))
    place = side * sides[axis] - low[axis]
    at_v[axis] = place
    outside[axis], inside[axis] = (place, place - 1) if side > 0 else (place - 1, place)
    axes = [(np.arange(s.start, s.stop) + n + 0.5) * h for s, n in zip(spans, low, strict=True)]
    axes[axis] = np.array([side * sides[axis] * h])
    turns = sum(
        (k[c] * a).reshape([-1 if c == b else 1 for b in range(3)]) for c, a in enumerate(axes)
    )
    wave = np.exp(1j * np.squeeze(turns + np.zeros([len(a) for a in axes]), axis))
    flow = wave * np.sin(k[axis] * h / 2) / np.sin(np.pi / steps)
    return _Face(
        axis, -side, tuple(at_v), tuple(outside), tuple(inside), flow, wave,
        wave * np.exp(0.5j * side * k[axis] * h),
    )  # fmt: skip


def _time_steps(h: float, direction: Array) -> tuple[int, float, float]:
    """Return steps per period, c dt/h, and the wave number of the lattice.

    The steps are the fewest that are stable. Waves on a lattice are slow, most along its axes. A
    long step compensates this in one direction, 20 degrees off an axis: sin^2(pi/steps) = (c
    dt/h)^2 sum_j sin^2(k_j h/2).
    """
    true = np.array([np.sin(np.radians(20.0)), 0.0, np.cos(np.radians(20.0))])
    mean = (np.sin(np.pi * h * true) ** 2).sum()
    steps = 4
    while np.sin(np.pi / steps) / np.sqrt(mean) >= 0.98 / np.sqrt(3):
        steps += 1
    k = 2 * np.pi
    for _ in range(20):  # Newton steps towards the same sine in the direction of the wave
        angles = k * direction * h / 2
        slope = (np.sin(2 * angles) * direction * h / 2).sum()
        k -= ((np.sin(angles) ** 2).sum() - mean) / slope
    return steps, float(np.sin(np.pi / steps) / np.sqrt(mean)), float(k)


def _phase(periods: float) -> complex:
    """Return exp(-i omega t) with a smooth rise."""
    rise = min(periods / RAMP, 1.0)
    return complex(np.sin(np.pi / 2 * rise) ** 2 * np.exp(-2j * np.pi * periods))


def silhouette_field(points: Array, angle: float, depth: float = HALF, half: float = HALF) -> Array:
    """Return u at points (n, 3) behind the body by its silhouette, 1 without the body."""
    corner = half, half, depth
    corners = [[corner[c] * (2 * ((n >> c) & 1) - 1) for c in range(3)] for n in range(8)]
    faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    direction = np.array([np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))])
    source = pw.PointSource(tuple(-DISTANCE * direction), DISTANCE)
    body = pw.Polyhedron(corners, faces)
    return np.asarray(pw.amplitude(source, points, 1.0, "kirchhoff", obstacles=body))


def sampled(waves: Waves) -> tuple[Array, Array]:
    """Return points (n, 3) on the planes behind the cube, and |u| there."""
    h = waves.x[1] - waves.x[0]
    every = max(1, round(STRIDE / h))
    x, y = waves.x[every // 2 :: every], waves.y[every // 2 :: every]
    columns, levels = [], []
    for plane in PLANES:
        layer = int(np.abs(waves.z - plane).argmin())
        grid = np.meshgrid(x, y, waves.z[[layer]], indexing="ij")
        columns.append(np.stack(grid, axis=-1).reshape(-1, 3))
        levels.append(np.abs(waves.values[every // 2 :: every, every // 2 :: every, layer]).ravel())
    return np.concatenate(columns), np.concatenate(levels)


def compared(points: Array, result: Array, angle: float, depth: float) -> str:
    """Return the rms and the largest difference in dB above the floor, and the number of points."""
    model = np.abs(silhouette_field(points, angle, depth))
    chosen = 20 * np.log10(result) > FLOOR
    off = 20 * np.log10(model[chosen] / result[chosen])
    return f"{np.sqrt(np.mean(off**2)):.2f} | {np.abs(off).max():.2f} | {chosen.mean():.0%}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, nargs="+", default=list(CELLS))
    parser.add_argument("--store", type=Path)
    chosen = parser.parse_args()
    stored: dict[str, Any] = {"half": HALF, "thin": THIN, "cells": max(chosen.cells)}
    print(f"### Body {2 * HALF:g} wavelengths wide: silhouettes beside FDTD, above {FLOOR:g} dB\n")
    print("| body | wave arrives at | cells per wavelength | rms, dB | largest, dB | points | s |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    for (body, shape), angle, cells in product(CASES, ANGLES, chosen.cells):
        start, depth = time.process_time(), SHAPES[shape]
        points, result = sampled(field_around(body, angle, cells, depth))
        taken = time.process_time() - start
        row = compared(points, result, angle, depth)
        print(f"| {shape}, {body} | {angle:.0f}° | {cells} | {row} | {taken:.0f} |", flush=True)
        if cells == stored["cells"]:
            stored["points"] = points.round(6).tolist()[::STORED]
            stored[f"{shape}, {body}, {angle:.0f}"] = result.round(4).tolist()[::STORED]
    if chosen.store:
        chosen.store.write_text(json.dumps(stored) + "\n", "utf-8")


if __name__ == "__main__":
    main()
