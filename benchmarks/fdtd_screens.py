"""How far are rays and diffraction integrals from the field behind real screens?

Run ``python benchmarks/fdtd_screens.py``; takes four minutes of CPU. Finite differences in time
(FDTD) solve the wave equation behind the paper's square, 10 mm wide at 94 GHz, in a plane wave at
normal incidence, for comparison with Wigner rays and with ``pw.amplitude``. Prints Markdown tables
for two grids, whose difference estimates the error of the finer grid: the rms difference of levels
in dB, the relative rms error of fields, and times. Lengths are in wavelengths.

The field scattered by a soft screen is even in z, and by a hard screen odd, so that a half space
suffices:

    soft: u = 0 on the screen,      du/dz = du_inc/dz in the hole
    hard: du/dz = 0 on the screen,  u = u_inc in the hole

Kirchhoff's black screen is the mean of two fields with u = u_inc, or du/dz = du_inc/dz, in the hole
and zero on the screen. The integrals are exact for it, except for the lattice.

``--store FILE`` writes the black screen's irradiance for the figure ``volrender_fdtd`` instead.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np

import polywigner as pw

__all__ = ["Field", "Screen", "field_behind", "field_of"]

Screen = Literal["soft", "hard", "given field", "given slope"]
SCREENS = ("soft", "hard", "black")
METHODS = ("rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2")
RAYS = "rays"
"""Wigner rays with Kirchhoff's obliquity."""
WIDTH = 10e-3 * 94e9 / pw.SPEED_OF_LIGHT
CELLS = (12, 20)  # per wavelength: a coarse and a fine grid
DISTANCES = (2.0, 3.0, 4.0, 5.0, 6.0)
ANGLES = (30.0, 60.0)  # degrees off the axis at the centre of the hole
FLOOR = -30.0  # dB of the largest level on the plane
STRIDE = 0.2  # distance of compared nodes
# Effective extent of a half-line of nodes beyond its last node, in cells: the Wiener-Hopf factor
# sqrt((1 - s)(1 - b s)), b = 3 - sqrt(8), of the lattice's Laplacian on the line is sqrt(1 - s)
# shifted by this value as s -> 1.
TIP = (2 - np.sqrt(2)) / 4
RAMP = 4.0  # rise time of the incident wave in periods
# Angle off the axis of waves with the correct speed on the lattice.
TRUE_ANGLE = np.radians(20.0)
# Periods after the rise, in which waves across the hole decay.
SETTLING = 8.0
# Absorbing layers: thickness, and reflected amplitude at normal incidence.
LAYER, REFLECTION = 1.0, 1e-4

Array = np.ndarray


@dataclass(frozen=True)
class Field:
    """u behind the screen for an incident wave exp(ikz), at the nodes of a quarter of the space."""

    spacing: float
    values: Array
    """(n, n, m) complex, from the axis x = y = 0 and the screen z = 0 on."""

    def plane(self, z: float) -> tuple[Array, float, Array]:
        """Return positions x = y (n,), the height of the nodes next to z, and u (n, n) there."""
        layer = round(z / self.spacing)
        x = self.spacing * np.arange(len(self.values))
        return x, self.spacing * layer, self.values[:, :, layer]


