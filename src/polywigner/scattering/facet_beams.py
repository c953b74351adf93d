"""Fields scattered by illuminated surfaces after one or several reflections, equation (SC6).

A face reflects a plane wave as a beam, whose cross section is the illuminated polygon. If space is
unfolded at each mirror, all beams continue along the incident direction. The cross sections of the
beams lie in the transmitter's image plane and shrink with each reflection.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.errors import GEOSException

from polywigner.errors import ArgumentError
from polywigner.execution.progress import slow_bar
from polywigner.geometry.arguments import check_most, warn_caller
from polywigner.geometry.hidden_parts import (
    GRID,
    NOTHING,
    Projected,
    Shapes,
    in_triangles,
    intersections,
    mended,
    unions,
    visible_parts,
)
from polywigner.geometry.polyhedron import axes_across
from polywigner.numerics import Columns, Complex, Floats, Indices, index_blocks
from polywigner.scattering.facets import (
    Facets,
    Pieces,
    Sides,
    Visible,
    facing,
    less_hidden,
    pieces_of,
    surface_sums,
    triangle_transforms,
    visible_along,
    visible_pieces,
)

# Largest number of pairs of a beam and a triangle, which take several minutes.
_MOST_COMPARED = 4e8
# Number of pairs of a beam and a triangle per block, which take 100 MB.
_BLOCK = 1 << 19
# Errors in single directions: failures of GEOS, and exceeded limits of memory or time.
_ERRORS = GEOSException, ArgumentError
# Largest product of the numbers of triangles and of direction pairs that are traced together.
_AT_ONCE = 1 << 10
# Margin of bounding boxes relative to the body size. It exceeds the rounding errors of coordinates
# up to thousands of times that size.
_SLACK = 1e-9


def sums_of_beams(
    facets: Facets, k: Floats, s: Floats, lengths: Floats, monostatic: bool, bounces: int
) -> tuple[Complex, Complex | None]:
    """Return the scattering amplitudes N (m, 3) and M (m, 3, 3) in m^2 for m pairs of directions.

    Waves travel along ``k`` (m, 3) to receivers in the directions ``s`` (m, 3). ``lengths`` (m,):
    wavelengths in m. The scattered field is ``N x h + M h`` for the incident magnetic field h,
    equation (SC6), with phases relative to the body's centre. N contains the first reflection, and
    M contains all later reflections. M is None without later reflections. N is NaN, with a warning,
    for directions in which the computation fails. Raises ArgumentError if all directions have too
    many beams.
    """
    nu = (s - k) / lengths[:, None]
    if not facets.casts_shadows:
        pieces = Pieces(facets.corner, facets.first, facets.second, facets.vector)
        return surface_sums(pieces, nu, lambda rows, block: facing(facets, k[rows], block)), None
    first = np.zeros((len(k), 3), np.complex128)
    later = None if bounces == 1 else np.zeros((len(k), 3, 3), np.complex128)
    failures: list[tuple[Indices, Exception]] = []
    views = _views(facets, k, s, monostatic, failures)
    at_once = max(1, _AT_ONCE // len(facets.corner))

    def add(group: list[View]) -> None:
        """Add the fields of some pairs of directions; retry single pairs after an error."""
        for view in group:
            first[view.rows] = surface_sums(view.pieces, nu[view.rows])
        if later is None:
            return
        ends = Ends(group, k, s)
        try:
            for hits in hits_after(facets, ends, bounces):
                _add_fields(later, facets, hits, ends, lengths)
        except _ERRORS as error:
            later[ends.samples] = 0.0
            if len(group) == 1:
                failures.append((ends.samples, error))
            else:  # Isolate the directions that fail.
                for view in group:
                    add([view])

    with slow_bar("radar cross sections", len(k)) as advance:
        while group := list(islice(views, at_once)):
            add(group)
            advance(sum(len(view.rows) for view in group))
    _mark_failures(first, failures)
    return first, later


def _mark_failures(sums: Complex, failures: list[tuple[Indices, Exception]]) -> None:
    """Set failed samples to NaN with a warning; raise the error if all samples exceed a limit."""
    if not failures:
        return
    rows, error = np.concatenate([rows for rows, _ in failures]), failures[-1][1]
    if isinstance(error, ArgumentError) and len(rows) == len(sums):
        raise error
    sums[rows] = np.nan
    warn_caller(
        f"{len(rows)} of {len(sums)} directions cannot be computed and are NaN ({error}); rotate "
        "the body slightly, or simplify its mesh"
    )


class View(NamedTuple):
    """Illuminated and visible surfaces for a pair of directions."""

    rows: Indices
    """Indices of the samples with these directions, one for each wavelength, shape (m,)."""
    pieces: Pieces
    """Parts of the surface that are both illuminated and visible."""
    lit: Visible
    """Illuminated parts, shared by all views with the same transmitter."""
    visible: Visible
    """Parts visible from the receiver."""


class Ends:
    """The m transmitters and n receivers of n views, sorted by transmitter."""

    def __init__(self, views: Sequence[View], k: Floats, s: Floats) -> None:
        """Group views by transmitter; ``k`` and ``s`` are the directions of all samples."""
        before = [None, *(view.lit for view in views)]
        new = [view.lit is not last for view, last in zip(views, before, strict=False)]
        of_transmitter = [j for j, is_new in enumerate(new) if is_new]
        self.lit: list[Visible] = [views[j].lit for j in of_transmitter]
        self.k: Floats = k[[views[j].rows[0] for j in of_transmitter]]
        """Propagation directions, shape (m, 3)."""
        self.across: Floats = axes_across(self.k)
        """Image axes, shape (m, 2, 3)."""
        self.s: Floats = s[[view.rows[0] for view in views]]
        """Directions towards the receivers, shape (n, 3)."""
        self.visible: list[Visible] = [view.visible for view in views]
        self.views: tuple[Indices, Indices] = _runs(np.diff([*of_transmitter, len(views)]))
        """Index of the first view and number of views of each transmitter, both of shape (m,)."""
        self.samples: Indices = np.concatenate([view.rows for view in views])
        """Sample indices of all views."""
        self.of_view: tuple[Indices, Indices] = _runs([len(view.rows) for view in views])
        """Index of the first sample and number of samples of each view, both of shape (n,)."""


def _runs(counts: ArrayLike) -> tuple[Indices, Indices]:
    """Return the first index and the length of consecutive ranges with given lengths."""
    numbers = np.asarray(counts, np.intp)
    return np.cumsum(numbers) - numbers, numbers


def _members(owner: Indices, runs: tuple[Indices, Indices]) -> tuple[Indices, Indices]:
    """Return the members of the ranges ``runs[owner]``: position in ``owner``, and index.

    Both arrays have one entry for each index in the ranges. ``runs``: first index and length of
    each range.
    """
    begins, counts = (column[owner] for column in runs)
    pair = np.repeat(np.arange(len(owner)), counts)
    return pair, np.arange(len(pair)) + (begins - np.cumsum(counts) + counts)[pair]


def _views(
    facets: Facets,
    k: Floats,
    s: Floats,
    monostatic: bool,
    failures: list[tuple[Indices, Exception]],
) -> Iterator[View]:
    """Yield the view of each pair of directions (k, s); append failed views to ``failures``."""
    pairs, owner = np.unique(np.concatenate([k, s], axis=1), axis=0, return_inverse=True)
    order = np.argsort(owner.ravel(), kind="stable")
    ends = np.searchsorted(owner.ravel()[order], np.arange(1, len(pairs)))
    last, lit = None, None
    groups = np.split(order, ends) if len(pairs) else []
    for pair, rows in zip(pairs, groups, strict=True):
        try:
            # Pairs are sorted by transmitter, so that illuminated parts are computed once per
            # transmitter.
            if lit is None or (pair[:3] != last).any():
                last, lit = pair[:3], None
                lit = visible_along(facets, pair[:3])
            both = visible = lit
            if not monostatic:
                visible = visible_along(facets, -pair[3:])
                both = less_hidden(lit, visible, facing(facets, -pair[3:]))
        except _ERRORS as error:
            failures.append((rows, error))
            continue
        yield View(rows, visible_pieces(facets, both), lit, visible)


@dataclass(frozen=True, eq=False)
class Beams(Columns):
    """Reflected plane waves, bounded by polygons in the transmitter's image plane."""

    wave: Indices
    """Index of the transmitter, shape (n,)."""
    rotation: Floats
    """Matrix G of the unfolding x -> G x + c at the mirrors, shape (n, 3, 3)."""
    shift: Floats
    """Vector c, shape (n, 3). The wave is ``exp(2 pi i k.(G x + c)/wavelength)``, with the magnetic
    field ``G^T h`` for the incident h."""
    normal: Floats
    """Unit normal of the last mirror on the side of the beam, shape (n, 3)."""
    height: Floats
    """Offset of the last mirror along its normal, shape (n,)."""
    polygon: Shapes
    """Cross section in the transmitter's image plane, shape (n,)."""

    def __len__(self) -> int:
        return len(self.height)


