"""Illuminations: fields on sources as sums of plane waves."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import cached_property
from numbers import Complex
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import IlluminationError
from polywigner.geometry.arguments import (
    Immutable,
    checked_length,
    checked_number,
    checked_type,
    checked_vectors,
    complex_array,
    finite_array,
)


def checked_shift(shift: Any, dimension: int, name: str = "a shift") -> NDArray[np.float64]:
    """Return a translation as an array (dimension,); a number is accepted in one dimension.

    Raises ArgumentError unless the translation has this shape and is finite. ``name``: name in the
    message.
    """
    shapes = ((), (1,)) if dimension == 1 else ((dimension,),)
    expected = f"expected {name} of {dimension} finite numbers"
    return np.atleast_1d(finite_array(shift, expected, *shapes))


def turned_points(points: NDArray[np.float64], angle: Any) -> NDArray[np.float64]:
    """Rotate points (n, 2) counter-clockwise about the origin; multiples of pi/2 rad are exact."""
    radians = checked_number(angle, "angle", "an angle in radians")
    quarters = round(radians / (math.pi / 2))
    c, s = math.cos(radians), math.sin(radians)
    if radians == quarters * (math.pi / 2):
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarters % 4]
    x, y = points.T
    # Adding 0.0 turns -0.0 into 0.0.
    return np.column_stack([c * x - s * y, s * x + c * y]) + 0.0


@final
class Illumination(Immutable):
    """A field u(x) = sum_m c_m exp(2 pi i kappa_m.x) on an aperture (d = 2) or on slits (d = 1).

    All transforms have closed forms. `a * b` multiplies two fields, `2j * a` and `a / 2` scale a
    field, and `a + b` and `a - b` superpose fields. Waves of the same frequency are merged.

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
    """Complex amplitudes c_m, shape (m,), read-only."""
    frequencies: NDArray[np.float64]
    """Frequencies kappa_m in cycles per metre, shape (m, d), in lexicographic order, read-only."""

    def __init__(self, amplitudes: ArrayLike, frequencies: ArrayLike) -> None:
        waves, kappa = _merged_waves(*_checked_waves(amplitudes, frequencies))
        self._set(amplitudes=waves, frequencies=kappa)

    @property
    def dimension(self) -> int:
        """Number d of components of a position: 2 for apertures, 1 for slits."""
        return int(self.frequencies.shape[1])

    def __call__(self, x: ArrayLike) -> NDArray[np.complex128]:
        """Return the complex field, shape (...), at positions x (..., d) in m."""
        expected = f"expected x to be real numbers of shape (..., {self.dimension})"
        points = checked_vectors(x, expected, (self.dimension,))
        return np.exp(2j * np.pi * (points @ self.frequencies.T)) @ self.amplitudes

    def moved(self, shift: ArrayLike) -> Illumination:
        """Return the shifted field u(x - shift), with the shift (d,) in m."""
        phases = shift_phases(self.frequencies, checked_shift(shift, self.dimension))
        return Illumination(self.amplitudes * phases, self.frequencies)

    def turned(self, angle: float) -> Illumination:
        """Return the field rotated counter-clockwise about the origin by an angle in radians.

        Multiples of pi/2 are exact.

        Raises
        ------
        IlluminationError
            If the field is defined on slits.
        """
        if self.dimension != 2:
            raise IlluminationError(
                "expected a field on an aperture, got a field on slits, which cannot be rotated"
            )
        return Illumination(self.amplitudes, turned_points(self.frequencies, angle))

    def scaled(self, factor: float) -> Illumination:
        """Return the scaled field u(x / factor), for a factor above zero."""
        size = checked_length(factor, "factor")
        with np.errstate(over="ignore"):
            return Illumination(self.amplitudes, self.frequencies / size)

    def __mul__(self, other: Illumination | complex) -> Illumination:
        """Return the product with another field, or with a complex number."""
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
        """Raise IlluminationError unless another field has the same number of dimensions."""
        if other.dimension != self.dimension:
            raise IlluminationError(
                f"expected fields of equal dimension, got dimensions {self.dimension} and "
                f"{other.dimension}"
            )

    def __truediv__(self, other: complex) -> Illumination:
        """Return the field divided by a complex number."""
        if not isinstance(other, Complex):
            return NotImplemented
        if other == 0:
            raise IlluminationError("a field cannot be divided by zero; pass a nonzero number")
        return Illumination(self.amplitudes / complex(other), self.frequencies)

    def __neg__(self) -> Illumination:
        """Return the field with the opposite sign."""
        return -1 * self

    def __sub__(self, other: Illumination) -> Illumination:
        """Return the difference from another field."""
        return self + -other if isinstance(other, Illumination) else NotImplemented

    def __add__(self, other: Illumination) -> Illumination:
        """Return the sum with another field."""
        if not isinstance(other, Illumination):
            return NotImplemented
        self._check_dimension(other)
        return Illumination(
            np.concatenate([self.amplitudes, other.amplitudes]),
            np.concatenate([self.frequencies, other.frequencies]),
        )

    @cached_property
    def _key(self) -> tuple[int, bytes, bytes]:
        """Dimension, amplitudes and frequencies, which are equal for equal fields."""
        return self.dimension, self.amplitudes.tobytes(), self.frequencies.tobytes()

    def __len__(self) -> int:
        """Return the number of plane waves."""
        return len(self.amplitudes)

    def __repr__(self) -> str:
        plural = "s" if len(self) > 1 else ""
        return f"Illumination({len(self)} plane wave{plural}, {self.dimension}D)"


