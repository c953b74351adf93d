"""Patterns of arrays as they are built and used: with errors, and of radars with two arrays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.progress import told
from polywigner.geometry.arguments import (
    checked_count,
    checked_generator,
    checked_length,
    checked_number,
    checked_wavelength,
    takes_frequency,
)
from polywigner.propagation.far_field_tables import FLOOR
from polywigner.propagation.far_fields import far_field, powers_of
from polywigner.propagation.patterns import decibels, described, radiation_pattern
from polywigner.propagation.places import angle_axes, checked_phi, checked_theta, unit_vectors
from polywigner.radiometry.directions import PlaneSource, checked_source
from polywigner.source import Array
from polywigner.source.obliquities import ObliquityName, obliquity_of

if TYPE_CHECKING:
    import xarray

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# Complex numbers at a time: 64 MiB.
_BLOCK = 2**22
_NEPER = 20 / math.log(10)
"""Decibels in a factor of e."""


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
    """Return the patterns of an array whose elements have random errors: mean, 5 % and 95 %.

    Each sample has weights w_k f_k with independent factors
    f_k = d_k 10^(a_k/20) exp(i p_k - i k s.x_k), a_k, p_k and x_k of normal distributions, d_k = 0
    for dead elements and else 1. With m = <f_k> and v = <|f_k|^2> - |m|^2 the mean is (RP4)

        <|E|^2> = |m|^2 |E_0|^2 + v sum_k |w_k E_k|^2

    J. Ruze, Nuovo Cimento 9, Suppl. (1952) 364-380; E_k is the far field of element k.

    Parameters
    ----------
    array : of apertures in the plane z = 0, with fields as :func:`radiation_pattern` takes them.
    wavelength : in m.
    theta, phi : (n,) and (m,) angles in rad, as of :func:`radiation_pattern`.
    amplitude : error of the amplitudes, rms in dB.
    phase : error of the phases, rms in rad.
    dead : share of the elements that radiate nothing, on average, from 0 to below 1.
    position : error of the positions, rms in m along each of x, y and z.
    count : number of samples, 2 or more.
    seed : of NumPy's default generator, or a generator.
    obliquity : as of :func:`radiation_pattern`.

    Returns
    -------
    xarray.Dataset over theta and phi, 4 pi |E|^2/P in dBi with P the radiated power of the array
    without errors: ``nominal`` without errors, ``expected``, the mean in closed form, and of the
    samples ``mean``, ``low`` and ``high``, the levels that 5 and 95 % of them are below. Levels of
    a cut below -300 dBi are -300 dBi. Attributes: the errors, count, and ``peak_loss`` in dB, by
    which the expected level at the nominal peak of these angles is below the nominal one.
    Time and memory: angles x elements x count multiplications, in blocks of some 64 MiB.

    Raises
    ------
    ArgumentError for anything but an Array, errors below zero, no error at all, and shares of 1;
    otherwise as :func:`radiation_pattern`.

    >>> import polywigner as pw
    >>> places = pw.arrays.grid_positions(8, 8, 2e-3)
    >>> array = pw.phased_array(pw.shapes.square(1.9e-3), places)
    >>> found = pw.array_tolerance(array, 3.9e-3, 0.0, 0.0, phase=0.2)
    >>> round(found.attrs["peak_loss"], 3)  # dB
    0.171
    """
    if not isinstance(array, Array):
        raise ArgumentError(
            f"expected an Array of apertures, got {type(array).__name__}; make one by phased_array"
        )
    source, length = checked_source(array), checked_wavelength(wavelength)
    assert isinstance(source, Array)
    errors = _checked_errors(amplitude=amplitude, phase=phase, position=position, dead=dead)
    number = checked_count(count, "count", 2)
    random = checked_generator(seed)
    polar, azimuth = checked_theta(theta), checked_phi(phi)
    condition = obliquity_of(obliquity)
    condition.warn_of_fit(source, length)
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
    return described(source, angle_axes(polar, azimuth), directivities, about)


def _checked_errors(**errors: float) -> dict[str, float]:
    """The errors by name; ArgumentError for negative ones, dead arrays, and none at all."""
    for name, unit in (("amplitude", "dB"), ("phase", "rad"), ("position", "m")):
        meaning = f"an rms error of zero or more, in {unit}"
        errors[name] = checked_length(errors[name], name, zero=True, meaning=meaning)
    errors["dead"] = checked_number(errors["dead"], "dead", "a share from 0 to below 1")
    if not 0 <= errors["dead"] < 1:
        raise ArgumentError(f"expected dead as a share from 0 to below 1, got {errors['dead']!r}")
    if errors["amplitude"] > 40 or errors["phase"] > 2 * math.pi:
        raise ArgumentError(
            "expected rms errors of up to 40 dB and 2 pi rad, got "
            f"{errors['amplitude']:g} dB and {errors['phase']:g} rad; give phases in rad"
        )
    if not any(errors.values()):
        raise ArgumentError(
            "expected an error of amplitude, phase, dead or position above zero, got none"
        )
    return errors


def _moments(errors: dict[str, float], wavelength: float) -> tuple[float, float]:
    """|<f>|^2 and <|f|^2> - |<f>|^2 of the factors of :func:`array_tolerance`."""
    spread = (errors["amplitude"] / _NEPER) ** 2
    turns = errors["phase"] ** 2 + (2 * math.pi * errors["position"] / wavelength) ** 2
    alive = 1 - errors["dead"]
    square = alive**2 * math.exp(spread - turns)
    # e^(2 spread) - alive e^(spread - turns), without the difference of two numbers close to 1
    rest = math.exp(2 * spread) * (errors["dead"] - alive * math.expm1(-spread - turns))
    return square, alive * rest


def _draw(
    errors: dict[str, float], shape: tuple[int, int], random: np.random.Generator
) -> tuple[Complexes, Reals | None]:
    """Factors (n, count) of the weights, and shifts (n, count, 3) of the elements, if any."""
    logarithms = errors["amplitude"] / _NEPER * random.standard_normal(shape)
    phases = errors["phase"] * random.standard_normal(shape)
    alive = random.random(shape) >= errors["dead"]
    factors = np.where(alive, np.exp(logarithms + 1j * phases), 0)
    if not errors["position"]:
        return factors, None
    return factors, errors["position"] * random.standard_normal((*shape, 3))


def _statistics(
    source: Array,
    directions: Reals,
    wavelength: float,
    obliquity: str,
    errors: dict[str, float],
    factors: Complexes,
    shifts: Reals | None,
) -> dict[str, Reals]:
    """|E|^2 (n,) in directions (n, 3): without errors, expected, mean, low and high."""
    square, variance = _moments(errors, wavelength)
    weighted = source.weights[:, None] * factors
    size = len(source) * (1 if shifts is None else factors.shape[1]) + factors.shape[1]
    rows = max(1, _BLOCK // size)
    found = []
    blocks = [directions[k : k + rows] for k in range(0, len(directions), rows)]
    with told("directions", blocks) as each:
        for block in each:
            fields = element_fields(source, block, wavelength, obliquity)
            nominal = np.square(np.abs(fields @ source.weights))
            alone = np.square(np.abs(fields * source.weights)).sum(axis=1)
            if shifts is None:
                total = fields @ weighted
            else:
                turns = np.tensordot(block / wavelength, shifts, axes=(1, 2))
                total = np.einsum("mk,kc,mkc->mc", fields, weighted, np.exp(-2j * np.pi * turns))
            samples = np.square(np.abs(total))
            low, high = np.quantile(samples, (0.05, 0.95), axis=1)
            expected = square * nominal + variance * alone
            found.append((nominal, expected, samples.mean(axis=1), low, high))
    names = ("nominal", "expected", "mean", "low", "high")
    return dict(zip(names, map(np.concatenate, zip(*found, strict=True)), strict=True))


def element_fields(
    source: Array, directions: Reals, wavelength: float, obliquity: str
) -> Complexes:
    """Far field (m, n) of each of n elements, with weight 1, in directions (m, 3)."""
    if source.repeated is not None:
        element, positions = source.repeated
        turns = directions[:, :2] @ positions.T / wavelength
        own = far_field(element, directions, wavelength, obliquity)
        return np.asarray(own[:, None] * np.exp(-2j * np.pi * turns))
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
    """Return the pattern of a radar that transmits with one source and receives with another.

    Its field is the product E_t E_r, its level the sum of both directivities in dBi: a target of
    cross section c at the distance r returns G_t G_r c lambda^2/((4 pi)^3 r^4) of the power.

    Parameters
    ----------
    transmitter, receiver : an Aperture or Array of apertures each, in the plane z = 0, with any
        fields; weights of a receiver as those with which it would transmit.
    wavelength : in m.
    theta, phi : (n,) and (m,) angles in rad, as of :func:`radiation_pattern`.
    obliquity : as of :func:`radiation_pattern`.

    Returns
    -------
    xarray.Dataset over theta and phi: ``transmit`` and ``receive`` in dBi, ``two_way``, their sum
    in dB, and ``field``, complex, the product of both fields.

    Raises
    ------
    As :func:`radiation_pattern`.

    >>> import polywigner as pw
    >>> square = pw.shapes.square(10e-3)
    >>> found = pw.two_way_pattern(square, square, 3.2e-3, 0.0, 0.0)
    >>> round(float(found["two_way"][0, 0]), 1)  # twice 21.35 dBi
    42.7
    """
    there, back = (
        radiation_pattern(one, wavelength, theta, phi, obliquity=obliquity)
        for one in (transmitter, receiver)
    )
    levels, fields = ([one[name] for one in (there, back)] for name in ("directivity", "field"))
    units = {"two_way": ("dB", "two-way directivity"), "field": ("W sr-1", "product of fields")}
    products = {"two_way": levels[0] + levels[1], "field": fields[0] * fields[1]}
    found = there[["theta", "phi"]].assign(transmit=levels[0], receive=levels[1], **products)
    for name, (unit, meaning) in units.items():
        found[name].attrs = {"units": unit, "long_name": meaning}
    found.attrs = {name: there.attrs[name] for name in ("wavelength", "frequency", "obliquity")}
    return found
