"""How much longer does a scene with a Wigner emitter take than with Mitsuba's ``area`` emitter?

The floor, camera, integrator, sampler, samples, mesh and null BSDF are equal.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from benchmarks.lines import Line, absent, as_times, line_of
from benchmarks.timing import Action, Effort, cores, in_turns
from polywigner.llvm import prepare
from polywigner.quantities import wavelength_of

__all__ = ["CASES", "QUESTION", "THREADS", "area_light", "floor_scene", "measure"]

QUESTION = "A rendered floor, 256 x 256 pixels of 64 samples"
WAVELENGTH = wavelength_of(94e9)
SHAPES = {
    "square": lambda: pw.shapes.square(0.01),
    "chevron": lambda: pw.shapes.chevron(0.01, 0.01, 0.004),
    "two chevrons": lambda: pw.shapes.chevron_pair(0.01, 0.01, 0.004),
}
CASES = list(SHAPES)
THREADS = (1,)
# Largest accepted time relative to the area emitter.
TARGETS = {"square": 1 / 1.2, "chevron": 1 / 3}
SIZE, SAMPLES = 256, 64
SIZE_QUICK, SAMPLES_QUICK = 64, 4
FEWER_ROUNDS = 3  # a render takes about a second


def area_light(aperture: pw.Aperture, folder: Path) -> dict[str, Any]:
    """Return Mitsuba's area emitter on the mesh of a ``wigner`` shape."""
    import mitsuba as mi

    vertices, triangles = pw.geometry.triangulate(pw.automean(aperture))
    mesh = mi.Mesh("automean", len(vertices), len(triangles))
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.pad(vertices, ((0, 0), (0, 1))).ravel().tolist()
    params["faces"] = triangles.ravel().tolist()
    params.update()
    file = folder / "automean.ply"
    mesh.write_ply(str(file))
    emitter = {"type": "area", "radiance": {"type": "spectrum", "value": 10.0}}
    return {
        "type": "ply",
        "filename": str(file),
        "face_normals": True,
        "bsdf": {"type": "null"},
        "emitter": emitter,
    }


def floor_scene(light: dict[str, Any], size: int) -> Any:
    """Return a floor 10 wavelengths below the light, with an image of 40 wavelengths, in metres."""
    import mitsuba as mi

    transform = mi.ScalarTransform4f
    z, half = 10 * WAVELENGTH, 20 * WAVELENGTH
    look = transform().look_at([0, 0, z / 2], [0, 0, z], [0, 1, 0])
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {
                "type": "orthographic",
                "near_clip": 1e-3 * z,
                "to_world": look.scale([half, half, 1]),
                "film": film,
                "sampler": {"type": "multijitter"},
            },
            "floor": {
                "type": "rectangle",
                "to_world": transform().translate([0, 0, z]).rotate([1, 0, 0], 180).scale(2 * half),
            },
            "light": light,
        }
    )


def measure(case: str, threads: int | None, effort: Effort) -> list[Line]:
    """Measure both emitters in turns."""
    count = threads or cores()
    labels = {"question": "emitter", "case": case, "precision": "single", "threads": count}
    labels |= {"unit": "s", "error_unit": "of the peak, rms noise"}
    if not prepare().usable:
        return [absent(labels, "Mitsuba's area emitter", "needs LLVM (polywigner doctor)")]
    import polywigner.mitsuba as pwm

    # isort: split
    import mitsuba as mi

    mi.set_variant("llvm_ad_mono")
    mi.set_log_level(mi.LogLevel.Error)
    aperture = SHAPES[case]()
    size, spp = (SIZE_QUICK, SAMPLES_QUICK) if effort.quick else (SIZE, SAMPLES)
    with tempfile.TemporaryDirectory() as folder:
        lights = {
            "ours": pwm.aperture(aperture, WAVELENGTH),
            "area": area_light(aperture, Path(folder)),
        }
        scenes = {name: floor_scene(light, size) for name, light in lights.items()}
    actions = {name: _render(scene, spp) for name, scene in scenes.items()}
    times = in_turns(actions, max(2, effort.rounds // FEWER_ROUNDS), count)
    entries = {
        name: (as_times(result, 1.0, _noise(actions[name])), result, 1.0)
        for name, result in times.items()
    }
    target = TARGETS.get(case)
    peer = "Mitsuba's area emitter"
    return [line_of(labels, peer, entries["ours"], entries["area"], target=target)]


def _render(scene: Any, spp: int) -> Action:
    import mitsuba as mi

    seeds = iter(range(1 << 30))
    return lambda: np.array(mi.render(scene, spp=spp, seed=next(seeds)))


def _noise(render: Action) -> float:
    """Return the noise from two images with different seeds."""
    one, other = render(), render()
    mean = (one + other) / 2
    return float(np.sqrt(np.mean((one - other) ** 2) / 2) / np.abs(mean).max())
