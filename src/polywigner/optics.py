"""First-order optics: systems that act on rays by symplectic matrices."""

from __future__ import annotations

import math
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, value_text
from polywigner.geometry.arguments import (
    Immutable,
    broadcast_shape,
    checked_number,
    checked_vectors,
    finite_array,
)
from polywigner.geometry.illumination import turned_points

Matrix = NDArray[np.float64]

# Largest relative violation of the symplectic conditions; matrices with ten digits are accepted.
_SYMPLECTIC = 1e-9
# Relative rounding error of matrix elements.
_ULP = 2.0**-52
_ONE = np.eye(2)
# Smallest focal length or magnification with a finite inverse.
_LEAST = 2.0**-1023


def check_symplectic(matrix: Matrix) -> None:
    """Raise ArgumentError unless A^T C and B^T D are symmetric and A^T D - C^T B = 1.

    A, B, C and D are the four blocks of the ray matrix (2, 2) or (4, 4). Relative deviations up to
    1e-9 are accepted.
    """
    half = len(matrix) // 2
    a, b = matrix[:half, :half], matrix[:half, half:]
    c, d = matrix[half:, :half], matrix[half:, half:]
    conditions = (
        ("A^T C - C^T A = 0", a.T @ c - c.T @ a, abs(a).T @ abs(c)),
        ("B^T D - D^T B = 0", b.T @ d - d.T @ b, abs(b).T @ abs(d)),
        ("A^T D - C^T B = 1", a.T @ d - c.T @ b - np.eye(half), 1 + abs(a).T @ abs(d)),
    )
    for law, deviation, size in conditions:
        wrong = float(abs(deviation).max())
        if wrong > _SYMPLECTIC * float(size.max()):
            raise ArgumentError(
                f"expected a symplectic ray matrix, but {law} is violated by {wrong:.3g}; use "
                "rays (x, s) with direction cosines s, and matrix elements given to ten digits, "
                "or compose the system from free_space, lens and magnifier"
            )


def checked_pair(value: Any, expected: str) -> Matrix:
    """Return one or two numbers, possibly infinite, as an array (2,).

    Raises ArgumentError for zero, NaN and other values. ``expected``: beginning of the error
    message.
    """
    numbers = checked_vectors(value, expected, ())
    if numbers.shape not in ((), (2,)) or not (np.abs(numbers) >= _LEAST).all():
        raise ArgumentError(f"{expected}, got {value_text(value)}")
    return np.broadcast_to(numbers, 2)