@dataclass(frozen=True, eq=False)
class Hits:
    """Parts of triangles that beams illuminate."""

    beams: Beams
    beam: Indices
    """Index of the beam, shape (n,)."""
    facet: Indices
    """Index of the triangle, shape (n,)."""
    signs: Sides
    """Illuminated side, shape (n,)."""
    polygon: Shapes
    """Illuminated part in the transmitter's image plane, shape (n,)."""
    part: Shapes
    """Illuminated part in coordinates of the triangle, as in :class:`Visible`, shape (n,)."""


def hits_after(facets: Facets, ends: Ends, bounces: int) -> Iterator[Hits]:
    """Yield the parts of triangles that beams illuminate after 1, then 2, ... reflections.

    There is one item for each number of reflections up to ``bounces - 1``. Raises ArgumentError if
    the computation would take more than several minutes.
    """
    beams = _first_beams(facets, ends)
    for number in range(2, bounces + 1):
        if not len(beams):
            return
        compared = len(beams) * len(facets.corner)
        things = f"comparisons of beams and triangles for reflection {number}"
        remedy = f"use bounces={number - 1}, or simplify the mesh"
        check_most(compared, _MOST_COMPARED, things, remedy)
        hits = _hits(facets, ends, beams)
        yield hits
        if number < bounces:
            beams = _reflected(facets, hits)


