"""Diffracted shadows of a box and a ball on the floor below a patch antenna.

python shadows_of_bodies.py [FOLDER]

A square patch of 10 mm at 94 GHz is 0.3 m above a floor and radiates downwards. Writes
shadows_of_bodies.png: the irradiance on the floor with geometric shadows, and with edge waves of
the silhouettes of both bodies.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw
from polywigner.figures import level_db

WAVELENGTH = 299_792_458 / 94e9
PATCH = pw.shapes.square(10e-3)
FLOOR, LOWEST = 0.3, -40.0
"""Distance of the floor from the patch in m, and the lowest level shown in dB."""


def box(centre: Any, half: Any, turn: float) -> pw.Polyhedron:
    """Return a box rotated about z by an angle in radians."""
    c, s = np.cos(turn), np.sin(turn)
    corners = np.array([[(-1, 1)[(n >> k) & 1] for k in range(3)] for n in range(8)]) * half
    corners[:, :2] = corners[:, :2] @ np.array([[c, s], [-s, c]])
    faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    return pw.Polyhedron(corners + centre, faces)


def ball(centre: Any, radius: float, steps: int = 24) -> pw.Polyhedron:
    """Return a ball of triangles and quadrilaterals between circles of latitude."""
    theta = np.pi * np.arange(1, steps) / steps
    phi = np.pi * np.arange(2 * steps) / steps
    rings = [
        [(np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)) for p in phi] for t in theta
    ]
    corners = np.concatenate([[(0.0, 0.0, 1.0)], *rings, [(0.0, 0.0, -1.0)]])
    around = 2 * steps
    faces = [(0, 1 + k, 1 + (k + 1) % around) for k in range(around)]
    for low in range(1, 1 + (steps - 2) * around, around):
        for k in range(around):
            right = (k + 1) % around
            faces.append((low + k, low + around + k, low + around + right))
            faces.append((low + k, low + around + right, low + right))
    last = len(corners) - 1
    faces += [(last - around + (k + 1) % around, last - around + k, last) for k in range(around)]
    return pw.Polyhedron(radius * corners + centre, faces)


BODIES = [
    box((0.06, 0.015, FLOOR - 0.12), (0.012, 0.012, 0.03), 0.4),
    ball((-0.025, -0.045, FLOOR - 0.10), 0.02),
]


def irradiances(samples: int) -> tuple[Any, Any, Any]:
    """Return coordinates in m, and the irradiance on the floor without and with both bodies."""
    x = np.linspace(-0.15, 0.15, samples)
    points = np.stack([*np.meshgrid(x, x), np.full((samples, samples), FLOOR)], axis=-1)
    free = pw.irradiance(PATCH, points, WAVELENGTH, "auto")
    result = pw.irradiance(PATCH, points, WAVELENGTH, "auto", obstacles=BODIES)
    return x, free, result


def draw(x: Any, free: Any, result: Any) -> Any:
    """Draw both in dB of the largest free irradiance."""
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.6), sharey=True, layout="constrained")
    ends = (1e3 * x[0], 1e3 * x[-1])
    for panel, values, name in zip(
        axes, (free, result), ("without the bodies", "behind a box and a ball"), strict=True
    ):
        shown = panel.imshow(
            level_db(values, float(free.max()), LOWEST), cmap="inferno", vmin=LOWEST, vmax=0.0,
            origin="lower", extent=(*ends, *ends),
        )  # fmt: skip
        panel.set(title=name, xlabel="x (mm)")
    axes[0].set_ylabel("y (mm)")
    label = f"irradiance, dB of the largest free one (floor {LOWEST:g} dB)"
    figure.colorbar(shown, ax=axes, label=label.replace("-", "\N{MINUS SIGN}"))
    figure.suptitle("Floor 0.3 m below a 10 mm patch, 94 GHz")
    return figure


def main(folder: Path, samples: int = 300) -> None:
    x, free, result = irradiances(samples)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "shadows_of_bodies.png"
    draw(x, free, result).savefig(path, dpi=150)
    blocked = 1.0 - result.sum() / free.sum()
    print(f"the bodies take {100 * blocked:.1f} % of the light on this part of the floor")
    print(f"wrote {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
