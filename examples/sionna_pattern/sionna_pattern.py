"""A source of polywigner as the antenna of a transmitter in Sionna RT.

Sionna RT evaluates an antenna pattern at the angles of every path. This pattern is a closed form in
Sionna's kernel, without tables and interpolation, and differentiable with respect to angles.

    pip install polywigner sionna-rt
    python sionna_pattern.py [folder of the figure]

Tested with Sionna RT 2.2.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from polywigner import llvm

llvm.prepare()  # before Dr.Jit, which loads its LLVM library once; a bad library is fatal

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402
import sionna.rt as rt  # noqa: E402

WAVELENGTH = 299792458 / 28e9
STEERED_BY = math.radians(20)


def antenna() -> pw.Array:
    """Return 12 x 16 tapered patches at half a wavelength, steered by 20 degrees."""
    patch = pw.shapes.rectangle(3.4e-3, 3.2e-3)
    positions = pw.arrays.grid_positions(12, 16, WAVELENGTH / 2, WAVELENGTH / 2)
    beam = (math.sin(STEERED_BY), 0.0, math.cos(STEERED_BY))
    weights = np.hamming(12)[:, None] * np.hamming(16)
    phases = pw.arrays.steering_weights(positions, beam, WAVELENGTH)
    return pw.phased_array(patch, positions, weights.ravel() * phases)


def vertical_pattern(source: Any, wavelength: float) -> Callable[[Any, Any], Any]:
    """Return a vertically polarised pattern of Sionna RT: (theta, phi) to a complex field.

    Sionna's antennas point along x, with z upwards: these are the z and y axes of the source, whose
    x axis is along y. |C|^2 is the directivity. Sionna's waves are exp(j omega t - j k r), so that
    C is the conjugate of the far field cos(theta) F/(i lambda) of pw.radiation_pattern (obliquity
    of Rayleigh-Sommerfeld I).
    """
    power = pw.radiation_pattern(source, wavelength, 0.0, 0.0).attrs["radiated_power"]
    scale = math.sqrt(4 * math.pi / power) / wavelength

    def pattern(theta: Any, phi: Any) -> Any:
        forward = dr.sin(theta) * dr.cos(phi)
        nu = mi.Point2f(dr.sin(theta) * dr.sin(phi), dr.cos(theta)) / wavelength
        transform = pw.fourier(source, nu)
        factor = scale * dr.select(forward > 0, forward, 0)
        return mi.Complex2f(transform.imag, transform.real) * factor

    return pattern


def register(name: str, source: Any, wavelength: float) -> None:
    """Register a source with Sionna RT as an antenna pattern of this name."""
    pattern = vertical_pattern(source, wavelength)

    def factory(*, polarization: str, polarization_model: str = "tr38901_2") -> Any:
        return rt.PolarizedAntennaPattern(
            v_pattern=pattern, polarization=polarization, polarization_model=polarization_model
        )

    rt.register_antenna_pattern(name, factory)


def scene_with(pattern: str, file: str | None = None) -> Any:
    """Return a scene of Sionna, or an empty scene, whose transmitters have the pattern."""
    scene = rt.load_scene(file)
    scene.frequency = 299792458 / WAVELENGTH
    one = {"num_rows": 1, "num_cols": 1, "polarization": "V"}
    scene.tx_array = rt.PlanarArray(**one, pattern=pattern)
    scene.rx_array = rt.PlanarArray(**one, pattern="iso")
    return scene


def gain_of_paths(pattern: str, angles: Any, distance: float = 100.0) -> Any:
    """Return Sionna's path gain (n,) times (4 pi distance/lambda)^2 in free space."""
    scene = scene_with(pattern)
    scene.add(rt.Transmitter("tx", position=[0, 0, 0]))
    for k, angle in enumerate(angles):
        place = [distance * math.cos(angle), distance * math.sin(angle), 0.0]
        scene.add(rt.Receiver(f"rx{k}", position=place))
    paths = rt.PathSolver()(scene, max_depth=0)
    real, imaginary = (np.asarray(part.numpy()) for part in paths.a)
    received = (real**2 + imaginary**2).reshape(len(angles))
    return received * (4 * math.pi * distance / WAVELENGTH) ** 2


def draw(path: Path) -> None:
    """Draw the coverage of Sionna's patch and of the array in a street canyon."""
    import matplotlib.pyplot as plt

    register("polywigner", antenna(), WAVELENGTH)
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    titles = {
        "tr38901": "element of 3GPP TR 38.901",
        "polywigner": "12 x 16 patches, steered by 20°",
    }
    for axis, (pattern, title) in zip(axes, titles.items(), strict=True):
        scene = scene_with(pattern, rt.scene.simple_street_canyon)
        scene.add(rt.Transmitter("tx", position=[-33, 0, 10], orientation=[0, 0.12, 0]))
        levels = rt.RadioMapSolver()(scene, cell_size=(1, 1), samples_per_tx=10**6, max_depth=3)
        gain = np.asarray(levels.path_gain.numpy())[0]
        centres = np.asarray(levels.cell_centers.numpy())
        with np.errstate(divide="ignore"):
            image = axis.pcolormesh(
                centres[..., 0], centres[..., 1], 10 * np.log10(gain), vmin=-140, vmax=-65
            )
        axis.set(title=title, xlabel="x in m", ylabel="y in m", aspect="equal")
    figure.colorbar(image, ax=axes, label="path gain in dB")
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    folder.mkdir(parents=True, exist_ok=True)
    draw(folder / "sionna_pattern.png")
    print(folder / "sionna_pattern.png")
