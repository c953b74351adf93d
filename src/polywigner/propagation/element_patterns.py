"""Far fields from tables over angles: interpolation, and fits of aperture fields."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from polywigner.errors import ArgumentError, GeometryError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import (
    check_most,
    checked_choice,
    checked_number,
    checked_wavelength,
    warn_caller,
)
from polywigner.geometry.illumination import Illumination
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.propagation.point_grids import unit_vectors
from polywigner.propagation.vector_fields import far_field_of_currents, from_co_and_cross
from polywigner.radiometry.directions import directions_and_weights
from polywigner.source.obliquities import DEFAULT, DefaultCondition
from polywigner.source.polarisation import MODELS, CurrentModel, checked_polarisation, ludwig_axes
from polywigner.transforms import fourier
from polywigner.transforms.xarray_arguments import arrays_of

if TYPE_CHECKING:
    import xarray


# Allowed rounding error of angles in pattern files [rad].
_EVEN = 1e-6
# Number of samples from which a value on an open meridian is interpolated. The error is 1e-6 for 8
# samples per lobe, and rounding errors grow by less than a factor of 100 (docs/patterns.md).
_STENCIL = 12
# Fraction of the largest field below which backward radiation counts as zero.
_NOTHING = 1e-9
# Number of directions per block.
_ROWS = 4096
# Numbers of angles of the largest table, which has steps of a quarter degree. The table takes 16
# MB, and its interpolation matrices take 0.1 GB.
MOST_THETA, MOST_PHI = 721, 1440
# Number of quadrature nodes in addition to the bandwidth of the field. The error, a Bessel function
# of high order, is then negligible.
_MARGIN = 40


class ElementPattern:
    """Far field of an antenna, interpolated over evenly spaced angles theta and phi.

    The interpolant is a trigonometric polynomial along phi, and along theta if the table covers the
    sphere. Otherwise, the interpolation along theta uses polynomials of degree 11. |E|^2 is in
    W/sr.
    """

    def __init__(self, theta: Floats, phi: Floats, components: tuple[Complex, Complex]) -> None:
        """Prepare the interpolation of E_theta and E_phi, shape (n, m).

        ``theta`` (n,) extends from 0 to pi/2 or pi, and ``phi`` (m,) around the full circle, in
        rad.
        """
        remedy = "use every second or third angle"
        check_most(len(theta), MOST_THETA, "theta angles", remedy)
        check_most(len(phi), MOST_PHI, "phi angles", remedy)
        if len(theta) < 3 or len(phi) < 4:
            raise ArgumentError(
                "expected at least three theta angles, and four phi angles around the full "
                f"circle, got {len(theta)} and {len(phi)}"
            )
        if not covers_front(theta, phi):
            raise ArgumentError(
                "expected evenly spaced theta angles from 0 to 90 or 180 degrees, and phi "
                f"angles around the full circle, got theta from {math.degrees(theta[0]):g} to "
                f"{math.degrees(theta[-1]):g} and phi from {math.degrees(phi[0]):g} to "
                f"{math.degrees(phi[-1]):g} degrees"
            )
        values = np.stack(components)
        if not np.isfinite(values).all():
            raise ArgumentError(
                "expected a pattern of finite far fields, got NaN or infinite values"
            )
        largest = float(np.abs(values).max())
        if not largest > 0:
            raise ArgumentError(
                "the far field of the pattern is zero in all directions; use another pattern"
            )
        behind = theta > math.pi / 2 + _EVEN
        dark = not np.abs(values[:, behind]).max(initial=0.0) > _NOTHING * largest
        self.covers_sphere = bool(behind.any()) and not dark
        if self.covers_sphere and abs(theta[-1] - math.pi) > _EVEN:
            raise ArgumentError(
                "a pattern with backward radiation must extend to theta = 180 degrees, got "
                f"angles up to {math.degrees(theta[-1]):g} degrees; add the missing angles, or "
                "pass the front hemisphere only"
            )
        if not self.covers_sphere:
            theta, values = theta[~behind], values[:, ~behind]
        count = len(phi)
        orders = np.fft.fftfreq(count, 1 / count)
        waves = np.fft.fft(values, axis=2) / count * np.exp(-1j * orders * phi[0])
        # For an even number of samples, the wave of highest order is a cosine, which consists of
        # two waves of opposite order and half the amplitude.
        if count % 2 == 0:
            waves[:, :, count // 2] /= 2
            other = waves[:, :, count // 2, None] * np.exp(-1j * count * phi[0])
            waves, orders = np.concatenate([waves, other], axis=2), np.append(orders, count / 2)
        used = np.abs(waves).max(axis=(0, 1)) > 1e-15 * largest
        self._orders, waves = orders[used], waves[:, :, used]
        # Beyond the pole, at phi + pi, both components change sign.
        beyond = -waves * (-1.0) ** np.abs(self._orders)
        # The angles pi and -pi are the same sample.
        last = len(theta) - 1 if self.covers_sphere else len(theta)
        self._waves = np.concatenate([beyond[:, last - 1 : 0 : -1], waves], axis=1)
        self._step = float(theta[-1]) / (len(theta) - 1)
        self._start = float(theta[-1]) - self._step * (self._waves.shape[1] - 1)

    @property
    def band(self) -> tuple[int, int]:
        """Highest Fourier orders of the field along theta and along phi."""
        return self._waves.shape[1] // 2, int(np.abs(self._orders).max(initial=0))

    def components(self, theta: Floats, phi: Floats) -> Complex:
        """Return E_theta and E_phi over theta (n,) and phi (m,) in rad, shape (2, n, m)."""
        along, around = self._theta_matrix(theta), self._phi_waves(phi)
        return np.asarray(along @ self._waves @ around.T)

    def grid(self, theta: Floats, phi: Floats) -> Complex:
        """Return Cartesian far-field vectors (n, m, 3) over theta (n,) and phi (m,) in rad."""
        return _cartesian(theta[:, None], phi, *self.components(theta, phi))

    def vectors(self, directions: Floats) -> Complex:
        """Return Cartesian far-field vectors (..., 3) in directions (..., 3) (unit vectors).

        The vectors are zero behind the plane if the table covers only the front.
        """
        flat = directions.reshape(-1, 3)
        field = np.empty(flat.shape, np.complex128)
        for rows in index_blocks(len(flat), _ROWS):
            x, y, z = flat[rows].T
            theta, phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
            along, around = self._theta_matrix(theta), self._phi_waves(phi)
            polar, azimuthal = (((along @ part) * around).sum(axis=1) for part in self._waves)
            field[rows] = _cartesian(theta, phi, polar, azimuthal)
        return field.reshape(directions.shape)

    def power(self, lag: float, factor: Callable[[Floats], Complex] | None = None) -> float:
        """Return the radiated power in W of the antenna, or of an array of such antennas.

        ``factor`` returns the array factor in given directions. ``lag`` is 2 pi times the array
        size in wavelengths. Backward radiation is included if the table covers the sphere.
        """
        polar, azimuthal = self.band
        node, weight = np.polynomial.legendre.leggauss(math.ceil(lag / 2) + polar + _MARGIN)
        if not self.covers_sphere:
            node, weight = (node + 1) / 2, weight / 2
        count = math.ceil(lag) + 2 * azimuthal + _MARGIN
        phi = 2 * math.pi * np.arange(count) / count
        total = 0.0
        for rows in index_blocks(len(node), _ROWS // count):
            theta = np.arccos(node[rows])
            squares = np.square(np.abs(self.components(theta, phi))).sum(axis=0)
            if factor is not None:
                squares = squares * np.square(np.abs(factor(unit_vectors(theta, phi))))
            total += float(weight[rows] @ squares.mean(axis=1))
        return 2 * math.pi * total

    def _phi_waves(self, phi: Floats) -> Complex:
        """Return the Fourier waves exp(i m phi) of all orders m, shape (n, orders)."""
        return np.exp(1j * phi[:, None] * self._orders)

    def _theta_matrix(self, theta: Floats) -> Floats:
        """Return the matrix (n, samples) that interpolates a meridian at theta angles in rad."""
        count = self._waves.shape[1]
        if self.covers_sphere:  # Dirichlet kernel
            half = (theta[:, None] - (self._start + self._step * np.arange(count))) / 2
            near = np.abs(np.sin(half)) < 1e-12
            safe = np.where(near, 1.0, half)
            return np.where(near, 1.0, np.sin(count * safe) / (count * np.tan(safe)))
        position = (theta - self._start) / self._step
        width = min(_STENCIL, count)
        first = np.clip(np.floor(position).astype(int) - width // 2 + 1, 0, count - width)
        offset = (position - first)[:, None] - np.arange(width)
        barycentric = np.array([(-1.0) ** k * math.comb(width - 1, k) for k in range(width)])
        exact = np.abs(offset) < 1e-12
        terms = barycentric / np.where(exact, 1.0, offset)
        rows = np.where(exact.any(axis=1)[:, None], exact, terms)
        rows = rows / rows.sum(axis=1, keepdims=True)
        matrix = np.zeros((len(theta), count))
        np.put_along_axis(matrix, first[:, None] + np.arange(width), rows, axis=1)
        return np.where((np.abs(theta) > math.pi / 2 + _EVEN)[:, None], 0.0, matrix)


def _cartesian(theta: Floats, phi: Floats, polar: Complex, azimuthal: Complex) -> Complex:
    """Return vectors (..., 3) with the components E_theta and E_phi at angles in rad.

    All arguments broadcast against each other.
    """
    x, y = polar_components(np.cos(theta) * polar, azimuthal, -phi)
    return np.stack([x, y, -np.sin(theta) * polar], axis=-1)


def covers_front(theta: Floats, phi: Floats) -> bool:
    """Return whether angles theta and phi in rad cover the front hemisphere in equal steps.

    Both angles must ascend. Theta must start at 0, and phi must cover the full circle without a
    repeated angle.
    """
    even = all(np.ptp(np.diff(angles)) < 10 * _EVEN for angles in (theta, phi) if len(angles) > 2)
    around = len(phi) > 1 and abs((phi[1] - phi[0]) * len(phi) - 2 * math.pi) < 1e-4
    spans_front = abs(theta[0]) <= _EVEN and theta[-1] >= math.pi / 2 - _EVEN
    return bool(even and around and spans_front)


def linear_components(pattern: Any, name: str) -> tuple[Floats, Floats, Complex, Complex, Complex]:
    """Return theta, phi, the field along x and y, and the Jones vector of a pattern.

    Angles are in rad. Both components follow Ludwig's third definition and have the shape (n, m)
    over ascending angles. Raises ArgumentError if the object is not the pattern of a polarised
    source.
    """
    axes = {"theta": "theta", "phi": "phi", "field": "theta phi", "cross_field": "theta phi"}
    maker = f"read_pattern or radiation_pattern(polarisation=...) as {name}"
    theta, phi, co, cross, state = arrays_of(pattern, axes, maker, "polarisation")
    order = np.ix_(np.argsort(theta), np.argsort(phi))
    jones = np.asarray(state, np.float64).view(np.complex128)
    x, y = from_co_and_cross(co[order], cross[order], jones)
    return np.sort(theta), np.sort(phi), x, y, jones


def polar_components(x: Complex, y: Complex, phi: Floats) -> tuple[Complex, Complex]:
    """Return E_theta and E_phi from components of Ludwig's third definition at azimuths in rad.

    The components have the shape (n, m), and ``phi`` has the shape (m,).
    """
    sine, cosine = np.sin(phi), np.cos(phi)
    return x * cosine + y * sine, y * cosine - x * sine


def element_pattern_of(pattern: Any, name: str = "element") -> ElementPattern:
    """Return the pattern of a polarised source as an interpolated far field.

    Raises ArgumentError for other datasets, and if the angles do not cover the front hemisphere in
    equal steps.
    """
    theta, phi, x, y, _ = linear_components(pattern, name)
    # The columns phi = 0 and 360 degrees are the same meridian.
    if abs(phi[-1] - phi[0] - 2 * math.pi) < 1e-6:
        phi, x, y = phi[:-1], x[:, :-1], y[:, :-1]
    return ElementPattern(theta, phi, polar_components(x, y, phi))


class FittedPattern(NamedTuple):
    """Aperture field returned by :func:`fit_pattern`, with measures of its quality."""

    aperture: Aperture
    """Aperture with the fitted field."""
    residual: float
    """Relative rms error of the far field: sqrt(power of the error/power of the pattern)."""
    power_ratio: float
    """Integral of |u|^2 over the aperture, divided by the radiated power.

    Values far above 3 indicate superdirectivity.
    """


_POOR = 0.3
# Period of the sum of plane waves, as a multiple of the extent of the outline. A multiple of 2
# would halve the residual, but would require 2.6 times as many waves.
_PERIODS = 1.25
# Largest number of plane waves. An outline 12 wavelengths wide requires this number, and the fit
# takes some seconds.
_MOST_WAVES = 1200


def fit_pattern(
    pattern: xarray.Dataset,
    aperture: Aperture,
    wavelength: float | None = None,
    *,
    polarisation: str | ArrayLike | None = None,
    method: CurrentModel | DefaultCondition = "huygens",
    cut_off: float = 1e-2,
) -> FittedPattern:
    """Fit a field on an aperture to a far-field pattern, by least squares over plane waves.

    The fit minimises the power, over the hemisphere, of the difference between the pattern and the
    far field of the aperture. Singular values below ``cut_off`` are discarded. The spatial
    frequencies of the plane waves form a lattice. The largest frequency is 1/wavelength plus the
    reciprocal of the outline's extent. The sum of the waves has a period of 1.25 times this extent.

    Parameters
    ----------
    pattern : xarray.Dataset
        Result of :func:`read_pattern`, or of :func:`radiation_pattern` with a polarisation. The
        origin of its phase lies in the plane of the aperture. Backward radiation is ignored.
    aperture : Aperture
        Outline of the radiating part without a field, up to some 12 wavelengths wide.
    wavelength : float, default the wavelength of the pattern
        Wavelength in m.
    polarisation : str or array_like, default the polarisation of the co-polar part
        Polarisation of the aperture, as in :func:`polywigner.field`. The orthogonal component of
        the pattern contributes to the residual.
    method : str, default "huygens"
        Equivalent currents "huygens", "magnetic" (an opening in a metal screen) or "electric", for
        use as a polarised source. For use without a polarisation, pass "rayleigh-sommerfeld-1", the
        default method of :func:`amplitude`.
    cut_off : float, default 1e-2
        Smallest singular value that is used, as a fraction of the largest singular value. Smaller
        values of ``cut_off`` give smaller residuals and less smooth fields.

    Returns
    -------
    FittedPattern
        The aperture with its field in the unit of the pattern, the residual, and the power ratio.

    Warns
    -----
    PolywignerWarning
        If the residual is above 0.3, which means that the outline or the method does not suit the
        pattern.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or range, or if the pattern does not contain a wavelength
        or radiation of this polarisation.
    GeometryError
        If the aperture is too wide.

    Examples
    --------
    >>> import numpy as np, polywigner as pw
    >>> square, wavelength = pw.shapes.square(6e-3), 3.9e-3
    >>> angles = np.radians(np.arange(0, 91, 3)), np.radians(np.arange(0, 360, 6))
    >>> horn = square.with_illumination(pw.te_mode(6e-3, 6e-3))
    >>> table = pw.radiation_pattern(horn, wavelength, *angles, polarisation="x")
    >>> fit = pw.fit_pattern(table, square)
    >>> fit.residual < 0.005
    True
    """
    known = element_pattern_of(pattern, "pattern")
    if not isinstance(aperture, Aperture) or aperture.illumination is not None:
        raise ArgumentError(
            f"expected an Aperture without a field, got {aperture!r:.80}; remove its field with "
            "with_illumination(None)"
        )
    length = float(pattern.attrs.get("wavelength", math.nan)) if wavelength is None else wavelength
    if wavelength is None and not math.isfinite(length):
        raise ArgumentError("the pattern does not contain a wavelength; pass wavelength=")
    length = checked_wavelength(length)
    model = checked_choice(method, "method", (*MODELS, DEFAULT))
    jones = linear_components(pattern, "pattern")[-1]
    if polarisation is not None:
        jones = checked_polarisation(polarisation, aperture)
    meaning = "a fraction from 1e-12 to 1"
    least = checked_number(cut_off, "cut_off", meaning, lambda x: 1e-12 <= x < 1)
    waves = _fit_waves(aperture, length)
    blocks = list(directions_and_weights(aperture.diameter, length))
    s, weights = (np.concatenate(column) for column in zip(*blocks, strict=True))
    # Far-field vector of a polarised point source, divided by its scalar far field.
    if model == DEFAULT:
        unit = s[:, 2:] * np.einsum("j,jkn->nk", jones, np.array(ludwig_axes(*s.T)))
    else:
        unit = far_field_of_currents(np.append(jones, 0.0), s, model)
    vectors, strength = known.vectors(s), np.linalg.norm(unit, axis=1)
    along = (unit.conj() * vectors).sum(axis=1) / strength
    total, polarised = (
        float(weights @ np.square(np.abs(v))) for v in (np.linalg.norm(vectors, axis=1), along)
    )
    if not polarised > _NOTHING * total:
        raise ArgumentError(
            "the pattern contains no radiation in the specified polarisation; pass another "
            "polarisation"
        )
    centre = np.reshape(aperture.bounds, (2, 2)).mean(axis=0)
    outline = aperture.moved(-centre)
    rows = strength * np.exp(-2j * math.pi * (s[:, :2] @ centre) / length) / (1j * length)
    columns = fourier(outline, s[:, None, :2] / length - waves) * rows[:, None]
    roots = np.sqrt(weights)
    amplitudes = np.linalg.lstsq(columns * roots[:, None], along * roots, least)[0]
    fitted = columns @ amplitudes
    error = total - polarised + float(weights @ np.square(np.abs(fitted - along)))
    power_ratio = float(
        (amplitudes.conj() @ fourier(outline, waves[:, None] - waves) @ amplitudes).real
    )
    power_ratio /= float(weights @ np.square(np.abs(fitted)))
    field = Illumination(amplitudes * np.exp(-2j * math.pi * (waves @ centre)), waves)
    residual = math.sqrt(max(0.0, error) / total)
    if residual > _POOR:
        warn_caller(
            f"the fit is poor: the residual of the far field is {residual:.2g}; check the "
            "polarisation, the method, the wavelength, and the size and position of the outline"
        )
    return FittedPattern(aperture.with_illumination(field), residual, power_ratio)


def _fit_waves(aperture: Aperture, wavelength: float) -> Floats:
    """Return the spatial frequencies (m, 2) of the plane waves that :func:`fit_pattern` adds up."""
    x0, y0, x1, y1 = aperture.bounds
    extents = np.array([x1 - x0, y1 - y0])
    limits = 1 / wavelength + 1 / extents
    counts = np.floor(_PERIODS * extents * limits)
    remedy = "use an outline up to about 12 wavelengths wide"
    check_most(np.prod(2 * counts + 1), 2 * _MOST_WAVES, "waves in a fit", remedy, GeometryError)
    steps = [np.arange(-n, n + 1) / (_PERIODS * e) for n, e in zip(counts, extents, strict=True)]
    waves = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    return waves[np.hypot(*(waves / limits).T) <= 1 + 1e-9]
