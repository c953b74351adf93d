"""Write the meshes of the street: a car, a facade, a kerb and a row of posts.

The OBJ files are committed, so that the scene renders without this script. Metres; x along the
street, y to the left, z up. Faces are counter-clockwise from outside.
"""

from __future__ import annotations

import math
from pathlib import Path

Point = tuple[float, float, float]
Triangle = tuple[int, int, int]
Mesh = tuple[list[Point], list[Triangle]]

# Side views (x, z) of a small hatchback, counter-clockwise, with the front at x = 0.
BODY = (
    (0.10, 0.25),
    (4.00, 0.25),
    (4.12, 0.60),
    (4.05, 0.95),
    (1.15, 0.98),
    (0.10, 0.80),
    (0, 0.5),
)
CABIN = ((1.10, 0.97), (3.95, 0.95), (3.50, 1.44), (1.95, 1.44))


def prism(outline: tuple[tuple[float, float], ...], near: list[float], far: list[float]) -> Mesh:
    """Extrude a side view (x, z) along y, from ``near[i]`` to ``far[i]`` at its i-th corner."""
    count = len(outline)
    vertices = [(x, y, z) for ys in (near, far) for (x, z), y in zip(outline, ys, strict=True)]
    caps = [(0, i, i + 1) for i in range(1, count - 1)]
    triangles = caps + [(count, count + j, count + i) for _, i, j in caps]
    for i in range(count):
        j = (i + 1) % count
        triangles += [(i, count + i, count + j), (i, count + j, j)]
    return vertices, triangles


def box(low: Point, high: Point) -> Mesh:
    """Return an axis-aligned box from its lowest to its highest corner."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    return prism(((x0, z0), (x1, z0), (x1, z1), (x0, z1)), [y0] * 4, [y1] * 4)


def disc(radius: float, sides: int = 24) -> tuple[tuple[float, float], ...]:
    """Return the corners of a regular polygon, counter-clockwise."""
    angles = (2 * math.pi * i / sides for i in range(sides))
    return tuple((radius * math.cos(a), radius * math.sin(a)) for a in angles)


def upright(mesh: Mesh) -> Mesh:
    """Exchange the axes cyclically so that y becomes z; faces stay outward."""
    vertices, triangles = mesh
    return [(z, x, y) for x, y, z in vertices], triangles


def moved(mesh: Mesh, x: float, y: float, z: float) -> Mesh:
    vertices, triangles = mesh
    return [(a + x, b + y, c + z) for a, b, c in vertices], triangles


def joined(*meshes: Mesh) -> Mesh:
    vertices: list[Point] = []
    triangles: list[Triangle] = []
    for points, faces in meshes:
        start = len(vertices)
        triangles += [(a + start, b + start, c + start) for a, b, c in faces]
        vertices += points
    return vertices, triangles


def car() -> Mesh:
    """Return a body, a cabin that is narrower at the roof, and four wheels."""
    waist, roof = 0.76, 0.58
    body = prism(BODY, [-0.82] * len(BODY), [0.82] * len(BODY))
    cabin = prism(CABIN, [-waist, -waist, -roof, -roof], [waist, waist, roof, roof])
    wheel = prism(disc(0.31), [-0.1] * 24, [0.1] * 24)
    wheels = [moved(wheel, x, y, 0.31) for x in (0.85, 3.25) for y in (-0.75, 0.75)]
    return joined(body, cabin, *wheels)


def facade() -> Mesh:
    """Return a wall along the street with protruding pilasters and sills."""
    wall = box((0, 0, 0), (18, 0.3, 5))
    pilasters = [box((x, -0.25, 0), (x + 0.5, 0, 5)) for x in (0.0, 3.5, 7.0, 10.5, 14.0, 17.5)]
    sills = [box((x + 1.1, -0.18, 1.0), (x + 2.9, 0, 1.15)) for x in (0.0, 3.5, 7.0, 10.5, 14.0)]
    return joined(wall, *pilasters, *sills)


def posts() -> Mesh:
    """Return bollards of 0.9 m along the kerb."""
    post = upright(prism(disc(0.07), [0.0] * 24, [0.9] * 24))
    return joined(*(moved(post, x, 3.2, 0.12) for x in (2.0, 4.0, 6.0, 8.0, 10.0, 12.0)))


def write_obj(mesh: Mesh, path: Path) -> None:
    vertices, triangles = mesh
    lines = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    path.write_text("\n".join([f"# {path.stem}; written by make_meshes.py", *lines]) + "\n")


def main() -> None:
    folder = Path(__file__).parent / "meshes"
    folder.mkdir(exist_ok=True)
    write_obj(car(), folder / "car.obj")
    write_obj(facade(), folder / "facade.obj")
    write_obj(box((-2, 3.0, -0.2), (18, 5.2, 0.12)), folder / "pavement.obj")
    write_obj(posts(), folder / "posts.obj")


if __name__ == "__main__":
    main()
