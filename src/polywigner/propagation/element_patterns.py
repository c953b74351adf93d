"""Far fields known at angles: between these, and as the far fields of apertures."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, GeometryError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import (
    checked_choice,
    checked_number,
    checked_wavelength,
    warn_caller,
)
from polywigner.propagation.places import unit_vectors
from polywigner.propagation.vector_fields import of_co_and_cross, of_currents
from polywigner.radiometry.directions import directions_and_weights
from polywigner.source.obliquities import DEFAULT, DefaultCondition
from polywigner.source.polarisation import (
    MODELS,
    CurrentModel,
    checked_polarisation,
    ludwig_axes,
)
from polywigner.source.waves import Illumination
from polywigner.transforms import fourier

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Steps of angles in files are rounded.
_EVEN = 1e-6
# Samples of a meridian that an interpolation takes, where it ends at the horizon: with 8 in a lobe
# it is right to 1e-6 there (docs/patterns.md), and rounding in files grows less than a hundredfold.
_STENCIL = 12
# Behind the plane less than this part of the largest field is nothing.
_NOTHING = 1e-9
# Directions at a time, each with a row of meridian samples and one of azimuth.
_ROWS = 4096
# Angles in steps of a quarter degree: 16 MB, and matrices of some 0.1 GB.
MOST_THETA, MOST_PHI = 721, 1440
# Nodes beyond the band of a quadrature: Bessel functions fall below rounding.
_MARGIN = 40


class ElementPattern:
    """A far field (n, m) over evenly spaced angles as a function of directions.

    Along phi it is a trigonometric polynomial. A meridian goes on over the pole at phi + pi, where
    E_theta and E_phi change their signs: of a whole sphere it is a trigonometric polynomial too,
    exact for band-limited fields; of a hemisphere it is interpolated by polynomials of degree 11.
    """

    def __init__(self, theta: Floats, phi: Floats, components: tuple[Complex, Complex]) -> None:
        """Components E_theta and E_phi (n, m), for theta from 0 to 90 or 180 degrees in rad."""
        if len(theta) > MOST_THETA or len(phi) > MOST_PHI:
            raise ArgumentError(
                f"expected at most {MOST_THETA} angles theta and {MOST_PHI} angles phi, got "
                f"{len(theta)} and {len(phi)}; take every second or third"
            )
        _check_angles(theta, phi)
        values = np.stack(components)
        if not np.isfinite(values).all():
            raise ArgumentError("expected finite far fields, got some that are not")
        largest = float(np.abs(values).max())
        if not largest > 0:
            raise ArgumentError("expected a far field other than zero, got zeros only")
        behind = theta > math.pi / 2 + _EVEN
        dark = not np.abs(values[:, behind]).max(initial=0.0) > _NOTHING * largest
        self.is_whole = bool(behind.any()) and not dark
        if self.is_whole and abs(theta[-1] - math.pi) > _EVEN:
            raise ArgumentError(
                "expected theta to 90 degrees, or to 180 of a field that goes backwards, got "
                f"{math.degrees(theta[-1]):g}"
            )
        if not self.is_whole:
            theta, values = theta[~behind], values[:, ~behind]
        if len(theta) < 3 or len(phi) < 4:
            raise ArgumentError(
                "expected three angles theta in front and four angles phi or more, got "
                f"{len(theta)} and {len(phi)}"
            )
        count = len(phi)
        orders = np.fft.fftfreq(count, 1 / count)
        waves = np.fft.fft(values, axis=2) / count * np.exp(-1j * orders * phi[0])
        if count % 2 == 0:  # the highest wave as a cosine
            waves[:, :, count // 2] /= 2
            # its other half turns the other way about the first angle
            other = waves[:, :, count // 2, None] * np.exp(-1j * count * phi[0])
            waves, orders = np.concatenate([waves, other], axis=2), np.append(orders, count / 2)
        used = np.abs(waves).max(axis=(0, 1)) > 1e-15 * largest
        self._orders, waves = orders[used], waves[:, :, used]
        beyond = -waves * (-1.0) ** np.abs(self._orders)  # at -theta
        last = len(theta) - 1 if self.is_whole else len(theta)  # pi is -pi
        self._waves = np.concatenate([beyond[:, last - 1 : 0 : -1], waves], axis=1)
        self._step = float(theta[-1]) / (len(theta) - 1)
        self._start = float(theta[-1]) - self._step * (self._waves.shape[1] - 1)

    @property
    def band(self) -> tuple[int, int]:
        """Highest wave numbers along theta and along phi."""
        return self._waves.shape[1] // 2, int(np.abs(self._orders).max(initial=0))

    def components(self, theta: Floats, phi: Floats) -> Complex:
        """E_theta and E_phi (2, n, m) over theta (n,) and phi (m,); zero behind a hemisphere."""
        along, around = self._along(theta), self._around(phi)
        return np.asarray(along @ self._waves @ around.T)

    def grid(self, theta: Floats, phi: Floats) -> Complex:
        """The far field (n, m, 3) over theta (n,) and phi (m,)."""
        return _vector(theta[:, None], phi, *self.components(theta, phi))

    def vectors(self, directions: Floats) -> Complex:
        """The far field (..., 3) at unit vectors (..., 3)."""
        flat = directions.reshape(-1, 3)
        found = np.empty(flat.shape, np.complex128)
        for k in range(0, len(flat), _ROWS):
            x, y, z = flat[k : k + _ROWS].T
            theta, phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
            along, around = self._along(theta), self._around(phi)
            polar, azimuthal = (((along @ part) * around).sum(axis=1) for part in self._waves)
            found[k : k + _ROWS] = _vector(theta, phi, polar, azimuthal)
        return found.reshape(directions.shape)

    def power(self, lag: float, factor: Callable[[Floats], Complex] | None = None) -> float:
        """The integral of |E|^2 over all directions, in W, times |factor|^2 of directions (n, 3).

        ``lag``: 2 pi times the largest distance in the array of which the factor is, in
        wavelengths. A Gauss rule in cos(theta), evenly spaced phi.
        """
        polar, azimuthal = self.band
        node, weight = np.polynomial.legendre.leggauss(math.ceil(lag / 2) + polar + _MARGIN)
        if not self.is_whole:
            node, weight = (node + 1) / 2, weight / 2
        count = math.ceil(lag) + 2 * azimuthal + _MARGIN
        phi = 2 * math.pi * np.arange(count) / count
        total, rows = 0.0, max(1, _ROWS // count)
        for k in range(0, len(node), rows):
            theta = np.arccos(node[k : k + rows])
            squares = np.square(np.abs(self.components(theta, phi))).sum(axis=0)
            if factor is not None:
                squares = squares * np.square(np.abs(factor(unit_vectors(theta, phi))))
            total += float(weight[k : k + rows] @ squares.mean(axis=1))
        return 2 * math.pi * total

    def _around(self, phi: Floats) -> Complex:
        return np.exp(1j * phi[:, None] * self._orders)

    def _along(self, theta: Floats) -> Floats:
        """The matrix (n, k) that takes samples of a meridian to theta (n,)."""
        count = self._waves.shape[1]
        if self.is_whole:
            apart = theta[:, None] - (self._start + self._step * np.arange(count))
            return _dirichlet(apart, count)
        place = (theta - self._start) / self._step
        width = min(_STENCIL, count)
        first = np.clip(np.floor(place).astype(int) - width // 2 + 1, 0, count - width)
        apart = (place - first)[:, None] - np.arange(width)
        shares = np.array([(-1.0) ** k * math.comb(width - 1, k) for k in range(width)])
        exact = np.abs(apart) < 1e-12
        terms = shares / np.where(exact, 1.0, apart)
        rows = np.where(exact.any(axis=1)[:, None], exact, terms)
        rows = rows / rows.sum(axis=1, keepdims=True)
        matrix = np.zeros((len(theta), count))
        np.put_along_axis(matrix, first[:, None] + np.arange(width), rows, axis=1)
        return np.where((np.abs(theta) > math.pi / 2 + _EVEN)[:, None], 0.0, matrix)


def _dirichlet(angle: Floats, count: int) -> Floats:
    """The kernel of trigonometric interpolation on an even number of places, at angles from one."""
    half = angle / 2
    near = np.abs(np.sin(half)) < 1e-12
    safe = np.where(near, 1.0, half)
    return np.where(near, 1.0, np.sin(count * safe) / (count * np.tan(safe)))


def _vector(theta: Floats, phi: Floats, polar: Complex, azimuthal: Complex) -> Complex:
    """Vectors (n, 3) of the components along theta and phi."""
    sine, cosine = np.sin(phi), np.cos(phi)
    radial = np.cos(theta) * polar
    return np.stack(
        [
            radial * cosine - azimuthal * sine,
            radial * sine + azimuthal * cosine,
            -np.sin(theta) * polar,
        ],
        axis=-1,
    )


def covers_front(theta: Floats, phi: Floats) -> bool:
    """Whether theta (n,) and phi (m,), in rad, cover the front in even steps."""
    even = all(np.ptp(np.diff(angles)) < 10 * _EVEN for angles in (theta, phi) if len(angles) > 2)
    around = len(phi) > 1 and abs((phi[1] - phi[0]) * len(phi) - 2 * math.pi) < 1e-4
    reach = abs(theta[0]) <= _EVEN and theta[-1] >= math.pi / 2 - _EVEN
    return bool(even and around and reach)


def _check_angles(theta: Floats, phi: Floats) -> None:
    """Raise ArgumentError unless theta (n,) and phi (m,) cover the front in even steps."""
    if not covers_front(theta, phi):
        raise ArgumentError(
            "expected evenly spaced theta from 0 to 90 or 180 degrees, and phi around the full "
            f"circle, got theta from {math.degrees(theta[0]):g} to {math.degrees(theta[-1]):g} and "
            f"phi from {math.degrees(phi[0]):g} to {math.degrees(phi[-1]):g}"
        )


def linear_components(pattern: Any, name: str) -> tuple[Floats, Floats, Complex, Complex, Complex]:
    """Theta (n,) and phi (m,), ascending, fields (n, m) along x and y, and the Jones vector (2,).

    ArgumentError for anything but the dataset of a polarised source.
    """
    try:
        pattern = pattern.sortby(["theta", "phi"]).transpose("theta", "phi")
        theta, phi = (np.asarray(pattern[axis].values, np.float64) for axis in ("theta", "phi"))
        co, cross = (np.asarray(pattern[k].values, complex) for k in ("field", "cross_field"))
        jones = np.asarray(pattern.attrs["polarisation"], np.float64).view(np.complex128)
        if co.shape != (len(theta), len(phi)) or not len(theta) or jones.shape != (2,):
            raise ValueError
    except (TypeError, KeyError, IndexError, AttributeError, ValueError):
        raise ArgumentError(
            f"expected {name} as a pattern with a polarisation over theta and phi, got "
            f"{type(pattern).__name__}; use read_pattern, or radiation_pattern(polarisation=...)"
        ) from None
    return theta, phi, *of_co_and_cross(co, cross, jones), jones


def polar_components(x: Complex, y: Complex, phi: Floats) -> tuple[Complex, Complex]:
    """E_theta and E_phi (n, m) of fields along x and y, by Ludwig's third definition."""
    sine, cosine = np.sin(phi), np.cos(phi)
    return x * cosine + y * sine, y * cosine - x * sine


