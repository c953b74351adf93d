"""Strehl ratio and rms wavefront error of aberrated pupils."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.geometry import Aperture
from polywigner.source import Array
from polywigner.source.array import PathLengths
from polywigner.source.normal_form import normal_form
from polywigner.transforms.aberrated_pupils import (
    TOLERANCE,
    AberratedPupil,
    checked_aberration,
    checked_tolerance,
    converged,
)
from polywigner.transforms.aberrations import Aberration
from polywigner.transforms.pupil import (
    checked_band,
    checked_energy,
    checked_pupil_radius,
    checked_waves,
)

Floats = NDArray[np.float64]

# Error of the rms, relative to the largest path.
_PRECISE = 1e-12
# Frequencies of integrals without waves.
_NO_BAND = np.zeros(2), np.zeros(2)


def strehl(
    source: Aperture | Array,
    wavelength: ArrayLike,
    aberration: Aberration | None = None,
    defocus: float = 0.0,
    pupil_radius: float | None = None,
    *,
    weights: ArrayLike | None = None,
    tolerance: float = TOLERANCE,
) -> float:
    """Compute the Strehl ratio of a pupil, |int u exp(2 pi i W/lambda)|^2/(int |u|)^2.

    This is the irradiance of :func:`psf` on the axis, relative to a pupil of the same |u| in phase.
    Pistons and tilts of segments count as aberrations.

    Parameters
    ----------
    source : Aperture or Array
        Field in the pupil, of elements that do not overlap.
    wavelength : float or array_like, shape (k,)
        In m; k wavelengths of a polychromatic source.
    aberration : Aberration, optional
        Path length in m.
    defocus : float, default 0
        Wavefront aberration W20 at ``pupil_radius`` in waves of the mean wavelength.
    pupil_radius : float, optional
        See :func:`otf`.
    weights : array_like, shape (k,), optional
        Weights of the wavelengths, at least 0; equal by default.
    tolerance : float, default 1e-10
        Allowed error, estimated by a second rule; at least 1e-13.

    Returns
    -------
    float
        From 0 to 1. For several wavelengths the mean of their ratios.

    Raises
    ------
    ArgumentError
        For arguments of the wrong type, shape or range.
    IlluminationError
        If the fields of an Array cancel everywhere.

    Examples
    --------
    >>> import polywigner as pw
    >>> pupil = pw.shapes.disc(5e-3)
    >>> coma = pw.zernike({8: 550e-9 / 14}, radius=5e-3)  # Marechal's limit
    >>> round(pw.strehl(pupil, 550e-9, coma), 2)
    0.82
    """
    lengths, fractions = checked_band(wavelength, weights)
    checked_energy(source)
    radius, error = checked_pupil_radius(source, pupil_radius), checked_tolerance(tolerance)
    bend = checked_waves(defocus) * float(fractions @ lengths) / radius**2
    ratios = []
    for length in lengths.tolist():
        checked_aberration(aberration, length)
        part = source.at_wavelength(length)
        pupil = AberratedPupil.of(part, aberration, length, bend / length)
        ratios.append(_strehl_ratio(pupil, error))
    return float(fractions @ ratios)


def _strehl_ratio(pupil: AberratedPupil, tolerance: float) -> float:
    def evaluate(extra: int) -> NDArray[np.complex128]:
        total = np.zeros(2, np.complex128)
        for k, weight in enumerate(pupil.weights):
            for x, weights in pupil.rules(k, _NO_BAND, extra, tolerance):
                field = weight * weights * pupil.field(k, x)
                total += field.sum(), np.abs(field).sum()
        return total

    sums = converged(evaluate, 0.5 * tolerance * pupil.content, "the Strehl ratio").values
    return float(abs(sums[0] / sums[1]) ** 2)


def wavefront_error(source: Aperture | Array, aberration: Aberration | None = None) -> float:
    """Compute the rms wavefront error over a pupil in metres, about its mean.

    The mean is over the pupil with the weight |u|^2. Pistons and tilts of :func:`segmented_pupil`
    are included.

    Parameters
    ----------
    source : Aperture or Array
        Field in the pupil.
    aberration : Aberration, optional
        Path length in m.

    Returns
    -------
    float
        Standard deviation of the path length in m.

    Raises
    ------
    ArgumentError
        For arguments of the wrong type.
    IlluminationError
        If the fields of an Array cancel everywhere.

    Examples
    --------
    >>> import polywigner as pw
    >>> hexagon = pw.shapes.regular_polygon(6, 0.5)
    >>> defocus = pw.zernike({4: 10e-9}, radius=0.5, orthogonal_on=hexagon)
    >>> round(pw.wavefront_error(hexagon, defocus) * 1e9, 9)
    10.0
    """
    checked_aberration(aberration, 1.0)
    checked_energy(source)
    pupil = AberratedPupil.of(source, aberration, 1.0, 0.0)
    paths = normal_form(source).paths

    def moments(extra: int) -> tuple[Floats, Floats]:
        """Return path lengths and weights of all nodes."""
        lengths, weights = [], []
        for k, amplitude in enumerate(pupil.weights):
            for x, areas in pupil.rules(k, _NO_BAND, 1 + extra, _PRECISE):
                weights.append((areas * np.abs(amplitude * pupil.field(k, x)) ** 2).ravel())
                lengths.append((pupil.cycles(x) + _path_of(paths, k, x)).ravel())
        return np.concatenate(lengths), np.concatenate(weights)

    def evaluate(extra: int) -> Any:
        lengths, weights = moments(extra)
        mean = weights @ lengths / weights.sum()
        return np.sqrt(weights @ np.square(lengths - mean) / weights.sum())

    largest = float(np.abs(moments(0)[0]).max()) or 1.0
    return float(converged(evaluate, _PRECISE * largest, "the wavefront error").values)


def _path_of(paths: PathLengths | None, number: int, x: Floats) -> Floats | float:
    """Return the piston and tilt of a segment at x (..., 2) in m."""
    if paths is None:
        return 0.0
    return paths.wavelength * np.asarray(paths.cycles[number] + x @ paths.slopes[number])
