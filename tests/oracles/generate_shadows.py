"""Write tests/data/shadows.json: |U| of a square behind a plate and a box, by surface integrals.

Run: PYTHONPATH=src:tests python -m oracles.generate_shadows
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import polywigner as pw
from oracles.shadow_quadrature import aperture_radiators, lit_regions, shadowed_field, surface_of

DATA = Path(__file__).parents[1] / "data" / "shadows.json"


def main() -> None:
    reference = json.loads(DATA.read_text("utf-8"))
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
        # all points of the square see the same faces
        counts = {len(lit_regions([surface_of(body)], p)[0]) for p in source.positions}
        assert len(counts) == 1
        points = np.array(reference[name]["points"]) / wavelength
        field = shadowed_field([body], source, points, order=10, share_regions=True)
        reference[name]["field"] = np.abs(field).tolist()
        reference[name]["free"] = np.abs(source.field(points)).tolist()
    DATA.write_text(json.dumps(reference, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
