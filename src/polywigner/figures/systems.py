"""A source before and behind a first-order system: the light, and W over position and direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from polywigner.errors import ArgumentError
from polywigner.figures.levels import level_db
from polywigner.figures.slices import LARGEST_SAMPLES, default_position, outline_of
from polywigner.figures.style import (
    LEVEL_MAP,
    SIGNED_MAP,
    colour_bar,
    draw_polygons,
    length_axes,
    letter_panels,
    number_text,
    signed_norm,
    signed_ticks,
)
from polywigner.geometry.display import length_unit
from polywigner.illumination.support import mutual_support
from polywigner.transforms.wavefronts import flat_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Half width of the axis of frequencies, and of those that the picture of the light follows, in
# 1/width of the source: four lobes of a square, and a lobe and a half.
_LOBES, _BRIGHT = 4.0, 1.5
_INK, _ACCENT = "#1f3b57", "#c1440e"


@dataclass(frozen=True)
class SystemSlices:
    """W and the light of a source before and behind a system; arrays are read-only, SI units.

    ``before`` (n, n) is W at ((x[i], y), (nu[j], 0)), in m^2; ``behind`` (n, n) that at
    ((x_out[i], y_out), (nu_out[j], nu_y)), where the ray through the middle, (y_out, nu_y), leaves
    the system. ``light`` (n, n) is |U|^2 at (across[i], up[j]) behind it.
    """

    source: pw.Aperture | pw.Array
    aperture: pw.Aperture
    system: pw.FirstOrder
    wavelength: float
    x: NDArray[np.float64]
    nu: NDArray[np.float64]
    before: NDArray[np.float64]
    x_out: NDArray[np.float64]
    nu_out: NDArray[np.float64]
    behind: NDArray[np.float64]
    across: NDArray[np.float64]
    up: NDArray[np.float64]
    light: NDArray[np.float64]


def system_slices(
    source: pw.Aperture | pw.Array,
    system: pw.FirstOrder,
    wavelength: float,
    samples: int = 257,
) -> SystemSlices:
    """W of a source over x and nu_x before and behind a system, and the irradiance behind it.

    Parameters
    ----------
    source : an aperture with its field, or an array of apertures in the plane z = 0; metres.
    system : what is between the source and the plane behind.
    wavelength : m.
    samples : points along each axis, from 2 to 4096.

    Raises
    ------
    ArgumentError : anything but such arguments; too few or too many samples.
    """
    if not 2 <= samples <= LARGEST_SAMPLES:
        raise ArgumentError(
            f"expected from 2 to {LARGEST_SAMPLES} samples along an axis, got {samples}"
        )
    aperture, support = outline_of(source), mutual_support(flat_of(source))
    middle = np.array(default_position(support, aperture.centre))
    xmin, ymin, xmax, ymax = support.bounds
    width = np.array([xmax - xmin, ymax - ymin])
    sides = np.array([xmin, xmax]) + np.array([-0.1, 0.1]) * width[0]
    x = _axis(sides, samples)
    nu = np.linspace(-_LOBES / width[0], _LOBES / width[0], samples)
    grid = np.meshgrid(x, nu)
    before = pw.wigner(source, _pairs(grid[0], middle[1]), _pairs(grid[1], 0.0))
    # the corners of that section, as rays
    ends = np.array([(a, b) for a in sides for b in nu[[0, -1]]])
    corners = system.rays(_pairs(ends[:, 0], middle[1]), wavelength * _pairs(ends[:, 1], 0.0))
    y_out, s_out = system.rays(middle, np.zeros(2))
    x_out = _axis(corners[0][:, 0], samples)
    nu_out = _axis(corners[1][:, 0] / wavelength, samples)
    grid = np.meshgrid(x_out, nu_out)
    behind = pw.wigner(
        source,
        _pairs(grid[0], y_out[1]),
        _pairs(grid[1], s_out[1] / wavelength),
        through=system,
        wavelength=wavelength,
    )
    bright = [
        system.rays(
            (a, b), (c * wavelength * _BRIGHT / width[0], d * wavelength * _BRIGHT / width[1])
        )[0]
        for a in sides
        for b in (ymin, ymax)
        for c in (-1, 1)
        for d in (-1, 1)
    ]
    across, up = (_axis(np.array(bright)[:, k], samples) for k in range(2))
    light = pw.irradiance(
        source, np.stack(np.meshgrid(across, up), axis=-1), wavelength, through=system,
        tolerance=1e-6,
    )  # fmt: skip
    found = (x, nu, before, x_out, nu_out, behind, across, up, light)
    for array in found:
        array.setflags(write=False)
    return SystemSlices(source, aperture, system, wavelength, *found)


def _pairs(first: Any, second: float) -> NDArray[np.float64]:
    return np.stack([first, np.full_like(first, second)], axis=-1)


def _axis(values: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
    low, high = float(values.min()), float(values.max())
    return np.linspace(low, high, samples)


def draw_system_panels(axes: Any, slices: SystemSlices, floor_db: float) -> None:
    """The aperture, W before, the light behind, and W behind, on (2, 2) axes."""
    unit = length_unit(slices.aperture.diameter)
    draw_polygons(axes[0, 0], slices.aperture.polygons, unit, facecolor=_INK, edgecolor="none")
    axes[0, 0].set_title("aperture")
    length_axes(axes[0, 0], "x", unit)
    _draw_section(axes[0, 1], slices, slices.x, slices.nu, slices.before, "W(x, ν) before")
    wide = length_unit(float(np.ptp(slices.across)))
    peak = float(slices.light.max())
    shown = axes[1, 0].imshow(
        level_db(slices.light, peak, floor_db),
        origin="lower",
        extent=_extent(slices.across / wide.metres, slices.up / wide.metres),
        cmap=LEVEL_MAP,
        vmin=floor_db,
        vmax=0.0,
    )
    colour_bar(axes[1, 0], shown, f"dB relative to {peak:.3g}, floor {number_text(floor_db)} dB")
    axes[1, 0].set_title("|U|² behind")
    axes[1, 0].set_xlabel(f"$x$ ({wide.name})")
    axes[1, 0].set_ylabel(f"$y$ ({wide.name})")
    _draw_section(axes[1, 1], slices, slices.x_out, slices.nu_out, slices.behind, "W(x, ν) behind")
    letter_panels(axes.ravel())


def _draw_section(
    axes: Axes, slices: SystemSlices, x: Any, nu: Any, values: Any, title: str
) -> None:
    """W over x and the direction lambda nu, in units of the largest before the system."""
    unit = length_unit(float(np.ptp(x)))
    peak = float(np.abs(slices.before).max())
    mrad = 1e3 * slices.wavelength
    shown = axes.imshow(
        values / peak,
        origin="lower",
        extent=_extent(x / unit.metres, nu * mrad),
        aspect="auto",
        cmap=SIGNED_MAP,
        norm=signed_norm(),
        interpolation="nearest",
    )
    signed_ticks(colour_bar(axes, shown, "W / peak before"))
    axes.set_title(title)
    axes.set_xlabel(f"$x$ ({unit.name})")
    axes.set_ylabel(r"$\lambda\nu_x$ (mrad)")


def _extent(x: Any, y: Any) -> tuple[float, float, float, float]:
    """Edges of pixels whose middles are the samples."""
    (left, right), (low, high) = (
        np.array([-0.5, 0.5]) * (axis[1] - axis[0]) + axis[[0, -1]] for axis in (x, y)
    )
    return float(left), float(right), float(low), float(high)
