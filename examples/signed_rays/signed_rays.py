"""Diffraction by ray tracing: rays that carry W through lenses of optiland to the focus.

Run:  python signed_rays.py [FOLDER]        (needs optiland 0.6; some minutes)
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw

WAVELENGTH = 587.6e-9
MM = 1e-3
BEFORE = 20.0  # mm from the pupil to the lens
# name: (across corners of the hexagon in mm, [(radius, thickness in mm, glass)])
SINGLET = [(51.68, 3.0, "N-BK7"), (np.inf, 0.0, "air")]
DOUBLET = [(62.8, 4.0, "N-BK7"), (-45.7, 2.5, "SF5"), (-128.2, 0.0, "air")]
LENSES = {"singlet, f/20": (5.0, SINGLET), "doublet, f/12.5": (8.0, DOUBLET)}
RAYS = 1 << 22
WIDER = (6.5, 8.0, 10.0, 12.0)  # mm, diameters of pupils in front of the singlet
PIXELS = 48
# half width of the image, in wavelengths over the aperture's angle
REACH = 5.0
BLOCK = 1 << 20

Values = NDArray[np.float64]


def hexagon(across: float) -> pw.Aperture:
    """Return a hexagonal pupil with a width in mm across its corners."""
    return pw.shapes.regular_polygon(6, across * MM / 2)


def lens_of(surfaces: list[Any], across: float) -> Any:
    """Return an optical system of pupil, lens and a screen in the paraxial focus, in mm."""
    from optiland.optic import Optic

    system = Optic()
    system.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    system.surfaces.add(index=1, radius=np.inf, thickness=BEFORE, is_stop=True)
    for k, (radius, thickness, glass) in enumerate(surfaces):
        system.surfaces.add(index=k + 2, radius=radius, thickness=thickness, material=glass)
    system.surfaces.add(index=len(surfaces) + 2)
    system.set_aperture(aperture_type="EPD", value=across)
    system.fields.set_type(field_type="angle")
    system.fields.add(y=0)
    system.wavelengths.add(value=WAVELENGTH * 1e6, is_primary=True)
    system.set_thickness(float(system.paraxial.F2()), len(surfaces) + 1)
    return system


def traced(system: Any, position: Values, direction: Values, weight: Values) -> Any:
    """Trace rays in m and W from the pupil to the screen by optiland."""
    from optiland.rays import RealRays

    wavelength = np.full(len(weight), WAVELENGTH * 1e6)
    rays = RealRays(*(position / MM).T, *direction.T, weight, wavelength)
    return system.surfaces.trace(rays, record=False)


def screen_of(system: Any, rays: Any) -> Any:
    """Return all rays at the screen, traced in blocks of a million."""
    position, direction, weight = (
        np.array(rays[name].values) for name in ("position", "direction", "weight")
    )
    for start in range(0, len(weight), BLOCK):
        some = slice(start, start + BLOCK)
        out = traced(system, position[some], direction[some], weight[some])
        position[some] = np.column_stack([out.x, out.y, out.z]) * MM
        direction[some] = np.column_stack([out.L, out.M, out.N])
        weight[some] = out.i
    return pw.rays.traced(rays, position, direction, weight)


def pixels(half: float) -> tuple[Values, Values]:
    """Return two Gauss points along each pixel of the screen (2 n,), and the centres (n,)."""
    edges = np.linspace(-half, half, PIXELS + 1)
    middles = (edges[1:] + edges[:-1]) / 2
    step = (edges[1] - edges[0]) / 2 / np.sqrt(3)
    return (middles[:, None] + [-step, step]).ravel(), middles


def mean_of(values: Values) -> Values:
    """Return means over pixels of values at their Gauss points."""
    return values.reshape(PIXELS, 2, PIXELS, 2).mean(axis=(1, 3))


def collins(pupil: pw.Aperture, focal_length: float, half: float) -> Values:
    """Return the irradiance in the focus of a perfect lens, |F|^2/(lambda f)^2."""
    points = np.stack(np.meshgrid(*[pixels(half)[0]] * 2), axis=-1)
    field = pw.fourier(pupil, points / (WAVELENGTH * focal_length))
    return mean_of(np.abs(field / (WAVELENGTH * focal_length)) ** 2)


class Wavefront:
    """The lens's wavefront: a ray and its path length for each point of the pupil."""

    def __init__(self, system: Any, pupil: pw.Aperture) -> None:
        places, self.shares = nodes_of(pupil)
        n = len(places)
        still = np.tile([0.0, 0.0, 1.0], (n, 1))
        out = traced(system, np.column_stack([places, np.zeros(n)]), still, np.ones(n))
        self.directions = out.L, out.M
        # Each ray becomes a small plane wave; its phase is at the centre of the screen.
        self.path = (out.opd - out.opd.mean() - out.L * out.x - out.M * out.y) * MM
        self.spread = float(np.hypot(out.x, out.y).max()) * MM

    @property
    def waves(self) -> float:
        """Aberration of the wavefront, peak to valley, in wavelengths."""
        return float(np.ptp(self.path)) / WAVELENGTH

    def irradiance(self, focal_length: float, half: float) -> Values:
        """Return the irradiance by Huygens' principle, a sum over the pupil."""
        k = 2 * np.pi / WAVELENGTH
        x, _ = pixels(half)
        along_x, along_y = (np.exp(1j * k * np.outer(x, d)) for d in self.directions)
        field = (along_y * (self.shares * np.exp(1j * k * self.path))) @ along_x.T
        return mean_of(np.abs(field / (WAVELENGTH * focal_length)) ** 2)