@final
class FirstOrder(Immutable):
    """A first-order optical system, described by its symplectic ray matrix [[A, B], [C, D]].

    A ray with the position x (m) and the direction cosines s = lambda nu leaves the system at the
    position A x + B s, with the direction cosines C x + D s. Systems are composed with ``@``, like
    matrices: the right system acts first. Source: M. J. Bastiaans, J. Opt. Soc. Am. 69, 1710
    (1979).

    Parameters
    ----------
    matrix : array_like, shape (4, 4) or (2, 2)
        Real ray matrix that acts on (x, y, s_x, s_y), or on (x, s) for a rotationally symmetric
        system; A and D are dimensionless, B is in m and C in 1/m.

    Raises
    ------
    ArgumentError
        If the matrix has the wrong shape, is not finite, or is not symplectic.

    Examples
    --------
    >>> import polywigner as pw
    >>> pw.FirstOrder.free_space(0.2) @ pw.FirstOrder.lens(0.2)
    FirstOrder([[0.0, 0.2], [-5.0, 1.0]])
    """

    matrix: Matrix
    """Ray matrix [[A, B], [C, D]], shape (4, 4), read-only."""
    rounding: Matrix
    """Bounds on the rounding errors of the elements, shape (4, 4). In a product, elements within
    their bounds are set to zero, so a system of lenses and distances that forms an image has B = 0.
    """

    def __init__(self, matrix: ArrayLike) -> None:
        expected = "expected a ray matrix of finite real numbers with shape (4, 4) or (2, 2)"
        given = finite_array(matrix, expected, (2, 2), (4, 4))
        check_symplectic(given)
        full = np.asarray(np.kron(given, _ONE), np.float64) if len(given) == 2 else given
        self._set(matrix=full, rounding=_ULP * abs(full))

    @classmethod
    def free_space(cls, z: float) -> FirstOrder:
        """Return the system of free space between two planes.

        Parameters
        ----------
        z : float
            Distance between the planes in m, negative for backward propagation.

        Returns
        -------
        FirstOrder
            System with A = D = 1, B = z, C = 0.

        Raises
        ------
        ArgumentError
            If the distance is not a finite number.

        Examples
        --------
        >>> import polywigner as pw
        >>> pw.FirstOrder.free_space(0.1)
        FirstOrder([[1.0, 0.1], [0.0, 1.0]])
        """
        return cls([[1.0, checked_number(z, "z", "a distance in m")], [0.0, 1.0]])

    @classmethod
    def lens(cls, f: float | tuple[float, float], angle: float = 0.0) -> FirstOrder:
        """Return a thin lens, or a pair of crossed cylindrical lenses.

        Parameters
        ----------
        f : float or tuple of two floats
            Focal length in m, not 0, negative for a diverging lens; or (f_x, f_y), ``inf`` for a
            flat axis.
        angle : float, default 0.0
            Counter-clockwise angle from the x axis to the x axis of the lens, in radians.

        Returns
        -------
        FirstOrder
            System with A = D = 1, B = 0 and C = -1/f along the axes of the lens.

        Raises
        ------
        ArgumentError
            If a focal length is 0 or NaN, or the angle is not finite.

        Examples
        --------
        >>> import polywigner as pw
        >>> pw.FirstOrder.lens((0.5, float("inf"))).C.tolist()
        [[-2.0, 0.0], [0.0, 0.0]]
        """
        expected = "expected f to be a focal length in m other than 0, or a pair (f_x, f_y)"
        powers = -1.0 / checked_pair(f, f"{expected}, with inf for no lens") + 0.0
        axes = turned_points(_ONE, angle)
        if powers[0] == powers[1]:
            return cls([[1.0, 0.0], [powers[0], 1.0]])
        return cls(np.block([[_ONE, 0.0 * _ONE], [axes.T @ np.diag(powers) @ axes, _ONE]]))

    @classmethod
    def magnifier(cls, m: float | tuple[float, float]) -> FirstOrder:
        """Return a system that magnifies the field without a lens phase.

        Parameters
        ----------
        m : float or tuple of two floats
            Magnification, not 0, negative for an inverted image; or (m_x, m_y).

        Returns
        -------
        FirstOrder
            System with A = m, D = 1/m, B = C = 0.

        Raises
        ------
        ArgumentError
            If a magnification is 0 or not finite.

        Examples
        --------
        >>> import polywigner as pw
        >>> pw.FirstOrder.magnifier(-2.0)
        FirstOrder([[-2.0, 0.0], [0.0, -0.5]])
        """
        expected = "expected m to be a magnification other than 0, or a pair (m_x, m_y)"
        scales = checked_pair(m, expected)
        if not np.isfinite(scales).all():
            raise ArgumentError(f"{expected}, got {value_text(m)}")
        zero = 0.0 * _ONE
        return cls(np.block([[np.diag(scales), zero], [zero, np.diag(1.0 / scales)]]))

    @classmethod
    def fourier(cls, f: float) -> FirstOrder:
        """Return a Fourier transformer, which is a lens between its focal planes.

        The field in the back focal plane is F(x/(lambda f))/(i lambda f), without the phase of the
        axial path.

        Parameters
        ----------
        f : float
            Focal length in m, not 0.

        Returns
        -------
        FirstOrder
            System with A = D = 0, B = f, C = -1/f.

        Raises
        ------
        ArgumentError
            If the focal length is 0 or NaN.

        Examples
        --------
        >>> import polywigner as pw
        >>> pw.FirstOrder.fourier(0.5)
        FirstOrder([[0.0, 0.5], [-2.0, 0.0]])
        """
        return cls.fractional(1.0, f)

    @classmethod
    def fractional(cls, order: float, f: float) -> FirstOrder:
        """Return a fractional Fourier transformer.

        The transformer rotates phase space by ``order`` quarter turns. The orders of successive
        systems add up. Order 1 is :meth:`fourier`, order 2 an inverted image, and order 4 the
        identity. Source: A. W. Lohmann, J. Opt. Soc. Am. A 10, 2181 (1993).

        Parameters
        ----------
        order : float
            Number a of quarter turns, the angle a pi/2 between (x, f s) and (x', f s').
        f : float
            Scale in m, not 0: the focal length of the transformer of order 1.

        Returns
        -------
        FirstOrder
            System with A = D = cos(a pi/2), B = f sin(a pi/2), C = -sin(a pi/2)/f.

        Raises
        ------
        ArgumentError
            If the order is not finite, or the scale is 0 or NaN.

        Examples
        --------
        >>> import polywigner as pw
        >>> half = pw.FirstOrder.fractional(0.5, 0.3)
        >>> (half @ half).A.round(15).tolist()
        [[0.0, 0.0], [0.0, 0.0]]
        """
        scale = checked_number(f, "f", "a length in m other than 0", lambda x: abs(x) >= _LEAST)
        quarters = checked_number(order, "order", "a number of quarter turns")
        turned = turned_points(np.array([[1.0, 0.0]]), math.remainder(quarters, 4.0) * math.pi / 2)
        cosine, sine = turned[0].tolist()
        return cls([[cosine, scale * sine], [-sine / scale, cosine]])

    @classmethod
    def rotation(cls, angle: float) -> FirstOrder:
        """Return a counter-clockwise rotation about the optical axis, such as a rotation by prisms.

        Parameters
        ----------
        angle : float
            Angle in radians.

        Returns
        -------
        FirstOrder
            System with A = D = rotation matrix, B = C = 0.

        Raises
        ------
        ArgumentError
            If the angle is not a finite number.

        Examples
        --------
        >>> import math
        >>> import polywigner as pw
        >>> pw.FirstOrder.rotation(math.pi / 2).A.tolist()
        [[0.0, -1.0], [1.0, 0.0]]
        """
        turn = turned_points(_ONE, angle).T + 0.0
        return cls(np.block([[turn, 0.0 * _ONE], [0.0 * _ONE, turn]]))

    @property
    def A(self) -> Matrix:
        """Matrix from input positions to output positions, shape (2, 2), dimensionless."""
        return self.matrix[:2, :2]

    @property
    def B(self) -> Matrix:
        """Matrix from input directions to output positions, shape (2, 2), in m; 0 for imaging."""
        return self.matrix[:2, 2:]

    @property
    def C(self) -> Matrix:
        """Matrix from input positions to output directions, shape (2, 2), in 1/m."""
        return self.matrix[2:, :2]

    @property
    def D(self) -> Matrix:
        """Matrix from input directions to output directions, shape (2, 2), dimensionless."""
        return self.matrix[2:, 2:]

    @property
    def inverse(self) -> FirstOrder:
        """Inverse system [[D^T, -B^T], [-C^T, A^T]]."""
        swap = np.array([2, 3, 0, 1])
        signs = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.ones((2, 2)))
        matrix, rounding = (m.T[swap][:, swap] for m in (self.matrix, self.rounding))
        return FirstOrder._of(matrix=signs * matrix + 0.0, rounding=rounding)

    @property
    def is_symmetric(self) -> bool:
        """Whether the system is rotationally symmetric (blocks proportional to the unit matrix)."""
        blocks = (self.A, self.B, self.C, self.D)
        return all(b[0, 0] == b[1, 1] and not (b[0, 1] or b[1, 0]) for b in blocks)

    def rays(self, x: ArrayLike, s: ArrayLike) -> tuple[Matrix, Matrix]:
        """Return the positions and directions of rays behind the system.

        Parameters
        ----------
        x : array_like, shape (..., 2)
            Positions in m.
        s : array_like, shape (..., 2)
            Direction cosines lambda nu; the shape broadcasts against the shape of ``x``.

        Returns
        -------
        positions : ndarray of float64, shape (..., 2)
            Positions in m behind the system.
        directions : ndarray of float64, shape (..., 2)
            Direction cosines behind the system.

        Raises
        ------
        ArgumentError
            If the arguments are not real numbers of these shapes.

        Examples
        --------
        >>> import polywigner as pw
        >>> x, s = pw.FirstOrder.lens(0.5).rays((0.01, 0.0), (0.0, 0.0))
        >>> s.tolist()
        [-0.02, 0.0]
        """
        both = (
            checked_vectors(x, "expected x of shape (..., 2)", (2,)),
            checked_vectors(s, "expected s of shape (..., 2)", (2,)),
        )
        shape = broadcast_shape(*(part.shape for part in both))
        rays = np.concatenate([np.broadcast_to(a, shape) for a in both], axis=-1) @ self.matrix.T
        return rays[..., :2], rays[..., 2:]

    def __matmul__(self, other: FirstOrder) -> FirstOrder:
        """Return the system that consists of ``other``, followed by this system."""
        if not isinstance(other, FirstOrder):
            return NotImplemented
        product = self.matrix @ other.matrix
        first, second = abs(self.matrix), abs(other.matrix)
        rounding = (self.rounding + _ULP * first) @ second + first @ other.rounding
        product[abs(product) <= rounding] = 0.0
        return FirstOrder._of(matrix=product, rounding=rounding)

    @property
    def _key(self) -> bytes:
        """Bytes of the ray matrix, which are equal for equal systems."""
        return (self.matrix + 0.0).tobytes()

    def __repr__(self) -> str:
        shown = self.matrix[::2, ::2] if self.is_symmetric else self.matrix
        return f"FirstOrder({(shown + 0.0).tolist()})"