def element_pattern_of(pattern: Any, name: str = "element") -> ElementPattern:
    """The far field of a dataset of a polarised source; ArgumentError for anything else."""
    theta, phi, x, y, _ = linear_components(pattern, name)
    if abs(phi[-1] - phi[0] - 2 * math.pi) < 1e-6:  # the first meridian twice
        phi, x, y = phi[:-1], x[:, :-1], y[:, :-1]
    return ElementPattern(theta, phi, polar_components(x, y, phi))


class FittedPattern(NamedTuple):
    """The result of :func:`fit_pattern`."""

    aperture: Aperture
    """The outline with the field that was found."""
    residual: float
    """Root of the power of the error of the far field over the power of the pattern in front."""
    stored: float
    """Power int |u|^2 on the aperture over the radiated one: far above 3, it is superdirective."""


# A residual above which the field has little to do with the pattern.
_POOR = 0.3
# Periods of the waves, in extents of the outline: 2 take 2.6 times as many waves for half of the
# residual. As many waves as a fit of some seconds has: an outline of some 12 wavelengths.
_PERIODS = 1.25
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
    """Field on an aperture whose far field comes nearest to a pattern: least squares of waves.

    Minimises the power of the difference over the hemisphere, by a singular value decomposition
    without the values below ``cut_off``. Waves have periods of 1.25 times the outline's extents,
    and frequencies up to a beam's width above 1/wavelength.

    Parameters
    ----------
    pattern : of :func:`read_pattern`, or of :func:`radiation_pattern` with a polarisation. Its
        origin is that of the aperture's plane; what it sends backwards is left out.
    aperture : the outline of the part that radiates, up to some 12 wavelengths; without a field.
    wavelength : in m; None: the pattern's own.
    polarisation : of the aperture, as of :func:`polywigner.field`; None: the one that the pattern's
        co-polar part refers to. What the pattern has besides counts in the residual.
    method : how the aperture radiates: "huygens", "magnetic" (an opening in a metal screen) or
        "electric", as of polarised sources everywhere; or, for scalar fields and links without a
        polarisation, the default method of :func:`amplitude`.
    cut_off : fraction of the largest singular value. A smaller one follows the pattern closer, by
        fields that are less smooth.

    Returns
    -------
    FittedPattern : (aperture, residual, stored), the aperture with its field in the pattern's unit.

    Warns
    -----
    PolywignerWarning where the residual is above 0.3: the outline, or how it radiates, is another.

    Raises
    ------
    ArgumentError for other arguments, a pattern without a wavelength, and one that sends nothing of
    this polarisation; GeometryError for apertures of too many wavelengths.

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
            f"expected an Aperture without a field, got {aperture!r:.80}; take a field off by "
            "with_illumination(None)"
        )
    length = float(pattern.attrs.get("wavelength", math.nan)) if wavelength is None else wavelength
    if wavelength is None and not math.isfinite(length):
        raise ArgumentError("expected a wavelength, since the pattern has none, got None; give it")
    length = checked_wavelength(length)
    model = checked_choice(method, "method", (*MODELS, DEFAULT))
    jones = linear_components(pattern, "pattern")[-1]
    if polarisation is not None:
        jones = checked_polarisation(polarisation, aperture)
    least = checked_number(cut_off, "cut_off", "a fraction from 1e-12 to 1")
    if not 1e-12 <= least < 1:
        raise ArgumentError(f"expected cut_off from 1e-12 up to below 1, got {cut_off!r}")
    waves = _waves_on(aperture, length)
    blocks = list(directions_and_weights(aperture.diameter, length))
    s, weights = (np.concatenate(column) for column in zip(*blocks, strict=True))
    wanted, unit = known.vectors(s), _unit_far_fields(jones, s, model)
    strength = np.linalg.norm(unit, axis=1)
    along = (unit.conj() * wanted).sum(axis=1) / strength
    size, there = (
        float(weights @ np.square(np.abs(v))) for v in (np.linalg.norm(wanted, axis=1), along)
    )
    if not there > _NOTHING * size:
        raise ArgumentError("expected a pattern of the aperture's polarisation, got none of it")
    centre = np.reshape(aperture.bounds, (2, 2)).mean(axis=0)
    outline = aperture.moved(-centre)
    rows = strength * np.exp(-2j * math.pi * (s[:, :2] @ centre) / length) / (1j * length)
    columns = fourier(outline, s[:, None, :2] / length - waves) * rows[:, None]
    roots = np.sqrt(weights)
    found = np.linalg.lstsq(columns * roots[:, None], along * roots, least)[0]
    sent = columns @ found
    left = size - there + float(weights @ np.square(np.abs(sent - along)))
    stored = float((found.conj() @ fourier(outline, waves[:, None] - waves) @ found).real)
    stored /= float(weights @ np.square(np.abs(sent)))
    field = Illumination(found * np.exp(-2j * math.pi * (waves @ centre)), waves)
    residual = math.sqrt(max(0.0, left) / size)
    if residual > _POOR:
        warn_caller(
            f"got a field whose far field differs from the pattern by {residual:.2g} of it: check "
            "polarisation, method, wavelength, and the outline's size and place"
        )
    return FittedPattern(aperture.with_illumination(field), residual, stored)


def _unit_far_fields(jones: Complex, s: Floats, model: str) -> Complex:
    """Far fields (n, 3) of a point with a Jones vector (2,), over its scalar F/(i lambda)."""
    if model == DEFAULT:
        return s[:, 2:] * np.einsum("j,jkn->nk", jones, np.array(ludwig_axes(*s.T)))
    return of_currents(np.append(jones, 0.0), s, model)


def _waves_on(aperture: Aperture, wavelength: float) -> Floats:
    """Frequencies (m, 2) of periods in extents, up to a beam's width above 1/wavelength."""
    x0, y0, x1, y1 = aperture.bounds
    extents = np.array([x1 - x0, y1 - y0])
    limits = 1 / wavelength + 1 / extents
    counts = np.floor(_PERIODS * extents * limits)
    if np.prod(2 * counts + 1) > 2 * _MOST_WAVES:
        raise GeometryError(
            "expected an aperture of at most some 12 wavelengths, got "
            f"{extents[0] / wavelength:.3g} by {extents[1] / wavelength:.3g}; take a smaller one"
        )
    steps = [np.arange(-n, n + 1) / (_PERIODS * e) for n, e in zip(counts, extents, strict=True)]
    waves = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    return waves[np.hypot(*(waves / limits).T) <= 1 + 1e-9]
