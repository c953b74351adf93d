"""Fields as boundary integrals, to a tolerance: edges cut into panels with the waves along them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import NumpyOperations
from polywigner.execution.choice import resolved
from polywigner.execution.progress import told
from polywigner.geometry import Aperture
from polywigner.kernels.boundary import integrals
from polywigner.kernels.boundary.integrals import fresnel_edge_sum
from polywigner.kernels.kernel import Kernel
from polywigner.numerics import phases
from polywigner.numerics.nodes import gauss_rules
from polywigner.radiometry.directions import checked_source
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import DEFAULT, OBLIQUITIES, direction_cosines

Floats = NDArray[np.float64]
Block = tuple[Floats, NDArray[np.complex128], NDArray[np.bool_]]
_OPS = NumpyOperations(double=True)

# Rounding leaves few digits of smaller cosines; waves that graze the plane have p_z = 0.
_GRAZING = 1e-6
# With so many turns of phase on half a panel, the largest rule still has nodes to spare.
_TURNS = 48.0


@dataclass(frozen=True)
class _Element:
    """An outline with its waves, at shifts (n, 2) with weights (n,)."""

    outline: Aperture
    amplitudes: NDArray[np.complex128]
    frequencies: Floats
    shifts: Floats
    weights: NDArray[np.complex128]

    @property
    def edges(self) -> int:
        """Number of edges of all copies, once for each wave."""
        return sum(map(len, self.outline.rings)) * len(self.amplitudes) * len(self.weights)


@dataclass(frozen=True)
class Radiator:
    """A source of the plane z = 0 as outlines with waves."""

    elements: tuple[_Element, ...]
    low: Floats
    """Corners (2,) of the box around it."""
    high: Floats

    @property
    def centre(self) -> Floats:
        return self.low / 2 + self.high / 2

    @property
    def amplitude(self) -> float:
        """Bound on the field of any one element."""
        return max(
            float(np.abs(e.weights).max() * np.abs(e.amplitudes).sum()) for e in self.elements
        )

    @property
    def content(self) -> float:
        """Bound on the modulus of the Fourier transform."""
        return sum(
            float(np.abs(e.weights).sum() * np.abs(e.amplitudes).sum()) * e.outline.area
            for e in self.elements
        )

    @property
    def highest_frequency(self) -> float:
        """Highest frequency of all waves, in cycles per metre."""
        return max(float(np.linalg.norm(e.frequencies, axis=1).max()) for e in self.elements)

    @property
    def perimeter(self) -> float:
        """Edges of all copies, once for each of their waves."""
        return sum(
            e.outline.polygons.length * len(e.amplitudes) * len(e.shifts) for e in self.elements
        )

    def distance(self, points: Floats) -> Floats:
        """From points (n, 3) to the box around the source."""
        x, y, z = points.T
        aside = np.maximum(np.maximum(self.low[0] - x, x - self.high[0]), 0.0)
        beside = np.maximum(np.maximum(self.low[1] - y, y - self.high[1]), 0.0)
        return np.sqrt(aside * aside + beside * beside + z * z)

    def distance_of_centre(self, points: Floats) -> Floats:
        """Distance of points (n, 3) from the centre of the box, (n,)."""
        x, y, z = points.T
        dx, dy = x - self.centre[0], y - self.centre[1]
        return np.sqrt(dx * dx + dy * dy + z * z)


def radiator_of(source: object) -> Radiator:
    """The radiating outlines of an Aperture, or of an Array in the plane z = 0."""
    form = normal_form(checked_source(source)).in_plane
    copies = [(e, np.zeros((1, 2)), np.array([e.weight])) for e in form.distinct]
    if form.repeated is not None:
        copies = [(form.repeated.element, form.repeated.positions, form.weights)]
    elements = tuple(
        _Element(e.shape, e.amplitudes, e.frequencies, shifts[w != 0], w[w != 0])
        for e, shifts, w in copies
        if w.any()
    )
    low, high = np.reshape(form.bounds, (2, 2))
    return Radiator(elements, low, high)


def panels_of(
    radiator: Radiator, wavelength: float, longest: float, count: int, paraxial: bool
) -> Iterator[Block]:
    """Panels times waves in blocks of at most about ``count``.

    ``longest``: of a panel, in wavelengths. Each block is (m, 12) floats: beginning x, y relative
    to the centre, direction x, y, length, p_x, p_y, |p_z|, what these miss by rounding, phase at
    the beginning in turns, all in wavelengths; amplitudes (m,); and which waves are evanescent
    (m,).
    ``paraxial``: with 1 - (p_x^2 + p_y^2)/2 in place of |p_z|, and none evanescent.
    """
    for element in radiator.elements:
        plane = element.frequencies * wavelength
        cosines = cosines_of(element.frequencies, wavelength, paraxial)
        rests = _rests_of(element.frequencies, wavelength, plane, cosines, paraxial)
        reach = reaches(plane, longest)
        for wave, amplitude in enumerate(element.amplitudes):
            pieces = pieces_of(element.outline, wavelength * reach[wave])
            begin, along, length = pieces.begin, pieces.along, pieces.length
            start = starts(begin, element.frequencies[wave])
            step = max(1, count // len(length))
            for first in range(0, len(element.weights), step):
                shifts = element.shifts[first : first + step]
                weights = element.weights[first : first + step]
                places = ((shifts - radiator.centre)[:, None] + begin) / wavelength
                rows = np.empty((len(shifts), len(length), 12))
                rows[..., :2] = places
                rows[..., 2:4] = along
                rows[..., 4] = length / wavelength
                rows[..., 5:7] = plane[wave]
                rows[..., 7] = cosines[wave].real + cosines[wave].imag  # one of them is 0
                rows[..., 8:11] = rests[wave]
                rows[..., 11] = start
                amplitudes = np.repeat(weights * amplitude, len(length))
                evanescent = np.full(amplitudes.shape, bool(cosines[wave].imag > 0))
                yield rows.reshape(-1, 12), amplitudes, evanescent


def cosines_of(frequencies: Floats, wavelength: float, paraxial: bool) -> NDArray[np.complex128]:
    """p_z of waves (m, 2); with ``paraxial`` 1 - (p_x^2 + p_y^2)/2."""
    if not paraxial:
        return direction_cosines(frequencies, wavelength)
    return (1 - ((frequencies * wavelength) ** 2).sum(axis=1) / 2).astype(np.complex128)


def _rests_of(
    frequencies: Floats,
    wavelength: float,
    plane: Floats,
    cosines: NDArray[np.complex128],
    paraxial: bool,
) -> Floats:
    """The parts of p_x, p_y and p_z of waves that rounding leaves out, (m, 3)."""
    x, y = plane.T
    rest = np.stack([phases.dot(_OPS, (kappa,), (wavelength,))[1] for kappa in frequencies.T])
    lost = -2 * (x * rest[0] + y * rest[1])
    z = cosines.real
    if paraxial:
        # 2 p_z = 2 - p_x^2 - p_y^2
        total, low = phases.dot(_OPS, (1.0, x, y, z), (2.0, -x, -y, -2.0))
        return np.stack([*rest, (total + (low + lost)) / 2], axis=1)
    total, low = phases.dot(_OPS, (1.0, x, y, z), (1.0, -x, -y, -z))
    upward = np.divide(total + (low + lost), 2 * z, out=np.zeros_like(z), where=z > _GRAZING)
    return np.stack([*rest, upward], axis=1)


def reaches(plane: Floats, longest: float) -> Floats:
    """Longest panels in wavelengths for waves with p_x, p_y (m, 2)."""
    return np.minimum(longest, _TURNS / (1.0 + np.linalg.norm(plane, axis=1)))


def starts(begin: Floats, kappa: Floats) -> Floats:
    """The phase of a wave at places (n, 2), in turns from -1/2 to 1/2."""
    turns = phases.dot(_OPS, tuple(kappa), (begin[:, 0], begin[:, 1]))
    return np.broadcast_to(phases.reduced(_OPS, turns), len(begin))


class Pieces(NamedTuple):
    """Pieces of the edges of an outline: beginnings (n, 2), directions (n, 2), lengths (n,)."""

    begin: Floats
    along: Floats
    length: Floats


def pieces_of(outline: Aperture, longest: float) -> Pieces:
    """Pieces of an outline's edges, none longer than ``longest``."""
    begin = np.concatenate(outline.rings)
    edge = np.concatenate([np.roll(ring, -1, axis=0) for ring in outline.rings]) - begin
    length = np.hypot(edge[:, 0], edge[:, 1])
    pieces = np.ceil(length / longest).astype(np.intp)
    owner = np.repeat(np.arange(len(edge)), pieces)
    number = np.arange(len(owner)) - np.repeat(pieces.cumsum() - pieces, pieces)
    share = number / pieces[owner]
    return Pieces(
        begin[owner] + share[:, None] * edge[owner],
        (edge / length[:, None])[owner],
        (length / pieces)[owner],
    )


