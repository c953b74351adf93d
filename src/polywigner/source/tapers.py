"""Fields of antennas and pupils: steering, tapers, waveguide modes, and fits to field samples.

All fields are sums of plane waves. Tapers and modes are exact inside a rectangle (or interval)
around the origin, and periodic outside it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, IlluminationError, value_text
from polywigner.geometry.arguments import (
    check_most,
    checked_choice,
    checked_count,
    checked_length,
    checked_number,
    complex_array,
    finite_array,
    real_array,
    takes_frequency,
)
from polywigner.geometry.illumination import Illumination
from polywigner.numerics import Complex, Floats

# Largest deviation of the length of a unit vector from 1, for float32 vectors.
_UNIT = 1e-6

_ADVICE = "divide the vector by its length"


def checked_unit_vectors(name: str, vectors: Any, *shape: Any) -> Floats:
    """Return unit vectors (..., 3); raise ArgumentError if a length differs from 1 by over 1e-6.

    The vectors are not normalised. ``name``: name of the argument in the error message. ``shape``:
    (3,) for one vector.
    """
    shape_text = "(3,)" if shape else "(..., 3)"
    expected = f"expected {name} to be unit vectors of shape {shape_text}"
    array = real_array(vectors, expected, shape or (..., 3))
    length = np.linalg.norm(array, axis=-1)
    wrong = ~(np.abs(length - 1) <= _UNIT)
    if wrong.any():
        raise ArgumentError(
            f"{expected}, got {array[wrong][0].tolist()} of length {length[wrong][0]:.6g}; "
            f"{_ADVICE}"
        )
    return array


def unit_vector(direction: Any) -> Floats:
    """Return a unit vector (3,) with z >= 0; raise ArgumentError for other vectors.

    Lengths may differ from 1 by 1e-6; the vector is not normalised.
    """
    vector = checked_unit_vectors("direction", direction, 3)
    if vector[2] < 0:
        raise ArgumentError(
            "expected a direction in front of the aperture, with a z component of at least "
            f"0, got {value_text(direction)}"
        )
    return vector


def direction_of(theta: float, phi: float = 0.0) -> Floats:
    """Return the unit vector at the polar angle theta and the azimuth phi, in radians.

    Raises ArgumentError for directions behind the aperture, |theta| > pi/2.
    """
    sine = math.sin(theta)
    return unit_vector([sine * math.cos(phi), sine * math.sin(phi), math.cos(theta)])


def transverse(direction: Any) -> Floats:
    """Return the components of a direction along the aperture, shape (2,), or (1,) for slits.

    The direction is given as a unit vector (3,), as its components along the aperture (2,), or as
    the sine of an angle. Raises ArgumentError for other values, and for vectors behind the
    aperture.
    """
    expected = (
        "expected a direction as a unit vector of shape (3,), its components (2,) along the "
        "aperture, or the sine of an angle for slits"
    )
    components = np.atleast_1d(finite_array(direction, expected, (), (1,), (2,), (3,)))
    if components.shape == (3,):
        return unit_vector(components)[:2]
    length = math.hypot(*components)
    if length > 1 + _UNIT:
        raise ArgumentError(
            "expected the components of a unit vector along the aperture, got components "
            f"with norm {length:.6g} > 1; {_ADVICE}"
        )
    return components


# Highest power of a cosine taper with exact binomial coefficients.
_HIGHEST_POWER = 32
# Highest TE mode index and n-bar, far beyond real designs.
_HIGHEST_MODE = 1000
_HIGHEST_NBAR = 100
# Largest sidelobe suppression [dB]; rounding errors of a field are at -300 dB.
_LARGEST_SUPPRESSION = 200.0

_Waves = tuple[NDArray[Any], NDArray[Any]]
"""Amplitudes (m,), complex or real, and frequencies (m,) in cycles per metre along one axis."""


def uniform(dimension: int = 2) -> Illumination:
    """Return the field 1, a plane wave of frequency 0.

    Parameters
    ----------
    dimension : int, default 2
        2, or 1 for slits.

    Returns
    -------
    Illumination
        The field.

    Examples
    --------
    >>> import polywigner as pw
    >>> float(pw.uniform()((0.0, 0.0)).real)
    1.0
    """
    return Illumination([1.0], np.zeros((1, checked_count(dimension, "dimension", 1, 2))))


@takes_frequency
def steering(direction: ArrayLike, wavelength: float) -> Illumination:
    """Return the phase that steers a beam: u(x) = exp(2 pi i s.x/wavelength).

    The vector s consists of the components of the direction along the aperture. The Fourier
    transform of the aperture with this field peaks at nu = s/wavelength.

    Parameters
    ----------
    direction : array_like, shape (3,) or (2,)
        Unit vector with a positive z, of length 1 within 1e-6, or its components along the
        aperture, or the sine of the angle for slits.
    wavelength : float
        Wavelength in m.

    Returns
    -------
    Illumination
        The field.

    Raises
    ------
    ArgumentError
        If the vector is not a unit vector or points behind the aperture, the components are longer
        than 1, or the wavelength is not above zero.

    Examples
    --------
    >>> import polywigner as pw
    >>> beam = pw.steering((0.5, 0.0, 3**0.5 / 2), 10e-3)
    >>> beam.frequencies.tolist()
    [[50.0, 0.0]]
    """
    return Illumination(
        [1.0], transverse(direction)[None, :] / checked_length(wavelength, "wavelength")
    )


def cosine_taper(
    width: float | None, height: float | None = None, power: int = 1, dimension: int = 2
) -> Illumination:
    """Return the taper u(x, y) = cos(pi x/width)^power cos(pi y/height)^power.

    The taper is 1 at the centre and 0 at the edges, and has power + 1 waves for each axis.

    Parameters
    ----------
    width, height : float or None
        Lengths in m; None: no taper along this axis.
    power : int, default 1
        1 for a cosine, 2 for a squared cosine, up to 32.
    dimension : int, default 2
        2, or 1 for slits, whose taper has only a width.

    Returns
    -------
    Illumination
        The field.

    Raises
    ------
    ArgumentError
        If a length is not above zero, both are None, the power is out of range, or slits have a
        height.

    Examples
    --------
    >>> import polywigner as pw
    >>> taper = pw.cosine_taper(10e-3, 10e-3)
    >>> [round(float(abs(taper(x))), 12) for x in [(0.0, 0.0), (5e-3, 0.0)]]
    [1.0, 0.0]
    """
    exponent = checked_count(power, "power", 1, _HIGHEST_POWER)
    amplitudes = np.array([math.comb(exponent, k) for k in range(exponent + 1)]) / 2.0**exponent
    orders = np.arange(exponent + 1) - exponent / 2
    return _taper_along_axes(width, height, dimension, lambda size: (amplitudes, orders / size))


def te_mode(
    width: float, height: float, m: int = 1, n: int = 0, component: str = "y"
) -> Illumination:
    """Return a transverse electric field of the mode TE_mn of a rectangular waveguide.

    With x' = x + width/2 and y' = y + height/2, from a corner of the guide, and a peak of 1,

        E_y = sin(m pi x'/width) cos(n pi y'/height)
        E_x = cos(m pi x'/width) sin(n pi y'/height)

    E_y of TE10 is cos(pi x/width). The vector field is (-n/height E_x, m/width E_y) times a common
    factor. Kirchhoff and Rayleigh-Sommerfeld II use the normal derivatives of plane waves in free
    space, not the normal derivative of the mode in the guide.

    Parameters
    ----------
    width, height : float
        Inner dimensions of the guide along x and y in m.
    m, n : int
        Numbers of half periods along x and y, from 0, not both 0; default: TE10.
    component : {"y", "x"}, default "y"
        "y" requires m >= 1, and "x" requires n >= 1.

    Returns
    -------
    Illumination
        The field.

    Raises
    ------
    ArgumentError
        If a length is not above zero, a number is out of range, or the mode lacks the component.

    Examples
    --------
    >>> import polywigner as pw
    >>> mode = pw.te_mode(10e-3, 5e-3)
    >>> round(float(abs(mode((5e-3, 0.0)))), 12)  # zero at the wall
    0.0
    """
    a, b = checked_length(width, "width"), checked_length(height, "height")
    along_x = checked_count(m, "m", 0, _HIGHEST_MODE)
    along_y = checked_count(n, "n", 0, _HIGHEST_MODE)
    checked_choice(component, "component", ("x", "y"))
    number, axis = (along_x, "m") if component == "y" else (along_y, "n")
    if number == 0:
        raise ArgumentError(
            f"expected {axis} of at least 1, got 0; the field of TE_{m}{n} has no {component} "
            "component"
        )
    return _product_of_waves(
        _half_periods(along_x, a, sine=component == "y"),
        _half_periods(along_y, b, sine=component == "x"),
    )


def taylor_taper(
    width: float | None,
    height: float | None = None,
    sll: float = 30.0,
    nbar: int = 4,
    dimension: int = 2,
) -> Illumination:
    """Return Taylor's n-bar taper of a line source, along x and y, with sidelobes at -sll dB.

    Along each axis u = [1 + 2 sum_{m < nbar} F_m cos(2 pi m x/width)]/u_0, with u(0) = 1 and, with
    A = arccosh(10^(sll/20))/pi and s^2 = nbar^2/(A^2 + (nbar - 1/2)^2),

        F_m = (-1)^(m+1)/2 prod_{i < nbar} [1 - m^2/(s^2 (A^2 + (i - 1/2)^2))]
                         / prod_{i < nbar, i != m} [1 - m^2/i^2]

    The taper consists of 2 nbar - 1 waves for each axis. The zeros of the transform are at |nu|
    width = s sqrt(A^2 + (i - 1/2)^2) for i < nbar, then at nbar, nbar + 1, ... The level of the
    first sidelobe is -sll dB, or up to 0.7 dB lower. All other sidelobes are lower, and fall as
    1/|nu| for |nu| width above nbar.

    Parameters
    ----------
    width, height : float or None
        Lengths in m; None: no taper along this axis.
    sll : float, default 30
        Sidelobe suppression in dB, above 0 and up to 200: 30 for sidelobes at -30 dB.
    nbar : int, default 4
        Number of shifted zeros plus one, up to 100. Taylor recommends at least 2 A^2 + 1/2 (4 for
        30 dB, 7 for 40 dB); smaller values may raise the sidelobes.
    dimension : int, default 2
        2, or 1 for slits, whose taper has only a width.

    Returns
    -------
    Illumination
        The field.

    Raises
    ------
    ArgumentError
        If a length is not above zero, both are None, sll or nbar is out of range, or slits have a
        height.

    References
    ----------
    T. T. Taylor, IRE Trans. Antennas Propag. AP-3 (1955) 16-28.

    Examples
    --------
    >>> import polywigner as pw
    >>> taper = pw.taylor_taper(10e-3, sll=25.0)
    >>> bool(abs(taper((0.0, 0.0))) > abs(taper((4e-3, 0.0))))
    True
    """
    decibels, zeros = checked_sidelobes(sll, nbar)
    half = _taylor_coefficients(decibels, zeros)
    amplitudes = np.concatenate([half[::-1], [1.0], half])
    amplitudes /= amplitudes.sum()
    orders = np.arange(1 - zeros, zeros)
    return _taper_along_axes(width, height, dimension, lambda size: (amplitudes, orders / size))


def checked_sidelobes(sll: Any, nbar: Any) -> tuple[float, int]:
    """Return sidelobe suppression in dB and n-bar; raise ArgumentError for values out of range."""
    meaning = (
        f"a number of dB above 0 and up to {_LARGEST_SUPPRESSION:g}, such as 30 for sidelobes at "
        "-30 dB"
    )
    decibels = checked_number(sll, "sll", meaning, lambda x: 0 < x <= _LARGEST_SUPPRESSION)
    return decibels, checked_count(nbar, "nbar", 1, _HIGHEST_NBAR)


def _taper_along_axes(
    width: float | None, height: float | None, dimension: int, taper: Callable[[float], _Waves]
) -> Illumination:
    """Return the product of tapers along x and y. ``taper`` returns the waves for a length in m."""
    if checked_count(dimension, "dimension", 1, 2) == 1 and height is not None:
        raise ArgumentError(
            f"expected height=None for a taper of slits (dimension=1), got {value_text(height)}"
        )
    if width is None and (height is None or dimension == 1):
        raise ArgumentError("expected a width for the taper, got None")
    sizes = {"width": width, "height": height}.items()
    with np.errstate(over="ignore"):
        along = [
            _CONSTANT if size is None else taper(checked_length(size, name)) for name, size in sizes
        ]
    return Illumination(*along[0]) if dimension == 1 else _product_of_waves(*along)


_CONSTANT: _Waves = (np.ones(1), np.zeros(1))


def _product_of_waves(along_x: _Waves, along_y: _Waves) -> Illumination:
    """Return the product of a sum of waves along x and a sum of waves along y as a field."""
    amplitudes = np.multiply.outer(along_x[0], along_y[0])
    frequencies = np.stack(np.meshgrid(along_x[1], along_y[1], indexing="ij"), axis=-1)
    return Illumination(amplitudes.ravel(), frequencies.reshape(-1, 2))


def _half_periods(number: int, size: float, sine: bool) -> _Waves:
    """Return the cosine or the sine of ``number pi (x/size + 1/2)`` as waves along x.

    The argument ``sine`` selects the sine. For the number 0, the result is the constant 1.
    """
    if number == 0:
        return _CONSTANT
    phase = complex((1, 1j, -1, -1j)[number % 4])
    forward, backward = phase / 2, phase.conjugate() / 2
    amplitudes = [-1j * forward, 1j * backward] if sine else [forward, backward]
    return np.array(amplitudes), np.array([number, -number]) / (2 * size)


def _taylor_coefficients(decibels: float, nbar: int) -> Floats:
    """Return the coefficients F_1 to F_(nbar - 1) of :func:`taylor_taper`."""
    # A = arccosh(10^(sll/20))/pi is computed in a form without cancellation for small sll.
    excess = math.expm1(decibels / 20 * math.log(10))
    a = math.log1p(excess + math.sqrt(excess * (2 + excess))) / math.pi
    stretch = nbar**2 / (a**2 + (nbar - 0.5) ** 2)
    i = np.arange(1, nbar)
    m = i[:, None]
    above = 1 - m**2 / (stretch * (a**2 + (i - 0.5) ** 2))
    below = np.where(m == i, 1.0, 1 - m**2 / np.where(m == i, 1, i) ** 2)
    return -((-1.0) ** i) / 2 * np.prod(above / below, axis=1)


# Smallest singular value used in a fit, relative to the largest; smaller values cause large
# amplitudes that cancel.
_CUT_OFF = 1e-6

# Default period of fitted waves, in units of the sampled extent; waves with a period of twice the
# extent can also fit fields that are not periodic.
_PERIODS = 2

_MOST_WAVES = 4096


class FittedIllumination(NamedTuple):
    """The result of :func:`fit_illumination`."""

    illumination: Illumination
    residual: float
    """Relative rms error, sqrt(sum |u - values|^2 / sum |values|^2) over the samples."""
    rank: int
    """Number of linear combinations of waves that the samples determine."""
    cancellation: float
    """Ratio of sum |c_m| to the rms value of the samples. Errors of transforms grow by this factor,
    and errors of W and A grow by its square. Values of 1 to 10 are harmless."""


def fit_illumination(
    points: ArrayLike,
    values: ArrayLike,
    frequencies: ArrayLike | None = None,
    *,
    order: int = 4,
    cut_off: float = _CUT_OFF,
) -> FittedIllumination:
    """Fit plane waves of fixed frequencies to a sampled field by least squares.

    The sum of |u(x_j) - values_j|^2 is minimised by a singular value decomposition that ignores
    singular values below `cut_off`. The memory use is 16 bytes times the number of samples times
    the number of waves.

    Samples in the plane do not determine the normal derivative of the field, which Kirchhoff and
    Rayleigh-Sommerfeld II use. These conditions use the derivative of the fitted waves, which
    depends on the evanescent waves (|kappa| > 1/wavelength) of the fit. Two fits of the same field
    on a square with sides of one wavelength, with residuals below 1e-9, differed by 0.12 dB with
    Rayleigh-Sommerfeld II, and by 1e-4 dB with Rayleigh-Sommerfeld I. Use Rayleigh-Sommerfeld I, or
    fit only frequencies below 1/wavelength.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        Positions in m, of shape (n, 1) or (n,) for slits. The positions need not form a grid. The
        fit is meaningless outside their bounds, so sample up to the edges of the aperture.
    values : array_like, shape (n,)
        Complex field at these points.
    frequencies : array_like, shape (m, d), optional
        Frequencies in cycles per metre; default: waves whose period is twice the extent of the
        points, -order..order periods along each axis.
    order : int, default 4
        Largest number of periods, reduced if there are few samples. A phase of q cycles over the
        aperture requires an order of about 2 q + 4.
    cut_off : float, default 1e-6
        Smallest singular value used, as a fraction of the largest one, from 1e-15 up to below 1;
        use larger values for noisy samples.

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
    positions, field = _checked_samples(points, values)
    meaning = "a fraction of at least 1e-15 and below 1"
    least = checked_number(cut_off, "cut_off", meaning, lambda x: 1e-15 <= x < 1)
    low, high = positions.min(axis=0), positions.max(axis=0)
    centre = low / 2 + high / 2
    if frequencies is None:
        kappa = _default_frequencies(high - low, checked_count(order, "order", 0), len(positions))
    else:
        kappa = _distinct_frequencies(frequencies, positions.shape[1])
    check_most(len(kappa), _MOST_WAVES, "waves", "pass fewer frequencies, or a lower order")
    waves = np.exp(2j * np.pi * ((positions - centre) @ kappa.T))
    amplitudes, _, rank, _ = np.linalg.lstsq(waves, field, rcond=least)
    size = float(np.linalg.norm(field))
    residual = float(np.linalg.norm(waves @ amplitudes - field)) / size
    cancellation = float(np.abs(amplitudes).sum()) / (size / np.sqrt(len(field)))
    fitted = Illumination(amplitudes, kappa).moved(centre)
    return FittedIllumination(fitted, residual, int(rank), cancellation)


