"""Fields of pupils with aberrations in the far field and in the Fresnel approximation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.numerics.chirps import waves_of_cycles
from polywigner.propagation.collins import FrequencyLattice
from polywigner.transforms.aberrated_pupils import (
    AberratedPupil,
    Converged,
    converged,
)
from polywigner.transforms.aberrations import Aberration
from polywigner.transforms.pupil_gradients import Jets, PupilNumbers, edges_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Numbers of pairs of a quadrature node and a point: per block (some tens of megabytes), and at most
# per call. 1e9 pairs take about a minute.
_BLOCK, _MOST = 1 << 20, 2e10
# Number of the points at which the error of the quadrature rule is estimated.
_CHECKED = 32


def aberrated_spectrum(
    pupil: AberratedPupil, nu: Floats, tolerance: float, centre: Any = (0.0, 0.0)
) -> Converged:
    """Return the Fourier integrals (n,) of an aberrated pupil field at frequencies nu (n, 2).

    The integral is int u exp(2 pi i W/lambda - 2 pi i nu.(x - centre)) dx. ``tolerance`` is the
    allowed error as a fraction of int |u| dx. The error is estimated at some of the points.
    """
    band = band_of(nu)
    some = np.unique(np.linspace(0, max(len(nu) - 1, 0), _CHECKED).astype(int))[: len(nu)]

    def evaluate(extra: int, points: Floats) -> Complex:
        sums = element_sums(pupil, points, band, extra, tolerance, centre=centre)
        weighted = (weight * row for weight, (row,) in zip(pupil.weights, sums, strict=True))
        return np.asarray(sum(weighted))

    checked = converged(
        lambda extra: evaluate(extra, nu[some]), tolerance * pupil.content, "the pupil's field"
    )
    return checked._replace(values=evaluate(checked.extra, nu))


def band_of(nu: Floats) -> tuple[Floats, Floats]:
    """Return the lowest and the highest frequency along each axis, (2,) each, of nu (n, 2)."""
    if not len(nu):
        return np.zeros(2), np.zeros(2)
    return nu.min(axis=0), nu.max(axis=0)


def element_sums(
    pupil: AberratedPupil,
    nu: Floats,
    band: tuple[Floats, Floats],
    extra: int,
    error: float,
    factors: Callable[[Floats, Floats], Floats] | None = None,
    centre: Any = (0.0, 0.0),
) -> Iterator[Complex]:
    """Yield the Fourier integrals (k, n) of each element's field u times k factors.

    The integral is int factor u exp(-2 pi i nu.(x - centre)) dx, and u excludes the weight of the
    element. ``factors`` is a function of x and y (...) that returns factors (k, ...); None stands
    for the factor 1.
    """
    lattice = FrequencyLattice(nu)
    for number in range(len(pupil.elements)):
        total: Any = 0.0
        for x, weights in pupil.rules(number, band, extra, error):
            field = (weights * pupil.field(number, x))[None]
            if factors is not None:
                field = field * factors(x[..., 0], x[..., 1])
            total = total + np.array([_lattice_sum(lattice, x - centre, row) for row in field])
        yield total


def _lattice_sum(lattice: FrequencyLattice, nodes: Floats, field: Complex) -> Complex:
    """Return the sums (n,) of a field (k, m) times exp(-2 pi i nu.x) over nodes x (k, m, 2).

    The m nodes of a row have the same x coordinate. If the frequencies lie on a grid, all
    frequencies along x reuse the sums over y.
    """
    waves = field.size * (lattice.work if lattice.index is None else len(lattice.axes[1]))
    if waves > _MOST:
        raise ArgumentError(
            f"the aberrated pupil requires {waves:.1e} products of a quadrature node and a point, "
            f"at most {_MOST:.0e} are allowed; use fewer points, or a grid along x and y"
        )
    if lattice.index is None:
        return lattice.summed(nodes.reshape(-1, 2), field.ravel())
    x, y = nodes[:, 0, 0], nodes[..., 1]
    total: Any = 0.0
    rows = max(1, _BLOCK // max(1, y.shape[1] * len(lattice.axes[1])))
    for start in range(0, len(x), rows):
        some = slice(start, start + rows)
        along_y = waves_of_cycles(-y[some, :, None] * lattice.axes[1])
        sums = (field[some, None, :] @ along_y)[:, 0]
        total = total + waves_of_cycles(-np.outer(lattice.axes[0], x[some])) @ sums
    return np.asarray(total[lattice.index])


def spectrum_jets(
    pupil: AberratedPupil, nu: Floats, numbers: PupilNumbers, tolerance: float
) -> Jets:
    """Return the values and derivatives (n, 1 + m) of :func:`aberrated_spectrum` at nu (n, 2)."""
    values, _, extra = aberrated_spectrum(pupil, nu, tolerance)
    return numbers.joined(values, _OfSpectrum(pupil, nu, extra, tolerance))


@dataclass(frozen=True, eq=False)
class _OfSpectrum:
    """Derivatives of the spectrum of a pupil."""

    pupil: AberratedPupil
    nu: Floats
    extra: int
    error: float

    def _sums(self, factors: Callable[[Floats, Floats], Floats] | None = None) -> Iterator[Complex]:
        band = band_of(self.nu)
        return element_sums(self.pupil, self.nu, band, self.extra, self.error, factors)

    def vertices(self) -> Complex:
        pupil, parts = self.pupil, []
        largest = np.abs(np.stack(band_of(self.nu))).max(axis=0)
        for k, edges in enumerate(edges_of(pupil)):
            every, ones = np.arange(len(edges.begin)), np.ones(len(edges.begin))
            band = largest + np.abs(pupil.elements[k].frequencies).max(axis=0)
            x, weights = edges.rule(
                (every, 0.0 * ones, ones), pupil.slopes, band, self.error, self.extra
            )
            field = pupil.weights[k] * pupil.field(k, x)[..., None] * weights
            waves = np.exp(-2j * np.pi * (x @ self.nu.T)).swapaxes(1, 2)
            parts.append(edges.at_vertices(every, (waves @ field).swapaxes(0, 1)))
        return np.concatenate(parts, axis=1)

    def weights(self) -> tuple[Complex, Complex]:
        by_weight = np.stack([row for (row,) in self._sums()], axis=1)
        return by_weight, np.zeros_like(by_weight)

    def coefficients(self) -> Complex:
        path = self.pupil.aberration
        assert path is not None
        sums = self._sums(path.modes)
        total = sum(weight * rows.T for weight, rows in zip(self.pupil.weights, sums, strict=True))
        return np.asarray(total) * (2j * np.pi / self.pupil.wavelength)


def aberrated_fresnel_field(
    source: Any, aberration: Aberration, points: Floats, wavelength: float, tolerance: float
) -> tuple[Complex, Floats]:
    """Return the Fresnel field (n,) of an aberrated pupil at points (n, 3), and its error.

    The field is exp(ikz)/(i lambda z) int u exp(2 pi i W/lambda + i pi |X - x|^2/(lambda z)) dx.
    Points of equal z share a quadrature rule.
    """
    field, errors = np.empty(len(points), np.complex128), np.empty(len(points))
    for z in np.unique(points[:, 2]).tolist():
        some = points[:, 2] == z
        scale = wavelength * z
        pupil = AberratedPupil.of(source, aberration, wavelength, 0.5 / scale)
        nu = points[some, :2] / scale
        values, error, _ = aberrated_spectrum(pupil, nu, tolerance)
        turns = math.fmod(z, wavelength) / wavelength
        turns = turns + 0.5 * np.square(points[some, :2]).sum(axis=1) / scale
        field[some] = waves_of_cycles(turns) * values / (1j * scale)
        errors[some] = error / scale
    return field, errors
