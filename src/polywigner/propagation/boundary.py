"""Fields as boundary integrals, computed to a tolerance.

The method of steepest descent evaluates the integral along an entire edge. Edges are divided into
panels for points close to the plane of the source, for plane waves that graze this plane, and for
evanescent waves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import NumpyOperations
from polywigner.execution.choice import resolved
from polywigner.execution.progress import with_progress
from polywigner.geometry import Aperture
from polywigner.kernels.boundary import integrals
from polywigner.kernels.boundary.steepest_descent import steepest_edge_sum
from polywigner.kernels.kernel import Kernel
from polywigner.numerics import Complex, Floats, Indices, phases
from polywigner.numerics.nodes import gauss_rules
from polywigner.radiometry.directions import checked_source
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import OBLIQUITIES, direction_cosines

FieldEstimate = tuple[Complex, Floats, Floats]
"""Field at points, estimated error and allowed error; shape (n,) for each array."""
_OPS = NumpyOperations()


# ---- the source as outlines with plane waves ---------------------------------------------------


@dataclass(frozen=True)
class _Element:
    """Copies of one outline, all with the same plane waves."""

    outline: Aperture
    amplitudes: Complex
    """Amplitudes (m,) of the plane waves."""
    frequencies: Floats
    """Spatial frequencies (m, 2) of the plane waves, in 1/m."""
    shifts: Floats
    """Positions (n, 2) of the copies, in m."""
    weights: Complex
    """Complex weights (n,) of the copies."""

    @property
    def edges(self) -> int:
        """Number of edges of all copies, counted once for each plane wave."""
        return sum(map(len, self.outline.rings)) * len(self.amplitudes) * len(self.weights)


@dataclass(frozen=True)
class Radiator:
    """A source in the plane z = 0, as outlines whose fields are sums of plane waves."""

    elements: tuple[_Element, ...]
    low: Floats
    """Lower corner (2,) of the bounding box of the source, in m."""
    high: Floats
    """Upper corner (2,) of the bounding box, in m."""

    @property
    def centre(self) -> Floats:
        return self.low / 2 + self.high / 2

    @property
    def amplitude(self) -> float:
        """Upper bound on the modulus of the field u of any single element."""
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
        """Total length in m of the edges of all copies, counted once for each plane wave."""
        return sum(
            e.outline.polygons.length * len(e.amplitudes) * len(e.shifts) for e in self.elements
        )

    def distance(self, points: Floats) -> Floats:
        """Return the distances of points from the bounding box, in m."""
        outside = np.maximum(np.maximum(self.low - points[:, :2], points[:, :2] - self.high), 0.0)
        return np.asarray(np.sqrt((outside**2).sum(axis=1) + points[:, 2] ** 2))

    def distance_of_centre(self, points: Floats) -> Floats:
        """Return the distances of points from the centre of the bounding box, in m."""
        aside = points[:, :2] - self.centre
        return np.asarray(np.sqrt((aside**2).sum(axis=1) + points[:, 2] ** 2))


def radiator_of(source: object) -> Radiator:
    """Return an Aperture, or an Array in the plane z = 0, as a Radiator."""
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


# ---- division of edges into panels --------------------------------------------------------------

# Smallest direction cosine p_z of a plane wave whose rounding error is estimated. Smaller cosines
# have few correct digits, and p_z = 0 for waves along the plane of the source.
_GRAZING = 1e-6
# Number of cycles of phase over half a panel that the largest Gauss rule resolves with a margin.
_TURNS = 48.0


class _Panels(NamedTuple):
    """Table with one row for each pair of a panel and a plane wave; lengths are in wavelengths."""

    rows: Floats
    """Numbers of each row, shape (m, 12).

    The columns are x and y of the first end of the panel relative to the centre of the source, x
    and y of its direction, its length, the direction cosines p_x, p_y and |p_z| of the wave, the
    rounding errors of these cosines, and the phase of the wave at the first end in cycles.
    """
    amplitudes: Complex
    """Amplitudes (m,) of the plane waves."""
    evanescent: NDArray[np.bool_]
    """Whether each plane wave is evanescent, shape (m,)."""


def panels_of(
    radiator: Radiator,
    wavelength: float,
    longest: float,
    count: int,
    paraxial: bool,
    is_wanted: Callable[[Complex], NDArray[np.bool_]] | None = None,
) -> Iterator[_Panels]:
    """Yield panels of at most ``longest`` wavelengths, in blocks of about ``count`` panels.

    The direction cosines p_z are those of :func:`cosines_of`. ``is_wanted`` selects plane waves by
    p_z.
    """
    for element in radiator.elements:
        plane = element.frequencies * wavelength
        cosines = cosines_of(element.frequencies, wavelength, paraxial)
        errors = _rounding_of(element.frequencies, wavelength, plane, cosines, paraxial)
        reach = np.full(len(plane), longest)
        if math.isfinite(longest):  # Without a limit on the length, each panel is an entire edge.
            reach = np.minimum(longest, _TURNS / (1.0 + np.linalg.norm(plane, axis=1)))
        wanted = np.full(len(plane), True) if is_wanted is None else is_wanted(cosines)
        for wave in np.flatnonzero(wanted):
            amplitude = element.amplitudes[wave]
            begin, along, length = _divided_edges(element.outline, wavelength * reach[wave])
            kappa = tuple(element.frequencies[wave])
            cycles = phases.reduced(_OPS, phases.dot(_OPS, kappa, (begin[:, 0], begin[:, 1])))
            step = max(1, count // len(length))
            for first in range(0, len(element.weights), step):
                shifts = element.shifts[first : first + step]
                weights = element.weights[first : first + step]
                rows = np.empty((len(shifts), len(length), 12))
                rows[..., :2] = ((shifts - radiator.centre)[:, None] + begin) / wavelength
                rows[..., 2:4] = along
                rows[..., 4] = length / wavelength
                rows[..., 5:7] = plane[wave]
                # The direction cosine p_z is either real or imaginary.
                rows[..., 7] = cosines[wave].real + cosines[wave].imag
                rows[..., 8:11] = errors[wave]
                rows[..., 11] = cycles
                amplitudes = np.repeat(weights * amplitude, len(length))
                evanescent = np.full(amplitudes.shape, bool(cosines[wave].imag > 0))
                yield _Panels(rows.reshape(-1, 12), amplitudes, evanescent)


def cosines_of(frequencies: Floats, wavelength: float, paraxial: bool) -> Complex:
    """Return the direction cosines p_z of plane waves with given spatial frequencies.

    If ``paraxial`` is true, the cosine is replaced by ``1 - (p_x^2 + p_y^2)/2``, which is real.
    """
    if not paraxial:
        return direction_cosines(frequencies, wavelength)
    return (1 - ((frequencies * wavelength) ** 2).sum(axis=1) / 2).astype(np.complex128)


def _rounding_of(
    frequencies: Floats, wavelength: float, plane: Floats, cosines: Complex, paraxial: bool
) -> Floats:
    """Return the rounding errors of the direction cosines of plane waves, shape (m, 3)."""
    x, y = plane.T
    rest = np.stack([phases.dot(_OPS, (kappa,), (wavelength,))[1] for kappa in frequencies.T])
    lost = -2 * (x * rest[0] + y * rest[1])
    z = cosines.real
    if paraxial:
        # In the paraxial case, 2 p_z = 2 - p_x^2 - p_y^2.
        total, low = phases.dot(_OPS, (1.0, x, y, z), (2.0, -x, -y, -2.0))
        return np.stack([*rest, (total + (low + lost)) / 2], axis=1)
    total, low = phases.dot(_OPS, (1.0, x, y, z), (1.0, -x, -y, -z))
    upward = np.divide(total + (low + lost), 2 * z, out=np.zeros_like(z), where=z > _GRAZING)
    return np.stack([*rest, upward], axis=1)


def _divided_edges(outline: Aperture, longest: float) -> tuple[Floats, Floats, Floats]:
    """Divide the edges of an outline into pieces of limited length.

    Returns the first ends (n, 2), directions (n, 2) and lengths (n,) of the pieces.
    """
    begin = np.concatenate(outline.rings)
    edge = np.concatenate([np.roll(ring, -1, axis=0) for ring in outline.rings]) - begin
    length = np.hypot(edge[:, 0], edge[:, 1])
    pieces = np.maximum(np.ceil(length / longest), 1.0).astype(np.intp)
    owner = np.repeat(np.arange(len(edge)), pieces)
    number = np.arange(len(owner)) - np.repeat(pieces.cumsum() - pieces, pieces)
    first = begin[owner] + (number / pieces[owner])[:, None] * edge[owner]
    return first, (edge / length[:, None])[owner], (length / pieces)[owner]


# ---- sums over panels ---------------------------------------------------------------------------

# Computing time of the boundary integral along one edge, in units of the time of one edge in a
# Fourier transform. The choice of an engine depends on this ratio.
_TERMS = 16
# Largest number of panels of a source. These panels take 2 GB of memory, and one second per point
# on one core.
_MOST_PANELS = 1 << 24
# Pairs of an upper limit of the distance from the source, and the longest panels for points up to
# this distance, both in wavelengths. Panels twice as long as the distance need the fewest nodes.
_STRATA = ((3.0, 3.0), (6.0, 6.0), (math.inf, 12.0))
# Number of panels per block.
_ROWS = 1 << 14
# If the field at a point misses its tolerance, the number of digits is multiplied by the first
# value and the field is computed again, at most as often as the second value.
_HARDER, _ROUNDS = 1.6, 4
# Additional accuracy of each panel, as minus the natural logarithm of a factor of the error. It is
# needed because the errors of panels add up and the error estimate is conservative.
_MARGIN = 2.7
# Largest number of pairs of a point and a panel per call: about one second on two cores, in which
# Ctrl-C has no effect. With fewer points than _FEWEST_POINTS, setting up a call takes longer than
# the computation.
_MOST_PAIRS, _FEWEST_POINTS = 1 << 20, 1 << 12
# Steepest descent requires points at least this high above the source, in wavelengths, and plane
# waves with at least this direction cosine p_z. The stationary phase is then at least the product
# of both values in cycles, and N' in (B3) is twice the product.
_STEEP_HEIGHT, _STEEP_COSINE = 16.0, 0.5
# Number of attempts by steepest descent. Points that still miss their tolerance are computed with
# panels.
_STEEP_ROUNDS = 2


class _Table(NamedTuple):
    """Panels of a source, as input of a kernel."""

    panels: _Panels
    radiator: Radiator
    wavelength: float


def boundary_field(
    radiator: Radiator,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    engine: str,
) -> FieldEstimate:
    """Compute the field of a source at points (n, 3) by boundary integrals.

    ``tolerance`` is the allowed error as a fraction of the incident amplitude, or of the upper
    bound on the field of the entire source if the bound is smaller.
    """
    if method != "fresnel":
        return _summed(radiator, points, wavelength, method, tolerance, engine)
    spread = wavelength * points[:, 2]
    estimate = parabolic_field(radiator, points[:, :2], spread, tolerance, engine)
    # The phase factor is exp(2 pi i d) with d = z + rho^2/(2 z) in wavelengths, where rho is the
    # distance from the axis through the centre.
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
    """Compute the Fresnel field of a source at points (n, 2) of planes behind it.

    The field at y is ``int u(x) exp(i pi |y - x|^2/spread) dx/(i spread)``, divided by
    ``exp(i pi |y - c|^2/spread)``, where c is the centre of the source. ``spread`` (n,) is the
    wavelength times the distance of the plane, in m^2.
    """
    # The size of the source replaces the wavelength as the unit of length in the kernel.
    size = float((radiator.high - radiator.low).max())
    scaled = np.column_stack([points, spread / size])
    return _summed(radiator, scaled, size, "fresnel", tolerance, engine)


def _summed(
    radiator: Radiator,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    engine: str,
) -> FieldEstimate:
    """Return the field at points, with more digits where the estimated error is too large.

    The "fresnel" field lacks the phase of the distance from the centre of the source.
    """
    paraxial = method == "fresnel"
    # Coefficient of the second boundary term in (B3), which Fresnel fields do not have.
    share = OBLIQUITIES[method].field if method in OBLIQUITIES else 0.0
    cycles, most = radiator.perimeter / wavelength, _MOST_PANELS * _STRATA[-1][1]
    if not (paraxial or cycles <= most):
        raise ArgumentError(
            f"the edges of the source are too long: {cycles:.3g} wavelengths in all, at most "
            f"{most:.3g} are allowed; check the unit of the wavelength"
        )
    sums = _EdgeSums(radiator, wavelength, share, paraxial, len(points), engine)
    # The allowed error is a fraction of the incident amplitude, or of the bound on the source's
    # field if the bound is smaller. The bound is the sum of the radiated field and of the static
    # field, which dominates within a wavelength.
    distance = points[:, 2] if paraxial else radiator.distance_of_centre(points)
    bound = radiator.content / distance * (1 / wavelength + share / (2 * math.pi * distance))
    found = _Estimates(points, tolerance * np.minimum(radiator.amplitude, bound))
    digits = math.log(1 / tolerance) + _MARGIN
    if paraxial:
        found.improve(np.arange(len(points)), sums.by_steepest_descent, digits, _ROUNDS)
        return found.values, found.errors, found.allowed
    far = np.flatnonzero(points[:, 2] >= _STEEP_HEIGHT * wavelength)
    found.improve(far, sums.by_steepest_descent, digits, _STEEP_ROUNDS)
    missing = np.flatnonzero(~(found.errors <= found.allowed))
    for some, longest in strata_of(radiator, points[missing], wavelength):
        panel_sums = partial(sums.over_panels, longest=longest)
        found.improve(missing[some], panel_sums, digits, _ROUNDS)
    return found.values, found.errors, found.allowed


class _Estimates:
    """Fields at points (n, 3), with estimated and allowed errors."""

    def __init__(self, points: Floats, allowed: Floats) -> None:
        self.points, self.allowed = points, allowed
        self.values = np.zeros(len(points), np.complex128)
        self.errors = np.full(len(points), np.inf)

    def improve(
        self,
        some: Indices,
        field: Callable[[Floats, float], tuple[Complex, Floats]],
        digits: float,
        rounds: int,
    ) -> None:
        """Compute the field at selected points, again with more digits if its error is too large.

        ``some`` contains the indices of the points, and ``rounds`` is the largest number of
        attempts.
        """
        for _ in range(rounds):
            if not len(some):
                return
            value, error = field(self.points[some], digits)
            better = error < self.errors[some]
            self.values[some[better]], self.errors[some[better]] = value[better], error[better]
            some = some[~(self.errors[some] <= self.allowed[some])]
            digits *= _HARDER


def _is_steep(cosines: Complex) -> NDArray[np.bool_]:
    """Return whether steepest descent can compute the field of each plane wave."""
    return cosines.real >= _STEEP_COSINE


def _is_shallow(cosines: Complex) -> NDArray[np.bool_]:
    return ~_is_steep(cosines)


@dataclass(frozen=True)
class _EdgeSums:
    """Computation of fields as sums over edges, or over panels of edges."""

    radiator: Radiator
    wavelength: float
    share: float
    paraxial: bool
    points: int
    """Number of points of the call, on which the choice of the engine depends."""
    engine: str

    def by_steepest_descent(self, points: Floats, digits: float) -> tuple[Complex, Floats]:
        """Return the field at points by steepest descent, and an estimate of its error.

        The error is about exp(-digits). Evanescent waves, and waves close to the plane of the
        source, are summed over panels.
        """
        if self.paraxial:
            return self._sum(steepest_edge_sum, points, digits, math.inf)
        whole = self._sum(steepest_edge_sum, points, digits, math.inf, _is_steep)
        longest = _STRATA[-1][1]
        others = self._sum(integrals.edge_sum, points, digits, longest, _is_shallow)
        return whole[0] + others[0], whole[1] + others[1]

    def over_panels(self, points: Floats, digits: float, longest: float) -> tuple[Complex, Floats]:
        """Return the field at points as a sum over panels, and an estimate of its error.

        The error is about exp(-digits), and ``longest`` is the largest length of a panel in
        wavelengths.
        """
        return self._sum(integrals.edge_sum, points, digits, longest)

    def _sum(
        self,
        edge_sum: Callable[..., integrals.Values],
        points: Floats,
        digits: float,
        longest: float,
        is_wanted: Callable[[Complex], NDArray[np.bool_]] | None = None,
    ) -> tuple[Complex, Floats]:
        radiator, paraxial = self.radiator, self.paraxial
        kernel = Kernel(
            name=f"boundary integral, {edge_sum.__name__}",
            dimension=3,
            tables=lambda table, double: _tables(table, double, self.share, paraxial),
            enter=integrals.enter,
            edge_sum=edge_sum,
            leave=integrals.leave_phase if paraxial else integrals.leave,
        )
        edges = _TERMS * sum(e.edges for e in radiator.elements)
        engine = resolved(self.engine, self.points, edges)
        field, error = np.zeros(len(points), np.complex128), np.zeros(len(points))
        blocks_of_panels = panels_of(radiator, self.wavelength, longest, _ROWS, paraxial, is_wanted)
        for panels in blocks_of_panels:
            step = max(_FEWEST_POINTS, _MOST_PAIRS // len(panels.rows))
            blocks = [slice(low, low + step) for low in range(0, len(points), step)]
            with with_progress("points", blocks) as remaining:
                for block in remaining:
                    real, imag, estimate = execution.evaluate(
                        kernel,
                        _Table(panels, radiator, self.wavelength),
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
    """Divide points into groups of similar distance from a source.

    Yields the indices of the points of each group, and the longest panels that they allow, in
    wavelengths.
    """
    distance = radiator.distance(points) / wavelength
    low = 0.0
    for high, longest in _STRATA:
        members = np.flatnonzero((low <= distance) & (distance < high))
        low = high
        if len(members):
            yield members, longest


def panels_in(radiator: Radiator, wavelength: float, longest: float) -> float:
    """Return an upper bound on the number of pairs of a panel and a plane wave."""
    edges = sum(element.edges for element in radiator.elements)
    return edges + radiator.perimeter / (longest * wavelength)


def boundary_tables(
    radiator: Radiator, wavelength: float, longest: float, double: bool, share: float
) -> integrals.BoundaryTables:
    """Return all panels of a source as the tables of a kernel.

    ``share`` is the coefficient of the same name in `BoundaryTables`.
    """
    blocks = panels_of(radiator, wavelength, longest, _ROWS, False)
    panels = _Panels(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))
    return _tables(_Table(panels, radiator, wavelength), double, share, False)


def _tables(table: _Table, double: bool, share: float, paraxial: bool) -> integrals.BoundaryTables:
    rows, amplitudes = table.panels.rows, table.panels.amplitudes / (2 * math.pi)
    cosines, errors = rows[:, 5:8], rows[:, 8:11]
    high = cosines if double else cosines.astype(np.float32).astype(np.float64)
    pairs = np.stack([high, (cosines - high) + errors], axis=2).reshape(len(rows), 6)
    last = np.stack([amplitudes.real, amplitudes.imag, table.panels.evanescent], axis=1)
    columns = np.concatenate([rows[:, :5], pairs, rows[:, 11:], last], axis=1)
    edges = tuple(map(tuple, columns.tolist()))
    x, y = table.radiator.centre.tolist()
    frame = integrals.BoundaryFrame((x, y), table.wavelength, double, paraxial)
    return integrals.BoundaryTables(frame, edges, gauss_rules(), share)
