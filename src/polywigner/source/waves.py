"""Fields that are sums of plane waves: given as such, or fitted to samples of a measurement."""

from __future__ import annotations

from fractions import Fraction
from functools import cached_property
from numbers import Complex
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, IlluminationError, value_text
from polywigner.geometry.arguments import (
    checked_count,
    checked_length,
    checked_number,
    finite_array,
    real_numbers,
    unchangeable,
)
from polywigner.geometry.display import shown_as_html
from polywigner.geometry.wavefront import checked_shift, turned_points


@final
class Illumination:
    """A field u(x) = sum_m c_m exp(2 pi i kappa_m.x) on an aperture (d = 2) or on slits (d = 1).

    All transforms stay closed forms. `a * b` multiplies two fields, `2j * a` and `a / 2` scale one,
    and `a + b` and `a - b` superpose them. Waves of one frequency are merged.

    Parameters
    ----------
    amplitudes : (m,) complex c_m, in the unit of the field.
    frequencies : (m, d) real kappa_m in cycles per metre; for d = 1 also (m,).

    Raises IlluminationError for values that are not finite numbers, shapes that do not match,
    and a field that is zero everywhere.

    >>> import polywigner as pw
    >>> tilt = pw.Illumination([1.0], [(100.0, 0.0)])  # towards s_x = 100 m^-1 times lambda
    >>> pw.shapes.square(0.01).with_illumination(tilt).illumination == tilt
    True
    """

    amplitudes: NDArray[np.complex128]
    """(m,), read-only."""
    frequencies: NDArray[np.float64]
    """(m, d), read-only, in lexicographic order."""
    is_fit: bool
    """Whether waves come from :func:`polywigner.fit_illumination`; equality and files ignore it."""

    def __init__(self, amplitudes: ArrayLike, frequencies: ArrayLike) -> None:
        waves = _merged(*_checked(amplitudes, frequencies))
        for name, array in zip(("amplitudes", "frequencies"), waves, strict=True):
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "is_fit", False)

    def _from(self, amplitudes: Any, frequencies: Any, is_fit: bool = False) -> Illumination:
        """A field made of this one; ``is_fit``: or of a fit."""
        return restored(amplitudes, frequencies, self.is_fit or is_fit)

    @property
    def dimension(self) -> int:
        """d, the number of components of a position."""
        return int(self.frequencies.shape[1])

    def __call__(self, x: ArrayLike) -> Any:
        """The field at positions x (..., d), complex (...)."""
        try:
            points = real_numbers(x)
        except ValueError as error:
            raise ArgumentError(f"expected x as real numbers, got {error}") from None
        if points.ndim == 0 or points.shape[-1] != self.dimension:
            raise ArgumentError(f"expected x of shape (..., {self.dimension}), got {points.shape}")
        return np.exp(2j * np.pi * (points @ self.frequencies.T)) @ self.amplitudes

    def moved(self, shift: ArrayLike) -> Illumination:
        """The field carried along by a shift (d,): u(x - shift)."""
        offset = checked_shift(shift, self.dimension)
        turns = [exact_turns(kappa, offset.tolist()) for kappa in self.frequencies.tolist()]
        return self._from(self.amplitudes * np.exp(-2j * np.pi * np.array(turns)), self.frequencies)

    def turned(self, angle: float) -> Illumination:
        """The field carried along by a turn about the origin, by an angle in radians.

        Counter-clockwise; quarter turns are exact. Raises IlluminationError for a field of slits.
        """
        if self.dimension != 2:
            raise IlluminationError("expected a field in two dimensions to turn, got one of slits")
        return self._from(self.amplitudes, turned_points(self.frequencies, angle))

    def scaled(self, factor: float) -> Illumination:
        """The field carried along when its source grows by a factor about the origin."""
        size = checked_length(factor, "factor")
        with np.errstate(over="ignore"):
            return self._from(self.amplitudes, self.frequencies / size)

    def _repr_html_(self) -> str:
        rows = [("waves", f"{len(self.amplitudes)} in {self.dimension} dimensions")]
        for amplitude, nu in list(zip(self.amplitudes, self.frequencies, strict=True))[:4]:
            place = ", ".join(f"{component:.4g}" for component in nu)
            rows.append((f"({place}) /m", f"{complex(amplitude):.4g}"))
        return shown_as_html("Illumination", rows)

    def __mul__(self, other: Illumination | complex) -> Illumination:
        if isinstance(other, Complex):
            return self._from(self.amplitudes * complex(other), self.frequencies)
        if not isinstance(other, Illumination):
            return NotImplemented
        self._check_dimension(other)
        products = np.multiply.outer(self.amplitudes, other.amplitudes)
        sums = self.frequencies[:, None] + other.frequencies
        return self._from(products.ravel(), sums.reshape(-1, self.dimension), other.is_fit)

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
        return self._from(self.amplitudes / complex(other), self.frequencies)

    def __neg__(self) -> Illumination:
        return -1 * self

    def __sub__(self, other: Illumination) -> Illumination:
        return self + -other if isinstance(other, Illumination) else NotImplemented

    def __add__(self, other: Illumination) -> Illumination:
        if not isinstance(other, Illumination):
            return NotImplemented
        self._check_dimension(other)
        return self._from(
            np.concatenate([self.amplitudes, other.amplitudes]),
            np.concatenate([self.frequencies, other.frequencies]),
            other.is_fit,
        )

    @cached_property
    def _key(self) -> tuple[int, bytes, bytes]:
        return self.dimension, self.amplitudes.tobytes(), self.frequencies.tobytes()

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Illumination) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)

    __setattr__ = __delattr__ = unchangeable

    def __reduce__(self) -> tuple[Any, ...]:
        return restored, (self.amplitudes, self.frequencies, self.is_fit)

    def __len__(self) -> int:
        """The number of waves."""
        return len(self.amplitudes)

    def __repr__(self) -> str:
        plural = "s" if len(self) > 1 else ""
        return f"Illumination({len(self)} plane wave{plural}, {self.dimension}D)"


