"""Electric fields of polarised sources, from equivalent currents (VP1).

A source with the scalar field u and the polarisation p is replaced by magnetic currents (an opening
in a metal screen), by electric currents, or by half of each (Huygens). The electric fields of these
currents are ``(q d/dz - z q.grad) Phi/(ik)`` and ``q Phi + grad (q.grad Phi)/k^2``, with the unit
normal z, ``q = (p_x, p_y, 0)``, and the potential ``Phi = int u exp(ikR)/(i wavelength R) dx``.

Phi is the second Rayleigh-Sommerfeld integral of the plane waves of u over their direction cosines
p_z, and dPhi/dz/(ik) is the first. Derivatives along the plane become factors of the plane waves,
and integrals along edges.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner import execution
from polywigner.execution import Engine, Precision
from polywigner.execution.choice import resolved
from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.arguments import checked_choice, checked_wavelength, takes_frequency
from polywigner.kernels.boundary.integrals import STRIPS, distance_of, point_in_wavelengths
from polywigner.numerics import Complex, Floats, index_blocks, phases
from polywigner.propagation.boundary import (
    Radiator,
    boundary_field,
    cosines_of,
    panels_of,
    radiator_of,
    strata_of,
)
from polywigner.propagation.curved_fields import field_at_nodes, summed_over_cells
from polywigner.propagation.point_grids import (
    checked_points,
    tolerance_from,
    warn_of_missed,
)
from polywigner.radiometry.directions import (
    PlaneSource,
    checked_powers,
    checked_radiator,
    directions_and_weights,
    largest_lag,
)
from polywigner.source import Array
from polywigner.source.obliquities import DEFAULT, DERIVATIVE_OF
from polywigner.source.polarisation import (
    MODELS,
    CurrentModel,
    Currents,
    checked_polarisation,
    components,
    ludwig_axes,
)
from polywigner.transforms import fourier
from polywigner.transforms.public_transforms import energy_of
from polywigner.transforms.traced_sources import check_no_drjit
from polywigner.transforms.xarray_arguments import takes_xarray

_OPS = execution.NumpyOperations()

SECOND = DERIVATIVE_OF[DEFAULT]
# Grazing waves cannot be divided by p_z. The field is analytic in the frequency, so the mean over
# four neighbouring frequencies replaces each grazing wave, with a relative error of 1e-11. _ASIDE
# is the phase difference [rad] between neighbouring frequencies across half of the source.
_ASIDE = 3e-3
_MEANS = ((-2.0, -1 / 6), (-1.0, 4 / 6), (1.0, 4 / 6), (2.0, -1 / 6))
# Rounding error of each part of a field.
_LEAST = 1e-13


def polarised_parts(
    source: PlaneSource | Wavefront, polarisation: Any
) -> list[tuple[PlaneSource | Wavefront, Complex]]:
    """Return a polarised source as scalar sources, each with a polarisation vector (3,).

    The z components of the vectors are zero.
    """
    jones = checked_polarisation(polarisation, source)
    return [(part, np.append(p, 0.0)) for part, p in components(source, jones)]


@takes_frequency
@takes_xarray(
    "points",
    units="W0.5 m-1",
    long_name="electric field E",
    components={"component": ("x", "y", "z")},
)
def field(
    source: Aperture | Array | Wavefront,
    points: ArrayLike,
    wavelength: float,
    polarisation: str | ArrayLike,
    method: CurrentModel = "huygens",
    *,
    tolerance: float | None = None,
) -> Complex:
    """Return the electric field E(x, y, z) of a polarised source in the plane z = 0.

    Equivalent currents in the plane replace the field u p on the source, where p is the
    polarisation (VP1). E is the electric field divided by the square root of twice the impedance of
    free space. Both |E|^2 and |u|^2 are therefore in W/m^2.

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Apertures in the plane z = 0 with any illumination, or a curved wave.
    points : array_like, shape (..., 3)
        Points in m with z > 0, at any distance from the source.
    wavelength : float
        Wavelength in m.
    polarisation : str or array_like
        "x", "y", an angle from x towards y such as "45 deg", "right" or "left" (IEEE, for waves
        exp(-i omega t)); or a complex Jones vector, shape (2,), of any norm. An Array of n elements
        also allows n Jones vectors, shape (n, 2), or a list of n names.
    method : {"huygens", "magnetic", "electric"}, default "huygens"
        Model of the equivalent currents. "magnetic" is for an opening in a metal screen, where u p
        is the tangential electric field. "electric" is for electric currents alone, where u z x p
        is the tangential magnetic field. "huygens" is half of each, for black surroundings, horns
        and waveguide openings in free space.
    tolerance : float, default 1e-9
        Allowed error of each component, as in :func:`amplitude`, at least 1e-13. Within a
        wavelength of an edge, the field of "electric" and its error are inversely proportional to
        the distance from the edge.

    Returns
    -------
    ndarray of complex128, shape (..., 3)
        Field in the unit of the source's field. If ``points`` is a DataArray, the result is a
        DataArray.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range or is a Dr.Jit array, or if a point lies
        behind the source.
    IlluminationError
        If the light is partially coherent.
    GeometryError
        If elements of an Array do not lie in the plane z = 0.

    Warns
    -----
    PolywignerWarning
        If the estimated error exceeds the tolerance at some point.

    References
    ----------
    C. A. Balanis, "Antenna theory", 3rd ed. (2005), ch. 12. Near fields are derived in
    docs/theory/polarisation.md.

    Examples
    --------
    >>> import polywigner as pw
    >>> square = pw.shapes.square(10e-3)
    >>> abs(pw.field(square, (0.0, 0.05, 0.1), 3.2e-3, "y", "magnetic")).round(4)
    array([0.    , 0.0545, 0.0269])
    """
    name = checked_choice(method, "method", MODELS)
    check_no_drjit(source=source, points=points, wavelength=wavelength)
    positions, length = checked_points(points), checked_wavelength(wavelength)
    allowed = tolerance_from(tolerance)
    radiator = checked_radiator(source)
    parts = polarised_parts(radiator, polarisation)
    flat = positions.reshape(-1, 3)
    total = np.zeros((len(flat), 3), np.complex128)
    errors, limits = np.zeros((2, len(flat)))
    for part, q in parts:
        if isinstance(part, Wavefront):
            terms = partial(_dipole_terms, part, q, MODELS[name])
            value, off = summed_over_cells(part, flat, length, terms, (3,))
        else:
            value, off, limit = _near_field(part, flat, length, allowed, q, MODELS[name])
            limits += limit
        total += value
        errors += off
    if not isinstance(radiator, Wavefront):
        warn_of_missed(errors, limits, "points")
    return total.reshape(positions.shape)


def _dipole_terms(
    wave: Wavefront, q: Complex, currents: Currents,
    part: Any, cells: Floats, points: Floats, wavelength: float,
) -> Complex:  # fmt: skip
    """Return the weighted fields (k, nodes, 3) of equivalent currents on k cells.

    ``points`` (k, 3) contains one point in m for each cell.
    """
    nodes, weights, _ = field_at_nodes(wave, part, cells, wavelength)
    ahead = np.empty((*nodes.shape[:2], 3))
    ahead[..., :2] = points[:, None, :2] - nodes
    ahead[..., 2] = points[:, None, 2]
    return dipole_fields(ahead / wavelength, q, currents) * (weights / wavelength**2)[..., None]


def dipole_fields(ahead: Floats, q: Complex, currents: Currents) -> Complex:
    """Return the electric field of equivalent currents on one square wavelength at the origin.

    ``ahead`` (..., 3) contains positions in wavelengths, and ``q`` (3,) is the polarisation vector
    with q_z = 0. The result (..., 3) is relative to the field on the source.
    """
    distance = np.linalg.norm(ahead, axis=-1, keepdims=True)
    s, a = ahead / distance, 0.5j / (math.pi * distance)
    wave = np.exp(2j * math.pi * (distance - np.round(distance))) / (1j * distance)
    along = s @ q[:, None]
    field = np.zeros(ahead.shape, np.complex128)
    if currents.magnetic:
        crossed = s[..., 2:] * q - along * np.array([0.0, 0.0, 1.0])
        field += currents.magnetic * (1 + a) * crossed
    if currents.electric:
        radial = (1 + 3 * a * (1 + a)) * along * s
        field += currents.electric * ((1 + a * (1 + a)) * q - radial)
    return wave * field


def _near_field(
    source: PlaneSource,
    points: Floats,
    wavelength: float,
    tolerance: float,
    q: Complex,
    currents: Currents,
) -> tuple[Complex, Floats, Floats]:
    """Return the electric field at points (n, 3) for the polarisation q, and two error arrays.

    The arrays (n,) are the estimated error and the allowed error.
    """
    radiator, (m, e) = radiator_of(source), currents
    without_grazing = _not_grazing(radiator, wavelength)
    field = np.zeros((len(points), 3), np.complex128)
    errors, limits = np.zeros((2, len(points)))

    def integral(method: str, factor: Any) -> Complex:
        """Return Phi of (VP1) at all points if ``method`` is SECOND, otherwise dPhi/dz/(ik).

        ``factor`` is a function of the direction cosines (m, 2) of the plane waves, and returns the
        factor of each wave.
        """
        scaled = (without_grazing if method == SECOND else radiator).times(
            lambda kappa: factor(kappa * wavelength)
        )
        if method == SECOND:
            scaled = scaled.times(lambda kappa: 1 / cosines_of(kappa, wavelength, False))
        if not any(element.amplitudes.any() for element in scaled.elements):
            return np.zeros(len(points), np.complex128)
        allowed = max(_LEAST, min(1.0, radiator.amplitude / scaled.amplitude) * tolerance)
        values, error, limit = boundary_field(scaled, points, wavelength, method, allowed, "auto")
        errors[:] += error
        limits[:] += limit
        return values

    if m:
        field[:, :2] += m * integral(DEFAULT, lambda p: 1.0 + 0.0 * p[:, 0])[:, None] * q[:2]
        field[:, 2] -= m * integral(SECOND, lambda p: p @ q[:2])
    if e:
        for a in range(2):
            field[:, a] += e * integral(SECOND, lambda p, a=a: q[a] - p[:, a] * (p @ q[:2]))
        field[:, 2] -= e * integral(DEFAULT, lambda p: p @ q[:2])
    for sums in edge_integrals(radiator, points, wavelength, tolerance):
        field[sums.where] += _edge_field(sums, q, currents)
    return field, errors, limits


def _edge_field(sums: EdgeIntegrals, q: Complex, currents: Currents) -> Complex:
    """Return the electric field (n, 3) of the line integrals along edges (VP4)."""
    m, e = currents
    n, field = sums.normal @ q[:2], np.zeros((len(sums.where), 3), np.complex128)
    if m:
        field[:, 2] -= m / (2 * math.pi) * (sums.wave @ n)
    if e:
        scale = -1j * e / (4 * math.pi**2)
        # The gradient of u G has a displacement term (`rise`) and a wave vector term.
        weighted, grown = sums.rise * n, sums.rise_by_length * n
        total = weighted.sum(axis=1)
        for a in range(2):
            begin = weighted @ sums.begin[:, a] + grown @ sums.along[:, a]
            gradient = begin - sums.points[:, a] * total
            carried = sums.wave @ (sums.normal[:, a] * (sums.plane @ q[:2]))
            field[:, a] -= scale * (gradient + 2j * math.pi * carried)
        field[:, 2] += scale * sums.points[:, 2] * total
    return field


def _not_grazing(radiator: Radiator, wavelength: float) -> Radiator:
    """Return a radiator in which the mean of four waves replaces each grazing plane wave."""
    half = max(1.0, float(np.linalg.norm(radiator.high - radiator.low)) / (2 * wavelength))
    step = _ASIDE / (2 * math.pi * half)
    elements = []
    for element in radiator.elements:
        sine = np.linalg.norm(element.frequencies, axis=1) * wavelength
        grazing = np.abs(sine - 1.0) < 0.1 * step
        if not grazing.any():
            elements.append(element)
            continue
        west, south, east, north = element.outline.bounds
        centre = np.array([west + east, south + north]) / 2
        amplitudes, frequencies = [element.amplitudes[~grazing]], [element.frequencies[~grazing]]
        for offset, weight in _MEANS:
            shifted = element.frequencies[grazing] * (1.0 + offset * step)
            cycles = (element.frequencies[grazing] - shifted) @ centre
            amplitudes.append(weight * element.amplitudes[grazing] * np.exp(2j * math.pi * cycles))
            frequencies.append(shifted)
        elements.append(
            replace(
                element,
                amplitudes=np.concatenate(amplitudes),
                frequencies=np.concatenate(frequencies),
            )
        )
    return replace(radiator, elements=tuple(elements))


# Number of pairs (point, panel) per block, and number of panels per block.
_PAIRS, _PANELS = 1 << 17, 1 << 14
# Cost of a pair (point, panel), relative to the cost of an edge in a Fourier transform.
_TERMS = 16
# Allowed error of edge integrals, as a fraction of the tolerance. The fraction is small because
# these integrals may cancel.
_FRACTION = 1e-2


@dataclass(frozen=True)
class EdgeIntegrals:
    """Integrals of a plane wave u times G = exp(2 pi i R)/R along m panels, for n points.

    R is the distance from the point. Lengths are in wavelengths.
    """

    where: NDArray[np.intp]
    """Indices of the points, shape (n,)."""
    points: Floats
    """Positions relative to the centre of the source, shape (n, 3)."""
    begin: Floats
    """First ends of the panels relative to the centre of the source, shape (m, 2)."""
    along: Floats
    """Unit vectors along the panels, shape (m, 2)."""
    plane: Floats
    """Direction cosines p_x and p_y of the wave, shape (m, 2)."""
    cosine: Complex
    """Direction cosine p_z of the wave, shape (m,)."""
    wave: Complex
    """Integral of u G, shape (n, m)."""
    rise: Complex
    """Integral of ``h = u (1/R - 2 pi i) G/R``, shape (n, m)."""
    rise_by_length: Complex
    """Integral of t h for the distance t from the first end, shape (n, m)."""

    @property
    def normal(self) -> Floats:
        """Outward unit normals, shape (m, 2)."""
        return np.stack([self.along[:, 1], -self.along[:, 0]], axis=1)


def edge_integrals(
    radiator: Radiator, points: Floats, wavelength: float, tolerance: float
) -> Iterator[EdgeIntegrals]:
    """Yield integrals along the edges of a source, for blocks of points (n, 3) in m."""
    digits = -math.log(max(tolerance * _FRACTION, 1e-14))
    x, y = radiator.centre.tolist()
    entered = point_in_wavelengths(_OPS, (x, y), wavelength, *points.T)
    relative = np.stack([high for high, _ in entered], axis=1)
    waves = np.exp(2j * math.pi * phases.reduced(_OPS, distance_of(_OPS, entered)))[:, None]
    for where, longest in strata_of(radiator, points, wavelength):
        for rows, amplitudes, evanescent in panels_of(
            radiator, wavelength, longest, _PANELS, False
        ):
            along = (rows[:, 5:7] * rows[:, 2:4]).sum(axis=1)
            columns = [*rows[:, :5].T, along, rows[:, 11]]
            for some in index_blocks(len(where), _PAIRS // len(rows)):
                block = where[some]
                pairs = [*relative[block].T[..., None], *(column[None] for column in columns)]
                sums = execution.evaluate(
                    STRIPS,
                    None,
                    [*pairs, np.full((1, 1), digits)],
                    double=True,
                    engine=resolved("auto", len(block) * len(rows), _TERMS),
                    outputs=6,
                )
                yield EdgeIntegrals(
                    block,
                    relative[block],
                    rows[:, :2],
                    rows[:, 2:4],
                    rows[:, 5:7],
                    np.where(evanescent, 1j, 1.0) * rows[:, 7].astype(np.complex128),
                    *(
                        (real + 1j * imag) * amplitudes * waves[block]
                        for real, imag in zip(sums[::2], sums[1::2], strict=True)
                    ),
                )


def far_vectors(
    parts: Sequence[tuple[PlaneSource | Wavefront, Complex]],
    directions: Floats,
    wavelength: float,
    model: str,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> Complex:
    """Return the electric far field (..., 3) of a polarised source in directions s (..., 3) (VP2).

    The far field is the limit of ``r exp(-ikr) E(r s)`` at large distances r, in m times the unit
    of u. The far field is zero at z < 0.
    """
    nu = directions[..., :2] / wavelength
    total = np.zeros(directions.shape, np.complex128)
    for part, q in parts:
        far = fourier(part, nu, precision=precision, engine=engine) / (1j * wavelength)
        total += far[..., None] * far_field_of_currents(q, directions, model)
    return np.where(directions[..., 2:] < 0, 0.0, total)


def far_field_of_currents(q: Complex, directions: Floats, model: str) -> Complex:
    """Return the far field of currents relative to the scalar far field F/(i wavelength) (VP2).

    ``q`` (3,) is the polarisation vector with q_z = 0. Directions and result have the shape (...,
    3).
    """
    m, e = MODELS[model]
    up, along = np.array([0.0, 0.0, 1.0]), directions @ q[:, None]
    far = m * (directions[..., 2:] * q - along * up) + e * (q - along * directions)
    return np.asarray(far)


def ludwig_components(far: Complex, directions: Floats) -> tuple[Complex, Complex]:
    """Return far-field components along x and y by Ludwig's third definition, each of shape (...).

    The vectors ``far`` and the directions have the shape (..., 3).
    """
    x, y, z = np.moveaxis(directions, -1, 0)
    axes = ludwig_axes(x, y, np.maximum(z, -1.0 + np.finfo(np.float64).epsneg))
    along_x, along_y = ((far * np.stack(axis, axis=-1)).sum(axis=-1) for axis in axes)
    return along_x, along_y


def co_and_cross(components: tuple[Complex, Complex], jones: Complex) -> tuple[Complex, Complex]:
    """Convert components along x and y to co- and cross-polar parts (VP3).

    ``jones`` (2,) is the unit Jones vector of the co-polar part.
    """
    (x, y), (p, q) = components, jones
    return p.conjugate() * x + q.conjugate() * y, p * y - q * x


def from_co_and_cross(co: Complex, cross: Complex, jones: Complex) -> tuple[Complex, Complex]:
    """Convert co- and cross-polar parts to components along x and y.

    ``jones`` (2,) is the unit Jones vector of the co-polar part.
    """
    p, q = jones
    return p * co - q.conjugate() * cross, q * co + p.conjugate() * cross


def axial_ratios(components: tuple[Complex, Complex]) -> Floats:
    """Return axial ratios in dB: infinite for linear polarisation, and NaN if the field is zero."""
    x, y = components
    right, left = np.abs(x - 1j * y), np.abs(x + 1j * y)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(20 * np.log10((right + left) / np.abs(right - left)))


def vector_powers(
    parts: Sequence[tuple[PlaneSource | Wavefront, Complex]], wavelength: float, model: str
) -> tuple[float, float]:
    """Return the integrals of |E|^2 over the front, and of |u|^2 over the source, in W.

    Raises IlluminationError if the source radiates nothing.
    """
    lag = max(largest_lag(part) for part, _ in parts)
    power = 0.0
    for directions, solid_angle in directions_and_weights(lag, wavelength):
        far = far_vectors(parts, directions, wavelength, model)
        power += float(solid_angle @ np.square(np.abs(far)).sum(axis=1))
    energy = float(sum(energy_of(part) * np.square(np.abs(q)).sum() for part, q in parts))
    return checked_powers(power, energy, wavelength)