def nodes_of(pupil: pw.Aperture, order: int = 24) -> tuple[Values, Values]:
    """Return Gauss points on triangles about the centre, and their areas."""
    t, w = np.polynomial.legendre.leggauss(order)
    t, w = (t + 1) / 2, w / 2
    u, v = (a.ravel() for a in np.meshgrid(t, t))
    share = np.outer(w, w).ravel() * v  # v: outwards from the centre, u: along the edge
    corners = pupil.rings[0]
    places, areas = [], []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        places.append(v[:, None] * (a + u[:, None] * (b - a)))
        areas.append(share * abs(a[0] * b[1] - a[1] * b[0]))
    return np.concatenate(places), np.concatenate(areas)


def compared(
    across: float, surfaces: list[Any], count: int = RAYS, seed: int = 0
) -> dict[str, Any]:
    """Compute the focal spot by rays, by Collins' integral, and with the lens's wavefront."""
    pupil, system = hexagon(across), lens_of(surfaces, across)
    focal_length = float(system.paraxial.f2()) * MM
    half = REACH * WAVELENGTH * focal_length / (across * MM)
    wavefront = Wavefront(system, pupil)
    cone = 1.5 * (half + wavefront.spread) / focal_length  # reaches the corners of the screen
    rays = pw.sample_rays(pupil, WAVELENGTH, count, seed, sampling="quasi-random", cone=cone)
    arrived = screen_of(system, rays)
    z = float(arrived.position[0, 2])
    rebuilt = pw.rays.rebuild(arrived, z, (-half, -half, half, half), (PIXELS, PIXELS))
    glass = float(arrived.weight.sum() / rays.weight.sum())  # transmission of the glass
    return {
        "rays": rebuilt.irradiance.values / glass,
        "standard error": rebuilt.standard_error.values / glass,
        "Collins": collins(pupil, focal_length, half),
        "Huygens": wavefront.irradiance(focal_length, half),
        "half": half,
        "waves": wavefront.waves,
    }


def error(result: Values, reference: Values) -> float:
    """Return the largest error relative to the peak."""
    return float(np.abs(result - reference).max() / reference.max())


def errors(result: dict[str, Any]) -> str:
    """Return the differences of the rays from both integrals as text."""
    rays, peak = result["rays"], result["Huygens"].max()
    return (
        f"{result['waves']:.2f} waves of aberration: rays differ by "
        f"{100 * error(rays, result['Huygens']):.2f} % of the peak from Huygens' integral with the "
        f"lens's wavefront, by {100 * error(rays, result['Collins']):.2f} % from Collins' of a "
        f"perfect lens; their standard error is up to "
        f"{100 * result['standard error'].max() / peak:.2f} %"
    )


def main(folder: Path) -> None:
    try:
        import optiland  # noqa: F401
    except ImportError:
        sys.exit("expected optiland, got none; run `pip install optiland==0.6.3`")
    import matplotlib.pyplot as plt

    warnings.filterwarnings("ignore", module="numba")
    figure, axes = plt.subplots(len(LENSES), 3, figsize=(10, 6), layout="constrained")
    for row, (name, (across, surfaces)) in zip(axes, LENSES.items(), strict=True):
        result = compared(across, surfaces)
        peak = result["Huygens"].max()
        print(f"{name}, {errors(result)}")
        edge = result["half"] * 1e6
        shown = [("rays", result["rays"] / peak), ("wavefront", result["Huygens"] / peak)]
        for axis, (kind, values) in zip(row, shown, strict=False):
            picture = axis.imshow(
                10 * np.log10(np.maximum(values, 1e-5)),
                extent=[-edge, edge, -edge, edge], origin="lower", vmin=-40, vmax=0,
            )  # fmt: skip
            axis.set(title=f"{name}: {kind}", xlabel="x in um", ylabel="y in um")
        figure.colorbar(picture, ax=row[:2], label="dB of the peak")
        middle = pixels(result["half"])[1] * 1e6
        row[2].plot(middle, result["Huygens"][PIXELS // 2] / peak, label="wavefront")
        row[2].plot(middle, result["rays"][PIXELS // 2] / peak, ".", label="rays")
        row[2].set(title="along x", xlabel="x in um", ylabel="of the peak")
        row[2].legend(loc="upper left", fontsize="small")
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "signed_rays.png", dpi=110)
    print(folder / "signed_rays.png")
    for across in WIDER:
        result = compared(across, SINGLET)
        real, by_rays = (
            result[name].max() / result["Collins"].max() for name in ("Huygens", "rays")
        )
        print(
            f"singlet, pupil of {across:g} mm, {errors(result)}; peak over that of a perfect lens "
            f"{real:.3f}, by rays {by_rays:.3f}"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