def restored(amplitudes: Any, frequencies: Any, is_fit: bool) -> Illumination:
    """An Illumination that knows whether it is a fit."""
    field = Illumination(amplitudes, frequencies)
    object.__setattr__(field, "is_fit", is_fit)
    return field


def exact_turns(kappa: list[float], shift: list[float]) -> float:
    """kappa.shift modulo 1, exact: far away it has many turns, whose rounding would spoil it."""
    turns = sum((Fraction(k) * Fraction(s) for k, s in zip(kappa, shift, strict=True)), Fraction(0))
    return float(turns - round(turns))


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
    """One wave for each frequency, in lexicographic order; no negative zeros.

    Amplitudes left by cancellation, below rounding of the terms that cancelled, count as 0.
    """
    found, number = np.unique(frequencies + 0.0, axis=0, return_inverse=True)
    total, size = np.zeros(len(found), np.complex128), np.zeros(len(found))
    np.add.at(total, number.ravel(), amplitudes)
    np.add.at(size, number.ravel(), np.abs(amplitudes))
    kept = np.abs(total) > 1e-15 * size
    if not kept.any():
        raise IlluminationError("expected a field other than zero, got amplitudes of zero only")
    return total[kept] + 0.0, found[kept]


# Waves of twice the period are nearly dependent on the samples' extent: singular values below this
# fraction change the fit by about as much, with amplitudes up to its inverse that cancel.
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

    Minimises sum_j |u(x_j) - values_j|^2 by a singular value decomposition without the values below
    `cut_off`. Memory is bounded by the square of the number of waves.

    The samples do not fix how the field changes away from the plane. Kirchhoff and
    Rayleigh-Sommerfeld II take that from the waves found, above all from evanescent ones, |kappa| >
    1/wavelength, and warn: two fits of one field on a square of one wavelength, with residuals of
    1e-9 and less, were 0.12 dB apart by Rayleigh-Sommerfeld II, and 1e-4 dB by I.

    Parameters
    ----------
    points : (n, 2) positions in m; for slits (n, 1) or (n,); on a grid or not. Outside of their
        bounds the fit means nothing: sample up to the edges of the aperture.
    values : (n,) complex field at these points.
    frequencies : (m, d) in cycles per metre. None: waves whose period is twice the extent of the
        points, -order..order periods along each axis.
    order : of these waves, fewer where there are fewer samples. A phase that turns by q over the
        aperture needs about 2 q + 4.
    cut_off : fraction of the largest singular value, from 1e-15 up to below 1; larger for noise.
    largest_residual : refuse fits that are worse; None: the caller looks at the residual.

    Returns
    -------
    FittedIllumination : (illumination, residual, rank, cancellation).

    Raises ArgumentError for points, values or options of other shapes or ranges; IlluminationError
    for values all zero, frequencies that do not fit, and a residual above `largest_residual`.

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
    if largest_residual is not None and not residual <= checked_number(
        largest_residual, "largest_residual", "a number"
    ):
        raise IlluminationError(
            f"expected a fit with a residual of at most {largest_residual:g}, got {residual:.3g} "
            f"with {len(kappa)} waves; give a higher order or other frequencies"
        )
    cancellation = float(np.abs(amplitudes).sum()) / (size / np.sqrt(len(field)))
    fitted = restored(amplitudes, kappa, True).moved(centre)
    return FittedIllumination(fitted, residual, rank, cancellation)


def _samples(points: Any, values: Any) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    expected = "expected points (n, 2), or (n, 1) for slits"
    places = finite_array(points, expected, (None,), (None, 1), (None, 2)).reshape(len(points), -1)
    try:
        field = np.array(values, dtype=np.complex128)
    except (TypeError, ValueError, OverflowError):
        field = np.empty(0, np.complex128)
    if field.shape != places.shape[:1] or not np.isfinite(field).all():
        raise ArgumentError(
            f"expected a finite complex number for each of {len(places)} points, "
            f"got {value_text(values)}"
        )
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
    """Frequencies (m, d): whole numbers of periods in twice the extent; no more than samples."""
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
    """Amplitudes, norm of the rest of the field, and rank.

    The triangle of a QR decomposition grows by blocks of rows (the field as the last column), so
    that any number of samples fits into memory.
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