Indices = NDArray[np.intp]

# An edge costs about as much as so many terms of other kernels, for the choice of an engine.
_TERMS = 16
# Most turns of phase on half a panel of Fresnel fields; and along an outline: 5 s for each point.
_FRESNEL_TURNS, _MOST_TURNS = 60.0, 1e7
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
    of what could come from all of the source.
    """
    if method == "fresnel":
        spread = wavelength * points[:, 2]
        values, errors, allowed = parabolic_field(
            radiator, points[:, :2], spread, tolerance, double, engine
        )
        return values * _phase_of_distance(radiator, points, wavelength), errors, allowed
    return _summed(radiator, points, wavelength, method, tolerance, double, engine)


def parabolic_field(
    radiator: Radiator,
    points: Floats,
    spread: Floats,
    tolerance: float,
    double: bool,
    engine: str,
) -> tuple[NDArray[np.complex128], Floats, Floats]:
    """Field of parabolic waves at points (n, 2), estimate of its error, and allowed error, (n,).

    int u(x) exp(i pi |y - x|^2/spread) dx/(i spread), without the factor exp(i pi |y - c|^2/spread)
    of the centre c. ``spread``: (n,) in m^2, wavelength times distance. The kernel takes the size
    of the source for the wavelength, so that panels are as long as edges.
    """
    size = float((radiator.high - radiator.low).max())
    places = np.column_stack([points, spread / size])
    return _summed(radiator, places, size, "fresnel", tolerance, double, engine)


def _phase_of_distance(
    radiator: Radiator, points: Floats, wavelength: float
) -> NDArray[np.complex128]:
    """exp(2 pi i d), d = z + rho^2/(2 z) in wavelengths, rho from the centre; points (n, 3)."""
    x, y = radiator.centre.tolist()
    place = integrals.point_in_wavelengths(_OPS, (x, y), wavelength, *points.T)
    turns = phases.reduced(_OPS, integrals.paraxial_distance(_OPS, place))
    return np.asarray(np.exp(2j * math.pi * turns))


def _summed(
    radiator: Radiator,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    double: bool,
    engine: str,
) -> tuple[NDArray[np.complex128], Floats, Floats]:
    """:func:`boundary_field`; of "fresnel" without the phase of the distance from the centre."""
    paraxial = method == "fresnel"
    # of the second boundary term (B3), which Fresnel fields do not have
    share = OBLIQUITIES[method].field if method in OBLIQUITIES else 0.0
    # phases of Fresnel's parabolas far off the axis are worth float64 in any case
    edges = sum(e.edges for e in radiator.elements)
    engine = resolved(engine, len(points), _TERMS * edges)
    task = _Task(radiator, wavelength, _kernel(method, share), paraxial, double or paraxial, engine)
    values = np.zeros(len(points), np.complex128)
    errors = np.full(len(points), np.inf)
    allowed = tolerance * _size(radiator, points, wavelength, share, paraxial)
    around, most = radiator.perimeter / wavelength, _MOST_PANELS * _STRATA[-1][1]
    if not (paraxial or around <= most):
        raise ArgumentError(
            f"expected edges of at most {most:.3g} wavelengths in all, got {around:.3g}, whose "
            "field cannot be summed up; check the unit of the wavelength"
        )
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


def _size(
    radiator: Radiator, points: Floats, wavelength: float, share: float, paraxial: bool
) -> Floats:
    """The incident amplitude, or where that is less, the bound on the source's whole field.

    That is a wave and, of the normal derivative of a wave, the static field that is all there is
    well within a wavelength of a small source.
    """
    distance = points[:, 2] if paraxial else radiator.distance_of_centre(points)
    whole = radiator.content / distance * (1 / wavelength + share / (2 * math.pi * distance))
    return np.minimum(radiator.amplitude, whole)


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
    around = radiator.perimeter / wavelength
    turns = around * float(slope.max(initial=0.0))
    if turns > _MOST_TURNS or around > _MOST_ROWS * float(longest.min(initial=1.0)):
        raise ArgumentError(
            f"the parabolic waves of Fresnel's integral have {turns:.3g} turns of phase along the "
            f"outline, at most {_MOST_TURNS:.0e}; use method={DEFAULT!r}, points nearer to the "
            "axis, or a plane farther from the source and its images"
        )
    for number in np.unique(step):
        yield np.flatnonzero(step == number), _STRATA[-1][1] / 2.0 ** int(number)


def _kernel(method: str, share: float) -> Kernel:
    paraxial = method == "fresnel"
    return Kernel(
        name=f"boundary integral, {method}",
        dimension=3,
        tables=lambda panels, double: _tables(panels, double, share, paraxial),
        enter=integrals.enter,
        edge_sum=fresnel_edge_sum if paraxial else integrals.edge_sum,
        leave=integrals.leave_phase if paraxial else integrals.leave,
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
