"""Fields of pupils with aberrations in the far field and in the Fresnel approximation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.numerics.chirps import waves_of_turns
from polywigner.numerics.triangles import Indices, counts_for
from polywigner.propagation.collins import FrequencyLattice
from polywigner.transforms.aberrated_pupils import (
    AberratedPupil,
    Columns,
    Converged,
    converged,
)
from polywigner.transforms.aberrations import Aberration
from polywigner.transforms.pupil_gradients import (
    Edges,
    Jets,
    Parts,
    PupilNumbers,
    edges_of,
    nodes_on,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Values of waves in a block: some tens of megabytes. Largest number of waves, about 1e9 a minute.
_BLOCK, _MOST = 1 << 20, 2e10
# Points at which the error of a rule is estimated.
_CHECKED = 32


def aberrated_spectrum(
    pupil: AberratedPupil, nu: Floats, tolerance: float, centre: Any = (0.0, 0.0)
) -> Converged:
    """Return int u exp(2 pi i W/lambda - 2 pi i nu.(x - centre)) dx (...) at nu (..., 2).

    ``tolerance``: allowed error over int |u|. The error is estimated at some of the points.
    """
    flat = nu.reshape(-1, 2)
    band = band_of(flat)
    some = np.unique(np.linspace(0, max(len(flat) - 1, 0), _CHECKED).astype(int))[: len(flat)]

    def evaluate(extra: int, points: Floats) -> Complex:
        lattice, total = FrequencyLattice(points), np.zeros(len(points), np.complex128)
        for k, weight in enumerate(pupil.weights):
            for part in pupil.columns(k, band, extra, tolerance):
                total += weight * lattice_sum(lattice, part, centre)
        return total

    checked = converged(
        lambda extra: evaluate(extra, flat[some]), tolerance * pupil.content, "the pupil's field"
    )
    values = evaluate(checked.extra, flat).reshape(nu.shape[:-1])
    errors = np.full(values.shape, checked.errors.max(initial=0.0))
    return Converged(values, errors, checked.extra)


def band_of(nu: Floats) -> tuple[Floats, Floats]:
    """Return the lowest and highest frequencies (2,) of nu (n, 2)."""
    if not len(nu):
        return np.zeros(2), np.zeros(2)
    return nu.min(axis=0), nu.max(axis=0)


def lattice_sum(lattice: FrequencyLattice, part: Columns, centre: Any = (0.0, 0.0)) -> Complex:
    """Return sums (n,) of a field at nodes times exp(-2 pi i nu.(x - centre)).

    On a grid the sums over y are shared by all frequencies along x.
    """
    waves = part.field.size * (lattice.work if lattice.index is None else len(lattice.axes[1]))
    if waves > _MOST:
        raise ArgumentError(
            f"the aberrated pupil requires {waves:.1e} waves from nodes to points, at most "
            f"{_MOST:.0e}; use fewer points, or a grid along x and y"
        )
    if lattice.index is None:
        return lattice.summed(part.nodes - centre, part.field.ravel())
    x, y = part.x - centre[0], part.y - centre[1]
    total: Any = 0.0
    rows = max(1, _BLOCK // max(1, y.shape[1] * len(lattice.axes[1])))
    for start in range(0, len(x), rows):
        some = slice(start, start + rows)
        along_y = waves_of_turns(-y[some, :, None] * lattice.axes[1])
        sums = (part.field[some, None, :] @ along_y)[:, 0]
        total = total + waves_of_turns(-np.outer(lattice.axes[0], x[some])) @ sums
    return np.asarray(total[lattice.index])


def spectrum_jets(
    pupil: AberratedPupil, nu: Floats, numbers: PupilNumbers, tolerance: float
) -> Jets:
    """Return jets (n, 1 + m) of :func:`aberrated_spectrum` at nu (n, 2)."""
    values, _, extra = aberrated_spectrum(pupil, nu, tolerance)
    return numbers.joined(values, pupil, _OfSpectrum(nu, extra, tolerance))


@dataclass(frozen=True, eq=False)
class _OfSpectrum(Parts):
    """Derivatives of the spectrum of a pupil."""

    nu: Floats
    extra: int
    error: float

    @cached_property
    def lattice(self) -> FrequencyLattice:
        return FrequencyLattice(self.nu)

    def _columns(self, pupil: AberratedPupil, number: int) -> list[Columns]:
        return pupil.columns(number, band_of(self.nu), self.extra, self.error)

    def weights(self, pupil: AberratedPupil) -> tuple[Complex, Complex]:
        sums = [
            sum(lattice_sum(self.lattice, part) for part in self._columns(pupil, k))
            for k in range(len(pupil.elements))
        ]
        by_weight = np.stack(sums, axis=1)
        return by_weight, np.zeros_like(by_weight)

    def coefficients(self, pupil: AberratedPupil) -> Complex:
        assert pupil.aberration is not None
        total: Any = 0.0
        for k, weight in enumerate(pupil.weights):
            for part in self._columns(pupil, k):
                modes = pupil.aberration.modes(*part.nodes.T)
                fields = weight * part.field * modes.reshape(-1, *part.y.shape)
                terms = [lattice_sum(self.lattice, part._replace(field=f)) for f in fields]
                total = total + np.stack(terms, axis=1)
        return np.asarray(total * (2j * np.pi / pupil.wavelength))

    def vertices(self, pupil: AberratedPupil) -> Complex:
        parts = []
        for k, (edges, weight) in enumerate(zip(edges_of(pupil), pupil.weights, strict=True)):
            x, terms, owner = self._boundary(pupil, k, edges)
            by_node = np.zeros((len(x), len(edges.begin), 2), np.complex128)
            row = np.arange(len(x))
            for corner, fraction in ((edges.first, 0), (edges.second, 1)):
                local = corner[owner] - edges.first[0]
                by_node[row, local] += terms[:, fraction, None] * edges.normal[owner]
            waves = np.exp(-2j * np.pi * (self.nu @ x.T))
            parts.append(weight * np.tensordot(waves, by_node, 1))
        return np.concatenate(parts, axis=1)

    def _boundary(
        self, pupil: AberratedPupil, number: int, edges: Edges
    ) -> tuple[Floats, Complex, Indices]:
        """Return nodes (m, 2) on edges, the field times (1 - t, t) dt (m, 2), and edges (m,)."""
        ends = edges.begin[:, None] + np.array([0.0, 0.5, 1.0])[:, None] * edges.vector[:, None]
        slope = np.abs((pupil.slopes(ends) * edges.vector[:, None]).sum(axis=-1)).max()
        kappa = np.abs(pupil.elements[number].frequencies).max(axis=0)
        reach = kappa + np.abs(np.stack(band_of(self.nu))).max(axis=0)
        cycles = slope + float((np.abs(edges.vector) @ reach).max())
        count = int(counts_for(np.array(cycles), self.error)) + self.extra
        every = np.ones(len(edges.begin))
        t, weights = nodes_on(0.0 * every, every, count)
        x = (edges.begin[:, None] + t[..., None] * edges.vector[:, None]).reshape(-1, 2)
        field = pupil.waves(number, x) * np.exp(2j * np.pi * pupil.cycles(x)) * weights.ravel()
        terms = field[:, None] * np.stack([1.0 - t.ravel(), t.ravel()], axis=1)
        return x, terms, np.repeat(np.arange(len(every)), count)


def aberrated_fresnel_field(
    source: Any, aberration: Aberration, points: Floats, wavelength: float, tolerance: float
) -> tuple[Complex, Floats]:
    """Return Fresnel's field (n,) of an aberrated pupil at points (n, 3), and its error.

    exp(ikz)/(i lambda z) int u exp(2 pi i W/lambda + i pi |X - x|^2/(lambda z)) dx: points of one z
    share a rule.
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
        field[some] = waves_of_turns(turns) * values / (1j * scale)
        errors[some] = error / scale
    return field, errors