class Lattice:
    """Leapfrog steps of p and its gradient v, with absorbing layers at the far ends (PML).

    p has three parts, one per direction, because layers damp them differently. v is scaled to
    decrease by the difference of p in a step.
    """

    def __init__(self, shape: tuple[int, int, int], courant: float, layer: int) -> None:
        self.courant = courant
        self.p = np.zeros(shape, np.float32)
        self.parts = [np.zeros(shape, np.float32) for _ in shape]
        self.v = [np.zeros(self._shortened(shape, axis), np.float32) for axis in range(3)]
        self.spare = [np.empty_like(v) for v in self.v]
        self.layers = [self._absorbing(axis, layer) for axis in range(3)]

    @staticmethod
    def _shortened(shape: tuple[int, ...], axis: int) -> tuple[int, ...]:
        return tuple(n - (k == axis) for k, n in enumerate(shape))

    def _absorbing(self, axis: int, layer: int) -> list[tuple[Any, Array, Array]]:
        """Return slices of v and p, and their damping before and after a step."""
        last = self.v[axis].shape[axis]
        place = _along(axis, slice(last - layer, last))
        shape = [-1 if k == axis else 1 for k in range(3)]
        result = []
        for offset in (0.5, 0.0):
            depth = (np.arange(layer) + offset) / layer
            damping = -2 * np.log(REFLECTION) / layer * self.courant * depth**3
            factors = 1 - damping / 2, 1 / (1 + damping / 2)
            before, after = (f.reshape(shape).astype(np.float32) for f in factors)
            result.append((place, before, after))
        return result

    def step(self, flow: Array | float) -> None:
        """Advance by one step; ``flow`` is the given part of v on the plane z = 0."""
        for axis in range(3):
            self._step_along(axis, flow if axis == 2 else 0.0)
        np.add(self.parts[0], self.parts[1], out=self.p)
        self.p += self.parts[2]

    def _step_along(self, axis: int, flow: Array | float) -> None:
        v, spare, part = self.v[axis], self.spare[axis], self.parts[axis]
        low, high, first = (_along(axis, s) for s in (slice(-1), slice(1, None), 0))
        (in_v, before_v, after_v), (in_p, before_p, after_p) = self.layers[axis]
        np.subtract(self.p[high], self.p[low], out=spare)
        v[in_v] *= before_v
        v -= spare
        v[in_v] *= after_v
        np.subtract(v[high], v[low], out=spare[high])
        spare[first] = 2 * (v[first] - flow)  # If p is even, v is odd.
        spare *= np.float32(self.courant**2)
        part[in_p] *= before_p
        part[low] -= spare
        part[in_p] *= after_p


def _along(axis: int, index: Any) -> tuple[Any, ...]:
    return (*(slice(None) for _ in range(axis)), index)


def field_behind(
    screen: Screen, cells: int = CELLS[-1], width: float = WIDTH, reach: float = DISTANCES[-1]
) -> Field:
    """Return u behind a square hole for |x|, |y| and z up to ``reach``."""
    # Values on the complete plane change halfway between two nodes.
    tip = {"soft": -TIP, "hard": TIP}.get(screen, 0.5)
    last = round(cells * width / 2 - tip)  # last node on the screen, or in the hole
    spacing = width / 2 / (last + tip)
    layer, size = round(LAYER / spacing), round(reach / spacing) + 1
    steps, courant = _time_steps(spacing)
    lattice = Lattice((size + layer,) * 3, courant, layer)
    hole = np.zeros(lattice.p.shape[:2], bool)
    inside = last + (screen != "soft")
    hole[:inside, :inside] = True
    # v of the incident wave halfway between two planes of nodes, and its mean on a plane.
    half = np.arcsin(np.sin(np.pi / steps) / courant)
    flow = hole * np.float32(np.sin(half) * np.cos(half) / np.sin(np.pi / steps))
    periods = RAMP + SETTLING + np.sqrt(3) * reach + width
    total = np.zeros((size,) * 3, np.complex64)
    start = int(np.ceil(periods)) * steps
    for n in range(start + steps):
        has_flow = screen in ("soft", "given slope")
        lattice.step(flow * _incident((n + 0.5) / steps) if has_flow else 0.0)
        given = lattice.p[:, :, 0]
        if screen in ("soft", "given field"):
            given[~hole] = 0
        if screen in ("hard", "given field"):
            given[hole] = _incident((n + 1) / steps)
        if n >= start:
            wave = np.exp(2j * np.pi * (n + 1) / steps).astype(np.complex64)
            total += lattice.p[:size, :size, :size] * (wave * np.float32(2 / steps))
    return Field(spacing, total)


def _time_steps(spacing: float) -> tuple[int, float]:
    """Return steps per period, the fewest that are stable, and c dt/h.

    Waves on a lattice are slow, most along its axes. A long step compensates this in one direction:
    sin^2(pi/steps) = (c dt/h)^2 sum_j sin^2(k_j h/2).
    """
    direction = np.array([np.sin(TRUE_ANGLE), np.cos(TRUE_ANGLE)])
    mean = (np.sin(np.pi * spacing * direction) ** 2).sum()
    steps = 4
    while np.sin(np.pi / steps) / np.sqrt(mean) >= 0.98 / np.sqrt(3):
        steps += 1
    return steps, float(np.sin(np.pi / steps) / np.sqrt(mean))


def _incident(periods: float) -> np.float32:
    rise = min(periods / RAMP, 1.0)
    return np.float32(np.sin(np.pi / 2 * rise) ** 2 * np.cos(2 * np.pi * periods))