def _checked_samples(points: Any, values: Any) -> tuple[Floats, Complex]:
    """Return the positions (n, d) and complex values (n,) of a sampled field as arrays."""
    expected = "expected points of shape (n, 2), or (n, 1) for slits"
    positions = finite_array(points, expected, (None,), (None, 1), (None, 2)).reshape(
        len(points), -1
    )
    expected = f"expected a finite complex number for each of {len(positions)} points"
    field = complex_array(values, expected, (len(positions),))
    if not field.any():
        raise IlluminationError("expected nonzero values, got only zeros")
    return positions, field


def _distinct_frequencies(frequencies: Any, dimension: int) -> Floats:
    """Return frequencies (m, dimension) without duplicates, or raise IlluminationError."""
    count = len(frequencies) if hasattr(frequencies, "__len__") else 1
    kappa = Illumination(np.ones(count), frequencies).frequencies
    if kappa.shape[1] != dimension:
        raise IlluminationError(
            f"expected frequencies with {dimension} components, got {kappa.shape[1]} components"
        )
    return kappa


def _default_frequencies(extent: Floats, order: int, samples: int) -> Floats:
    """Return the frequencies (m, d) of waves that are periodic over twice the sampled extent (d,).

    ``order`` is the largest number of periods, which is reduced if there are few samples.
    """
    axes = int(np.count_nonzero(extent))
    highest = order
    while highest and (2 * highest + 1) ** axes > samples:
        highest -= 1
    steps = np.arange(-highest, highest + 1)
    along = [steps / (_PERIODS * size) if size else np.zeros(1) for size in extent]
    return np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, len(extent))