def _first_beams(facets: Facets, ends: Ends) -> Beams:
    """Return the beams that the illuminated parts of a body reflect."""
    signs = np.stack([lit.signs for lit in ends.lit])
    wave, facet = np.nonzero(signs)
    parts = np.stack([lit.parts for lit in ends.lit])[wave, facet]
    flat = facets.corners[facet] @ np.swapaxes(ends.across, 1, 2)[wave]
    polygons = np.asarray(shapely.polygons(flat), dtype=object)
    (cut,) = np.nonzero(~shapely.is_missing(parts))
    inside, owner = shapely.get_coordinates(parts[cut], return_index=True)
    corner, first, second = np.moveaxis(flat[cut[owner]], 1, 0)
    points = corner + inside[:, :1] * (first - corner) + inside[:, 1:] * (second - corner)
    polygons[cut] = mended(shapely.set_coordinates(parts[cut], points))
    count = len(ends.k)
    incident = Beams(
        np.arange(count),
        np.broadcast_to(np.eye(3), (count, 3, 3)),
        np.zeros((count, 3)),
        np.zeros((count, 3)),
        np.zeros(count),
        np.full(count, None),
    )
    return _reflected(facets, Hits(incident, wave, facet, signs[wave, facet], polygons, parts))


def _reflected(facets: Facets, hits: Hits) -> Beams:
    """Return the beams reflected by triangles, one beam for each group of coplanar triangles."""
    keys = np.column_stack([hits.beam, facets.plane[hits.facet], hits.signs])
    _, first, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(number.ravel(), kind="stable")
    polygons = hits.polygon[:0]
    if len(order):
        polygons = mended(unions(hits.polygon[order], number.ravel()[order], facets.size))
    facet, before = hits.facet[first], hits.beams.subset(hits.beam[first])
    normal = facets.normal[facet] * hits.signs[first, None]
    height = (normal * facets.corner[facet]).sum(axis=1)
    mirror = np.eye(3) - 2 * normal[:, :, None] * normal[:, None, :]
    shift = before.shift + 2 * height[:, None] * _transformed(before.rotation, normal)
    return Beams(before.wave, before.rotation @ mirror, shift, normal, height, polygons)


