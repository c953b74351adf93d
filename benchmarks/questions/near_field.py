"""What do exact fields on a plane cost, against rasters convolved by FFT?

A plane of 256 x 256 points that extends 45 degrees beyond the source. Errors must be below 0.1 dB
at levels above -40 dB of the peak on the plane; peers use the coarsest sufficient raster of a
list.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import polywigner as pw
from benchmarks.lines import Line, absent, as_times, line_of
from benchmarks.peers.raster import NumpyRaster, PeerRaster, Raster, available
from benchmarks.timing import Action, Effort, cores, in_turns
from polywigner.quantities import wavelength_of

__all__ = ["CASES", "QUESTION", "THREADS", "measure"]

QUESTION = "The exact field on a plane of 256 x 256 points, within 0.1 dB"
WAVELENGTH = wavelength_of(94e9)
POINTS, POINTS_QUICK = 256, 64
DECIBEL, FLOOR = 0.1, -40.0
# Relative to the incident amplitude: 0.1 dB is a hundredth of the field at the floor.
TOLERANCE = 1e-4
# Pixels for a side of 10 mm, 3.1 wavelengths.
RASTERS = (32, 48, 64, 96)
# Largest window; padded to twice its width, complex arrays have 0.8 GB each.
MOST_PIXELS = 3500
SQUARE, CHEVRONS = "10 mm square", "two chevrons of 20 mm"
SOURCES = {
    SQUARE: lambda: pw.shapes.square(10e-3),
    CHEVRONS: lambda: _chevrons(),
}
# Distances in wavelengths. A raster grows with the square of the distance: 5 s at 100.
HEIGHTS = {SQUARE: (5, 20, 50), CHEVRONS: (20,)}
CASES = [f"{source}, z = {z}" for source, heights in HEIGHTS.items() for z in heights]
THREADS = (1,)
KINDS = {"raster, NumPy FFT": NumpyRaster, "diffractio": PeerRaster}
FEWER_ROUNDS = 5


def _chevrons() -> pw.Aperture:
    one = pw.shapes.chevron(20e-3, 12e-3, 4e-3)
    return pw.Aperture([*one.moved((0, 9e-3)).rings, *one.moved((0, -9e-3)).rings])


def _points(half: float, z: float, count: int) -> np.ndarray:
    x = np.linspace(-1, 1, count) * half
    return np.stack(np.meshgrid(x, x, [z]), axis=-1).reshape(-1, 3)


def measure(case: str, threads: int | None, effort: Effort) -> list[Line]:
    """Measure rasters in turns with the integral along the edges."""
    name, height = case.split(", z = ")
    source, wavelengths, count = SOURCES[name](), float(height), threads or cores()
    z, half = wavelengths * WAVELENGTH, (wavelengths + 5) * WAVELENGTH
    points = _points(half, z, POINTS_QUICK if effort.quick else POINTS)
    actions: dict[str, Action] = {
        "ours": lambda: pw.amplitude(source, points, WAVELENGTH, tolerance=TOLERANCE)
    }
    misses, notes, missing = {"ours": _own_miss(source, half, z)}, {"ours": ""}, {}
    for peer, kind in KINDS.items():
        if kind is PeerRaster and not available():
            missing[peer] = "not installed (pip install diffractio)"
            continue
        result = _coarsest(kind, source, z, half)
        if result is None:
            missing[peer] = f"no raster of up to {MOST_PIXELS} pixels a side will do"
            continue
        actions[peer], misses[peer], pixels = result
        notes[peer] = f"{pixels} pixels a side"
    times = in_turns(actions, max(2, effort.rounds // FEWER_ROUNDS), count)
    entries: dict[str, Any] = {
        peer: (as_times(result, 1.0, misses[peer]), result, 1.0) for peer, result in times.items()
    }
    labels = {"question": "near field", "case": case, "precision": "double", "threads": count}
    labels |= {"unit": "s", "error_unit": "dB"}
    lines = [
        line_of(labels, peer, entries["ours"], entries[peer], note=notes[peer])
        for peer in times
        if peer != "ours"
    ]
    return lines + [absent(labels, peer, why, entries["ours"][0]) for peer, why in missing.items()]


def _coarsest(
    kind: type[Raster], source: pw.Aperture, z: float, half: float
) -> tuple[Raster, float, int] | None:
    """Return the coarsest sufficient raster, its largest error in dB, and its size in pixels."""
    for pixels in RASTERS:
        if 2 * half * pixels / 10e-3 > MOST_PIXELS:
            return None
        raster = kind(source, WAVELENGTH, z, half, 10e-3 / pixels)
        miss = _miss(raster, source, half)
        if miss <= DECIBEL:
            return raster, miss, len(raster.x)
    return None


def _miss(raster: Raster, source: pw.Aperture, half: float) -> float:
    """Return the largest error in dB of some hundred pixels above the floor."""
    field, x = raster(), raster.x
    inside = np.flatnonzero(np.abs(x) <= half)
    rows = np.random.default_rng(0).choice(inside, 400)
    columns = np.random.default_rng(1).choice(inside, 400)
    rows = np.concatenate([rows, np.full(200, np.abs(x).argmin()), rows[:200]])
    columns = np.concatenate([columns, columns[:200], rows[:200]])
    points = np.column_stack([x[columns], x[rows], np.full(len(rows), raster.height)])
    exact = np.abs(pw.amplitude(source, points, WAVELENGTH))
    return _decibels(np.abs(field[rows, columns]), exact, np.abs(field).max())


def _own_miss(source: pw.Aperture, half: float, z: float) -> float:
    """Return the error relative to the tolerance, from a run with a thousandth of the tolerance."""
    points = _points(half, z, 41)
    result, exact = (
        np.abs(pw.amplitude(source, points, WAVELENGTH, tolerance=TOLERANCE * factor))
        for factor in (1, 1e-4)
    )
    return _decibels(result, exact, exact.max())


def _decibels(result: np.ndarray, exact: np.ndarray, peak: float) -> float:
    above = 20 * np.log10(exact / peak) > FLOOR
    return float(np.abs(20 * np.log10(result[above] / exact[above])).max())
