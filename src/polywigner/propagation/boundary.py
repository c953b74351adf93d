"""Fields as boundary integrals (B1) to (B6), computed to a tolerance.

Steepest descent integrates along entire edges. Edges are divided into panels for points close to
the source plane, and for grazing and evanescent waves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.execution import NumpyOperations
from polywigner.execution.choice import resolved
from polywigner.execution.progress import with_progress
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import check_most
from polywigner.geometry.rings import edges_of_rings
from polywigner.kernels.boundary import integrals
from polywigner.kernels.boundary.steepest_descent import steepest_edge_sum
from polywigner.kernels.kernel import Kernel
from polywigner.numerics import Complex, Floats, Indices, index_blocks, phases
from polywigner.numerics.nodes import gauss_rules
from polywigner.radiometry.directions import checked_source
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import OBLIQUITIES, direction_cosines

FieldEstimate = tuple[Complex, Floats, Floats]
"""Field at points, estimated error and allowed error, each of shape (n,)."""
_OPS = NumpyOperations()


@dataclass(frozen=True)
class _Element:
    """Copies of an outline with a field that is a sum of m plane waves."""

    outline: Aperture
    amplitudes: Complex
    """Amplitudes of the plane waves, shape (m,)."""
    frequencies: Floats
    """Spatial frequencies in 1/m, shape (m, 2)."""
    shifts: Floats
    """Positions of the copies in m, shape (n, 2)."""
    weights: Complex
    """Weights of the copies, shape (n,)."""

    @property
    def edges(self) -> int:
        """Number of edges times number of plane waves, for all copies."""
        return sum(map(len, self.outline.rings)) * len(self.amplitudes) * len(self.weights)


@dataclass(frozen=True)
class Radiator:
    """A source in the plane z = 0, represented by outlines and plane waves."""

    elements: tuple[_Element, ...]
    low: Floats
    """Lower corner of the bounding box in m, shape (2,)."""
    high: Floats
    """Upper corner of the bounding box in m, shape (2,)."""

    @property
    def centre(self) -> Floats:
        """Centre of the bounding box in m, shape (2,)."""
        return self.low / 2 + self.high / 2

    @property
    def amplitude(self) -> float:
        """Upper bound on |u| over all elements."""
        return max(
            float(np.abs(e.weights).max() * np.abs(e.amplitudes).sum()) for e in self.elements
        )

    @property
    def content(self) -> float:
        """Upper bound on the modulus of the source's Fourier transform."""
        return sum(
            float(np.abs(e.weights).sum() * np.abs(e.amplitudes).sum()) * e.outline.area
            for e in self.elements
        )

    @property
    def highest_frequency(self) -> float:
        """Highest spatial frequency of the plane waves, in 1/m."""
        return max(float(np.linalg.norm(e.frequencies, axis=1).max()) for e in self.elements)

    @property
    def perimeter(self) -> float:
        """Total edge length in m, counted once for each copy and plane wave."""
        return sum(
            e.outline.polygons.length * len(e.amplitudes) * len(e.shifts) for e in self.elements
        )

    def times(self, factor: Callable[[Floats], Any]) -> Radiator:
        """Return a copy with plane waves multiplied by a function of their frequencies (m, 2)."""
        elements = (
            replace(e, amplitudes=e.amplitudes * factor(e.frequencies)) for e in self.elements
        )
        return replace(self, elements=tuple(elements))

    def distance(self, points: Floats) -> Floats:
        """Return the distances (n,) of points (n, 3) from the bounding box, in m."""
        outside = np.maximum(np.maximum(self.low - points[:, :2], points[:, :2] - self.high), 0.0)
        return np.asarray(np.sqrt((outside**2).sum(axis=1) + points[:, 2] ** 2))

    def distance_of_centre(self, points: Floats) -> Floats:
        """Return the distances (n,) of points (n, 3) from the centre of the bounding box, in m."""
        aside = points[:, :2] - self.centre
        return np.asarray(np.sqrt((aside**2).sum(axis=1) + points[:, 2] ** 2))


