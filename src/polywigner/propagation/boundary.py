"""Rayleigh-Sommerfeld, Kirchhoff and Fresnel fields as boundary integrals, to a tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution.choice import resolved
from polywigner.execution.progress import told
from polywigner.illumination.obliquities import OBLIQUITIES
from polywigner.kernels.boundary import integrals
from polywigner.kernels.boundary.integrals import fresnel_edge_sum
from polywigner.kernels.kernel import Kernel
from polywigner.numerics.nodes import gauss_rules
from polywigner.propagation.panels import Radiator, panels_of

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# An edge costs about as much as so many terms of other kernels, for the choice of an engine.
_TERMS = 16
_PARAXIAL = ("fresnel", "collins")
# Most turns of phase on half a panel of Fresnel fields.
_FRESNEL_TURNS = 60.0
_MOST_ROWS = 1 << 20
# Most panels of other fields: 2 GB, and a second of a core for each point.
_MOST_PANELS = 1 << 24
# Panels as long as twice the distance need the fewest nodes in all; (upper end of a stratum of
# distance, longest panel there), in wavelengths.
_STRATA = ((3.0, 3.0), (6.0, 6.0), (math.inf, 12.0))
# Rows of a table at a time.
_ROWS = 1 << 14
# Points that miss their tolerance are computed again with so much higher demands, so many times.
_HARDER, _ROUNDS = 1.6, 4
# In the accuracy demanded of panels, for the sum over them and the estimate's caution.
_MARGIN = 2.7

# Pairs of a point and a panel in one computation, which Ctrl-C cannot interrupt: about a second on
# two cores; but not so few points that setting it up takes longer than computing them.
_MOST_PAIRS, _FEWEST_POINTS = 1 << 20, 1 << 12


@dataclass(frozen=True)
class _Panels:
    """A block of :func:`panels_of`."""

    rows: Floats
    amplitudes: NDArray[np.complex128]
    evanescent: NDArray[np.bool_]
    centre: tuple[float, float]
    wavelength: float


@dataclass(frozen=True)
class _Task:
    """Settings that all points share."""

    radiator: Radiator
    wavelength: float
    kernel: Kernel
    paraxial: bool
    double: bool
    engine: str


def boundary_field(
    radiator: Radiator,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    double: bool,
    engine: str,
) -> tuple[NDArray[np.complex128], Floats, Floats]:
    """Field at points (n, 3), estimate of its error, and allowed error, all (n,).

    ``tolerance``: what is allowed as a fraction of the incident amplitude or, where that is less,
    of what could come from all of the source. ``method`` "collins": Fresnel's field without the
    phase of its distance.
    """
    paraxial = method in _PARAXIAL
    # phases of Fresnel's parabolas far off the axis are worth float64 in any case
    edges = sum(e.edges for e in radiator.elements)
    engine = resolved(engine, len(points), _TERMS * edges)
    task = _Task(radiator, wavelength, _kernel(method), paraxial, double or paraxial, engine)
    values = np.zeros(len(points), np.complex128)
    errors = np.full(len(points), np.inf)
    allowed = tolerance * _size(radiator, points, wavelength, _share_of_field(method))
    if not paraxial:
        _check_panels(radiator, wavelength)
    for todo, longest in strata_of(radiator, points, wavelength, paraxial):
        digits = math.log(1 / tolerance) + _MARGIN
        for _ in range(_ROUNDS):
            value, error = _once(task, points[todo], digits, longest)
            better = error < errors[todo]
            values[todo[better]], errors[todo[better]] = value[better], error[better]
            todo = todo[~(errors[todo] <= allowed[todo])]
            if not len(todo):
                break
            digits *= _HARDER
    return values, errors, allowed


def _size(radiator: Radiator, points: Floats, wavelength: float, share: float) -> Floats:
    """The incident amplitude, or where that is less, the bound on the source's whole field.

    That is a wave and, of the normal derivative of a wave, the static field that is all there is
    well within a wavelength of a small source.
    """
    distance = radiator.distance_of_centre(points)
    whole = radiator.content / distance * (1 / wavelength + share / (2 * math.pi * distance))
    return np.minimum(radiator.amplitude, whole)


def _check_panels(radiator: Radiator, wavelength: float) -> None:
    around = radiator.perimeter / wavelength
    if not around <= _MOST_PANELS * _STRATA[-1][1]:
        raise ArgumentError(
            f"expected edges of at most {_MOST_PANELS * _STRATA[-1][1]:.3g} wavelengths in all, "
            f"got {around:.3g}, of which a field is more than can be summed up; check the unit "
            "of the wavelength"
        )


def strata_of(
    radiator: Radiator, points: Floats, wavelength: float, paraxial: bool
) -> Iterator[tuple[Indices, float]]:
    """Numbers of points, and how long panels may be for them, in wavelengths."""
    if paraxial:
        yield from _paraxial_strata(radiator, points, wavelength)
        return
    distance = radiator.distance(points) / wavelength
    low = 0.0
    for high, longest in _STRATA:
        mine = np.flatnonzero((low <= distance) & (distance < high))
        low = high
        if len(mine):
            yield mine, longest


def _paraxial_strata(
    radiator: Radiator, points: Floats, wavelength: float
) -> Iterator[tuple[Indices, float]]:
    """:func:`strata_of` Fresnel fields: phases run as fast along an edge as it is seen aslant."""
    steepest = wavelength * radiator.highest_frequency
    aside = np.maximum(points[:, :2] - radiator.low, radiator.high - points[:, :2])
    slope = np.linalg.norm(aside, axis=1) / points[:, 2] + steepest
    with np.errstate(divide="ignore"):  # seen straight
        longest = np.minimum(2 * _FRESNEL_TURNS / slope, _STRATA[-1][1])
    step = np.ceil(-np.log2(longest / _STRATA[-1][1])).astype(np.intp)
    if radiator.perimeter / (wavelength * float(longest.min(initial=1.0))) > _MOST_ROWS:
        worst = int(longest.argmin())
        raise ArgumentError(
            "expected points where Fresnel's parabolic waves can be summed up, got "
            f"{points[worst].tolist()}, from where the source is seen at a slope of "
            f'{slope[worst]:.3g}; use method="kirchhoff"'
        )
    for number in np.unique(step):
        yield np.flatnonzero(step == number), _STRATA[-1][1] / 2.0 ** int(number)


def _share_of_field(method: str) -> float:
    """The share of the second boundary term (B3); Fresnel fields have none."""
    return OBLIQUITIES[method].field if method in OBLIQUITIES else 0.0


def _kernel(method: str) -> Kernel:
    share = _share_of_field(method)
    paraxial = method in _PARAXIAL
    edge_sum = fresnel_edge_sum if paraxial else integrals.edge_sum
    return Kernel(
        name=f"boundary integral, {method}",
        dimension=3,
        tables=lambda panels, double: _tables(panels, double, share, paraxial),
        enter=integrals.enter,
        edge_sum=edge_sum,
        leave=integrals.leave_phase if method == "collins" else integrals.leave,
    )


def _once(
    task: _Task, points: Floats, digits: float, longest: float
) -> tuple[NDArray[np.complex128], Floats]:
    """The field with errors of about exp(-digits), from panels up to ``longest`` wavelengths."""
    x, y = task.radiator.centre.tolist()
    values = np.zeros(len(points), np.complex128)
    errors = np.zeros(len(points))
    blocks = panels_of(task.radiator, task.wavelength, longest, _ROWS, task.paraxial)
    for rows, amplitudes, evanescent in blocks:
        panels = _Panels(rows, amplitudes, evanescent, (x, y), task.wavelength)
        step = max(_FEWEST_POINTS, _MOST_PAIRS // len(rows))
        parts = [slice(low, low + step) for low in range(0, len(points), step)]
        with told("points", parts) as each:
            for some in each:
                real, imag, error = execution.evaluate(
                    task.kernel,
                    panels,
                    [*points[some].T, np.asarray(digits)],
                    double=task.double,
                    engine=task.engine,
                    outputs=3,
                )
                values[some] += real + 1j * imag
                errors[some] += error
    return values, errors


def panels_in(radiator: Radiator, wavelength: float, longest: float) -> float:
    """Bound on the number of panels up to ``longest`` wavelengths, once for each wave."""
    edges = sum(element.edges for element in radiator.elements)
    return edges + radiator.perimeter / (longest * wavelength)


def boundary_tables(
    radiator: Radiator, wavelength: float, longest: float, double: bool, share: float
) -> integrals.BoundaryTables:
    """All panels of a source as one kernel's tables; ``share`` as `BoundaryTables` has it."""
    blocks = list(panels_of(radiator, wavelength, longest, _ROWS, False))
    rows, amplitudes, evanescent = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    x, y = radiator.centre.tolist()
    panels = _Panels(rows, amplitudes, evanescent, (x, y), wavelength)
    return _tables(panels, double, share, False)


def _tables(
    panels: _Panels, double: bool, share: float, paraxial: bool
) -> integrals.BoundaryTables:
    rows, amplitudes = panels.rows, panels.amplitudes / (2 * math.pi)
    cosines, rests = rows[:, 5:8], rows[:, 8:11]
    high = cosines if double else cosines.astype(np.float32).astype(np.float64)
    pairs = np.stack([high, (cosines - high) + rests], axis=2).reshape(len(rows), 6)
    last = np.stack([amplitudes.real, amplitudes.imag, panels.evanescent], axis=1)
    columns = np.concatenate([rows[:, :5], pairs, rows[:, 11:], last], axis=1)
    edges = tuple(map(tuple, columns.tolist()))
    frame = integrals.BoundaryFrame(panels.centre, panels.wavelength, double, paraxial)
    return integrals.BoundaryTables(frame, edges, gauss_rules(), share)
