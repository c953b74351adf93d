"""The figure sampling, planned in the comments of the paper: samples and errors of grids."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import polywigner as pw
from paper.figures.sources import (
    WAVELENGTH,
    Made,
    Quality,
    chevrons,
    number_samples,
    square,
)
from polywigner.figures import style

POSITION = (0.5e-3, 0.8e-3)
"""Place of the slice that is summed on grids, in m: no symmetry of the chevrons helps there."""

_BYTES = 8


def dense_samples(width: float, wavelength: float, dimension: int) -> int:
    """Return the size of a dense grid for W, (2 ceil(width/wavelength))^2d as in the paper."""
    return int((2 * np.ceil(width / wavelength)) ** (2 * dimension))


def grid_wigner(
    source: pw.Aperture, x: tuple[float, float], frequency: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Return W(x, nu) as a sum over count x count lags, like a zero-padded FFT."""
    xmin, ymin, xmax, ymax = source.bounds
    sides = 2 * np.array([xmax - xmin, ymax - ymin])
    middles = (np.arange(count) + 0.5) / count - 0.5
    along, up = (side * middles for side in sides)
    lags = np.stack(np.meshgrid(along, up), axis=-1)
    inside = pw.autocorrelation(source, np.array(x), lags).real
    waves = [np.exp(-2j * np.pi * np.outer(frequency, lag)) for lag in (along, up)]
    cell = float(np.prod(sides)) / count**2
    return np.asarray((waves[1] @ inside @ waves[0].T).real * cell)


@style.typeset
def draw_sampling(quality: Quality) -> Made:
    """Draw (a) the samples of dense grids, and (b) the error of a grid."""
    sizes = np.geomspace(1, 100, 400)
    counts = np.array([[dense_samples(size, 1.0, d) for size in sizes] for d in (1, 2)])
    # Not only powers of two, for which edges fall equally between cells.
    halves = np.arange(number_samples(quality, 13, 17))
    cells = np.round(8 * 2 ** (halves / 2)).astype(np.int64)
    source = chevrons()
    frequency = np.linspace(-1, 1, 65) / WAVELENGTH
    exact = pw.wigner(source, POSITION, np.stack(np.meshgrid(frequency, frequency), axis=-1))
    errors = np.array(
        [_rms(grid_wigner(source, POSITION, frequency, int(n)) - exact) for n in cells]
    ) / _rms(exact)
    figure = style.new_figure(8.4, 3.6, spacing=0.05)
    left, right = figure.subplots(1, 2)
    _draw_counts(left, sizes, counts)
    _draw_errors(right, cells, errors, source)
    style.letter_panels((left, right))
    return Made(
        {"": figure},
        {
            "size": (sizes, "D/wavelength"),
            "samples": (counts, "1; of one-dimensional apertures, and of two-dimensional ones"),
            "cells": (cells, "1, along each axis of the box around all lags at x"),
            "error": (errors, "1, rms of the error of W(x, nu) over rms of W(x, nu)"),
            "x": (np.array(POSITION), "m"),
        },
    )


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _draw_counts(axes: Any, sizes: NDArray[np.float64], counts: NDArray[np.int64]) -> None:
    axes.loglog(sizes, counts[0], color=style.BLUE, label="slits: 2 coordinates", lw=1.3)
    axes.loglog(sizes, counts[1], color=style.RED, label="plane: 4 coordinates", lw=1.3)
    axes.axhline(1, color="0.35", ls="--", lw=1.1, label="closed form, for one ray")
    width = np.sqrt(square().area)
    marked = dense_samples(width, WAVELENGTH, 2)
    axes.plot(width / WAVELENGTH, marked, "ko", ms=4)
    axes.annotate(
        f"10 mm square, 94 GHz: {marked}",
        (width / WAVELENGTH, marked),
        xytext=(-50, 50),
        textcoords="offset points",
        fontsize=8,
        arrowprops={"arrowstyle": "-", "lw": 0.6},
    )
    axes.set(
        xlabel="width of the aperture / wavelength",
        ylabel="samples of a dense grid",
        title="growth at the paper's Nyquist rate",
    )
    axes.set(xlim=(sizes[0], sizes[-1]), ylim=(0.5, 1e10))
    axes.legend(frameon=False, fontsize=8)
    axes.grid(alpha=0.3, lw=0.5)
    memory = axes.secondary_yaxis("right", functions=(lambda n: n * _BYTES, lambda b: b / _BYTES))
    memory.set_ylabel("bytes, 8 for each")


def _draw_errors(
    axes: Any, cells: NDArray[np.int64], errors: NDArray[np.float64], source: pw.Aperture
) -> None:
    axes.loglog(cells, errors, "o-", color=style.RED, ms=4, lw=1.3, label="sum over a grid (FFT)")
    fine = len(cells) // 2
    # An edge along an axis between two rows of cells has a random error.
    guide = np.max((errors * cells)[fine:]) / cells
    axes.loglog(cells, guide, color="0.5", lw=0.9, ls=":", label="∝ 1/cells")
    xmin, _, xmax, _ = source.bounds
    nyquist = 2 * np.ceil(2 * (xmax - xmin) / WAVELENGTH)
    axes.axvline(nyquist, color="0.35", ls="--", lw=1.1, label="Nyquist for |ν| ≤ 1/λ")
    axes.set(
        xlabel="cells along each axis of the box of lags",
        ylabel="rms error / rms of W",
        title="W(x, ν) of two chevrons, error of grids",
    )
    axes.legend(frameon=False, fontsize=8)
    axes.grid(alpha=0.3, lw=0.5)
