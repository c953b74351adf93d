"""Plane waves fitted to a sampled field, such as a measurement or a simulation of a horn."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, IlluminationError
from polywigner.geometry.arguments import checked_count, checked_number, real_numbers, shape_of
from polywigner.illumination.waves import Illumination, restored

# Singular values below this fraction of the largest are left out. Waves of twice the period are
# nearly dependent on the samples' extent; what is left out here could not change the fit by more
# than about this fraction, but would have amplitudes up to its inverse that cancel.
_CUT_OFF = 1e-6

# The default periods, in extents of the samples: with twice the extent a field need not be
# periodic to be approximated up to its edges.
_PERIODS = 2

# Samples that are in memory as rows of the matrix at a time.
_ROWS = 4096
_MOST_WAVES = 4096


class FittedIllumination(NamedTuple):
    """The result of :func:`fit_illumination`."""

    illumination: Illumination
    residual: float
    """sqrt(sum |u - values|^2 / sum |values|^2) over the samples."""
    rank: int
    """Number of combinations of waves that the samples determined."""
    cancellation: float
    """sum |c_m| over the rms of the values: transforms lose this factor in accuracy, W and A its
    square. About 1 to 10 is harmless."""


def fit_illumination(
    points: ArrayLike,
    values: ArrayLike,
    frequencies: ArrayLike | None = None,
    *,
    order: int = 4,
    cut_off: float = _CUT_OFF,
    largest_residual: float | None = None,
) -> FittedIllumination:
    """Plane waves whose sum comes nearest to a sampled field: least squares on given frequencies.

    Minimises sum_j |u(x_j) - values_j|^2 over the amplitudes, by a singular value decomposition
    without the values below `cut_off`. Memory is bounded by the square of the number of waves.

    The samples do not fix how the field changes away from the plane. Transforms and
    Rayleigh-Sommerfeld I do not ask for that. Kirchhoff and Rayleigh-Sommerfeld II take it from the
    waves found, and another fit has others, above all where some are evanescent,
    |kappa| > 1/wavelength: two fits of one field on a square of one wavelength, with residuals of
    1e-9 and less, were 0.12 dB apart by Rayleigh-Sommerfeld II, and 1e-4 dB by I. Using such a fit
    with them is met with a PolywignerWarning.

    Parameters
    ----------
    points
        (n, 2) positions in m; for slits (n, 1) or (n,). They need not lie on a grid. Outside of
        their bounds the fit means nothing: sample up to the edges of the aperture.
    values
        (n,) complex field at these points.
    frequencies
        (m, d) in cycles per metre. None: the lattice of waves whose period is twice the extent of
        the points, -order..order periods along each axis ((2 order + 1)^2 waves in the plane). A
        field with a phase that turns by q over the aperture needs an order of about 2 q + 4.
    order
        Of the default lattice; lowered where there are fewer samples than waves.
    cut_off
        Fraction of the largest singular value, from 1e-15 up to below 1. Larger for noisy samples.
    largest_residual
        Refuse fits that are worse; None: the caller looks at the residual.

    Returns
    -------
    FittedIllumination : (illumination, residual, rank, cancellation).

    Raises
    ------
    ArgumentError for points, values or options of other shapes or ranges; IlluminationError for
    values all zero, frequencies that do not fit, and a residual above `largest_residual`.

    >>> import polywigner as pw
    >>> import numpy as np
    >>> x = np.stack(np.meshgrid(*2 * [np.linspace(-1, 1, 9)]), axis=-1).reshape(-1, 2)
    >>> fit = pw.fit_illumination(x, np.cos(np.pi * x[:, 0] / 2))
    >>> fit.residual < 1e-2
    True
    """
    places, field = _samples(points, values)
    least = checked_number(cut_off, "cut_off", "a fraction from 1e-15 to 1")
    if not 1e-15 <= least < 1:
        raise ArgumentError(f"expected cut_off from 1e-15 up to below 1, got {cut_off!r}")
    low, high = places.min(axis=0), places.max(axis=0)
    centre = low / 2 + high / 2
    if frequencies is None:
        kappa = _lattice(high - low, checked_count(order, "order", 0), len(places))
    else:
        kappa = _given(frequencies, places.shape[1])
    if len(kappa) > _MOST_WAVES:
        raise ArgumentError(
            f"expected at most {_MOST_WAVES} waves, got {len(kappa)}; give fewer frequencies, or a "
            "lower order"
        )
    amplitudes, left, rank = _least_squares(places - centre, field, kappa, least)
    size = float(np.linalg.norm(field))
    residual = left / size
    if largest_residual is not None and not residual <= largest_residual:
        raise IlluminationError(
            f"expected a fit with a residual of at most {largest_residual:g}, got {residual:.3g} "
            f"with {len(kappa)} waves; give a higher order or other frequencies"
        )
    cancellation = float(np.abs(amplitudes).sum()) / (size / np.sqrt(len(field)))
    fitted = restored(amplitudes, kappa, True).moved(centre)
    return FittedIllumination(fitted, residual, rank, cancellation)


def _samples(points: Any, values: Any) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    try:
        places = real_numbers(points)
        field = np.array(values, dtype=np.complex128)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(
            "expected points (n, 2) and complex values (n,) that are numbers, got shapes "
            f"{shape_of(points)} and {shape_of(values)}"
        ) from None
    if places.ndim == 1:
        places = places[:, None]
    shapes = places.ndim == 2 and places.shape[1] in (1, 2) and field.shape == places.shape[:1]
    if not shapes or not len(field):
        raise ArgumentError(
            f"expected points (n, 2), or (n, 1) for slits, and a value for each, got shapes "
            f"{shape_of(points)} and {shape_of(values)}"
        )
    if not (np.isfinite(places).all() and np.isfinite(field).all()):
        raise ArgumentError("expected finite points and values, got inf or nan")
    if not field.any():
        raise IlluminationError("expected values other than zero, got zeros only")
    return places, field


def _given(frequencies: Any, dimension: int) -> NDArray[np.float64]:
    """Frequencies (m, d), each once, as an Illumination has them."""
    count = len(frequencies) if hasattr(frequencies, "__len__") else 1
    kappa = Illumination(np.ones(count), frequencies).frequencies
    if kappa.shape[1] != dimension:
        raise IlluminationError(
            f"expected frequencies of {dimension} components, got {kappa.shape[1]}"
        )
    return kappa


def _lattice(extent: NDArray[np.float64], order: int, samples: int) -> NDArray[np.float64]:
    """Frequencies (m, d): whole numbers of periods in twice the extent, along axes that have one.

    No more waves than samples.
    """
    axes = int(np.count_nonzero(extent))
    highest = order
    while highest and (2 * highest + 1) ** axes > samples:
        highest -= 1
    steps = np.arange(-highest, highest + 1)
    along = [steps / (_PERIODS * size) if size else np.zeros(1) for size in extent]
    return np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, len(extent))


def _least_squares(
    places: NDArray[np.float64],
    field: NDArray[np.complex128],
    kappa: NDArray[np.float64],
    cut_off: float,
) -> tuple[NDArray[np.complex128], float, int]:
    """Amplitudes, the norm of what they leave of the field, and the rank.

    The triangle of a QR decomposition is built up from blocks of rows (with the field as the last
    column), so that any number of samples fits into memory.
    """
    waves = len(kappa)
    triangle: NDArray[np.complex128] = np.empty((0, waves + 1), np.complex128)
    for start in range(0, len(places), _ROWS):
        block = slice(start, start + _ROWS)
        matrix = np.exp(2j * np.pi * (places[block] @ kappa.T))
        rows = np.vstack([triangle, np.column_stack([matrix, field[block]])])
        triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    left, values, right = np.linalg.svd(triangle[:, :waves], full_matrices=False)
    kept = values > cut_off * values[0]
    along = left.conj().T @ triangle[:, waves]
    amplitudes = right.conj().T[:, kept] @ (along[kept] / values[kept])
    remainder = triangle[:, waves] - triangle[:, :waves] @ amplitudes
    return amplitudes, float(np.linalg.norm(remainder)), int(kept.sum())
