"""Patterns of arrays whose elements have random errors, and two-way patterns of radars."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from polywigner.errors import ArgumentError
from polywigner.execution.progress import with_progress
from polywigner.geometry.arguments import (
    checked_count,
    checked_generator,
    checked_number,
    checked_type,
    checked_wavelength,
    takes_frequency,
)
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.propagation.far_field_tables import FLOOR
from polywigner.propagation.far_fields import far_field, powers_of
from polywigner.propagation.patterns import decibels, described, radiation_pattern
from polywigner.propagation.point_grids import angle_axes, checked_theta_and_phi, unit_vectors
from polywigner.radiometry.directions import PlaneSource, checked_source
from polywigner.source import Array
from polywigner.source.obliquities import ObliquityName, obliquity_of

if TYPE_CHECKING:
    import xarray


# Number of complex numbers per block, which take 64 MiB.
_BLOCK = 2**22
# Upper limit of each error, and the description of its range in error messages.
_ERRORS = {
    "amplitude": (40.0, "an rms error from 0 to 40 dB"),
    "phase": (2 * math.pi, "an rms error from 0 to 2 pi rad"),
    "position": (math.inf, "an rms error of zero or more, in m"),
    "dead": (math.nextafter(1.0, 0.0), "a fraction from 0 to below 1"),
}
# Number of decibels per neper.
_NEPER = 20 / math.log(10)


@takes_frequency
def array_tolerance(
    array: Array,
    wavelength: float,
    theta: ArrayLike,
    phi: ArrayLike,
    *,
    amplitude: float = 0.0,
    phase: float = 0.0,
    dead: float = 0.0,
    position: float = 0.0,
    count: int = 200,
    seed: int | np.random.Generator = 0,
    obliquity: ObliquityName | None = None,
) -> xarray.Dataset:
    """Compute the mean and quantiles of an array's pattern for random errors of its elements.

    The weight w_k of element k is multiplied by an independent random factor
    ``f_k = d_k 10^(a_k/20) exp(i p_k - 2 pi i s.x_k/wavelength)``, where s is the direction of
    radiation. The errors a_k of the amplitude in dB, p_k of the phase and x_k of the position are
    normally distributed. The factor d_k is 0 for dead elements and 1 otherwise.

    The mean intensity is ``<|E|^2> = |m|^2 |E_0|^2 + v sum_k |w_k E_k|^2`` (RP4). Here E_0 is the
    far field without errors, and E_k is the far field of element k. The random factors have the
    mean m = <f_k> and the variance v = <|f_k|^2> - |m|^2.

    Parameters
    ----------
    array : Array
        Array of apertures in the plane z = 0, with any fields.
    wavelength : float
        Wavelength in m.
    theta, phi : array_like, shapes (n,) and (m,)
        Angles in rad, as in :func:`radiation_pattern`.
    amplitude : float, default 0
        Rms error of the amplitudes in dB.
    phase : float, default 0
        Rms error of the phases in rad.
    dead : float, default 0
        Probability, below 1, that an element does not radiate.
    position : float, default 0
        Rms error of the positions in m, along each of x, y and z.
    count : int, default 200
        Number of samples, 2 or more.
    seed : int or numpy.random.Generator, default 0
        Seed of NumPy's default generator, or a generator.
    obliquity : str, optional
        As in :func:`radiation_pattern`.

    Returns
    -------
    xarray.Dataset
        Levels 4 pi |E|^2/P in dBi over theta and phi, at least -300 dBi, where P is the radiated
        power without errors. ``nominal`` is the pattern without errors and ``expected`` is the
        mean (RP4). ``mean``, ``low`` and ``high`` are the mean, the 5 % quantile and the 95 %
        quantile of the samples. The attributes contain the errors, the count, and ``peak_loss``,
        the nominal minus the expected level in dB at the peak of the nominal pattern.

    Raises
    ------
    ArgumentError
        If ``array`` is not an Array, if an error is out of range, or if all errors are zero. See
        also :func:`radiation_pattern`.

    Notes
    -----
    The computing time is proportional to the number of directions times the number of elements
    times ``count``.

    References
    ----------
    J. Ruze, Nuovo Cimento 9, Suppl. (1952) 364-380.

    Examples
    --------
    >>> import polywigner as pw
    >>> positions = pw.arrays.grid_positions(8, 8, 2e-3)
    >>> array = pw.phased_array(pw.shapes.square(1.9e-3), positions)
    >>> tolerance = pw.array_tolerance(array, 3.9e-3, 0.0, 0.0, phase=0.2)
    >>> round(tolerance.attrs["peak_loss"], 3)  # dB
    0.171
    """
    checked_type(array, "an Array of apertures", Array, advice="create an Array with phased_array")
    source, length = checked_source(array), checked_wavelength(wavelength)
    assert isinstance(source, Array)
    errors = _checked_errors(amplitude=amplitude, phase=phase, position=position, dead=dead)
    number = checked_count(count, "count", 2)
    random = checked_generator(seed)
    polar, azimuth = checked_theta_and_phi(theta, phi)
    condition = obliquity_of(obliquity)
    name = condition.name
    power, _ = powers_of(source, length, name)
    directions = unit_vectors(polar, azimuth)
    factors, shifts = _draw(errors, (len(source), number), random)
    levels = _statistics(source, directions.reshape(-1, 3), length, name, errors, factors, shifts)
    directivities = {
        key: np.maximum(decibels(value, power), FLOOR).reshape(directions.shape[:2])
        for key, value in levels.items()
    }
    peak = np.unravel_index(directivities["nominal"].argmax(), directions.shape[:2])
    about = {
        "wavelength": length,
        "obliquity": name,
        **errors,
        "count": number,
        "peak_loss": float(directivities["nominal"][peak] - directivities["expected"][peak]),
    }
    return described(source, angle_axes(theta=polar, phi=azimuth), directivities, about)


def _checked_errors(**errors: float) -> dict[str, float]:
    """Return the error parameters of array_tolerance; raise ArgumentError for invalid values."""
    for name, (most, meaning) in _ERRORS.items():
        errors[name] = checked_number(errors[name], name, meaning)
        if not 0 <= errors[name] <= most:
            raise ArgumentError(f"expected {name} to be {meaning}, got {errors[name]:g}")
    if not any(errors.values()):
        raise ArgumentError(
            "expected at least one of amplitude, phase, dead and position to be above zero, got "
            "zero for all of them"
        )
    return errors


def _mean_and_variance(errors: dict[str, float], wavelength: float) -> tuple[float, float]:
    """Return the squared mean |m|^2 and the variance v of the random factors in (RP4)."""
    spread = (errors["amplitude"] / _NEPER) ** 2
    phase = errors["phase"] ** 2 + (2 * math.pi * errors["position"] / wavelength) ** 2
    alive = 1 - errors["dead"]
    square = alive**2 * math.exp(spread - phase)
    # This form avoids cancellation in exp(2 spread) - alive exp(spread - phase).
    variance = math.exp(2 * spread) * (errors["dead"] - alive * math.expm1(-spread - phase))
    return square, alive * variance


def _draw(
    errors: dict[str, float], shape: tuple[int, int], random: np.random.Generator
) -> tuple[Complex, Floats | None]:
    """Draw random factors of an array's weights, and shifts of its elements in m.

    ``shape`` contains the numbers of elements and samples. The shifts have the shape (elements,
    samples, 3), or are None if the positions have no errors.
    """
    logarithms = errors["amplitude"] / _NEPER * random.standard_normal(shape)
    phases = errors["phase"] * random.standard_normal(shape)
    alive = random.random(shape) >= errors["dead"]
    factors = np.where(alive, np.exp(logarithms + 1j * phases), 0)
    if not errors["position"]:
        return factors, None
    return factors, errors["position"] * random.standard_normal((*shape, 3))


def _statistics(
    source: Array,
    directions: Floats,
    wavelength: float,
    obliquity: str,
    errors: dict[str, float],
    factors: Complex,
    shifts: Floats | None,
) -> dict[str, Floats]:
    """Return |E|^2 in directions (n, 3): nominal, expected, sample mean, and sample quantiles.

    Each of the five arrays (n,) is in W/sr. See `_draw` for ``factors`` and ``shifts``.
    """
    square, variance = _mean_and_variance(errors, wavelength)
    weighted = source.weights[:, None] * factors
    size = len(source) * (1 if shifts is None else factors.shape[1]) + factors.shape[1]
    results = []
    parts = [directions[rows] for rows in index_blocks(len(directions), _BLOCK // size)]
    with with_progress("directions", parts) as blocks:
        for block in blocks:
            fields = _element_fields(source, block, wavelength, obliquity)
            nominal = np.square(np.abs(fields @ source.weights))
            incoherent = np.square(np.abs(fields * source.weights)).sum(axis=1)
            if shifts is None:
                total = fields @ weighted
            else:
                cycles = np.tensordot(block / wavelength, shifts, axes=(1, 2))
                total = np.einsum("mk,kc,mkc->mc", fields, weighted, np.exp(-2j * np.pi * cycles))
            samples = np.square(np.abs(total))
            low, high = np.quantile(samples, (0.05, 0.95), axis=1)
            expected = square * nominal + variance * incoherent
            results.append((nominal, expected, samples.mean(axis=1), low, high))
    names = ("nominal", "expected", "mean", "low", "high")
    return dict(zip(names, map(np.concatenate, zip(*results, strict=True)), strict=True))


def _element_fields(
    source: Array, directions: Floats, wavelength: float, obliquity: str
) -> Complex:
    """Return unweighted far fields of all elements, shape (directions, elements).

    Phases refer to the origin.
    """
    if source.repeated is not None:
        element, positions = source.repeated
        cycles = directions[:, :2] @ positions.T / wavelength
        field = far_field(element, directions, wavelength, obliquity)
        return np.asarray(field[:, None] * np.exp(-2j * np.pi * cycles))
    elements = source.elements_in_plane
    return np.stack([far_field(e, directions, wavelength, obliquity) for e in elements], axis=1)


@takes_frequency
def two_way_pattern(
    transmitter: PlaneSource,
    receiver: PlaneSource,
    wavelength: float,
    theta: ArrayLike,
    phi: ArrayLike,
    *,
    obliquity: ObliquityName | None = None,
) -> xarray.Dataset:
    """Return the two-way pattern of a radar: the product of the transmit and receive patterns.

    The field is the product of the two far fields, and the level is the sum of the two
    directivities in dBi. A target of radar cross section c at the distance r returns the fraction
    ``G_t G_r c wavelength^2/((4 pi)^3 r^4)`` of the transmitted power, where G_t and G_r are the
    gains of the two antennas.

    Parameters
    ----------
    transmitter, receiver : Aperture or Array
        Antennas in the plane z = 0, with any fields. Specify the field of the receiver as if it
        transmitted.
    wavelength : float
        Wavelength in m.
    theta, phi : array_like, shapes (n,) and (m,)
        Angles in rad, as in :func:`radiation_pattern`.
    obliquity : str, optional
        As in :func:`radiation_pattern`.

    Returns
    -------
    xarray.Dataset
        Directivities ``transmit`` and ``receive`` in dBi, their sum ``two_way`` in dB, and the
        complex product ``field`` of the two far fields, over theta and phi.

    Raises
    ------
    PolywignerError
        See :func:`radiation_pattern`.

    Examples
    --------
    >>> import polywigner as pw
    >>> square = pw.shapes.square(10e-3)
    >>> pattern = pw.two_way_pattern(square, square, 3.2e-3, 0.0, 0.0)
    >>> round(float(pattern["two_way"][0, 0]), 1)  # twice 21.35 dBi
    42.7
    """
    sent, received = (
        radiation_pattern(source, wavelength, theta, phi, obliquity=obliquity)
        for source in (transmitter, receiver)
    )
    levels = sent["directivity"], received["directivity"]
    products = {"two_way": levels[0] + levels[1], "field": sent["field"] * received["field"]}
    result = sent[["theta", "phi"]].assign(transmit=levels[0], receive=levels[1], **products)
    result["two_way"].attrs = {"units": "dB", "long_name": "two-way directivity"}
    result["field"].attrs = {"units": "W sr-1", "long_name": "product of fields"}
    result.attrs = {name: sent.attrs[name] for name in ("wavelength", "frequency", "obliquity")}
    return result
