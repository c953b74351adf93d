"""Integrals of waves along edges, and gradients of exact fields from these: (G6), (G7)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.execution.choice import resolved
from polywigner.illumination.obliquities import OBLIQUITIES
from polywigner.kernels.boundary.integrals import STRIPS, distance_of, point_in_wavelengths
from polywigner.numerics import phases
from polywigner.propagation.boundary import (
    Radiator,
    boundary_field,
    cosines_of,
    panels_of,
    strata_of,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

_OPS = execution.NumpyOperations(double=True)
# Pairs of a point and a panel in one block, and panels in one block.
_PAIRS, _PANELS = 1 << 17, 1 << 14
# Cost of a pair in terms of other kernels, for the choice of an engine.
_TERMS = 16
# Tolerance of integrals along edges over the tolerance of the field, since they may cancel.
_FRACTION = 1e-2
# The other of Rayleigh and Sommerfeld's conditions, whose field is the derivative in z.
_OTHER = {"rayleigh-sommerfeld-1": "rayleigh-sommerfeld-2"}
_OTHER |= {second: first for first, second in _OTHER.items()}


@dataclass(frozen=True)
class EdgeIntegrals:
    """Integrals of u times functions of R along m panels, for n points: (n, m) each.

    Lengths in wavelengths, G = exp(2 pi i R)/R.
    """

    where: NDArray[np.intp]
    """Numbers of the points (n,)."""
    points: Floats
    """Points (n, 3), relative to the centre of the source."""
    begin: Floats
    """First ends of the panels (m, 2), relative to the centre of the source."""
    along: Floats
    """Directions of the panels (m, 2)."""
    plane: Floats
    """Direction cosines p_x and p_y of the waves (m, 2)."""
    cosine: Complex
    """Direction cosines p_z (m,)."""
    wave: Complex
    """Integrals of u G."""
    rise: Complex
    """Integrals of h = u (1/R - 2 pi i) G/R."""
    rise_by_length: Complex
    """Integrals of t h, with t the length from the first end."""

    @property
    def normal(self) -> Floats:
        """Outward normals of the panels, (m, 2)."""
        return np.stack([self.along[:, 1], -self.along[:, 0]], axis=1)


def edge_integrals(
    radiator: Radiator, points: Floats, wavelength: float, tolerance: float
) -> Iterator[EdgeIntegrals]:
    """Integrals along all panels of a source, for blocks of points (n, 3) in m and of panels."""
    digits = -math.log(max(tolerance * _FRACTION, 1e-14))
    x, y = radiator.centre.tolist()
    entered = point_in_wavelengths(_OPS, (x, y), wavelength, *points.T)
    relative = np.stack([high for high, _ in entered], axis=1)
    waves = np.exp(2j * math.pi * phases.reduced(_OPS, distance_of(_OPS, entered)))[:, None]
    for where, longest in strata_of(radiator, points, wavelength, False):
        for rows, amplitudes, evanescent in panels_of(
            radiator, wavelength, longest, _PANELS, False
        ):
            along = (rows[:, 5:7] * rows[:, 2:4]).sum(axis=1)
            columns = [*rows[:, :5].T, along, rows[:, 11]]
            step = max(1, _PAIRS // len(rows))
            for start in range(0, len(where), step):
                some = where[start : start + step]
                pairs = [*relative[some].T[..., None], *(column[None] for column in columns)]
                sums = execution.evaluate(
                    STRIPS,
                    None,
                    [*pairs, np.full((1, 1), digits)],
                    double=True,
                    engine=resolved("auto", len(some) * len(rows), _TERMS),
                    outputs=6,
                )
                yield EdgeIntegrals(
                    some,
                    relative[some],
                    rows[:, :2],
                    rows[:, 2:4],
                    rows[:, 5:7],
                    np.where(evanescent, 1j, 1.0) * rows[:, 7].astype(np.complex128),
                    *(
                        (real + 1j * imag) * amplitudes * waves[some]
                        for real, imag in zip(sums[::2], sums[1::2], strict=True)
                    ),
                )


def field_gradient(
    radiator: Radiator, points: Floats, wavelength: float, method: str, tolerance: float
) -> Complex:
    """Gradient (n, 3) in 1/m of the exact field at points (n, 3): (G6), (G7).

    ``method``: one of the boundary conditions; ``tolerance``: as of :func:`boundary_field`.
    """
    gradient = np.zeros((len(points), 3), np.complex128)
    for axis in range(3):
        carried = _carried(radiator, wavelength, axis)
        if any(element.amplitudes.any() for element in carried.elements):
            name = method if axis < 2 else _OTHER.get(method, method)
            how = (wavelength, name, tolerance, True, "auto")
            gradient[:, axis] = boundary_field(carried, points, *how)[0]
    condition = OBLIQUITIES[method]
    of_field = condition.field / (2 * math.pi)
    for sums in edge_integrals(radiator, points, wavelength, tolerance):
        z, inward = sums.points[:, 2:], -sums.normal
        kernel = of_field * z * sums.rise - 1j * condition.slope * sums.cosine * sums.wave
        gradient[sums.where, :2] += kernel @ inward / wavelength
        distance = (sums.begin * inward).sum(axis=1) - sums.points[:, :2] @ inward.T
        across = (sums.plane * inward).sum(axis=1)
        height = distance * sums.rise + 2j * math.pi * across * sums.wave
        gradient[sums.where, 2] += of_field * height.sum(axis=1) / wavelength
    return gradient


def _carried(radiator: Radiator, wavelength: float, axis: int) -> Radiator:
    """A source whose waves are multiplied by 2 pi i times their frequencies along an axis."""
    elements = []
    for element in radiator.elements:
        rates = (
            element.frequencies.T[axis]
            if axis < 2
            else (cosines_of(element.frequencies, wavelength, False) / wavelength)
        )
        elements.append(replace(element, amplitudes=element.amplitudes * (2j * math.pi * rates)))
    return replace(radiator, elements=tuple(elements))
