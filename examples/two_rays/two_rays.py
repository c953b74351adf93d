"""Two rays over concrete, compared with Sionna RT in the far and in the near field.

A transmitter and receivers are above a floor of concrete at 28 GHz. `pm.channel` and Sionna RT add
the amplitudes of the direct and the reflected path. For small antennas both agree, including
phases. For an array of 0.34 m, Sionna's synthetic arrays use the far-field pattern; polywigner
couples the array and its image at any distance.

    pip install polywigner sionna-rt
    python two_rays.py [folder of the figure]

Tested with Sionna RT 2.2.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
import polywigner.mitsuba as pm  # before Dr.Jit: selects the LLVM library

try:
    import mitsuba as mi
    import sionna.rt as rt
except ModuleNotFoundError:
    sys.exit("this example needs Sionna RT 2.2: pip install sionna-rt")

FREQUENCY = 28e9
WAVELENGTH = pw.SPEED_OF_LIGHT / FREQUENCY
HEIGHTS = (0.5, 0.3)
# Concrete by ITU-R P.2040-3 at 28 GHz: relative permittivity, and conductivity in S/m.
PERMITTIVITY = 5.24
CONDUCTIVITY = 0.0462 * 28**0.7822
# A hundredth of a wavelength, which is isotropic in front with this obliquity.
DOT = pw.shapes.square(WAVELENGTH / 100)
ALL_SIDES: dict[str, Any] = {"obliquity": "rayleigh-sommerfeld-2"}
# A vertical column of 64 elements at half a wavelength, 0.34 m, with a far field from 21 m.
COLUMN = pw.phased_array(DOT, pw.arrays.grid_positions(1, 64, WAVELENGTH, WAVELENGTH / 2))


def looking(place: Any, ahead: float) -> Any:
    """Return a pose along +x or -x with y upwards."""
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([(0, ahead, 0), (0, 0, 1), (ahead, 0, 0)])
    pose[:3, 3] = place
    return pose


def channel_of(source: Any, distances: Any, **options: Any) -> Any:
    """Return h (n,) of receivers at distances along x by polywigner, with vertical polarisation."""
    index = np.sqrt(PERMITTIVITY + 1j * CONDUCTIVITY / (2 * math.pi * FREQUENCY * 8.8541878188e-12))
    concrete = {"type": "conductor", "eta": float(index.real), "k": float(index.imag)}
    size = mi.ScalarTransform4f().scale([400.0, 400.0, 1.0])
    scene = {
        "type": "scene",
        "tx": pm.aperture(source, WAVELENGTH, looking((0, 0, HEIGHTS[0]), 1.0), **options),
        "floor": {"type": "rectangle", "to_world": size, "bsdf": concrete},
    }
    for k, x in enumerate(distances):
        pose = looking((float(x), 0, HEIGHTS[1]), -1.0)
        scene[f"rx{k:04d}"] = pm.receiver(DOT, WAVELENGTH, pose, **ALL_SIDES)
    result = pm.channel(mi.load_dict(scene), [FREQUENCY], reflections=1, polarisation="y")
    return result.h.sortby("receiver").values[0, :, 0]


def sionna_channel_of(distances: Any, rows: int = 1) -> Any:
    """Return h (n,) by Sionna RT, for antennas of 0 dBi or for a column of them."""
    scene = rt.load_scene()
    scene.frequency = FREQUENCY
    one = {"num_cols": 1, "polarization": "V", "pattern": "iso", "vertical_spacing": 0.5}
    scene.tx_array = rt.PlanarArray(num_rows=rows, **one)
    scene.rx_array = rt.PlanarArray(num_rows=1, **one)
    concrete = rt.RadioMaterial(
        "concrete", thickness=10.0, relative_permittivity=PERMITTIVITY, conductivity=CONDUCTIVITY
    )
    mesh = mi.load_dict({"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(400.0)})
    scene.edit(add=rt.SceneObject(mi_mesh=_mesh_of(mesh), name="floor", radio_material=concrete))
    scene.add(rt.Transmitter("tx", position=[0, 0, HEIGHTS[0]]))
    for k, x in enumerate(distances):
        scene.add(rt.Receiver(f"rx{k}", position=[float(x), 0, HEIGHTS[1]]))
    paths = rt.PathSolver()(scene, max_depth=1, synthetic_array=True)
    response = paths.cfr(frequencies=np.zeros(1), normalize=False, out_type="numpy")
    return response.reshape(len(distances), rows).sum(axis=1) / math.sqrt(rows)


def _mesh_of(rectangle: Any) -> Any:
    """Return the two triangles of a rectangle, because Sionna RT requires meshes."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 400.0
    mesh = mi.Mesh("floor", 4, 2)
    params = mi.traverse(mesh)
    params["vertex_positions"] = corners.ravel().tolist()
    params["faces"] = [0, 1, 2, 0, 2, 3]
    params.update()
    return mesh


def direct_phase(distances: Any) -> Any:
    """Return exp(ikr) of the line of sight, because Sionna's delays start at the first path."""
    return np.exp(2j * math.pi * np.hypot(distances, HEIGHTS[0] - HEIGHTS[1]) / WAVELENGTH)


def draw(path: Path) -> None:
    """Draw fringes over distance for a small antenna and for a column of 64 elements."""
    import matplotlib.pyplot as plt

    fine, coarse = np.geomspace(2.0, 60.0, 150), np.geomspace(2.0, 60.0, 40)
    figure, panels = plt.subplots(2, 1, figsize=(8, 6.4), sharex=True, layout="constrained")
    titles = {1: "a small antenna", 64: "an upright column of 64, 0.34 m: far field from 21 m on"}
    for axes, (rows, title) in zip(panels, titles.items(), strict=True):
        exact = channel_of(DOT if rows == 1 else COLUMN, fine, **ALL_SIDES)
        far = 2 * sionna_channel_of(coarse, rows)  # 3 dBi of a half space at each end
        axes.semilogx(fine, 20 * np.log10(np.abs(exact)), lw=1.0, label="polywigner")
        axes.semilogx(coarse, 20 * np.log10(np.abs(far)), "o", ms=3.5, label="Sionna RT")
        axes.set_title(title, fontsize=9)
        axes.set_ylabel("received over sent (dB)")
        axes.grid(alpha=0.4, lw=0.5)
    axes.set_xlabel("distance (m)")
    axes.set_xticks([2, 5, 10, 20, 50], labels=["2", "5", "10", "20", "50"])
    axes.minorticks_off()
    panels[0].legend(frameon=False)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    folder.mkdir(parents=True, exist_ok=True)
    draw(folder / "two_rays.png")
    print(folder / "two_rays.png")
