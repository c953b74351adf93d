"""Arrays: elements that radiate coherently, each with a complex weight."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar, final, overload

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, GeometryError, IlluminationError
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits, automean
from polywigner.geometry.arguments import (
    checked_type,
    checked_wavelength,
    finite_array,
    takes_frequency,
    warn_caller,
)
from polywigner.geometry.illumination import Illumination
from polywigner.geometry.parts import shifted, union_on_grid
from polywigner.geometry.wavefront import TakesWaves, Wavefront
from polywigner.numerics.chirps import waves_of_cycles
from polywigner.source.lattices import checked_sites, checked_weights, joint_bounds

Element = Aperture | PlacedAperture | Polyhedron | Slits
_E = TypeVar("_E")

# Limits for an element that counts as lying in the plane z = 0: largest distance from the plane, as
# a fraction of the diameter, and largest tilt [rad]. Rounding of poses causes such deviations.
_IN_PLANE = 1e-12


def _checked_elements(elements: Any) -> tuple[Element, ...]:
    """Return elements as a tuple; raise ArgumentError for invalid types or mixed dimensions."""
    expected = "expected a sequence of elements (Aperture, placed aperture, Polyhedron, Slits)"
    items = tuple(elements) if isinstance(elements, Iterable) else ()
    if not items:
        got = "none" if isinstance(elements, Iterable) else f"one {type(elements).__name__}"
        raise ArgumentError(f"{expected}, got {got}; pass a list of elements")
    for k, element in enumerate(items):
        if not isinstance(element, Element):
            hint = "; pass its elements and weights" if isinstance(element, Array) else ""
            raise ArgumentError(f"{expected}, got {type(element).__name__} as element {k}{hint}")
    if len({isinstance(element, Slits) for element in items}) > 1:
        raise ArgumentError(
            "expected elements of equal dimension, got Slits (one dimension) and other "
            "elements; replace the slits by rectangles from polywigner.shapes.rectangle"
        )
    return items


def aperture_in_plane(number: int, element: Element) -> Aperture:
    """Return element ``number`` as an aperture in the plane z = 0, with its pose applied.

    Raises GeometryError if the element does not lie in this plane.
    """
    if isinstance(element, Aperture):
        return element
    got = type(element).__name__
    if isinstance(element, PlacedAperture):
        rotation, shift = element.pose[:3, :3], element.pose[:3, 3]
        tilt = float(np.arctan2(np.hypot(*rotation[:2, 2]), abs(rotation[2, 2])))
        got = f"z = {shift[2]:.6g}"
        if tilt > _IN_PLANE:
            got = f"a tilt of {np.degrees(tilt):.3g} degrees"
        elif abs(shift[2]) <= _IN_PLANE * element.aperture.diameter:
            got = ""
    if got:
        raise GeometryError(
            f"expected elements in the plane z = 0, got {got} for element {number}; only the "
            "transform polywigner.fourier accepts elements outside this plane"
        )
    assert isinstance(element, PlacedAperture)
    plane = rotation[:2, :2]
    outline = shapely.transform(element.aperture.polygons, lambda p: p @ plane.T + shift[:2])
    field = element.aperture.illumination
    if field is None:
        return Aperture(outline)
    rotated = Illumination(field.amplitudes, field.frequencies @ plane.T)
    return Aperture(outline).with_illumination(rotated.moved(shift[:2]))


# Largest relative difference between curvatures that count as equal, due to rounding.
_SAME = 1e-12


def _array_of_waves(elements: Sequence[Any], weights: Any) -> Wavefront:
    """Combine elements with curved waves into a single curved wave on an array.

    Raises IlluminationError if curvatures, coherence widths or wavelengths differ. Different
    centres become plane waves of the elements.
    """
    waves = [e if isinstance(e, Wavefront) else Wavefront(e) for e in elements]
    first = waves[0]
    curvatures = np.array([wave.curvature for wave in waves])
    allowed = _SAME * float(np.abs(curvatures).max())
    properties = first.coherence_width, first.wavelength
    for k, wave in enumerate(waves):
        difference = float(np.abs(wave.curvature - first.curvature).max())
        if difference > allowed or (wave.coherence_width, wave.wavelength) != properties:
            raise IlluminationError(
                f"expected elements with equal curvature and coherence width, got {wave!r} as "
                f"element {k} and {first!r} as element 0; make a separate array for each kind "
                "of wave, and add the fields of the arrays"
            )
    factors = checked_weights(weights, len(waves))
    # Two waves with centres d apart differ by the plane wave exp(-2 pi i x.Q d) and the phase exp(2
    # pi i (c - d/2).Q d).
    centres = np.array([wave.centre for wave in waves])
    offsets = centres - first.centre
    slopes = (curvatures @ offsets[:, :, None])[:, :, 0]
    cycles = ((centres - offsets / 2) * slopes).sum(axis=1)
    array = _with_phases(Array([wave.source for wave in waves], factors), cycles, -slopes)
    if first.wavelength is not None:
        array = array.with_paths(PathLengths(cycles, -slopes, first.wavelength))
    return first._with(source=array)


@dataclass(frozen=True, eq=False)
class PathLengths:
    """Phases of the elements of an array due to path lengths, at one wavelength."""

    cycles: NDArray[np.float64]
    """Phase of each element at the origin in cycles, shape (n,)."""
    slopes: NDArray[np.float64]
    """Gradient of the phase of each element in cycles per metre, shape (n, d)."""
    wavelength: float
    """Wavelength in m."""


def _with_phases(array: Array, cycles: NDArray[np.float64], slopes: NDArray[np.float64]) -> Array:
    """Return an array whose element k is multiplied by exp(2 pi i (cycles_k + slopes_k.x))."""
    pairs = zip(array.elements, slopes, strict=True)
    elements = [_tilted(element, slope) for element, slope in pairs]
    return Array(elements, array.weights * waves_of_cycles(cycles))


def _tilted(element: _E, kappa: NDArray[np.float64]) -> _E:
    """Return the element multiplied by exp(2 pi i kappa.x), with kappa (d,)."""
    if not kappa.any():
        return element
    outline: Any = element
    tilt, field = Illumination([1.0], kappa[None]), outline.illumination
    tilted: _E = outline.with_illumination(tilt if field is None else field * tilt)
    return tilted


@final
class Array(TakesWaves):
    """A coherent array of elements with complex weights: the field is u(x) = sum_k w_k 1_k(x).

    Elements may touch, overlap or coincide. The fields of overlapping elements add up, so
    `Array([a, a], [1, -1])` has no field. All arrays have a Fourier transform. The Wigner and
    ambiguity functions require slits or elements in the plane z = 0.

    Parameters
    ----------
    elements : sequence of Slits, or of Aperture, PlacedAperture and Polyhedron
        Apertures lie in the plane z = 0. Elements with waves of equal curvature become a
        :class:`Wavefront` on an array.
    weights : array_like, shape (n,), optional
        Complex amplitude of each element; default: all 1.

    Raises
    ------
    ArgumentError
        If the list is empty, an element has an unsupported type, or slits are mixed with other
        elements.
    IlluminationError
        If the weights are not n finite complex numbers, or are all zero.

    Examples
    --------
    >>> import polywigner as pw
    >>> pair = pw.Array([pw.shapes.square(1.0), pw.shapes.square(1.0).moved((3, 0))], [1, -1])
    >>> bool(abs(pw.fourier(pair, (0.0, 0.0))) < 1e-12)
    True
    """

    weights: NDArray[np.complex128]
    """Complex weights of the elements, shape (n,), read-only."""
    repeated: tuple[Aperture | Slits, NDArray[np.float64]] | None
    """The element and the positions (n, d) of its copies in a `phased_array`; otherwise None."""
    paths: PathLengths | None
    """The phases due to path lengths of a :func:`segmented_pupil`; otherwise None."""

    def __new__(cls, elements: Any = (), weights: Any = None) -> Any:
        """Make an array, or a Wavefront on an array if the elements are Wavefronts."""
        if isinstance(elements, Sequence) and any(isinstance(e, Wavefront) for e in elements):
            return _array_of_waves(elements, weights)
        return object.__new__(cls)

    def __init__(self, elements: Iterable[Element], weights: ArrayLike | None = None) -> None:
        items = _checked_elements(elements)
        factors = checked_weights(weights, len(items))
        self._set(elements=items, weights=factors, repeated=None, paths=None)

    def with_paths(self, paths: PathLengths | None) -> Array:
        """Return this array with recorded path lengths, for conversion to other wavelengths.

        The fields and weights do not change; they must contain the phases already. If ``paths`` is
        None, the recorded path lengths are removed.

        Raises
        ------
        ArgumentError
            If the number of path lengths differs from the number of elements.
        """
        size = len(self.weights)
        if paths is not None and not len(paths.cycles) == len(paths.slopes) == size:
            raise ArgumentError(
                f"expected one path length for each of the {size} elements, got {paths!r:.80}"
            )
        return Array._of(elements=self.elements, weights=self.weights, repeated=None, paths=paths)

    def at_wavelength(self, wavelength: float) -> Array:
        """Return the array at another wavelength in m, with the phases of path lengths converted.

        An array without ``paths`` is returned unchanged.
        """
        length = checked_wavelength(wavelength)
        paths = self.paths
        if paths is None or length == paths.wavelength:
            return self
        ratio = paths.wavelength / length
        cycles, slopes = paths.cycles * ratio, paths.slopes * ratio
        array = _with_phases(self, cycles - paths.cycles, slopes - paths.slopes)
        return array.with_paths(PathLengths(cycles, slopes, length))

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """The elements, each with its field but without its weight."""
        # Only phased arrays reach this line; __init__ sets the elements of other arrays.
        assert self.repeated is not None
        element, positions = self.repeated
        return tuple(element.moved(position) for position in positions)

    @property
    def distinct(self) -> tuple[Element, ...]:
        """The distinct elements; a `phased_array` has only one."""
        return self.elements if self.repeated is None else (self.repeated[0],)

    @property
    def dimension(self) -> int:
        """Dimension of the space: 1 for slits, 2 for apertures without a pose, otherwise 3."""
        kinds = {type(element) for element in self.distinct}
        if kinds == {Slits}:
            return 1
        return 2 if kinds == {Aperture} else 3

    @cached_property
    def bounds(self) -> tuple[float, ...]:
        """Bounds in m: (xmin, xmax) of slits, (xmin, ymin, xmax, ymax) of apertures in z = 0.

        Raises
        ------
        GeometryError
            If an element does not lie in that plane.
        """
        if self.repeated is not None:
            element, positions = self.repeated
            return joint_bounds([element.bounds], positions)
        return joint_bounds([element.bounds for element in self.elements_in_plane])

    @cached_property
    def elements_in_plane(self) -> tuple[Any, ...]:
        """The elements, as slits or as apertures in the plane z = 0 with their poses applied.

        Raises
        ------
        GeometryError
            If an element does not lie in that plane.
        """
        if self.dimension == 1:
            return self.elements
        return tuple(aperture_in_plane(k, element) for k, element in enumerate(self.elements))

    @cached_property
    def support(self) -> Aperture:
        """The union of the elements, a uniform aperture that contains all points with a field.

        ``polywigner.automean(array.support)`` contains the support of the Wigner function.

        Raises
        ------
        GeometryError
            If an element does not lie in the plane z = 0, or the elements are slits.
        """
        if self.dimension == 1:
            raise GeometryError(
                "expected an array of apertures for a support in the plane, got an array of slits"
            )
        return Aperture(union_on_grid([element.polygons for element in self.elements_in_plane]))

    @cached_property
    def _key(self) -> tuple[Any, ...]:
        """Values by which arrays are compared: elements, weights and positions."""
        if self.repeated is None:
            design = None if self.paths is None else self.paths.wavelength
            return self.elements, self.weights.tobytes(), design
        element, positions = self.repeated
        return element, positions.tobytes(), self.weights.tobytes()

    def __getstate__(self) -> dict[str, Any]:
        elements = {"elements": self.elements} if self.repeated is None else {}
        return super().__getstate__() | elements

    def __len__(self) -> int:
        return len(self.weights)

    def __repr__(self) -> str:
        kinds = [type(element).__name__ for element in self.distinct]
        copies = len(self) // len(kinds)
        counts = [f"{copies * kinds.count(kind)} x {kind}" for kind in dict.fromkeys(kinds)]
        uniform = "weights all 1" if (self.weights == 1).all() else "weighted"
        return f"Array({', '.join(counts)}, {uniform})"


@overload
def phased_array(
    element: Aperture | Slits, positions: ArrayLike, weights: ArrayLike | None = None
) -> Array: ...


@overload
def phased_array(
    element: Wavefront, positions: ArrayLike, weights: ArrayLike | None = None
) -> Wavefront: ...


def phased_array(
    element: Aperture | Slits | Wavefront, positions: ArrayLike, weights: ArrayLike | None = None
) -> Array | Wavefront:
    """Make an array of equal elements: copies of an element and its field at given positions.

    The array is equivalent to `Array([element.moved(p) for p in positions], weights)`, at a
    fraction of the cost. A PolywignerWarning reports elements that overlap.

    Parameters
    ----------
    element : Aperture, Slits or Wavefront
        An element with or without an illumination; the curved wave of a Wavefront is copied as
        well.
    positions : array_like, shape (n, d)
        Shifts of the copies in m, with d = 2 for an aperture. For slits, the shape is (n, 1) or
        (n,).
    weights : array_like, shape (n,), optional
        Complex weights of the copies; default: all 1.

    Returns
    -------
    Array or Wavefront
        The array; a Wavefront on an array if the element has a curved wave.

    Raises
    ------
    ArgumentError
        If the element has an unsupported type, or the positions are not (n, d) finite numbers.
    IlluminationError
        If the weights are not n finite complex numbers, or are all zero.

    Examples
    --------
    >>> import polywigner as pw
    >>> positions = pw.arrays.grid_positions(8, 8, 2e-3, 2e-3)
    >>> len(pw.phased_array(pw.shapes.square(1.5e-3), positions))
    64
    """
    if isinstance(element, Wavefront):
        positions, amplitudes = checked_sites(positions, weights, element.dimension)
        array: Any = _array_of_waves(
            [element.moved(position) for position in positions], amplitudes
        )
        warn_of_overlaps(array.source)
    else:
        array = repeated_element(element, positions, weights)
        warn_of_overlaps(array)
    return array


# Largest number of pairs of elements intersected at once.
_MOST_PAIRS = 1000
# Largest overlap of elements that count as touching, as a fraction of their area.
_TOUCHING = 1e-9
# Number of elements in one query of the search tree.
_ROWS = 32


def warn_of_overlaps(array: Array) -> None:
    """Warn if two elements of an array overlap; elements in several planes are not tested."""
    if array.repeated is None:
        try:
            elements = array.elements_in_plane
        # Elements with different poses have no common plane, so they are not tested.
        except GeometryError:
            return
        outlines = np.array([_as_polygons(element) for element in elements], object)
    else:
        element, positions = array.repeated
        shifts = np.pad(positions, ((0, 0), (0, 2 - array.dimension)))
        outlines = shifted(np.full(len(array), _as_polygons(element), object), shifts)
    bounds = shapely.bounds(outlines)
    margins = np.tile(_TOUCHING * (bounds[:, 2:] - bounds[:, :2]), 2) * (1, 1, -1, -1)
    boxes = shapely.box(*(bounds + margins).T)
    tree = shapely.STRtree(boxes)
    for start in range(0, len(boxes), _ROWS):
        first, second = tree.query(boxes[start : start + _ROWS])
        ahead = np.flatnonzero(second > first + start)[:_MOST_PAIRS]
        first, second = first[ahead] + start, second[ahead]
        shared = shapely.area(shapely.intersection(outlines[first], outlines[second]))
        overlaps = np.flatnonzero(shared > _TOUCHING * shapely.area(outlines[first]))
        if len(overlaps):
            worst = overlaps[shared[overlaps].argmax()]
            warn_caller(
                f"elements {first[worst]} and {second[worst]} (counted from 0) overlap by "
                f"{shared[worst]:.4g} {'m' if array.dimension == 1 else 'm^2'}, where their "
                "fields add up; check the positions, their unit and the size of the elements"
            )
            return


def _as_polygons(element: Aperture | Slits) -> shapely.MultiPolygon | shapely.Polygon:
    """Return the polygons of an aperture, or of slits as rectangles of unit height."""
    if isinstance(element, Aperture):
        return element.polygons
    begin, end = element.intervals.T
    return shapely.union_all(shapely.box(begin, 0.0, end, 1.0))


def repeated_element(
    element: Aperture | Slits, positions: ArrayLike, weights: ArrayLike | None = None
) -> Array:
    """Return the :func:`phased_array` of an element with a flat wave; overlaps are not checked."""
    advice = "use polywigner.Array for other elements"
    checked_type(
        element, "an Aperture or Slits as the element to repeat", Aperture, Slits, advice=advice
    )
    dimension = 1 if isinstance(element, Slits) else 2
    positions, amplitudes = checked_sites(positions, weights, dimension)
    return Array._of(repeated=(element, positions), weights=amplitudes, paths=None)


# Largest number of pairs of convex pieces for which the automean (the set of midpoints of all pairs
# of source points) is computed. The computation for 500 pairs takes 0.7 s.
_MOST_AUTOMEAN_PAIRS = 500


def mutual_support(source: Aperture | Array) -> Aperture:
    """Return a region that contains all x with W(x, nu) != 0, for any weights and fields.

    The region is the automean of the source, or its convex hull if the automean has more than 500
    pairs of convex pieces. Raises GeometryError for slits and for elements outside the plane z = 0.
    """
    if isinstance(source, Array):
        # An array has at least one convex piece for each element.
        if source.dimension > 1 and len(source) ** 2 > 2 * _MOST_AUTOMEAN_PAIRS:
            outlines = [element.polygons for element in source.elements_in_plane]
            return Aperture(shapely.GeometryCollection(outlines).convex_hull)
        source = source.support
    pieces = len(source.convex_cover)
    if pieces * (pieces + 1) <= 2 * _MOST_AUTOMEAN_PAIRS:
        return automean(source)
    return Aperture(source.polygons.convex_hull)


@takes_frequency
def segmented_pupil(
    pupil: Aperture | Sequence[Aperture],
    wavelength: float,
    piston: ArrayLike = 0.0,
    tilt: ArrayLike = 0.0,
) -> Array:
    """Return a pupil that consists of segments with pistons and tilts.

    The field of segment k, with its centroid c_k, is multiplied by
    exp(2 pi i (piston_k + tilt_k.(x - c_k))/wavelength).

    Pistons and tilts are path lengths. Functions that take a wavelength (:func:`psf`, :func:`mtf`,
    :func:`irradiance` with its ``bandwidth``, ...) use the phases at that wavelength. Functions
    without a wavelength (:func:`otf`, :func:`fourier`, :func:`wigner`) use the phases at the
    ``wavelength`` of this function; :meth:`Array.at_wavelength` changes it. In contrast, the phases
    of a :func:`phased_array` come from phase shifters and are the same at all wavelengths.

    Parameters
    ----------
    pupil : Aperture or sequence of Aperture
        An aperture whose ``segments`` are the n segments, in their order; or a list of apertures,
        each with its own field.
    wavelength : float
        Wavelength in m at which the phases of the returned array apply.
    piston : float or array_like, shape (n,), default 0
        Path length of the wavefront in m at each segment's centroid: 2 d for a mirror segment
        displaced by d.
    tilt : float or array_like, shape (2,) or (n, 2), default 0
        Slopes of the wavefront along x and y on each segment, dimensionless.

    Returns
    -------
    Array
        The segments, each with its phase.

    Raises
    ------
    ArgumentError
        If the pupil has an unsupported type, or pistons and tilts are not n finite numbers.

    Examples
    --------
    >>> import polywigner as pw
    >>> mirror = pw.shapes.hexagonal_segments(1.32, 0.01, rings=1)
    >>> waves = pw.segmented_pupil(mirror, 2e-6, piston=[0, 0, 0, 1e-6, 0, 0])
    >>> peaks = [float(pw.psf(pupil, (0, 0), 2e-6, 10.0)) for pupil in (waves, mirror)]
    >>> round(peaks[0] / peaks[1], 6)  # (4/6)^2
    0.444444
    """
    length = checked_wavelength(wavelength)
    if isinstance(pupil, Aperture):
        segments: list[Any] = list(pupil.segments)
    else:
        segments = list(pupil) if isinstance(pupil, Sequence) else [pupil]
    if not segments or not all(isinstance(segment, Aperture) for segment in segments):
        raise ArgumentError("expected pupil to be an Aperture, or a list of apertures")
    count = len(segments)
    expected = (
        f"expected piston to be finite numbers of shape ({count},) and tilt of shape ({count}, "
        "2), or one value for all segments"
    )
    steps = np.broadcast_to(finite_array(piston, expected, (), (count,)), (count,))
    slopes = (
        np.broadcast_to(finite_array(tilt, expected, (), (2,), (count, 2)), (count, 2)) / length
    )
    centres = np.array([segment.polygons.centroid.coords[0] for segment in segments])
    cycles = steps / length - np.einsum("ij,ij->i", slopes, centres)
    array = _with_phases(Array(segments), cycles, slopes)
    return array.with_paths(PathLengths(cycles, slopes, length))
