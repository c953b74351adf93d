"""Fields as sums of plane waves, specified directly or fitted to samples."""

from __future__ import annotations

from fractions import Fraction
from functools import cached_property
from numbers import Complex
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, IlluminationError, value_text
from polywigner.geometry.arguments import (
    Immutable,
    checked_count,
    checked_length,
    checked_number,
    finite_array,
    real_numbers,
)
from polywigner.geometry.wavefront import checked_shift, turned_points


@final
class Illumination(Immutable):
    """A field u(x) = sum_m c_m exp(2 pi i kappa_m.x) on an aperture (d = 2) or on slits (d = 1).

    All transforms have closed forms. `a * b` multiplies two fields, `2j * a` and `a / 2` scale a
    field, and `a + b` and `a - b` superpose fields. Waves of one frequency are merged.

    Parameters
    ----------
    amplitudes : array_like, shape (m,)
        Complex amplitudes c_m in the unit of the field.
    frequencies : array_like, shape (m, d)
        Real frequencies kappa_m in cycles per metre; for d = 1 also (m,).

    Raises
    ------
    IlluminationError
        If a value is not finite, the shapes do not match, or the field is zero everywhere.

    Examples
    --------
    >>> import polywigner as pw
    >>> tilt = pw.Illumination([1.0], [(100.0, 0.0)])  # towards s_x = 100 m^-1 times lambda
    >>> pw.shapes.square(0.01).with_illumination(tilt).illumination == tilt
    True
    """

    amplitudes: NDArray[np.complex128]
    """(m,), read-only."""
    frequencies: NDArray[np.float64]
    """(m, d), read-only, in lexicographic order."""

    def __init__(self, amplitudes: ArrayLike, frequencies: ArrayLike) -> None:
        waves = _merged(*_checked(amplitudes, frequencies))
        for name, array in zip(("amplitudes", "frequencies"), waves, strict=True):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def dimension(self) -> int:
        """d, the number of components of a position."""
        return int(self.frequencies.shape[1])

    def __call__(self, x: ArrayLike) -> NDArray[np.complex128]:
        """Return the field (...), complex, at positions x (..., d) in m."""
        try:
            points = real_numbers(x)
        except ValueError as error:
            raise ArgumentError(f"expected x as real numbers, got {error}") from None
        if points.ndim == 0 or points.shape[-1] != self.dimension:
            raise ArgumentError(f"expected x of shape (..., {self.dimension}), got {points.shape}")
        return np.exp(2j * np.pi * (points @ self.frequencies.T)) @ self.amplitudes

    def moved(self, shift: ArrayLike) -> Illumination:
        """Return the field shifted by (d,) m: u(x - shift)."""
        phases = shift_phases(self.frequencies, checked_shift(shift, self.dimension))
        return Illumination(self.amplitudes * phases, self.frequencies)

    def turned(self, angle: float) -> Illumination:
        """Return the field rotated counter-clockwise about the origin by an angle in radians.

        Multiples of pi/2 are exact.

        Raises
        ------
        IlluminationError
            For a field of slits.
        """
        if self.dimension != 2:
            raise IlluminationError("expected a field in two dimensions, got a field of slits")
        return Illumination(self.amplitudes, turned_points(self.frequencies, angle))

    def scaled(self, factor: float) -> Illumination:
        """Return the field scaled about the origin by a factor."""
        size = checked_length(factor, "factor")
        with np.errstate(over="ignore"):
            return Illumination(self.amplitudes, self.frequencies / size)

    def __mul__(self, other: Illumination | complex) -> Illumination:
        if isinstance(other, Complex):
            return Illumination(self.amplitudes * complex(other), self.frequencies)
        if not isinstance(other, Illumination):
            return NotImplemented
        self._check_dimension(other)
        products = np.multiply.outer(self.amplitudes, other.amplitudes)
        sums = self.frequencies[:, None] + other.frequencies
        return Illumination(products.ravel(), sums.reshape(-1, self.dimension))

    __rmul__ = __mul__

    def _check_dimension(self, other: Illumination) -> None:
        if other.dimension != self.dimension:
            raise IlluminationError(
                f"expected fields of one dimension, got {self.dimension} and {other.dimension}"
            )

    def __truediv__(self, other: complex) -> Illumination:
        if not isinstance(other, Complex):
            return NotImplemented
        if other == 0:
            raise IlluminationError("expected a number other than zero to divide a field by, got 0")
        return Illumination(self.amplitudes / complex(other), self.frequencies)

    def __neg__(self) -> Illumination:
        return -1 * self

    def __sub__(self, other: Illumination) -> Illumination:
        return self + -other if isinstance(other, Illumination) else NotImplemented

    def __add__(self, other: Illumination) -> Illumination:
        if not isinstance(other, Illumination):
            return NotImplemented
        self._check_dimension(other)
        return Illumination(
            np.concatenate([self.amplitudes, other.amplitudes]),
            np.concatenate([self.frequencies, other.frequencies]),
        )

    @cached_property
    def _key(self) -> tuple[int, bytes, bytes]:
        return self.dimension, self.amplitudes.tobytes(), self.frequencies.tobytes()

    def __reduce__(self) -> tuple[Any, ...]:
        return Illumination, (self.amplitudes, self.frequencies)

    def __len__(self) -> int:
        """The number of waves."""
        return len(self.amplitudes)

    def __repr__(self) -> str:
        plural = "s" if len(self) > 1 else ""
        return f"Illumination({len(self)} plane wave{plural}, {self.dimension}D)"