def _transformed(matrices: Floats, vectors: Floats) -> Floats:
    """Return the product of each matrix (n, 3, 3) with a vector (n, 3)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _hits(facets: Facets, ends: Ends, beams: Beams) -> Hits:
    """Return the parts of all triangles that beams illuminate after their last reflection.

    Parts behind the mirror and parts hidden by other triangles are omitted.
    """
    beam, facet, signs = _candidates(facets, ends, beams)
    pairs, corners = beams.subset(beam), facets.corners[facet]
    unfolded = corners @ np.swapaxes(pairs.rotation, 1, 2) + pairs.shift[:, None]
    axes = np.concatenate([ends.across, ends.k[:, None]], axis=1)[pairs.wave]
    # Each point has two components across the incident direction and one component along this
    # direction.
    points = unfolded @ np.swapaxes(axes, 1, 2)
    ahead = _heights(facets, pairs, corners)
    # Restore the counter-clockwise order.
    backwards = (signs < 0) ^ (np.linalg.det(pairs.rotation) < 0)
    points[backwards], ahead[backwards] = points[backwards, ::-1], ahead[backwards, ::-1]
    beyond, number = _clipped(points, ahead)
    projected = Projected(beyond[..., :2], beyond[..., 2], facets.size, np.ones(beyond.shape[:2]))
    wide = projected.has_width
    number, projected = number[wide], projected.subset(wide)
    triangles = np.asarray(shapely.polygons(projected.points), dtype=object)
    window = beams.polygon[beam[number]]
    meets = shapely.intersects(window, triangles)
    number, projected, triangles = number[meets], projected.subset(meets), triangles[meets]
    # Without a grid, GEOS sometimes loses polygons with edges on the window's edges.
    grid = GRID * facets.size
    lit = intersections(window[meets], triangles, grid)
    boxes = _displaced_boxes(projected.points, beam[number], facets.size)
    shadowed, left = visible_parts(projected, triangles, lit, boxes, grid)
    lit[shadowed] = left
    least = NOTHING * facets.size * shapely.length(triangles)
    number, lit = number[shapely.area(lit) > least], lit[shapely.area(lit) > least]
    flat = (unfolded @ np.swapaxes(axes[:, :2], 1, 2))[number]
    parts = in_triangles(lit, flat, np.ones((len(number), 3)))
    return Hits(beams, beam[number], facet[number], signs[number], lit, parts)


def _heights(facets: Facets, beams: Beams, corners: Floats) -> Floats:
    """Return heights (n, 3) of corners (n, 3, 3) above n mirrors; positive on the beam's side."""
    heights = (corners @ beams.normal[:, :, None])[..., 0] - beams.height[:, None]
    heights[np.abs(heights) < NOTHING * facets.size] = 0.0
    return np.asarray(heights)