def radiator_of(source: object) -> Radiator:
    """Return an Aperture or a planar Array as a Radiator; elements of weight zero are omitted.

    Raises ArgumentError for other sources, and GeometryError for elements outside the plane.
    """
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


# Direction cosine p_z below which rounding errors are not estimated.
_GRAZING = 1e-6
# Largest number of phase cycles over half a panel that the largest Gauss rule resolves.
_MOST_CYCLES = 48.0


class _Panels(NamedTuple):
    """Table of panels, one row for each plane wave. Lengths are in wavelengths."""

    rows: Floats
    """First end of the panel relative to the source centre (2), direction (2), length, direction
    cosines p_x, p_y and |p_z| (3), their rounding errors (3), and phase at the first end in cycles.
    Shape (m, 12)."""
    amplitudes: Complex
    """Amplitudes of the plane waves, shape (m,)."""
    evanescent: NDArray[np.bool_]
    """Whether each wave is evanescent, shape (m,)."""


def panels_of(
    radiator: Radiator,
    wavelength: float,
    longest: float,
    count: int,
    paraxial: bool,
    steep: bool | None = None,
) -> Iterator[_Panels]:
    """Yield blocks of about ``count`` panels, each at most ``longest`` wavelengths long.

    ``steep`` selects plane waves within 60 degrees of the normal (True) or all other plane waves
    (False). By default all plane waves are included.
    """
    for element in radiator.elements:
        plane = element.frequencies * wavelength
        cosines = cosines_of(element.frequencies, wavelength, paraxial)
        errors = _cosine_errors(element.frequencies, wavelength, plane, cosines, paraxial)
        piece = np.full(len(plane), longest)
        if math.isfinite(longest):
            piece = np.minimum(longest, _MOST_CYCLES / (1.0 + np.linalg.norm(plane, axis=1)))
        is_steep = cosines.real >= _STEEP_COSINE
        for wave in range(len(plane)) if steep is None else np.flatnonzero(is_steep == steep):
            amplitude = element.amplitudes[wave]
            begin, along, length = _divided_edges(element.outline, wavelength * piece[wave])
            kappa = tuple(element.frequencies[wave])
            cycles = phases.reduced(_OPS, phases.dot(_OPS, kappa, (begin[:, 0], begin[:, 1])))
            for some in index_blocks(len(element.weights), count // len(length)):
                shifts, weights = element.shifts[some], element.weights[some]
                rows = np.empty((len(shifts), len(length), 12))
                rows[..., :2] = ((shifts - radiator.centre)[:, None] + begin) / wavelength
                rows[..., 2:4] = along
                rows[..., 4] = length / wavelength
                rows[..., 5:7] = plane[wave]
                rows[..., 7] = cosines[wave].real + cosines[wave].imag
                rows[..., 8:11] = errors[wave]
                rows[..., 11] = cycles
                amplitudes = np.repeat(weights * amplitude, len(length))
                evanescent = np.full(amplitudes.shape, bool(cosines[wave].imag > 0))
                yield _Panels(rows.reshape(-1, 12), amplitudes, evanescent)


def cosines_of(frequencies: Floats, wavelength: float, paraxial: bool) -> Complex:
    """Return the complex direction cosines p_z (m,) of plane waves with frequencies (m, 2) in 1/m.

    The values of evanescent waves are positive imaginary. The paraxial value is ``1 - (p_x^2 +
    p_y^2)/2``.
    """
    if not paraxial:
        return direction_cosines(frequencies, wavelength)
    return (1 - ((frequencies * wavelength) ** 2).sum(axis=1) / 2).astype(np.complex128)


def _cosine_errors(
    frequencies: Floats, wavelength: float, plane: Floats, cosines: Complex, paraxial: bool
) -> Floats:
    """Return the rounding errors of the direction cosines of m plane waves, shape (m, 3).

    ``plane`` (m, 2) contains p_x and p_y, and ``cosines`` (m,) contains p_z.
    """
    x, y = plane.T
    rest = np.stack([phases.dot(_OPS, (kappa,), (wavelength,))[1] for kappa in frequencies.T])
    lost = -2 * (x * rest[0] + y * rest[1])
    z = cosines.real
    if paraxial:
        total, low = phases.dot(_OPS, (1.0, x, y, z), (2.0, -x, -y, -2.0))
        return np.stack([*rest, (total + (low + lost)) / 2], axis=1)
    total, low = phases.dot(_OPS, (1.0, x, y, z), (1.0, -x, -y, -z))
    upward = np.divide(total + (low + lost), 2 * z, out=np.zeros_like(z), where=z > _GRAZING)
    return np.stack([*rest, upward], axis=1)


def _divided_edges(outline: Aperture, longest: float) -> tuple[Floats, Floats, Floats]:
    """Return the first ends (n, 2), directions (n, 2) and lengths (n,) of pieces of the edges.

    Lengths are in m; ``longest`` is the largest length of a piece, and directions are unit vectors.
    """
    begin, end = edges_of_rings(outline.rings)
    edge = end - begin
    length = np.hypot(edge[:, 0], edge[:, 1])
    pieces = np.maximum(np.ceil(length / longest), 1.0).astype(np.intp)
    owner = np.repeat(np.arange(len(edge)), pieces)
    number = np.arange(len(owner)) - np.repeat(pieces.cumsum() - pieces, pieces)
    first = begin[owner] + (number / pieces[owner])[:, None] * edge[owner]
    return first, (edge / length[:, None])[owner], (length / pieces)[owner]


# Cost of an edge in a boundary integral, relative to its cost in a Fourier transform.
_TERMS = 16
# Largest number of panels, which take 2 GB of memory, and one second per point on one core.
_MOST_PANELS = 1 << 24
# Pairs (upper limit of the distance from the source, length of the longest panels) [wavelengths].
# Panels twice as long as the distance need the fewest nodes.
_STRATA = ((3.0, 3.0), (6.0, 6.0), (math.inf, 12.0))
# Number of panels per block.
_ROWS = 1 << 14
# Factor by which the number of digits grows in each round of refinement, and largest number of
# rounds.
_HARDER, _ROUNDS = 1.6, 4
# Additional digits per panel [natural logarithm], because the errors of panels add up.
_MARGIN = 2.7
# Number of pairs (point, panel) per call. The call takes about one second on two cores, during
# which Ctrl-C has no effect. Fewer than _FEWEST_POINTS points take less time than the overhead of a
# call.
_MOST_PAIRS, _FEWEST_POINTS = 1 << 20, 1 << 12
# Smallest height [wavelengths] and smallest direction cosine p_z for steepest descent. These limits
# bound the stationary phase N'/2 of (B3) from below.
_STEEP_HEIGHT, _STEEP_COSINE = 16.0, 0.5
# Number of rounds of steepest descent after which panels are used instead.
_STEEP_ROUNDS = 2


def boundary_field(
    radiator: Radiator,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    engine: str,
) -> FieldEstimate:
    """Compute the field of a source at points (n, 3) in m by boundary integrals.

    ``tolerance`` is relative to the smaller of the incident amplitude and the bound on the field.
    Errors above the allowed errors are returned without a warning.
    """
    if method != "fresnel":
        return _by_edge_sums(radiator, points, wavelength, method, tolerance, engine)
    spread = wavelength * points[:, 2]
    estimate = parabolic_field(radiator, points[:, :2], spread, tolerance, engine)
    x, y = radiator.centre.tolist()
    point = integrals.point_in_wavelengths(_OPS, (x, y), wavelength, *points.T)
    cycles = phases.reduced(_OPS, integrals.paraxial_distance(_OPS, point))
    return estimate[0] * np.exp(2j * math.pi * cycles), *estimate[1:]


def parabolic_field(
    radiator: Radiator,
    points: Floats,
    spread: Floats,
    tolerance: float,
    engine: str,
) -> FieldEstimate:
    """Compute the Fresnel field of a source at points (n, 2), without its quadratic phase.

    The field at y is ``int u(x) exp(i pi |y - x|^2/spread) dx/(i spread)``, divided by ``exp(i pi
    |y - c|^2/spread)``, where c is the centre of the source. ``spread`` (n,) is the wavelength
    times the distance of the plane, in m^2.
    """
    # The kernel's unit of length is the source size instead of the wavelength.
    size = float((radiator.high - radiator.low).max())
    scaled = np.column_stack([points, spread / size])
    return _by_edge_sums(radiator, scaled, size, "fresnel", tolerance, engine)


def _by_edge_sums(
    radiator: Radiator,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    engine: str,
) -> FieldEstimate:
    """Compute the field at points by steepest descent, or by panels if descent is inaccurate."""
    paraxial = method == "fresnel"
    # Weight of the second boundary term of (B3), which is absent in Fresnel fields.
    second_term = OBLIQUITIES[method].field if method in OBLIQUITIES else 0.0
    cycles, most = radiator.perimeter / wavelength, _MOST_PANELS * _STRATA[-1][1]
    if not paraxial:
        things = "wavelengths along all edges of the source"
        check_most(cycles, most, things, "check the unit of the wavelength")
    edges = _TERMS * sum(element.edges for element in radiator.elements)
    chosen = resolved(engine, len(points), edges)
    edge_sums = partial(_edge_sums, radiator, wavelength, second_term, paraxial, chosen)
    # The bound on the field includes the static field, which dominates within a wavelength of the
    # source.
    distance = points[:, 2] if paraxial else radiator.distance_of_centre(points)
    bound = radiator.content / distance * (1 / wavelength + second_term / (2 * math.pi * distance))
    allowed = tolerance * np.minimum(radiator.amplitude, bound)
    values, errors = np.zeros(len(points), np.complex128), np.full(len(points), np.inf)

    def improve(some: Indices, field: Callable[..., tuple[Complex, Floats]], rounds: int) -> None:
        """Recompute ``some`` points, with more digits in each round, while errors are too large."""
        digits = math.log(1 / tolerance) + _MARGIN
        for _ in range(rounds):
            if not len(some):
                return
            value, error = field(points[some], digits)
            better = error < errors[some]
            values[some[better]], errors[some[better]] = value[better], error[better]
            some = some[~(errors[some] <= allowed[some])]
            digits *= _HARDER

    def by_steepest_descent(points: Floats, digits: float) -> tuple[Complex, Floats]:
        """Return the field at points and its error; use panels for grazing and evanescent waves."""
        if paraxial:
            return edge_sums(points, digits, steepest_edge_sum, math.inf)
        steep = edge_sums(points, digits, steepest_edge_sum, math.inf, True)
        shallow = edge_sums(points, digits, integrals.edge_sum, _STRATA[-1][1], False)
        return steep[0] + shallow[0], steep[1] + shallow[1]

    if paraxial:
        improve(np.arange(len(points)), by_steepest_descent, _ROUNDS)
        return values, errors, allowed
    far = np.flatnonzero(points[:, 2] >= _STEEP_HEIGHT * wavelength)
    improve(far, by_steepest_descent, _STEEP_ROUNDS)
    missing = np.flatnonzero(~(errors <= allowed))
    for some, longest in strata_of(radiator, points[missing], wavelength):
        over_panels = partial(edge_sums, edge_sum=integrals.edge_sum, longest=longest)
        improve(missing[some], over_panels, _ROUNDS)
    return values, errors, allowed


def _edge_sums(
    radiator: Radiator,
    wavelength: float,
    second_term: float,
    paraxial: bool,
    engine: str,
    points: Floats,
    digits: float,
    edge_sum: Callable[..., integrals.Values],
    longest: float,
    steep: bool | None = None,
) -> tuple[Complex, Floats]:
    """Return the field at points as a sum over panels, and its estimated error, about exp(-digits).

    ``longest`` is in wavelengths. ``steep`` selects plane waves, as in :func:`panels_of`.
    """
    kernel = Kernel(
        name=f"boundary integral, {edge_sum.__name__}",
        dimension=3,
        tables=lambda panels, double: _kernel_tables(
            panels, radiator, wavelength, double, second_term, paraxial
        ),
        enter=integrals.enter,
        edge_sum=edge_sum,
        leave=integrals.leave_phase if paraxial else integrals.leave,
    )
    field, error = np.zeros(len(points), np.complex128), np.zeros(len(points))
    for panels in panels_of(radiator, wavelength, longest, _ROWS, paraxial, steep):
        blocks = index_blocks(len(points), max(_FEWEST_POINTS, _MOST_PAIRS // len(panels.rows)))
        with with_progress("points", blocks) as remaining:
            for block in remaining:
                real, imag, estimate = execution.evaluate(
                    kernel,
                    panels,
                    [*points[block].T, np.asarray(digits)],
                    double=True,
                    engine=engine,
                    outputs=3,
                )
                field[block] += real + 1j * imag
                error[block] += estimate
    return field, error


def strata_of(
    radiator: Radiator, points: Floats, wavelength: float
) -> Iterator[tuple[Indices, float]]:
    """Yield indices of points at similar distances, and their panel length [wavelengths]."""
    distance = radiator.distance(points) / wavelength
    low = 0.0
    for high, longest in _STRATA:
        members = np.flatnonzero((low <= distance) & (distance < high))
        low = high
        if len(members):
            yield members, longest


def panels_in(radiator: Radiator, wavelength: float, longest: float) -> float:
    """Return the largest possible number of pairs (panel, wave).

    Panels are up to ``longest`` wavelengths long.
    """
    edges = sum(element.edges for element in radiator.elements)
    return edges + radiator.perimeter / (longest * wavelength)


def boundary_tables(
    radiator: Radiator, wavelength: float, longest: float, double: bool, second_term: float
) -> integrals.BoundaryTables:
    """Return all panels of a source as kernel tables, for float64 if ``double``, else for float32.

    ``second_term`` is the factor m of the second boundary term of (B3).
    """
    blocks = panels_of(radiator, wavelength, longest, _ROWS, False)
    panels = _Panels(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))
    return _kernel_tables(panels, radiator, wavelength, double, second_term, False)


def _kernel_tables(
    panels: _Panels,
    radiator: Radiator,
    wavelength: float,
    double: bool,
    second_term: float,
    paraxial: bool,
) -> integrals.BoundaryTables:
    """Return panels as tables of the kernel, for float64 if ``double``, otherwise for float32.

    Direction cosines are sums of two floats.
    """
    rows, amplitudes = panels.rows, panels.amplitudes / (2 * math.pi)
    cosines, errors = rows[:, 5:8], rows[:, 8:11]
    high = cosines if double else cosines.astype(np.float32).astype(np.float64)
    pairs = np.stack([high, (cosines - high) + errors], axis=2).reshape(len(rows), 6)
    last = np.stack([amplitudes.real, amplitudes.imag, panels.evanescent], axis=1)
    columns = np.concatenate([rows[:, :5], pairs, rows[:, 11:], last], axis=1)
    edges = tuple(map(tuple, columns.tolist()))
    x, y = radiator.centre.tolist()
    frame = integrals.BoundaryFrame((x, y), wavelength, double, paraxial)
    return integrals.BoundaryTables(frame, edges, gauss_rules(), second_term)
