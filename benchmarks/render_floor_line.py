"""Does a rendered floor show the diffraction integral without bias?

Renders the line through the axis on a floor below an aperture (4096 samples per pixel, multijitter)
and compares it with the pixel-averaged quadrature of the same integral. Without the floor's cosine
that integral is compared with |U|^2 of the exact first Rayleigh-Sommerfeld integral. Prints one row
for each distance:

- error: mean |rendered - quadrature| over the line, in dB of the peak, for one seed;
- bias: (mean signed error of the line over all seeds) / (its statistical error): within about 3
  for 64 seeds; a dozen seeds give larger values by chance;
- model: rms of the integral against |U|^2 in dB, at levels above -20 dB of its peak;
- quadrature: its largest change with more nodes, over the peak.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import polywigner as pw
import polywigner.mitsuba as pwm  # before Mitsuba: selects the LLVM library

# isort: split
import mitsuba as mi

import render_reference as reference
from polywigner.quantities import wavelength_of

__all__ = ["COLUMNS", "WAVELENGTH", "Case", "cases", "floor_scene", "quadrature_line", "rendered"]

WAVELENGTH = wavelength_of(94e9)
COLUMNS = 401
_SPREAD = 2.0  # half width of the line over the distance
_MILLIMETRE = 1e-3  # unit of the scene; in metres, 2 wavelengths are too small for Mitsuba's rays


@dataclass(frozen=True)
class Case:
    """An aperture, a distance, and the required accuracy."""

    name: str
    aperture: pw.Aperture
    distance: float
    """Wavelengths."""
    error_db: float
    model_db: float | None = None

    @property
    def z(self) -> float:
        """Height of the aperture in metres."""
        return self.distance * WAVELENGTH


def cases() -> list[Case]:
    """Return the square of 10 mm at four distances, and a chevron of 10 mm at two distances."""
    square = pw.shapes.square(0.01)
    chevron = pw.shapes.chevron(0.01, 0.01, 0.004)
    asked = [(2, -30.0, 0.7), (5, -38.0, 0.35), (10, -40.0, 0.2), (20, -40.0, 0.08)]
    squares = [Case("square", square, *row) for row in asked]
    return [*squares, *(Case("chevron", chevron, z, -40.0) for z in (10, 50))]


def floor_scene(
    case: Case,
    columns: int = COLUMNS,
    sampler: str = "multijitter",
    bsdf: Any = None,
    more: Any = None,
    **options: Any,
) -> Any:
    """Return a white floor below the aperture and a camera that faces it, in millimetres.

    ``bsdf``: of another floor; ``more``: further entries; ``options``: of the aperture's entry.
    """
    transform = mi.ScalarTransform4f
    z = case.z / _MILLIMETRE
    half = _SPREAD * z
    look = transform().look_at([0, 0, z / 2], [0, 0, z], [0, 1, 0])
    floor = transform().translate([0, 0, z]).rotate([1, 0, 0], 180).scale(2 * half)
    white = {"type": "spectrum", "value": 1.0}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {
                "type": "orthographic",
                "near_clip": 1e-3 * z,
                "to_world": look.scale([half, half, 1]),
                "film": {
                    "type": "hdrfilm",
                    "width": columns,
                    "height": 1,
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": sampler},
            },
            "floor": {
                "type": "rectangle",
                "to_world": floor,
                "bsdf": bsdf or {"type": "diffuse", "reflectance": white},
            },
            "aperture": pwm.aperture(case.aperture, WAVELENGTH, scene_unit=_MILLIMETRE, **options),
            **(more or {}),
        }
    )


def rendered(scene: Any, spp: int, seed: int, integrator: Any = None) -> npt.NDArray[np.float64]:
    """Return the irradiance of the floor along +x, pi times the radiance of a white diffuser."""
    image = pwm.render(scene, integrator, spp=spp, seed=seed)
    # The camera points along +z with +y up, so its columns run towards -x.
    return np.pi * image[0, ::-1, 0].astype(np.float64)


def quadrature_line(case: Case, columns: int = COLUMNS) -> npt.NDArray[np.float64]:
    """Return the expectation of ``rendered``."""
    points = reference.pixel_points(columns, _SPREAD * case.z, case.z)
    values = reference.wigner_floor(case.aperture, points, WAVELENGTH)
    return reference.mean_over_pixels(values)


def model_error_db(case: Case, columns: int = COLUMNS) -> float:
    """Return the rms difference of the leading-order integral from |RS-I|^2 above -20 dB."""
    points = reference.pixel_points(columns, _SPREAD * case.z, case.z, per_side=1)[:, 0, 0]
    leading = reference.wigner_intensity(case.aperture, points, WAVELENGTH)
    exact = reference.rayleigh_sommerfeld(case.aperture, points, WAVELENGTH)
    lit = exact > 0.01 * exact.max()
    return float(np.sqrt(np.mean((10 * np.log10(leading[lit] / exact[lit])) ** 2)))


def quadrature_error(case: Case) -> float:
    """Return the largest change of the quadrature with more nodes, over its peak."""
    points = reference.pixel_points(41, _SPREAD * case.z, case.z, per_side=1)
    values = reference.wigner_floor(case.aperture, points, WAVELENGTH)
    return reference.convergence(case.aperture, points, WAVELENGTH, values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spp", type=int, default=4096)
    parser.add_argument("--seeds", type=int, default=64)
    parser.add_argument("--sampler", default="multijitter")
    arguments = parser.parse_args()
    mi.set_variant(pwm.choose_variant())
    mi.set_log_level(mi.LogLevel.Error)
    print("aperture  distance   error dB (asked)    bias   model dB (asked)   quadrature")
    for index, case in enumerate(cases()):
        expected = quadrature_line(case)
        scene = floor_scene(case, sampler=arguments.sampler)
        # With equal seeds, the errors of the rows would be correlated.
        seeds = range(index * arguments.seeds, (index + 1) * arguments.seeds)
        runs = [rendered(scene, arguments.spp, seed) for seed in seeds]
        errors = (np.array(runs) - expected) / expected.max()
        level = 10 * np.log10(np.abs(errors).mean())
        signed = errors.mean(axis=1)
        bias = signed.mean() / (signed.std(ddof=1) / np.sqrt(len(signed)))
        asked = "" if case.model_db is None else f"({case.model_db})"
        row = f"{case.name:9} {case.distance:4} waves   {level:7.2f} ({case.error_db:.0f})"
        row += f"   {bias:+7.2f}   {model_error_db(case):8.3f} {asked:8}"
        print(f"{row}   {quadrature_error(case):.0e}", flush=True)


if __name__ == "__main__":
    main()
