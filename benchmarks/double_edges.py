"""Where do waves over two successive edges matter?

Run ``python benchmarks/double_edges.py FOLDER``; takes some minutes, writes double_edges.png, and
prints a Markdown table of the differences in dB for some separations. A plane wave passes two half
planes, which extend downwards from their edges. Shadows by silhouettes, with one edge at a time,
are compared with two successive Kirchhoff screens: the field behind the first screen is integrated
over the open part of the second screen. Lengths are in wavelengths; angles of points are at the
second edge, downwards from the direction of the wave.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import hankel1

import polywigner as pw

Array = np.ndarray

SEPARATIONS = np.geomspace(0.5, 1000.0, 34)
GRAZING = 0.03  # height of the second edge over the root of the separation
TILTS = np.linspace(-19.5, 19.5, 40)  # degrees, of the line from the first edge to the second
ANGLES = np.linspace(-20.0, 45.0, 66)  # degrees into the shadow of the second edge
APART = 30.0  # separation of the edges for varying tilt
BEHIND = 100.0  # distance of points from the second edge
# Angles, separations, and heights of the second edge over the separation, of the table.
SHOWN = (0.0, 5.0, 10.0, 20.0, 40.0)
SPACINGS = (1.0, 10.0, 100.0, 300.0)
HEIGHTS = {
    "10° above the boundary": lambda n: n * np.tan(np.radians(10.0)),
    "just in the light": lambda n: GRAZING * n**0.5,
    "just in the shadow": lambda n: -GRAZING * n**0.5,
    "5° below the boundary": lambda n: -n * np.tan(np.radians(5.0)),
}
FLOOR = -36.0  # lowest compared level in dB relative to the free field
DISTANCE = 1e5  # distance of a point source in place of a plane wave
REACH = 1500.0  # length of the half planes
WINDOW, TAPER, NODES = (
    150.0,
    75.0,
    4.0,
)  # of the integral: length, length of its taper, nodes per unit length


def half_plane(top: float, z: float) -> Any:
    """Return an M-shaped plate that is opaque below x = top, with only its upper edge close to
    points.

    The strongest wave of an edge comes from its point nearest to the receiver. For the other edges,
    these are corners, whose waves are weaker by the root of the distance.
    """
    pose = np.eye(4)
    pose[0, 3], pose[2, 3] = top, z
    corners = [(0.0, -1.0), (0.0, 1.0), (-0.6, 1.2), (-0.4, 0.0), (-0.6, -1.2)]
    return pw.Aperture([(REACH * x, REACH * y) for x, y in corners]).placed(pose)


def behind(obstacles: Any, x: Array, z: Array | float) -> Array:
    """Return u at (x, 0, z), 1 without obstacles; the wave comes from far down the z axis."""
    points = np.stack(np.broadcast_arrays(x, 0.0, z), axis=-1)
    source = pw.PointSource((0.0, 0.0, -DISTANCE), DISTANCE)
    # Normalised to 1 at z = 0, without loss of phase over the long path.
    result = pw.amplitude(source, points, 1.0, "kirchhoff", obstacles=obstacles, tolerance=1e-4)
    return np.asarray(result * np.exp(-2j * np.pi * (DISTANCE % 1.0)))


def cascade(top: float, separation: float, x: Array, z: Array) -> Array:
    """Return u at points (x, 0, z) behind both half planes, by Kirchhoff's integral over the second
    one.

    The field behind the first half plane minus the field that the second one blocks: with G the
    outgoing wave of a line, the integral of u dG/dz - G du/dz over the blocked part of the
    plane.
    """
    count = round((WINDOW + TAPER) * NODES)
    step = (WINDOW + TAPER) / count
    nodes = top - step * (np.arange(count) + 0.5)
    depth = np.clip((top - nodes - WINDOW) / TAPER, 0.0, 1.0)
    weights = step * np.cos(np.pi / 2 * depth) ** 2
    first, small = half_plane(0.0, 0.0), 0.02
    ahead, here, back = (behind(first, nodes, separation + n * small) for n in (1, 0, -1))
    slope = (ahead - back) / (2 * small)
    k = 2 * np.pi
    down = z[:, None] - separation
    away = np.hypot(x[:, None] - nodes, down)
    wave, wave_slope = 0.25j * hankel1(0, k * away), 0.25j * k * hankel1(1, k * away) * down / away
    return behind(first, x, z) - (weights * (here * wave_slope - slope * wave)).sum(axis=1)


def compared(top: float, separation: float, degrees: Any = ANGLES) -> tuple[Array, Array]:
    """Return |u| at all angles by silhouettes and by two successive screens."""
    angles = np.radians(degrees)
    x, z = top - BEHIND * np.sin(angles), separation + BEHIND * np.cos(angles)
    both = [half_plane(0.0, 0.0), half_plane(top, separation)]
    return np.abs(behind(both, x, z)), np.abs(cascade(top, separation, x, z))


def differences(result: list[tuple[Array, Array]]) -> Any:
    """Return level differences in dB (angle, point) at bright points."""
    single, double = (np.maximum(np.array(part).T, 1e-6) for part in zip(*result, strict=True))
    off = 20 * np.log10(single / double)
    return np.ma.masked_where(20 * np.log10(double) < FLOOR, off)


def draw(lit: Any, hidden: Any, tilted: Any) -> Any:
    figure, axes = plt.subplots(1, 3, figsize=(12.5, 4.4), sharey=True, layout="constrained")
    style: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -12, "vmax": 12, "shading": "nearest"}
    for panel, places, off in zip(
        axes, (SEPARATIONS, SEPARATIONS, TILTS), (lit, hidden, tilted), strict=True
    ):
        shown = panel.pcolormesh(places, ANGLES, off, **style)
        lines = panel.contour(
            places, ANGLES, np.ma.filled(np.abs(off), np.nan), [1.0], colors="black", linewidths=0.8
        )
        panel.clabel(lines, fmt="1 dB", fontsize=7)
        panel.axhline(0.0, color="0.4", lw=0.7, ls=":")
        panel.set_facecolor("0.75")
    for panel, place in zip(axes, ("light", "shadow"), strict=False):
        title = f"second edge just in the {place} of the first"
        panel.set(xscale="log", xlabel="separation of the edges (wavelengths)")
        panel.set_title(title, fontsize=10)
    axes[0].set_ylabel("point, degrees into the second edge's shadow")
    axes[2].set_title(f"edges {APART:g} wavelengths apart", fontsize=10)
    axes[2].set_xlabel("second edge, degrees above the shadow boundary")
    label = "one edge at a time, dB above two screens in a row"
    figure.colorbar(shown, ax=axes, label=label, extend="both")
    return figure


def print_table() -> None:
    """Print differences in dB of silhouettes from the cascade, and levels of the cascade."""
    print("| second edge | separation | " + " | ".join(f"{a:g}°" for a in SHOWN) + " |")
    print("|---|--:|" + "--:|" * len(SHOWN))
    for name, height in HEIGHTS.items():
        for n in SPACINGS:
            one, both = (20 * np.log10(u) for u in compared(height(n), n, SHOWN))
            cells = (f"{a - b:+.1f} ({b:.0f})" for a, b in zip(one, both, strict=True))
            print(f"| {name} | {n:g} λ | " + " | ".join(cells) + " |")


def main(folder: Path) -> None:
    print_table()
    level = [[compared(side * GRAZING * n**0.5, n) for n in SEPARATIONS] for side in (1, -1)]
    tilted = [compared(APART * np.tan(np.radians(tilt)), APART) for tilt in TILTS]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "double_edges.png"
    draw(*map(differences, [*level, tilted])).savefig(path, dpi=150)
    print(f"wrote {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
