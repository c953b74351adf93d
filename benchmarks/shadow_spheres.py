"""How much do shadows of a black ball, a soft and a hard sphere differ?

Run ``python benchmarks/shadow_spheres.py``; takes a minute. A point source at 100 radii illuminates
a sphere. The field behind it is exact by partial waves if u = 0 (soft) or du/dr = 0 (hard) on it;
``pw.amplitude(obstacles=)`` uses a ball of 6,000 facets. Prints a Markdown table: dB of the free
field in the centre of the shadow (Arago's spot), within the shadow (mean power from 0.1 to 0.8 of
its radius) and at its boundary, and the rms difference of levels in the illuminated region (from
1.05 to 2 of its radius). Lengths are in wavelengths.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import polywigner as pw

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from oracles.meshes import ball
from oracles.spheres import field_of_sphere

RADII = (5.0, 50.0)
DISTANCES = (2.0, 4.0, 10.0, 40.0)  # behind the sphere's centre, in radii
BEFORE = 100.0  # distance of the source in radii
STEPS = 40  # steps of the ball, from pole to pole

Array = np.ndarray


@dataclass(frozen=True)
class Zones:
    """Points on a line across the shadow, its boundary and the illuminated region."""

    points: Array
    dark = slice(1, 72)
    boundary = 72
    lit = slice(73, None)


def across(radius: float, distance: float) -> Zones:
    """Return points from the axis outwards, at a distance behind the sphere's centre."""
    source = BEFORE * radius
    # The shadow cone touches the sphere on a circle in front of its centre.
    circle, place = radius * np.sqrt(1 - BEFORE**-2), -radius / BEFORE
    edge = circle * (distance + source) / (place + source)
    x = edge * np.concatenate([[0], np.linspace(0.1, 0.8, 71), [1], np.linspace(1.05, 2, 48)])
    return Zones(np.column_stack([x, 0 * x, 0 * x + distance]))


def behind_ball(radius: float, points: Array) -> Array:
    """Return |u| behind a black ball over the free field."""
    place = np.array([0.0, 0.0, -BEFORE * radius])
    source, body = pw.PointSource(tuple(place)), ball(radius, STEPS)
    result = pw.amplitude(source, points, 1.0, "kirchhoff", obstacles=body, tolerance=1e-4)
    return np.asarray(np.abs(result) * np.linalg.norm(points - place, axis=1))


def levels(radius: float, distance: float) -> dict[str, Array]:
    """Return dB of the free field at the points of :func:`across`: black, soft and hard."""
    points = across(radius, distance).points
    result = {"black": behind_ball(radius, points)}
    for kind in ("soft", "hard"):
        result[kind] = np.abs(field_of_sphere(kind, radius, BEFORE * radius, points))
    return {kind: 20 * np.log10(field) for kind, field in result.items()}


def mean_level(level: Array) -> float:
    """Return the level of the mean power in dB."""
    return float(10 * np.log10(np.mean(10 ** (level / 10))))


def main() -> None:
    columns = [
        "diameter",
        "behind its centre",
        "spot: black, soft, hard",
        "within: black, soft, hard",
    ]
    columns += ["boundary: black, soft, hard", "light, rms difference: soft, hard"]
    print("|", " | ".join(columns), "|")
    print("|" + "--:|" * len(columns))
    for radius in RADII:
        for distance in DISTANCES:
            result = levels(radius, radius * distance)
            middle = [level[0] for level in result.values()]
            dark = [mean_level(level[Zones.dark]) for level in result.values()]
            edge = [level[Zones.boundary] for level in result.values()]
            off = [(result[kind] - result["black"])[Zones.lit] for kind in ("soft", "hard")]
            lit = [np.sqrt(np.mean(difference**2)) for difference in off]
            cells = [", ".join(f"{dB:.1f}" for dB in some) for some in (middle, dark, edge, lit)]
            row = [f"{2 * radius:g} λ", f"{distance / 2:g} diameters", *cells]
            print("|", " | ".join(row).replace("-0.0", "0.0"), "|", flush=True)


if __name__ == "__main__":
    main()