def field_of(screen: str, cells: int) -> Field:
    """Return the field behind a screen of ``SCREENS``."""
    if screen != "black":
        return field_behind(screen, cells)  # type: ignore[arg-type]
    one, other = (field_behind(kind, cells) for kind in ("given field", "given slope"))
    return Field(one.spacing, (one.values + other.values) / 2)


def compared(field: Field, name: str, angle: float) -> str:
    """Return the differences on all planes in dB, and relative errors of fields."""
    levels, missing, whole = [], 0.0, 0.0
    for distance in DISTANCES:
        points, result = _sampled(field, distance)
        above = 20 * np.log10(np.abs(result) / np.abs(result).max()) > FLOOR
        chosen = above & (np.hypot(*points[:, :2].T) < np.tan(np.radians(angle)) * points[:, 2])
        model, some = values_of(name, points[chosen]), result[chosen]
        # Irradiances of rays may be negative near nulls, and count as the floor.
        least = 10 ** (FLOOR / 20) * np.abs(result).max()
        size = np.maximum(np.abs(model), least)
        levels.append(20 * np.log10(size / np.maximum(np.abs(some), least)))
        missing += (np.abs(model - some) ** 2).sum()
        whole += (np.abs(some) ** 2).sum()
    rms = f"{np.sqrt(np.mean(np.concatenate(levels) ** 2)):.2f} dB"
    return rms if name == RAYS else f"{rms}, {np.sqrt(missing / whole):.0%}"


def values_of(name: str, points: Array) -> Array:
    """Return the field of the square at points (n, 3) by an integral, or its modulus by rays."""
    source = pw.shapes.square(WIDTH)
    if name != RAYS:
        return pw.amplitude(source, points, 1.0, method=name, tolerance=1e-4)  # type: ignore[arg-type]
    result = pw.irradiance(source, points, 1.0, obliquity="kirchhoff", tolerance=1e-2)
    return np.sqrt(np.maximum(result, 0.0))


def _sampled(field: Field, distance: float) -> tuple[Array, Array]:
    """Return points (n, 3) on a plane, some nodes apart, and u there."""
    x, z, u = field.plane(distance)
    every = slice(None, None, max(1, round(STRIDE / field.spacing)))
    points = np.stack(np.meshgrid(x[every], x[every], [z], indexing="ij"), axis=-1)
    return points.reshape(-1, 3), u[every, every].ravel().astype(complex)


def store(path: Path) -> None:
    """Write |u|^2 behind the black screen, at every second node, in float16."""
    field = field_of("black", CELLS[0])
    values = np.abs(field.values[::2, ::2, ::2]) ** 2
    np.savez_compressed(path, irradiance=values.astype(np.float16), spacing=2 * field.spacing)
    print(f"{path} ({path.stat().st_size / 1024:.0f} KiB)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, nargs="+", default=list(CELLS))
    parser.add_argument("--store", type=Path)
    chosen = parser.parse_args()
    if chosen.store:
        store(chosen.store)
        return
    names, times = [RAYS, *METHODS], dict.fromkeys([RAYS, *METHODS], 0.0)
    print(f"### Square hole, {WIDTH:.2f} wavelengths wide: differences from FDTD\n")
    print("| screen | off the axis, up to | cells per wavelength |", " | ".join(names), "|")
    print("|---|--:|--:|" + "--:|" * len(names))
    for screen, cells in product(SCREENS, chosen.cells):
        start = time.process_time()
        field = field_of(screen, cells)
        taken = time.process_time() - start
        times[f"FDTD, {screen}, {1 / field.spacing:.1f} cells"] = taken
        for angle in ANGLES:
            row = [screen, f"{angle:.0f}°", f"{1 / field.spacing:.1f}"]
            for name in names:
                start = time.process_time()
                row.append(compared(field, name, angle))
                times[name] = time.process_time() - start
            print("|", " | ".join(row), "|", flush=True)
    count = sum(len(_sampled(field, distance)[0]) for distance in DISTANCES)
    print(f"\n### Processor seconds: of FDTD for the volume, else for at most {count} points\n")
    print("| method | s |\n|---|--:|")
    for name, taken in times.items():
        print(f"| {name} | {taken:.2f} |")


if __name__ == "__main__":
    main()
