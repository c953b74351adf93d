"""Aberrations of pupils, given by Zernike polynomials, power series or functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution
from polywigner.errors import ArgumentError, value_text
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import (
    DrJitArray,
    Immutable,
    checked_choice,
    checked_count,
    checked_length,
    checked_number,
    checked_type,
    finite_array,
)
from polywigner.numerics import Complex, Floats
from polywigner.numerics.nodes import cells_of, rule_over_cells, triangles_of
from polywigner.source import Array
from polywigner.source.normal_form import normal_form, polygons_of

Path = Callable[[Floats, Floats], ArrayLike]

# The complex Zernike polynomials V_n^m(z) = R_n^m(r) exp(i m theta) with z = x + iy satisfy
#     V_n^m = z V_(n-1)^(m-1) + conj(z) V_(n-1)^(m+1) - V_(n-2)^m,    V_n^(-m) = conj(V_n^m),
# where m >= 0. The recurrence has no cancellation. The real part of V_n^m is the cosine polynomial,
# and the imaginary part is the sine polynomial. Source: T. B. Andersen, Opt. Express 26, 18878
# (2018), in complex form.

Order = tuple[int, int]
"""Radial order n and azimuthal frequency m of a Zernike polynomial; m < 0 denotes a sine term."""


def noll(j: int) -> Order:
    """Return the order (n, m) of the Zernike polynomial with a Noll index, which starts at 1.

    Sine terms have m < 0. Source: R. J. Noll, J. Opt. Soc. Am. 66, 207 (1976).
    """
    n = (math.isqrt(8 * j - 7) - 1) // 2
    rank = j - n * (n + 1) // 2 - 1
    m = (rank + 1) // 2 * 2 if n % 2 == 0 else rank // 2 * 2 + 1
    return n, m if j % 2 == 0 else -m


def osa(j: int) -> Order:
    """Return the order (n, m) of the Zernike polynomial with an OSA/ANSI index, which starts at 0.

    Sine terms have m < 0. Source: ANSI Z80.28.
    """
    n = (math.isqrt(8 * j + 1) - 1) // 2
    return n, 2 * j - n * (n + 2)


def fringe(j: int) -> Order:
    """Return the order (n, m) of the Zernike polynomial with a fringe index, which starts at 1.

    Sine terms have m < 0.
    """
    d = math.isqrt(j - 1)
    rank = j - 1 - d * d
    m = d - rank // 2
    return 2 * d - m, m if rank % 2 == 0 else -m


class Indexing(NamedTuple):
    """A numbering of Zernike polynomials by a single index."""

    order: Callable[[int], Order]
    first: int
    is_normalised: bool
    """Whether the polynomials have unit rms on the disc. Otherwise their value at the rim is 1."""


INDEXINGS = {
    "noll": Indexing(noll, 1, True),
    "fringe": Indexing(fringe, 1, False),
    "osa": Indexing(osa, 0, True),
}


def zernike_norm(order: Order) -> float:
    """Return the factor for unit rms of a Zernike polynomial whose maximum at the rim is 1."""
    n, m = order
    return math.sqrt((n + 1) * (2 if m else 1))


def zernike_values(orders: Sequence[Order], x: Floats, y: Floats) -> Floats:
    """Return the values of Zernike polynomials at points, shape (polynomials, ...).

    The coordinates x and y are in units of the radius of the disc. The largest value of each
    polynomial on the rim of the disc is 1.
    """
    table = _complex_polynomials(max((n for n, _ in orders), default=0), x, y)
    return np.array([_real_or_imaginary(table[n, abs(m)], m) for n, m in orders])


def zernike_gradients(orders: Sequence[Order], x: Floats, y: Floats) -> Floats:
    """Return the derivatives of :func:`zernike_values` along x and y, shape (k, 2, ...).

    The complex polynomials satisfy d/dz V_n^m - d/dz V_(n-2)^m = n V_(n-1)^(m-1). For the
    derivative with respect to conj(z), the right-hand side is n V_(n-1)^(m+1).
    """
    table = _complex_polynomials(max((n for n, _ in orders), default=0), x, y)
    return np.array([_polynomial_gradient(table, order) for order in orders])


def _complex_polynomials(highest: int, x: Floats, y: Floats) -> dict[Order, Complex]:
    """Return the complex Zernike polynomials V_n^m at points, with (n, m) as keys.

    The table contains m >= 0 and n up to ``highest``.
    """
    z = np.asarray(x) + 1j * np.asarray(y)
    table: dict[Order, Complex] = {(0, 0): np.ones_like(z)}
    for n in range(1, highest + 1):
        for m in range(n % 2, n + 1, 2):
            value = z * _complex_polynomial(table, n - 1, m - 1)
            if m < n:
                value = value + z.conj() * table[n - 1, m + 1] - table[n - 2, m]
            table[n, m] = value
    return table


def _complex_polynomial(table: dict[Order, Complex], n: int, m: int) -> Complex:
    """Return the complex Zernike polynomial V_n^m for any m; it is zero if |m| exceeds n."""
    if abs(m) > n:
        return np.zeros_like(table[0, 0])
    return table[n, m] if m >= 0 else table[n, -m].conj()


def _real_or_imaginary(values: Complex, m: int) -> Floats:
    """Return the cosine part (m >= 0) or the sine part of complex Zernike polynomials."""
    return values.real if m >= 0 else values.imag


def _polynomial_gradient(table: dict[Order, Complex], order: Order) -> Floats:
    """Return the derivatives of a real Zernike polynomial along x and y, shape (2, ...)."""
    n, m = order
    by_z = by_conjugate = np.zeros_like(table[0, 0])
    for k in range(n, 0, -2):
        by_z = by_z + k * _complex_polynomial(table, k - 1, abs(m) - 1)
        by_conjugate = by_conjugate + k * _complex_polynomial(table, k - 1, abs(m) + 1)
    return _real_or_imaginary(np.array([by_z + by_conjugate, 1j * (by_z - by_conjugate)]), m)


# Step of finite differences for path functions, as a fraction of the pupil's radius.
_STEP = 1e-6
_HIGHEST_RADIAL_ORDER = 200
# Ratio of the smallest to the largest diagonal element of the Gram-Schmidt matrix. If the ratio is
# smaller, the polynomials are treated as linearly dependent on the pupil.
_DEPENDENT = 1e-10


class Modes(Protocol):
    """Functions on a pupil. The path length is their sum, weighted with coefficients in m."""

    def values(self, x: Floats, y: Floats) -> Floats:
        """Return the values of the functions at positions in m, one row for each function."""
        ...

    def gradients(self, x: Floats, y: Floats) -> Floats:
        """Return the derivatives of the functions along x and y in 1/m, shape (k, 2, ...)."""
        ...


@dataclass(frozen=True, eq=False)
class ZernikeModes:
    """Functions that are sums of Zernike polynomials."""

    orders: tuple[Order, ...]
    radius: float
    matrix: Floats
    """Coefficients of the Zernike polynomials, one row for each sum."""

    def values(self, x: Floats, y: Floats) -> Floats:
        """Return the values of the sums at positions in m, one row for each sum."""
        table = zernike_values(self.orders, x / self.radius, y / self.radius)
        return np.asarray(np.einsum("kj,j...->k...", self.matrix, table))

    def gradients(self, x: Floats, y: Floats) -> Floats:
        """Return the derivatives of the sums along x and y in 1/m, shape (k, 2, ...)."""
        table = zernike_gradients(self.orders, x / self.radius, y / self.radius)
        return np.asarray(np.einsum("kj,j...->k...", self.matrix / self.radius, table))


@dataclass(frozen=True, eq=False)
class PowerModes:
    """Functions that are products of powers, (x/radius)^i (y/radius)^j."""

    powers: NDArray[np.intp]
    """Exponents i and j of each function, shape (k, 2)."""
    radius: float

    def values(self, x: Floats, y: Floats) -> Floats:
        """Return the values of the power products at positions in m, one row for each product."""
        return np.array([(x / self.radius) ** i * (y / self.radius) ** j for i, j in self.powers])

    def gradients(self, x: Floats, y: Floats) -> Floats:
        """Return the derivatives of the power products along x and y in 1/m, shape (k, 2, ...)."""
        u, v = x / self.radius, y / self.radius
        derivatives = [
            (i * u ** max(i - 1, 0) * v**j, j * u**i * v ** max(j - 1, 0)) for i, j in self.powers
        ]
        return np.array(derivatives) / self.radius


@dataclass(frozen=True, eq=False)
class FunctionMode:
    """A user-defined path function, whose coefficient is a dimensionless factor."""

    path: Path
    radius: float

    def values(self, x: Floats, y: Floats) -> Floats:
        """Return the values of the path function in m at positions in m, as a single row.

        Raises ArgumentError unless the function returns one finite number, or one per position.
        """
        path = np.asarray(self.path(x, y), np.float64)
        if path.shape not in ((), np.shape(x)) or not np.isfinite(path).all():
            raise ArgumentError(
                f"expected path(x, y) to return finite numbers of shape {np.shape(x)}, got "
                f"shape {path.shape}; the function must be defined on the pupil and take "
                "arrays"
            )
        return np.broadcast_to(path, np.shape(x))[None]

    def gradients(self, x: Floats, y: Floats) -> Floats:
        """Return central differences of the path function along x and y, shape (1, 2, ...)."""
        step = _STEP * self.radius
        by_x = self.values(x + step, y) - self.values(x - step, y)
        by_y = self.values(x, y + step) - self.values(x, y - step)
        return np.stack([by_x, by_y], axis=1) / (2 * step)


@final
class Aberration(Immutable):
    """An aberration of a pupil, as a path length W(x, y) in metres.

    The field in the pupil is multiplied by exp(+2 pi i W/lambda). Waves are exp(+i k R) with the
    time factor exp(-i omega t). A positive W is therefore a longer path and delays the wavefront,
    like a positive ``piston`` of :func:`segmented_pupil`. The coordinates x and y are distances
    from the optical axis in m. The axes of the image are parallel to the axes of the pupil: the
    path length W = t x shifts the spot by t times the focal length along +x. W is the same at all
    wavelengths. Aberrations can be added with ``+`` and multiplied by numbers. :func:`zernike`
    returns the usual aberrations.

    Parameters
    ----------
    path : array_like, shape (m, n), or callable
        Coefficients c_ij in m of the power series W = sum_ij c_ij (x/radius)^i (y/radius)^j, or a
        function ``path(x, y)`` of arrays that returns W in m. The function must be smooth within
        the pupil. Kinks and steps reduce the accuracy.
    radius : float, default 1.0
        Unit of length of x and y in the power series, in m. For a function, the radius of the
        pupil, to which the steps of finite differences are proportional.

    Raises
    ------
    ArgumentError
        If the coefficients are not finite, or the radius is not above zero.

    Examples
    --------
    >>> import polywigner as pw
    >>> astigmatism = pw.Aberration([[0, 0, -50e-9], [0, 0, 0], [50e-9, 0, 0]], radius=5e-3)
    >>> float(astigmatism(5e-3, 0.0))
    5e-08
    """

    coefficients: Floats
    """Coefficient of each term in m. The coefficient of a function is dimensionless."""
    traced: Any
    """Dr.Jit array of the coefficients, or None if the coefficients are NumPy numbers."""
    _modes: tuple[Modes, ...]

    def __init__(self, path: ArrayLike | Path, radius: float = 1.0) -> None:
        size = checked_length(radius, "radius")
        modes: Modes
        if callable(path):
            modes, coefficients = FunctionMode(path, size), np.ones(1)
        else:
            expected = "expected path to be coefficients (m, n) in m, or a function of x and y"
            table = finite_array(path, expected, (None, None))
            powers = np.argwhere(table)
            modes, coefficients = PowerModes(powers, size), table[tuple(powers.T)]
        self._set(coefficients=coefficients, _modes=(modes,), traced=None)

    @property
    def _key(self) -> int:
        """Value by which aberrations are compared, which is equal only for the same object."""
        # Path functions cannot be compared, so each aberration equals only itself.
        return id(self)

    def with_coefficients(self, coefficients: ArrayLike | DrJitArray) -> Aberration:
        """Return an aberration with the same terms and new coefficients.

        Parameters
        ----------
        coefficients : array_like or Dr.Jit Float, shape (k,)
            Values in the order of :attr:`coefficients`. For a Dr.Jit array, :func:`psf`,
            :func:`otf` and :func:`mtf` return Dr.Jit arrays that are differentiable with respect
            to the coefficients.

        Returns
        -------
        Aberration
            An aberration with the same terms.

        Raises
        ------
        ArgumentError
            If ``coefficients`` does not consist of k finite numbers.

        Examples
        --------
        >>> import polywigner as pw
        >>> coma = pw.zernike({8: 10e-9}, radius=5e-3).with_coefficients([20e-9])
        >>> coma.coefficients.tolist()
        [2e-08]
        """
        traced: Any = None
        given: Any = coefficients
        if execution.is_drjit(given):
            pair = execution.numbers_of("coefficients", given, "Complex2f")
            traced, given = pair[0], execution.columns_of(pair)[:, 0]
        shape = (len(self.coefficients),)
        values = finite_array(
            given, f"expected coefficients to be finite numbers of shape {shape}", shape
        )
        return Aberration._of(coefficients=values, _modes=self._modes, traced=traced)

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Return the path length W in m at the positions (x, y) in m."""
        points = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        return np.asarray(np.einsum("k,k...->...", self.coefficients, self.modes(*points)))[()]

    def slopes(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Return the derivatives of the path length W along x and y, shape (..., 2).

        The positions x and y are in m, and the derivatives are dimensionless. A ray from (x, y)
        meets the focal plane at a point whose coordinates are the derivatives times the focal
        length. If W is a function, the derivatives are central differences.
        """
        points = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        gradients = np.concatenate([modes.gradients(*points) for modes in self._modes])
        return np.asarray(np.einsum("k,kd...->...d", self.coefficients, gradients))

    def modes(self, x: Floats, y: Floats) -> Floats:
        """Return the derivatives (k, ...) of the path length W with respect to the k coefficients.

        The positions x and y are in m.
        """
        return np.concatenate([modes.values(x, y) for modes in self._modes])

    def __add__(self, other: Aberration) -> Aberration:
        if not isinstance(other, Aberration):
            return NotImplemented
        if self.traced is not None or other.traced is not None:
            raise ArgumentError(
                "aberrations with Dr.Jit coefficients cannot be added; add the aberrations "
                "first, then use with_coefficients"
            )
        coefficients = np.concatenate([self.coefficients, other.coefficients])
        modes = self._modes + other._modes
        return Aberration._of(coefficients=coefficients, _modes=modes, traced=None)

    def __mul__(self, factor: float) -> Aberration:
        number = checked_number(factor, "factor", "a finite number")
        traced = None if self.traced is None else self.traced * number
        coefficients = self.coefficients * number
        return Aberration._of(coefficients=coefficients, _modes=self._modes, traced=traced)

    __rmul__ = __mul__

    def __repr__(self) -> str:
        return f"Aberration({len(self.coefficients)} terms)"


def zernike(
    coefficients: Mapping[int, float],
    radius: float,
    indexing: str = "noll",
    *,
    orthogonal_on: Aperture | Array | None = None,
) -> Aberration:
    """Return an aberration that is a sum of Zernike polynomials.

    The polynomials of the numberings "noll" and "osa" have unit rms on the disc, so each
    coefficient is an rms wavefront error in m. The polynomials of the numbering "fringe" have the
    value 1 at the rim. Sources: R. J. Noll, J. Opt. Soc. Am. 66, 207 (1976); ANSI Z80.28.

    Parameters
    ----------
    coefficients : mapping of int to float
        Coefficients in m, with the index of the polynomial as the key: ``{4: 25e-9, 11: 10e-9}``.
    radius : float
        Radius of the disc in m. The polynomials are also defined outside the disc.
    indexing : {"noll", "fringe", "osa"}
        Numbering of the polynomials. The numbering starts at 1 for "noll" and "fringe", and at 0
        for "osa".
    orthogonal_on : Aperture or Array, optional
        Pupil on which the polynomials are made orthogonal with unit rms, such as an annular,
        hexagonal or segmented pupil. The Gram-Schmidt method is applied in the order of the
        indices, with exact integrals over the polygon. Each new polynomial is a multiple of the
        Zernike polynomial with the same index, plus a sum of polynomials with lower indices.

    Returns
    -------
    Aberration
        The aberration. The attribute ``coefficients`` contains the values of the mapping in the
        same order.

    Raises
    ------
    ArgumentError
        If an index does not exist or a coefficient is not finite.

    Examples
    --------
    >>> import polywigner as pw
    >>> defocus = pw.zernike({4: 25e-9}, radius=5e-3)  # 25 nm rms on the disc
    >>> round(float(defocus(5e-3, 0.0)) * 1e9, 3)  # times sqrt(3) at the rim
    43.301
    """
    expected = "coefficients to be a mapping from indices to values in metres"
    checked_type(coefficients, expected, Mapping, advice="pass for example {4: 25e-9}")
    indices = _checked_indices(coefficients, indexing)
    values = [
        checked_number(value, f"coefficient {index}", "a finite number of metres")
        for index, value in coefficients.items()
    ]
    modes = _zernike_modes(indices, radius, indexing, orthogonal_on)
    return Aberration._of(coefficients=np.array(values), _modes=(modes,), traced=None)


class FittedAberration(NamedTuple):
    """Result of :func:`fit_zernike`: an aberration, its coefficients and the residual."""

    aberration: Aberration
    coefficients: dict[int, float]
    """Coefficients in m, with the index of the polynomial as the key."""
    residual: float
    """Rms difference between the samples and the fit, in m."""


def fit_zernike(
    x: ArrayLike,
    y: ArrayLike,
    opd: ArrayLike,
    radius: float,
    terms: int | Collection[int],
    indexing: str = "noll",
    *,
    orthogonal_on: Aperture | Array | None = None,
) -> FittedAberration:
    """Fit Zernike polynomials to samples of a path length by least squares.

    Parameters
    ----------
    x, y : array_like, shape (...)
        Positions of the samples in m.
    opd : array_like, shape (...)
        Path lengths in m.
    radius, indexing, orthogonal_on
        See :func:`zernike`.
    terms : int or collection of int
        Number of polynomials, starting with the first index, or a collection of indices.

    Returns
    -------
    FittedAberration
        Named tuple (aberration, coefficients, residual).

    Raises
    ------
    ArgumentError
        If the shapes of the samples differ, or the samples do not determine the coefficients.

    Examples
    --------
    >>> import numpy as np
    >>> import polywigner as pw
    >>> x, y = np.meshgrid(*2 * [np.linspace(-5e-3, 5e-3, 9)])
    >>> fit = pw.fit_zernike(x, y, 1e-3 * (x**2 - y**2), 5e-3, 6)
    >>> round(fit.coefficients[6] * 1e9, 3)  # 25 nm at the rim over sqrt(6)
    10.206
    """
    expected = "expected x, y and opd as finite numbers of equal shape"
    samples = [finite_array(np.ravel(a), expected, (None,)) for a in (x, y, opd)]
    if len({len(a) for a in samples}) != 1:
        raise ArgumentError(f"{expected}, got {', '.join(str(len(a)) for a in samples)} numbers")
    if not isinstance(terms, Collection):
        first = _indexing_of(indexing).first
        terms = range(first, first + checked_count(terms, "terms", 1))
    indices = _checked_indices(terms, indexing)
    modes = _zernike_modes(indices, radius, indexing, orthogonal_on)
    matrix = modes.values(*samples[:2]).T
    solution, _, rank, _ = np.linalg.lstsq(matrix, samples[2], rcond=None)
    values: Floats = np.asarray(solution, np.float64)
    if rank < len(indices):
        raise ArgumentError(
            f"{len(samples[0])} samples determine only {rank} of {len(indices)} polynomials; "
            "use fewer terms, or samples that cover the pupil"
        )
    residual = float(np.sqrt(np.square(samples[2] - matrix @ values).mean()))
    by_index = dict(zip(indices, values.tolist(), strict=True))
    fitted = Aberration._of(coefficients=values, _modes=(modes,), traced=None)
    return FittedAberration(fitted, by_index, residual)


def _indexing_of(name: Any) -> Indexing:
    """Return the numbering with a given name, or raise ArgumentError."""
    return INDEXINGS[checked_choice(name, "indexing", INDEXINGS)]


def _checked_indices(indices: Collection[Any], indexing: str) -> list[int]:
    """Return indices of Zernike polynomials as integers; raise ArgumentError for other values."""
    order, first, _ = _indexing_of(indexing)
    for index in indices:
        is_index = isinstance(index, int | np.integer) and not isinstance(index, bool)
        if not is_index or index < first or order(int(index))[0] > _HIGHEST_RADIAL_ORDER:
            raise ArgumentError(
                f"expected indices of the numbering {indexing} from {first} up to the radial "
                f"order {_HIGHEST_RADIAL_ORDER}, got {value_text(index)}"
            )
    if len(set(indices)) != len(indices) or not len(indices):
        raise ArgumentError(
            f"expected one or more distinct indices, got {value_text(list(indices))}"
        )
    return [int(index) for index in indices]


def _zernike_modes(
    indices: list[int], radius: float, indexing: str, orthogonal_on: Aperture | Array | None
) -> ZernikeModes:
    """Return the Zernike polynomials with given indices, which may be orthogonal on a pupil."""
    order, first, is_normalised = _indexing_of(indexing)
    is_plain = orthogonal_on is None
    orders = tuple(map(order, indices if is_plain else range(first, max(indices) + 1)))
    norms = [1.0 if is_plain and not is_normalised else zernike_norm(n_m) for n_m in orders]
    modes = ZernikeModes(orders, checked_length(radius, "radius"), np.diag(norms))
    if orthogonal_on is None:
        return modes
    rows = [index - first for index in indices]
    return replace(modes, matrix=_gram_schmidt(modes, orthogonal_on)[rows] @ modes.matrix)


def _gram_schmidt(modes: ZernikeModes, pupil: Aperture | Array) -> Floats:
    """Return the lower triangular matrix (k, k) that makes k polynomials orthonormal on a pupil.

    The new polynomials are the matrix times the old polynomials, and have unit rms over the area.
    Raises ArgumentError if the polynomials are linearly dependent on the pupil.
    """
    degree = max(n for n, _ in modes.orders)
    triangles, _ = triangles_of(polygons_of(normal_form(pupil).in_plane.elements))
    # The product of two polynomials has twice their degree, and the map to a triangle adds one.
    counts = np.full((len(triangles), 2), degree + 2, np.intp)
    nodes, weights, _ = rule_over_cells(cells_of(triangles), counts)
    table = modes.values(*nodes.T) * np.sqrt(weights / weights.sum())
    upper = np.linalg.qr(table.T, mode="r")
    diagonal = np.diagonal(upper)
    if not (abs(diagonal) > _DEPENDENT * abs(diagonal).max()).all():
        raise ArgumentError(
            f"the pupil determines fewer than {len(diagonal)} polynomials; use lower indices, "
            "or pass the radius of the pupil"
        )
    return np.linalg.inv(upper * np.sign(diagonal)[:, None]).T
