"""Generate reference data in tests/data: ``PYTHONPATH=src:tests python -m oracles.generate NAME``.

NAME is one of the functions at the end of this module.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

import laws
import polywigner as pw
from oracles import edge_integrals as plane_waves
from oracles import exact, kinds, positions, simplices, sources
from oracles.references import DATA, Reference, awkward, awkward_names, read_json
from oracles.shadow_quadrature import aperture_radiators, lit_regions, shadowed_field, surface_of

COINCIDENT, STABILITY, STEEPEST = 20220205, 20220206, 20220207  # seeds
# Numbers of frequencies, positions and lags of a shape.
FREQUENCIES, POSITIONS, LAGS = 128, 500, 300
# Number of frequencies in each decade, for each source.
REAL = 5


def coincident_edges() -> None:
    """Write W and A by :mod:`oracles.exact` of the outlines in the file, at hard points.

    This takes a minute on one core with gmpy2, and a few minutes without gmpy2. An outline is
    stored as rings (stacked, with lengths and roles), positions and lags with the index of their
    frequency.
    """
    arrays = {}
    for number, name in enumerate(awkward_names()):
        rng = np.random.default_rng([COINCIDENT, number])
        for key, value in of_outline(awkward(name), rng).items():
            arrays[f"{name}/{key}"] = value
    np.savez_compressed(DATA / "coincident_edges.npz", **arrays)


def of_outline(stored: Reference, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return all arrays of a shape."""
    rings, shape = stored.rings, positions.outline(stored.rings)
    rows = [(ring, k) for outer, holes in stored.polygons for k, ring in enumerate([outer, *holes])]
    nu = positions.frequencies(rng, shape, FREQUENCIES)
    x, xi = positions.positions(rng, shape, POSITIONS), positions.lags(rng, shape, LAGS)
    x_nu = rng.integers(FREQUENCIES, size=POSITIONS).astype(np.uint8)
    xi_nu = rng.integers(FREQUENCIES, size=LAGS).astype(np.uint8)
    return {
        "vertices": np.concatenate([ring for ring, _ in rows]),
        "lengths": np.array([len(ring) for ring, _ in rows], np.uint8),
        "hole": np.array([k > 0 for _, k in rows]),
        "nu": nu,
        "x": x,
        "x_nu": x_nu,
        "wigner": np.array([exact.wigner(rings, p, nu[k]) for p, k in zip(x, x_nu, strict=True)]),
        "xi": xi,
        "xi_nu": xi_nu,
        "ambiguity": np.array(
            [exact.ambiguity(rings, nu[k], p) for p, k in zip(xi, xi_nu, strict=True)]
        ),
    }


def fourier_stability() -> None:
    """Write F of :mod:`oracles.sources` by :mod:`oracles.simplices`, in half a minute."""
    arrays: dict[str, np.ndarray] = {}
    for number, (kind, members) in enumerate(sources.SOURCES.items()):
        for name, source in members.items():
            rng = np.random.default_rng([STABILITY, number, len(arrays)])
            for key, value in of_source(source, rng).items():
                arrays[f"{kind}/{name}/{key}"] = value
    np.savez_compressed(DATA / "fourier_stability.npz", **arrays)