def shift_phases(
    frequencies: NDArray[np.float64], shift: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Return exp(-2 pi i kappa.shift) (m,) for frequencies kappa (m, d) and a shift (d,).

    The products are exact: rounding would change the phase of a large product.
    """
    offset = [Fraction(s) for s in shift.tolist()]
    cycles = (
        sum((Fraction(k) * s for k, s in zip(kappa, offset, strict=True)), Fraction(0))
        for kappa in frequencies.tolist()
    )
    return np.exp(-2j * np.pi * np.array([float(c - round(c)) for c in cycles]))


def _checked(
    amplitudes: Any, frequencies: Any
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    try:
        if np.ma.is_masked(amplitudes):
            raise ValueError
        waves = np.atleast_1d(np.array(amplitudes, dtype=np.complex128))
        kappa = real_numbers(frequencies)
    except (TypeError, ValueError, OverflowError):
        raise IlluminationError(
            "expected complex amplitudes (m,) and real frequencies (m, d), got "
            f"{type(amplitudes).__name__} and {type(frequencies).__name__}"
        ) from None
    if kappa.ndim == 1:
        kappa = kappa[None, :] if waves.size == 1 and kappa.size == 2 else kappa[:, None]
    if waves.ndim != 1 or kappa.ndim != 2 or len(waves) != len(kappa) or not waves.size:
        raise IlluminationError(
            f"expected one frequency for each amplitude, got shapes {waves.shape} and {kappa.shape}"
        )
    if kappa.shape[1] not in (1, 2):
        raise IlluminationError(
            f"expected frequencies of one or two components, got {kappa.shape[1]}"
        )
    if not (np.isfinite(waves).all() and np.isfinite(kappa).all()):
        raise IlluminationError("expected finite amplitudes and frequencies, got inf or nan")
    return waves, kappa


def _merged(
    amplitudes: NDArray[np.complex128], frequencies: NDArray[np.float64]
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Merge waves of equal frequencies, in lexicographic order, without negative zeros.

    Sums of amplitudes below the rounding error of the amplitudes count as zero.
    """
    distinct, number = np.unique(frequencies + 0.0, axis=0, return_inverse=True)
    total, size = np.zeros(len(distinct), np.complex128), np.zeros(len(distinct))
    np.add.at(total, number.ravel(), amplitudes)
    np.add.at(size, number.ravel(), np.abs(amplitudes))
    nonzero = np.abs(total) > 1e-15 * size
    if not nonzero.any():
        raise IlluminationError("expected a field other than zero, got amplitudes of zero only")
    return total[nonzero] + 0.0, distinct[nonzero]


# Smallest singular value that a fit uses, as a fraction of the largest. Waves whose period is twice
# the sampled extent are nearly linearly dependent on the samples, so smaller singular values cause
# large amplitudes that cancel.
_CUT_OFF = 1e-6

# Default period of the waves, as a multiple of the sampled extent. A period of twice the extent
# approximates fields up to the edges even if they are not periodic.
_PERIODS = 2

_MOST_WAVES = 4096


class FittedIllumination(NamedTuple):
    """The result of :func:`fit_illumination`."""

    illumination: Illumination
    residual: float
    """sqrt(sum |u - values|^2 / sum |values|^2) over the samples."""
    rank: int
    """Number of combinations of waves that the samples determine."""
    cancellation: float
    """sum |c_m| divided by the rms value. Errors of transforms grow by this factor, errors of W and
    A by its square. Values of 1 to 10 are harmless."""


def fit_illumination(
    points: ArrayLike,
    values: ArrayLike,
    frequencies: ArrayLike | None = None,
    *,
    order: int = 4,
    cut_off: float = _CUT_OFF,
) -> FittedIllumination:
    """Fit plane waves of fixed frequencies to a sampled field by least squares.

    The sum of |u(x_j) - values_j|^2 is minimised by a singular value decomposition without singular
    values below `cut_off`. The memory is 16 bytes times the number of samples times the number of
    waves.

    Samples in the plane do not determine the normal derivative of the field, which Kirchhoff and
    Rayleigh-Sommerfeld II use: they take the derivative of the fitted waves, which depends on the
    evanescent waves (|kappa| > 1/wavelength) of the fit. Two fits of one field on a square of one
    wavelength, with residuals below 1e-9, differed by 0.12 dB with Rayleigh-Sommerfeld II, and by
    1e-4 dB with I. Use I, or fit frequencies below 1/wavelength only.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        Positions in m; for slits (n, 1) or (n,). They need not form a grid. The fit is meaningless
        outside their bounds, so sample up to the edges of the aperture.
    values : array_like, shape (n,)
        Complex field at these points.
    frequencies : array_like, shape (m, d), optional
        Frequencies in cycles per metre; default: waves whose period is twice the extent of the
        points, -order..order periods along each axis.
    order : int, default 4
        Largest number of periods, reduced for few samples. A phase of q cycles over the aperture
        needs an order of about 2 q + 4.
    cut_off : float, default 1e-6
        Fraction of the largest singular value, from 1e-15 up to below 1; use larger values for
        noise.

    Returns
    -------
    FittedIllumination
        Named tuple (illumination, residual, rank, cancellation).

    Raises
    ------
    ArgumentError
        If points, values or options have a wrong shape or range.
    IlluminationError
        If all values are zero, or the frequencies have a wrong shape.

    Examples
    --------
    >>> import polywigner as pw
    >>> import numpy as np
    >>> x = np.stack(np.meshgrid(*2 * [np.linspace(-1, 1, 9)]), axis=-1).reshape(-1, 2)
    >>> fit = pw.fit_illumination(x, np.cos(np.pi * x[:, 0] / 2))
    >>> fit.residual < 1e-2
    True
    """
    positions, field = _samples(points, values)
    least = checked_number(cut_off, "cut_off", "a fraction from 1e-15 to 1")
    if not 1e-15 <= least < 1:
        raise ArgumentError(f"expected cut_off from 1e-15 up to below 1, got {cut_off!r}")
    low, high = positions.min(axis=0), positions.max(axis=0)
    centre = low / 2 + high / 2
    if frequencies is None:
        kappa = _lattice(high - low, checked_count(order, "order", 0), len(positions))
    else:
        kappa = _distinct(frequencies, positions.shape[1])
    if len(kappa) > _MOST_WAVES:
        raise ArgumentError(
            f"expected at most {_MOST_WAVES} waves, got {len(kappa)}; give fewer frequencies, or a "
            "lower order"
        )
    waves = np.exp(2j * np.pi * ((positions - centre) @ kappa.T))
    amplitudes, _, rank, _ = np.linalg.lstsq(waves, field, rcond=least)
    size = float(np.linalg.norm(field))
    residual = float(np.linalg.norm(waves @ amplitudes - field)) / size
    cancellation = float(np.abs(amplitudes).sum()) / (size / np.sqrt(len(field)))
    fitted = Illumination(amplitudes, kappa).moved(centre)
    return FittedIllumination(fitted, residual, int(rank), cancellation)


def _samples(points: Any, values: Any) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    expected = "expected points (n, 2), or (n, 1) for slits"
    positions = finite_array(points, expected, (None,), (None, 1), (None, 2)).reshape(
        len(points), -1
    )
    try:
        field = np.array(values, dtype=np.complex128)
    except (TypeError, ValueError, OverflowError):
        field = np.empty(0, np.complex128)
    if field.shape != positions.shape[:1] or not np.isfinite(field).all():
        raise ArgumentError(
            f"expected a finite complex number for each of {len(positions)} points, "
            f"got {value_text(values)}"
        )
    if not field.any():
        raise IlluminationError("expected values other than zero, got zeros only")
    return positions, field


def _distinct(frequencies: Any, dimension: int) -> NDArray[np.float64]:
    """Return the distinct frequencies (m, d) in the order of an Illumination."""
    count = len(frequencies) if hasattr(frequencies, "__len__") else 1
    kappa = Illumination(np.ones(count), frequencies).frequencies
    if kappa.shape[1] != dimension:
        raise IlluminationError(
            f"expected frequencies of {dimension} components, got {kappa.shape[1]}"
        )
    return kappa


def _lattice(extent: NDArray[np.float64], order: int, samples: int) -> NDArray[np.float64]:
    """Return frequencies (m, d) with whole numbers of periods in twice the extent."""
    axes = int(np.count_nonzero(extent))
    highest = order
    while highest and (2 * highest + 1) ** axes > samples:
        highest -= 1
    steps = np.arange(-highest, highest + 1)
    along = [steps / (_PERIODS * size) if size else np.zeros(1) for size in extent]
    return np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, len(extent))