def _candidates(facets: Facets, ends: Ends, beams: Beams) -> tuple[Indices, Indices, Sides]:
    """Return beam, triangle and illuminated side for each pair with overlapping bounding boxes."""
    points = facets.corners.reshape(-1, 3)
    columns = []
    for some in index_blocks(len(beams), _BLOCK // len(points)):
        block = beams.subset(some)
        shape = len(block), len(facets.corner), 3
        sides = facing(facets, _transformed(np.swapaxes(block.rotation, 1, 2), ends.k[block.wave]))
        may_meet = sides != 0
        heights = (block.normal @ points.T).reshape(shape) - block.height[:, None, None]
        may_meet &= heights.max(axis=2) >= NOTHING * facets.size
        bounds = shapely.bounds(block.polygon)
        for axis in (0, 1):
            across = ends.across[block.wave, axis]
            rows = (across[:, None] @ block.rotation)[:, 0]
            shift = (across * block.shift).sum(axis=1)
            flat = (rows @ points.T).reshape(shape) + shift[:, None, None]
            may_meet &= flat.max(axis=2) > bounds[:, axis, None]
            may_meet &= flat.min(axis=2) < bounds[:, 2 + axis, None]
        beam, facet = np.nonzero(may_meet)
        columns.append((beam + some.start, facet, sides[beam, facet]))
    beam, facet, signs = (np.concatenate(column) for column in zip(*columns, strict=True))
    return beam, facet, signs


def _clipped(corners: Floats, heights: Floats) -> tuple[Floats, Indices]:
    """Return the parts (m, 3, 3) of triangles in front of mirrors, and their triangle indices.

    ``corners`` (n, 3, 3): corners in any frame. ``heights`` (n, 3): heights above the mirrors.
    """
    below = (heights < 0).sum(axis=1)
    (complete,), (quadrangle,), (tip,) = (np.nonzero(below == count) for count in range(3))
    # Move the corner that is alone on its side of the plane to the first position.
    alone = np.where(below == 1, (heights < 0).argmax(axis=1), heights.argmax(axis=1))
    order = (alone[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(corners, order[..., None], 1), 1, 0)
    of_a, of_b, of_c = np.moveaxis(np.take_along_axis(heights, order, 1), 1, 0)
    ab, ac = (
        a + (of_a / np.where(of_a == other, 1.0, of_a - other))[:, None] * (there - a)
        for there, other in ((b, of_b), (c, of_c))
    )
    parts = [
        (corners, complete),
        (np.stack([ab, b, c], axis=1), quadrangle),
        (np.stack([ab, c, ac], axis=1), quadrangle),
        (np.stack([a, ab, ac], axis=1), tip),
    ]
    triangles = np.concatenate([triangles[rows] for triangles, rows in parts])
    return triangles, np.concatenate([rows for _, rows in parts])


def _displaced_boxes(points: Floats, beam: Indices, size: float) -> Shapes:
    """Return bounding boxes, displaced so that boxes of different beams do not overlap."""
    slack = _SLACK * size
    low, high = points.min(axis=1) - slack, points.max(axis=1) + slack
    width = float(np.ptp(points[..., 0])) + 4 * slack if len(points) else 0.0
    offset = beam * width
    boxes = shapely.box(low[:, 0] + offset, low[:, 1], high[:, 0] + offset, high[:, 1])
    return np.asarray(boxes, dtype=object)


def _add_fields(later: Complex, facets: Facets, hits: Hits, ends: Ends, lengths: Floats) -> None:
    """Add the fields of visible ``hits`` to the matrices M of equation (SC6), shape (m, 3, 3)."""
    hit, view = _members(hits.beams.wave[hits.beam], ends.views)
    facet, signs, parts = hits.facet[hit], hits.signs[hit], hits.part[hit]
    visible = np.stack([visible.signs for visible in ends.visible])[view, facet]
    sees = (signs == facing(facets, -ends.s)[view, facet]) & (visible != 0)
    hit, view, facet, signs, parts = (a[sees] for a in (hit, view, facet, signs, parts))
    limits = np.stack([visible.parts for visible in ends.visible])[view, facet]
    (cut,) = np.nonzero(~shapely.is_missing(limits))
    parts[cut] = intersections(mended(parts[cut]), mended(limits[cut]), GRID)
    pieces, owner = pieces_of(facets, facet, signs, parts)
    beams, view = hits.beams.subset(hits.beam[hit[owner]]), view[owner]
    back = np.swapaxes(beams.rotation, 1, 2)
    k = ends.k[beams.wave]
    # The path lengths at a corner and along two sides, divided by the wavelength, are phases in
    # cycles.
    rate = ends.s[view] - _transformed(back, k)
    corner, first, second = (
        (rate * part).sum(axis=1) for part in (pieces.corner, pieces.first, pieces.second)
    )
    corner -= (beams.shift * k).sum(axis=1)
    fields = (np.cross(np.eye(3), pieces.vector[:, None]) @ back).reshape(-1, 9)
    for some in index_blocks(len(view), _BLOCK // int(ends.of_view[1].max())):
        piece, sample = _members(view[some], ends.of_view)
        piece, sample = piece + some.start, ends.samples[sample]
        waves = triangle_transforms(
            *(phase[piece] / lengths[sample] for phase in (corner, first, second))
        )
        _add_rows(later.reshape(-1, 9), sample, waves[:, None] * fields[piece])


def _add_rows(total: Complex, numbers: Indices, rows: Complex) -> None:
    """Add ``rows`` to the rows ``numbers`` of ``total``, faster than ``np.add.at``."""
    for column in range(total.shape[1]):
        for sums, terms in ((total.real, rows.real), (total.imag, rows.imag)):
            sums[:, column] += np.bincount(numbers, terms[:, column], len(total))