def shift_phases(
    frequencies: NDArray[np.float64], shift: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Return exp(-2 pi i kappa.shift) (m,) for frequencies kappa (m, d) and a shift (d,).

    The products are computed exactly, because rounding would change the phase of a large product.
    """
    offset = [Fraction(s) for s in shift.tolist()]
    cycles = (
        sum((Fraction(k) * s for k, s in zip(kappa, offset, strict=True)), Fraction(0))
        for kappa in frequencies.tolist()
    )
    return np.exp(-2j * np.pi * np.array([float(c - round(c)) for c in cycles]))


def _checked_waves(
    amplitudes: Any, frequencies: Any
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Return complex amplitudes (m,) and frequencies (m, d), d = 1 or 2, as arrays.

    Raises IlluminationError if they are not finite numbers of matching shapes.
    """
    expected = (
        "expected complex amplitudes of shape (m,), and one real frequency of shape (d,) for "
        "each amplitude, d = 1 or 2"
    )
    waves = complex_array(amplitudes, expected, (), (None,), error=IlluminationError)
    shapes = (None,), (None, 1), (None, 2)
    kappa = finite_array(frequencies, expected, *shapes, error=IlluminationError)
    if kappa.ndim == 1:
        kappa = kappa[None, :] if waves.size == 1 and kappa.size == 2 else kappa[:, None]
    if waves.size != len(kappa):
        raise IlluminationError(
            f"{expected}, got {waves.size} amplitudes and {len(kappa)} frequencies"
        )
    return np.atleast_1d(waves), kappa


def _merged_waves(
    amplitudes: NDArray[np.complex128], frequencies: NDArray[np.float64]
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Merge waves of equal frequency, sort them by frequency, and drop waves that cancel.

    Raises IlluminationError if all waves cancel.
    """
    distinct, number = np.unique(frequencies + 0.0, axis=0, return_inverse=True)
    total, size = np.zeros(len(distinct), np.complex128), np.zeros(len(distinct))
    np.add.at(total, number.ravel(), amplitudes)
    np.add.at(size, number.ravel(), np.abs(amplitudes))
    nonzero = np.abs(total) > 1e-15 * size
    if not nonzero.any():
        raise IlluminationError("expected a nonzero field, got only zero amplitudes")
    return total[nonzero] + 0.0, distinct[nonzero]


def checked_field(field: Any, dimension: int) -> Illumination | None:
    """Check that a field is None or an illumination of the given dimension, and return it.

    Raises ArgumentError or IlluminationError for other values.
    """
    if field is None:
        return None
    advice = "pass its .illumination, or make one with polywigner.Illumination"
    checked_type(field, "an Illumination", Illumination, advice=advice)
    if field.dimension != dimension:
        raise IlluminationError(
            f"expected an illumination whose frequencies have {dimension} components, got "
            f"{field.dimension}"
        )
    result: Illumination = field
    return result