def of_source(source: Any, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return all arrays of a source, including its vertices."""

    drawn = [sources.frequencies(rng, source, d, REAL) for d in sources.DECADES]
    nu = np.concatenate(drawn)
    return {"vertices": sources.points_of(source), "nu": nu, "F": simplices.rounded(source, nu)}


def exact_slices() -> None:
    """Write W, A, F and marginals of all coherent sources of :mod:`laws`, in half a minute."""
    arrays = {
        name: np.concatenate([laws.computed_values(name, f) for f in kinds.FUNCTIONS]).astype(
            complex
        )
        for name in laws.SOURCES
        if "partly" not in name
    }
    np.savez_compressed(DATA / "exact_slices.npz", **arrays)


def shadows() -> None:
    """Write |U| of a square behind a plate and a box, by surface integrals."""
    reference = read_json("shadows")
    wavelength = reference["wavelength"]
    square = pw.shapes.square(reference["side"] / wavelength)
    source = aperture_radiators(square, "rayleigh-sommerfeld-1", order=10, longest=4.0)
    pose = np.array(reference["plate_pose"])
    pose[:3, 3] /= wavelength
    plate = pw.Aperture(np.array(reference["plate_outline"]) / wavelength).placed(pose)
    vertices = np.array(reference["box_vertices"]) / wavelength
    for name, body in (
        ("plate", plate),
        ("box", pw.Polyhedron(vertices, reference["box_faces"])),
    ):
        # All points of the square see the same faces.
        counts = {len(lit_regions([surface_of(body)], p)[0]) for p in source.positions}
        assert len(counts) == 1
        points = np.array(reference[name]["points"]) / wavelength
        field = shadowed_field([body], source, points, order=10, share_regions=True)
        reference[name]["field"] = np.abs(field).tolist()
        reference[name]["free"] = np.abs(source.field(points)).tolist()
    (DATA / "shadows.json").write_text(json.dumps(reference, indent=1) + "\n", "utf-8")


# Star of 1 mm, wavelength of 550 nm, and direction cosines of the tilted wave.
STAR, LIGHT, TILTED = (5, 0.5e-3, 0.2e-3), 550e-9, (0.3, -0.2)


def edge_integrals() -> None:
    """Write fields of a star by :mod:`oracles.edge_integrals`, in ten minutes."""
    star = pw.shapes.star(*STAR)
    groups = {}
    for name, p, points in star_points(star.rings[0]):
        values = [plane_waves.fields(star.rings, point, LIGHT, p) for point in points]
        parts = [[[v.real, v.imag] for v in row] for row in values]
        groups[name] = {"direction": p, "points": points.tolist(), "fields": parts}
        if name.endswith("zones"):
            values = [plane_waves.parabolic_field(star.rings, point, LIGHT) for point in points]
            groups[name]["fresnel"] = [[v.real, v.imag] for v in values]
    reference = {"star": STAR, "wavelength": LIGHT, "methods": plane_waves.METHODS}
    text = json.dumps(reference | {"groups": groups}) + "\n"
    (DATA / "edge_integrals.json").write_text(text, "utf-8")


def star_points(ring: np.ndarray) -> Iterator[tuple[str, tuple[float, float], np.ndarray]]:
    """Yield a name, the direction cosines of a wave, and 20 points for each group."""
    rng, radius = np.random.default_rng(STEEPEST), STAR[1]
    heights = {
        "20 wavelengths": 20 * LIGHT,
        "200 Fresnel zones": radius**2 / (200 * LIGHT),
        "5 Fresnel zones": radius**2 / (5 * LIGHT),
        "1/100 Fresnel zone": radius**2 / (0.01 * LIGHT),
    }
    normal = (0.0, 0.0)
    for name, z in heights.items():
        yield name, normal, random_points(rng, max(radius, 1.5 * LIGHT * z / radius), z)
    z = heights["200 Fresnel zones"]
    share = rng.uniform(size=(10, 1))
    shadow = np.concatenate([ring, ring + share * (np.roll(ring, -1, axis=0) - ring)])
    yield "boundary of the shadow", normal, np.column_stack([shadow, np.full(20, z)])
    # Points on extensions of edges, and on lines through corners across the edges.
    along = ring - np.roll(ring, -1, axis=0)
    beyond = np.concatenate([ring + 0.4 * along, ring + 0.4 * along[:, ::-1] * [-1.0, 1.0]])
    yield "lines through corners", normal, np.column_stack([beyond, np.full(20, z)])
    ray = z * np.array(TILTED) / np.sqrt(1 - np.dot(TILTED, TILTED))
    yield "tilted", TILTED, random_points(rng, radius, z) + np.append(ray, 0.0)
    yield "tilted, boundary", TILTED, np.column_stack([shadow + ray, np.full(20, z)])


def random_points(rng: np.random.Generator, spread: float, z: float) -> np.ndarray:
    """Return 20 points of a square of half-width ``spread`` in the plane z."""
    return np.column_stack([rng.uniform(-spread, spread, (20, 2)), np.full(20, z)])


if __name__ == "__main__":
    writers = (coincident_edges, edge_integrals, exact_slices, fourier_stability, shadows)
    {f.__name__: f for f in writers}[sys.argv[1]]()
