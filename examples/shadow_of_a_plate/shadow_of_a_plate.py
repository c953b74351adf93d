"""Errors of geometric shadows: the field behind an opaque plate, exact and by rays.

python shadow_of_a_plate.py [FOLDER]

A point source at 77 GHz is 2 m in front of an L-shaped plate of 0.3 m. Writes
shadow_of_a_plate.png: the irradiance 1 m behind the plate by ray tracing and by Kirchhoff's
integral, and the difference.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import shapely

import polywigner as pw
from polywigner.figures import level_db

WAVELENGTH = 299_792_458 / 77e9
SOURCE = (0.0, 0.0, -2.0)
BEHIND = 1.0
FLOOR = -30.0
PLATE = pw.Aperture(
    [(-0.15, -0.15), (0.15, -0.15), (0.15, 0.0), (0.02, 0.0), (0.02, 0.15), (-0.15, 0.15)]
)


def shadow(samples: int) -> tuple[Any, Any, Any]:
    """Return coordinates in m, and the relative irradiance behind the plate by both models."""
    x = np.linspace(-0.35, 0.35, samples)
    points = np.stack([*np.meshgrid(x, x), np.full((samples, samples), BEHIND)], axis=-1)
    screen = pw.Screen(PLATE, pw.PointSource(SOURCE))
    field = pw.amplitude(screen, points, WAVELENGTH, "kirchhoff", tolerance=1e-4)
    distance = np.linalg.norm(points - SOURCE, axis=-1)
    # Intersections of the rays to the points with the plane of the plate.
    crossing = points[..., :2] * (SOURCE[2] / (SOURCE[2] - BEHIND))
    outline = shapely.union_all([shapely.Polygon(ring) for ring in PLATE.rings])
    lit = ~shapely.contains_xy(outline, crossing[..., 0], crossing[..., 1])
    return x, lit.astype(float), np.abs(field * distance) ** 2


def draw(x: Any, rays: Any, exact: Any) -> Any:
    """Draw both in dB of the free field, and their difference as a fraction of it."""
    figure, axes = plt.subplots(1, 3, figsize=(12.5, 4.1), sharey=True, layout="constrained")
    ends = (1e3 * x[0], 1e3 * x[-1])
    how: dict[str, Any] = {"origin": "lower", "extent": (*ends, *ends)}
    for panel, values, name in zip(axes, (rays, exact), ("rays", "Kirchhoff"), strict=False):
        levels = level_db(values, 1.0, FLOOR)
        shown = panel.imshow(levels, cmap="inferno", vmin=FLOOR, vmax=4.0, **how)
        panel.set_title(name)
    label = f"irradiance, dB of the free field (floor {FLOOR:g} dB)"
    figure.colorbar(shown, ax=axes[:2], label=label.replace("-", "\N{MINUS SIGN}"))
    shown = axes[2].imshow(exact - rays, cmap="RdBu_r", vmin=-1.0, vmax=1.0, **how)
    axes[2].set_title("Kirchhoff less rays")
    figure.colorbar(shown, ax=axes[2], label="irradiance over that of the free field")
    for panel in axes:
        panel.set_xlabel("x (mm)")
    axes[0].set_ylabel("y (mm)")
    figure.suptitle("1 m behind a plate that a point source lights from 2 m before it, 77 GHz")
    return figure


def main(folder: Path, samples: int = 240) -> None:
    x, rays, exact = shadow(samples)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "shadow_of_a_plate.png"
    draw(x, rays, exact).savefig(path, dpi=150)
    inside, outside = exact[rays == 0.0], 10 * np.log10(exact[rays == 1.0])
    print(f"in the shadow: on average {10 * np.log10(inside.mean()):.1f} dB of the free field")
    print(f"outside: {outside.min():.1f} to {outside.max():.1f} dB")
    print(f"wrote {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
