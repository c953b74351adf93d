"""Question: how much slower is a scene lit by the Wigner emitter than by Mitsuba's area emitter?

The same floor, camera, integrator, sampler and samples; the same mesh with a null BSDF; each
emitter in processes of its own, which take turns. A process renders once to compile (stated apart)
and then several times; the table gives the medians and their ratio, of the time on the wall and of
the processors' time, which other work on the machine disturbs less. Asked: 1.2 for the square, 3
for the chevron.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
import polywigner.mitsuba as pwm  # before Mitsuba: it chooses the LLVM library

# isort: split
import mitsuba as mi

from polywigner.quantities import wavelength_of

__all__ = ["area_light", "floor_scene"]

_WAVELENGTH = wavelength_of(94e9)
_SHAPES = {
    "square": lambda: pw.shapes.square(0.01),
    "chevron": lambda: pw.shapes.chevron(0.01, 0.01, 0.004),
    "two chevrons": lambda: pw.shapes.chevron_pair(0.01, 0.01, 0.004),
}


def area_light(aperture: pw.Aperture, folder: Path) -> dict[str, Any]:
    """Mitsuba's area emitter on the mesh that a ``wigner`` shape would have."""
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
    """A floor 10 wavelengths below the light, 40 wavelengths wide in the picture; metres."""
    transform = mi.ScalarTransform4f
    z, half = 10 * _WAVELENGTH, 20 * _WAVELENGTH
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


def _measure(emitter: str, shape: str, size: int, spp: int, repeats: int) -> list[float]:
    """First render, then medians of the others on the wall and of the processors; seconds."""
    mi.set_variant("llvm_ad_mono")
    mi.set_log_level(mi.LogLevel.Error)
    aperture = _SHAPES[shape]()
    with tempfile.TemporaryDirectory() as folder:
        if emitter == "area":
            light = area_light(aperture, Path(folder))
        else:
            light = pwm.aperture(aperture, _WAVELENGTH)
        scene = floor_scene(light, size)
    seconds = []
    for seed in range(repeats + 1):
        wall, cpu = time.perf_counter(), time.process_time()
        np.array(mi.render(scene, spp=spp, seed=seed))
        seconds.append((time.perf_counter() - wall, time.process_time() - cpu))
    return [seconds[0][0], *np.median(seconds[1:], axis=0).tolist()]


def _in_child(emitter: str, shape: str, arguments: argparse.Namespace) -> list[float]:
    command = [sys.executable, __file__, "--child", emitter, shape]
    for name in ("size", "spp", "repeats"):
        command += [f"--{name}", str(getattr(arguments, name))]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [float(word) for word in output.split()]


def main() -> None:
    """Print the table of ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--child", nargs=2, metavar=("EMITTER", "SHAPE"))
    arguments = parser.parse_args()
    if arguments.child:
        print(*_measure(*arguments.child, arguments.size, arguments.spp, arguments.repeats))
        return
    print("shape         area, s  wigner, s   ratio: wall           processors            first, s")
    for shape in _SHAPES:
        rounds = [
            [_in_child(emitter, shape, arguments) for emitter in ("area", "wigner")]
            for _ in range(arguments.rounds)
        ]
        times = np.array(rounds)  # (rounds, 2, 3): first, wall, processors
        first, wall, _ = np.median(times, axis=0).T
        ratios = np.sort(times[:, 1, 1:] / times[:, 0, 1:], axis=0)
        spreads = [
            f"{np.median(ratio):5.2f} ({ratio[0]:.2f} to {ratio[-1]:.2f})" for ratio in ratios.T
        ]
        row = f"{shape:13} {wall[0]:7.3f}  {wall[1]:9.3f}  {spreads[0]:21} {spreads[1]:21}"
        print(f"{row} {first[1]:8.2f}", flush=True)


if __name__ == "__main__":
    main()
