"""How far are fields at black, soft and hard edges, one edge at a time, from exact fields?

Run ``python benchmarks/conducting_edges.py``; takes a minute. Prints Markdown tables of levels in
dB. Lengths are in wavelengths.

- A half-plane and a block of 90 degrees: exact fields of a point source are integrals along the
  edge (Svensson, Fred and Vanderkooy, J. Acoust. Soc. Am. 106, 2331, 1999).
- A strip in a plane wave: integral equations for the currents. The field of a long plate differs
  from the field of the strip by waves from one edge to the other.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy.special import hankel1, j0

import polywigner as pw

Array = np.ndarray

K = 2 * np.pi
AWAY = 50.0  # distance of source and points from the edge of a half-plane
ANGLES = (2.0, 5.0, 10.0, 20.0, 40.0)  # degrees into the shadow
STARTS = (90.0, 40.0)  # degrees of the source from the half-plane
WIDTHS = (0.5, 1.0, 3.0, 10.0)  # of strips
TILTS = (0.0, 40.0, 75.0)  # degrees of the plane wave from the normal of the strip
LONG = 1e5  # length of quasi-infinite plates
DISTANCE = 1e6  # of a point source in place of a plane wave
FLOOR = -30.0  # lowest compared level in dB relative to the free field


def field_of_wedge(kind: str, outside: float, start: float, angles: Array) -> Array:
    """Return u over exp(ikR)/R in the shadow of a wedge, at ``angles`` from its illuminated face.

    ``outside``: the angle of space, in rad; ``start``: angle of the source. Source and points are
    at the distance AWAY from the edge, and not on the boundary of the shadow.
    """
    order = np.pi / outside
    # The path of integration is deformed, so that the wave decays along it.
    t, weights = np.polynomial.legendre.leggauss(4000)
    turn = np.exp(0.25j * np.pi)
    v, weights = 1.5 * turn * (1 + t), 1.5 * turn * weights
    path = 2 * AWAY + v**2
    eta = np.arccosh(1 + (path**2 - 4 * AWAY**2) / (2 * AWAY**2))
    # dz/(rho R) for a position z on the edge, with rho = R = path/2
    measure = 2 * v / (path * np.sqrt(path**2 / 4 - AWAY**2)) * weights
    total = np.zeros((len(angles), len(v)), complex)
    for sign, part in ((1, angles - start), (-1 if kind == "soft" else 1, angles + start)):
        for angle in order * np.array([np.pi + part, np.pi - part])[..., None]:
            total += sign * np.sin(angle) / (np.cosh(order * eta) - np.cos(angle))
    integral = 2 * (total * measure * np.exp(1j * K * path)).sum(axis=1)
    distance = AWAY * np.sqrt(2 - 2 * np.cos(angles - start))
    return -order / (4 * np.pi) * integral * distance * np.exp(-1j * K * distance)


def behind_plate(edge: Any, start: float, angles: Array) -> Array:
    """Return u over exp(ikR)/R of a large plate, z = 0 and x < 0, at ``angles`` from its front."""

    def at(angle: Any) -> Array:
        return AWAY * np.stack([-np.cos(angle), 0 * angle, -np.sin(angle)], axis=-1)

    # An M-shaped plate, whose other edges are far away; see double_edges.py.
    corners = [(0.0, -1.0), (0.0, 1.0), (-0.6, 1.2), (-0.4, 0.0), (-0.6, -1.2)]
    plate = pw.Aperture([(LONG * x, LONG * y) for x, y in corners]).placed(np.eye(4))
    source, points = at(np.array(start)), at(angles)
    lamp = pw.PointSource(tuple(source))
    field = pw.amplitude(lamp, points, 1.0, "kirchhoff", obstacles=plate, edge=edge)
    distance = np.linalg.norm(points - source, axis=1)
    return np.asarray(field * distance * np.exp(-1j * K * distance))


def edges_table() -> None:
    """Print levels behind a half-plane and behind a block of 90 degrees."""
    print("| edge | incidence | " + " | ".join(f"{a:g}°" for a in ANGLES) + " |")
    print("|---|--:|" + "--:|" * len(ANGLES))
    worst = 0.0
    for start in STARTS:
        first, angles = np.radians(start), np.radians(start + 180 + np.array(ANGLES))
        rows = {"black": behind_plate("black", first, angles)}
        for kind in ("soft", "hard"):
            plate = rows[f"half-plane, {kind}"] = behind_plate(kind, first, angles)
            exact = field_of_wedge(kind, 2 * np.pi, first, angles)
            worst = max(worst, float(np.abs(plate / exact - 1).max()))
            if angles.max() < 1.5 * np.pi:
                rows[f"block, {kind}"] = field_of_wedge(kind, 1.5 * np.pi, first, angles)
        for name, field in rows.items():
            levels = (f"{20 * np.log10(abs(u)):.1f}" for u in field)
            print(f"| {name} | {90 - start:g}° | " + " | ".join(levels) + " |")
    print(f"\nLargest difference of both half-planes, relative: {worst:.0e}\n")


class Strip:
    """Field of a soft or hard strip, |x| < width/2 and z = 0, in a plane wave."""

    def __init__(self, kind: str, width: float, tilt: float) -> None:
        self.kind, self.half = kind, width / 2
        count = 40 + round(30 * width)
        theta = (np.arange(count) + 0.5) * np.pi / count
        self.x, self.sine, self.step = self.half * np.cos(theta), np.sin(theta), np.pi / count
        self.tilt = np.radians(tilt)
        apart = np.abs(self.x[:, None] - self.x)
        m = np.arange(1, count)
        waves = np.cos(np.outer(theta, m))
        # Quadrature of ln|cos(theta) - cos(theta')| on the nodes, for even periodic functions.
        logs = -self.step * (np.log(2.0) + 2 * (waves / m) @ waves.T)
        safe = np.where(apart > 0.0, apart, 1.0)
        smooth = 0.25j * hankel1(0, K * safe) + j0(K * safe) / K * np.log(safe / self.half)
        smooth[apart == 0.0] = 0.25j - (np.log(K * self.half / 2) + np.euler_gamma) / K
        green = smooth * self.step - j0(K * apart) / K * logs
        incident = np.exp(1j * K * self.x * np.sin(self.tilt))
        if kind == "soft":  # the currents times sin(theta)
            self.current = np.linalg.solve(green, -incident)
            return
        order = np.arange(1, count // 2)
        sines, slopes = np.sin(np.outer(theta, order)), order * np.cos(np.outer(theta, order))
        heavy = self.half * self.sine[:, None] * sines
        system = self.step * (slopes.T @ green @ slopes - K**2 * heavy.T @ green @ heavy)
        normal = 1j * K * np.cos(self.tilt) * incident
        jumps = np.linalg.solve(system, self.step * heavy.T @ normal)
        self.current = heavy @ jumps

    def field(self, x: Array, z: Array) -> Array:
        """Return u at points (n,) away from the strip, for an incident wave of amplitude 1."""
        incident = np.exp(1j * K * (x * np.sin(self.tilt) + z * np.cos(self.tilt)))
        away = np.hypot(x[:, None] - self.x, z[:, None])
        if self.kind == "soft":
            kernel = 0.25j * hankel1(0, K * away)
        else:
            kernel = 0.25j * K * hankel1(1, K * away) * z[:, None] / away
        return incident + self.step * kernel @ self.current


def near_long_plate(edge: Any, width: float, tilt: float, x: Array, z: Array) -> Array:
    """Return u at points (x, 0, z) of a long plate."""
    angle = np.radians(tilt)
    plate = pw.shapes.rectangle(width, LONG).placed(np.eye(4))
    lamp = pw.PointSource((-DISTANCE * np.sin(angle), 0.0, -DISTANCE * np.cos(angle)), DISTANCE)
    points = np.stack([x, 0 * x, z], axis=-1)
    field = pw.amplitude(lamp, points, 1.0, "kirchhoff", obstacles=plate, edge=edge)
    return np.asarray(field * np.exp(-2j * np.pi * (DISTANCE % 1.0)))


def off_in_dB(field: Array, exact: Array) -> float:
    """Return the rms difference of levels at points above FLOOR."""
    bright = np.abs(exact) > 10 ** (FLOOR / 20)
    off = 20 * np.log10(np.abs(field[bright]) / np.abs(exact[bright]))
    return float(np.sqrt(np.mean(off**2)))


def strips_table() -> None:
    """Print rms differences on half circles behind and in front of a strip."""
    print("| width | incidence | kind | black, behind | one edge at a time, behind | in front |")
    print("|--:|--:|---|--:|--:|--:|")
    for width in WIDTHS:
        radius = 5.0 + width
        angle = np.radians(np.linspace(-85, 85, 171))
        x, z = radius * np.sin(angle), radius * np.cos(angle)
        for tilt in TILTS:
            black = near_long_plate("black", width, tilt, x, z)
            for kind in ("soft", "hard"):
                strip = Strip(kind, width, tilt)
                behind, front = strip.field(x, z), strip.field(x, -z)
                first = near_long_plate(kind, width, tilt, x, z)
                second = near_long_plate(kind, width, tilt, x, -z)
                values = [
                    off_in_dB(black, behind), off_in_dB(first, behind), off_in_dB(second, front)
                ]  # fmt: skip
                cells = " | ".join(f"{value:.2f}" for value in values)
                print(f"| {width:g} λ | {tilt:g}° | {kind} | {cells} |")


def times() -> None:
    """Print processor times for a square plate and 10,000 points."""
    points = np.random.default_rng(0).uniform((-20, -20, 5), (20, 20, 40), (10_000, 3))
    plate = pw.shapes.square(10.0).placed(np.eye(4))
    lamp = pw.PointSource((0.0, 0.0, -30.0))
    print("\n| edge | microseconds per point, NumPy |\n|---|--:|")
    for edge in ("black", "soft", "hard"):
        how: Any = {"obstacles": plate, "edge": edge, "engine": "numpy"}
        begin = time.process_time()
        pw.amplitude(lamp, points, 1.0, "kirchhoff", **how)
        print(f"| {edge} | {(time.process_time() - begin) * 100:.0f} |")


if __name__ == "__main__":
    edges_table()
    strips_table()
    times()
