"""Coherent collections: elements that radiate together, each with a complex weight."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any, NoReturn, final

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, GeometryError, IlluminationError
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits
from polywigner.geometry.arguments import shape_of
from polywigner.geometry.grid import union_on_grid
from polywigner.geometry.pose import rigid_pose
from polywigner.illumination.sites import Sites
from polywigner.illumination.waves import Illumination

__all__ = ["Array", "Element"]

Element = Aperture | PlacedAperture | Polyhedron | Slits

# How far an element may lie off the plane z = 0, as a fraction of its diameter, and lean, in
# radians, and still be in it: what rounding does to a pose multiplied from several.
_IN_PLANE = 1e-12
# From so many elements on it is looked for whether they are shifted copies of one, ...
_LEAST_COPIES = 24
# ... which they are if their vertices miss those by this fraction of the largest coordinate: a few
# roundings; and if their fields do so by more, which come from a sine.
_COPIES, _COPIED_FIELDS = 1e-15, 1e-13

# Products of two weights and an area must neither overflow nor vanish.
_LARGEST_WEIGHT = 1e100


@final
class Array:
    """A coherent collection of elements with complex weights: u(x) = sum_k w_k 1_k(x).

    Elements may touch, overlap or coincide: their fields add up. `Array([a, a], [1, -1])` is dark.

    Parameters
    ----------
    elements
        Sources of one space: Slits alone, or any mix of apertures, placed apertures and polyhedra.
        Apertures without a pose lie in the plane z = 0.
    weights
        (n,) complex amplitude of each element; default: all 1.

    The Fourier transform is there for all of these. Wigner and ambiguity functions are functions of
    position and frequency in the plane of the elements (or on the line of slits), and exist for
    elements that all lie in the plane z = 0. Elements in several planes have no such plane in
    common: a phase-space function of the whole would have six dimensions.

    Raises
    ------
    ArgumentError for anything but elements, none of them, and slits mixed with others.
    IlluminationError for weights that are not n finite complex numbers, for weights all zero, and
    where the largest modulus is not from 1e-100 to 1e100.
    """

    weights: NDArray[np.complex128]
    """(n,), read-only."""
    repeated: tuple[Aperture | Slits, NDArray[np.float64]] | None
    """The one element and the positions (n, d) of its copies, if made by `phased_array`."""

    def __init__(self, elements: Iterable[Element], weights: Any = None) -> None:
        found = _checked_elements(elements)
        self.__dict__["elements"] = found
        self.__dict__["weights"] = _checked_weights(weights, len(found))
        self.__dict__["repeated"] = None

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """The sources, each with its own field."""
        assert self.repeated is not None  # else __init__ has set them
        element, positions = self.repeated
        return tuple(element.moved(position) for position in positions)

    @cached_property
    def phased(self) -> Array | None:
        """The array as a `phased_array`: itself, or what its apertures are if many copies of one.

        None for other arrays, and for few copies, where it is not worth it.
        """
        if self.repeated is not None:
            return self
        return _as_phased(self) if len(self) >= _LEAST_COPIES else None

    @cached_property
    def sites(self) -> Sites:
        """Where the copies of a `phased_array` are, with their weights."""
        assert self.repeated is not None
        return Sites(self.repeated[1], self.weights)

    @property
    def dimension(self) -> int:
        """Of the space of the elements: 1 for slits, 2 for apertures without a pose, else 3."""
        if self.repeated is not None:
            return self.repeated[1].shape[1]
        kinds = {type(element) for element in self.elements}
        if kinds == {Slits}:
            return 1
        return 2 if kinds == {Aperture} else 3

    @cached_property
    def coplanar(self) -> tuple[Aperture, ...] | tuple[Slits, ...]:
        """The slits; or all elements as apertures in the plane z = 0, poses in that plane applied.

        Raises GeometryError if an element does not lie in that plane.
        """
        slits = tuple(element for element in self.elements if isinstance(element, Slits))
        return slits or tuple(_in_plane(k, element) for k, element in enumerate(self.elements))

    @cached_property
    def support(self) -> Aperture:
        """The union of the elements, which may overlap: where the field may differ from zero.

        ``polywigner.automean(array.support)`` is where the Wigner function may.

        Raises GeometryError if an element does not lie in the plane z = 0, and for slits.
        """
        outlines = [e.polygons for e in self.coplanar if isinstance(e, Aperture)]
        if not outlines:
            raise GeometryError("expected apertures for a support in the plane, got Slits")
        return Aperture(union_on_grid(outlines))

    def placed(self, to_world: Any) -> Array:
        """The whole array moved by a rigid pose (4, 4), for transforms with three-component nu.

        Raises GeometryError for a matrix that is not a rotation and a translation, and for slits.
        """
        pose = rigid_pose(to_world)
        return Array([_placed(element, pose) for element in self.elements], self.weights)

    @cached_property
    def _key(self) -> tuple[Any, ...]:
        if self.repeated is None:
            return self.elements, self.weights.tobytes()
        element, positions = self.repeated
        return element, positions.tobytes(), self.weights.tobytes()

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Array) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"an Array cannot be changed ({name}); build a new one")

    def __delattr__(self, name: str) -> NoReturn:
        raise AttributeError(f"an Array cannot be changed ({name}); build a new one")

    def __reduce__(self) -> tuple[Any, ...]:
        if self.repeated is not None:
            return phased_array, (*self.repeated, self.weights)
        return Array, (self.elements, self.weights)

    def __len__(self) -> int:
        return len(self.weights)

    def __repr__(self) -> str:
        if self.repeated is not None:
            kinds = [type(self.repeated[0]).__name__] * len(self)
        else:
            kinds = [type(element).__name__ for element in self.elements]
        counts = ", ".join(f"{kinds.count(kind)} x {kind}" for kind in dict.fromkeys(kinds))
        uniform = "weights all 1" if (self.weights == 1).all() else "weighted"
        return f"Array({counts}, {uniform})"


def _as_phased(array: Array) -> Array | None:
    try:
        elements = array.coplanar
    except GeometryError:
        return None
    first = elements[0]
    if not isinstance(first, Aperture):
        return None
    corners = np.concatenate(first.rings)
    positions, weights = [], []
    for element, weight in zip(elements, array.weights, strict=True):
        assert isinstance(element, Aperture)  # elements of one plane are of one kind
        if [len(ring) for ring in element.rings] != [len(ring) for ring in first.rings]:
            return None
        own = np.concatenate(element.rings)
        shift = (own - corners).mean(axis=0)
        allowed = _COPIES * max(float(np.abs(own).max()), float(np.abs(corners).max()))
        factor = _factor_of_copy(first.illumination, element.illumination, shift)
        if factor is None or float(np.abs(own - corners - shift).max()) > allowed:
            return None
        positions.append(shift)
        weights.append(weight * factor)
    return phased_array(first, positions, weights)


def _factor_of_copy(first: Any, other: Any, shift: NDArray[np.float64]) -> complex | None:
    """What a field is times another one shifted, or None."""
    if first is None or other is None:
        return 1.0 if first is other else None
    moved = first.moved(shift)
    if not np.array_equal(moved.frequencies, other.frequencies):
        return None
    factor = complex(other.amplitudes[0] / moved.amplitudes[0])
    error = float(np.abs(other.amplitudes - factor * moved.amplitudes).max())
    return factor if error <= _COPIED_FIELDS * float(np.abs(other.amplitudes).max()) else None


def phased_array(element: Aperture | Slits, positions: Any, weights: Any = None) -> Array:
    """One element many times: copies of it, its field included, shifted to the positions.

    The same field as `Array([element.moved(p) for p in positions], weights)`, at a fraction of the
    cost: the transforms make use of the copies being equal.

    Parameters
    ----------
    element : an Aperture, or Slits, with its own illumination.
    positions : (n, d) shifts in m, d = 2 for an aperture; for slits (n, 1) or (n,).
    weights : (n,) complex; default: all 1.

    Raises
    ------
    ArgumentError for other elements, and positions that are not (n, d) finite numbers;
    IlluminationError for weights as :class:`Array` does.
    """
    if not isinstance(element, Aperture | Slits):
        raise ArgumentError(
            f"expected an Aperture or Slits to repeat, got {type(element).__name__}; use "
            "polywigner.Array for other elements"
        )
    dimension = 1 if isinstance(element, Slits) else 2
    places, amplitudes = checked_sites(positions, weights, dimension)
    array = object.__new__(Array)
    array.__dict__["repeated"] = (element, places)
    array.__dict__["weights"] = amplitudes
    return array


def checked_sites(
    positions: Any, weights: Any, dimension: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Positions (n, d) and weights (n,), read-only; of one dimension, or of any up to three.

    Raises ArgumentError and IlluminationError as :func:`phased_array` does.
    """
    try:
        places = np.array(positions, dtype=np.float64)
    except (TypeError, ValueError):
        places = np.empty(0)
    if dimension in (1, None) and places.ndim == 1:
        places = places[:, None]
    allowed = (1, 2, 3) if dimension is None else (dimension,)
    if places.ndim != 2 or places.shape[1] not in allowed or not len(places):
        raise ArgumentError(
            f"expected positions of shape (n, {dimension or 'd'}), got {shape_of(positions)}"
        )
    if not np.isfinite(places).all():
        raise ArgumentError("expected finite positions, got inf or nan")
    places += 0.0
    places.setflags(write=False)
    return places, _checked_weights(weights, len(places))


def _checked_elements(elements: Any) -> tuple[Element, ...]:
    expected = "expected a sequence of elements (Aperture, placed aperture, Polyhedron, Slits)"
    if isinstance(elements, Element):
        raise ArgumentError(f"{expected}, got one {type(elements).__name__}; put it into a list")
    try:
        found = tuple(elements)
    except TypeError:
        raise ArgumentError(f"{expected}, got {type(elements).__name__}") from None
    if not found:
        raise ArgumentError(f"{expected}, got none")
    for k, element in enumerate(found):
        if not isinstance(element, Element):
            hint = "; join its elements and weights" if isinstance(element, Array) else ""
            raise ArgumentError(f"{expected}, got {type(element).__name__} at {k}{hint}")
    slits = [isinstance(element, Slits) for element in found]
    if any(slits) and not all(slits):
        raise ArgumentError(
            "expected elements of one space, got Slits (one dimension) and others; "
            "make rectangles of the slits with polywigner.shapes.rectangle"
        )
    return found


def _checked_weights(weights: Any, count: int) -> NDArray[np.complex128]:
    array = np.ones(count, np.complex128) if weights is None else _numbers(weights, count)
    if array.shape != (count,):
        raise IlluminationError(
            f"expected one weight for each of {count} elements, got shape {array.shape}"
        )
    if not np.isfinite(array).all():
        bad = array[~np.isfinite(array)][0]
        raise IlluminationError(f"expected finite weights, got {bad}")
    if not array.any():
        raise IlluminationError("expected a weight other than zero, got zeros only")
    largest = float(np.abs(array).max())
    if not 1 / _LARGEST_WEIGHT <= largest <= _LARGEST_WEIGHT:
        raise IlluminationError(
            f"expected a largest weight from {1 / _LARGEST_WEIGHT:g} to {_LARGEST_WEIGHT:g}, got "
            f"{largest:g}; divide all by it"
        )
    array += 0.0  # no negative zeros, which equal zeros but hash differently
    array.setflags(write=False)
    return array


def _numbers(weights: Any, count: int) -> NDArray[np.complex128]:
    if np.ma.is_masked(weights):
        raise IlluminationError(f"expected {count} weights, got masked ones; use .filled(0)")
    try:
        array = np.asarray(weights)
        if array.dtype.kind in "US":  # which NumPy would parse
            raise TypeError
        return np.array(array, dtype=np.complex128)
    except (TypeError, ValueError, OverflowError):
        raise IlluminationError(
            f"expected {count} complex weights, got {type(weights).__name__}"
        ) from None


def _placed(element: Element, pose: NDArray[np.float64]) -> Element:
    if isinstance(element, Aperture):
        return element.placed(pose)
    if isinstance(element, PlacedAperture):
        return element.aperture.placed(pose @ element.pose)
    if isinstance(element, Polyhedron):
        moved = element.vertices @ pose[:3, :3].T + pose[:3, 3]
        return Polyhedron(moved, element.faces)
    raise GeometryError("expected elements of the plane or of space to place, got Slits")


def _in_plane(number: int, element: Element) -> Aperture:
    if isinstance(element, Aperture):
        return element
    advice = (
        "Wigner and ambiguity functions need all elements in the plane z = 0 "
        "(polywigner.fourier has the others)"
    )
    if not isinstance(element, PlacedAperture):
        raise GeometryError(
            f"expected elements of one plane, got {type(element).__name__} at {number}; {advice}"
        )
    rotation, shift = element.pose[:3, :3], element.pose[:3, 3]
    lean = float(np.arctan2(np.hypot(*rotation[:2, 2]), abs(rotation[2, 2])))
    if lean > _IN_PLANE:
        raise GeometryError(
            f"expected elements of one plane, got one that leans by {np.degrees(lean):.3g} degrees "
            f"at {number}; {advice}"
        )
    if abs(shift[2]) > _IN_PLANE * element.aperture.diameter:
        raise GeometryError(
            f"expected elements of one plane, got one at z = {shift[2]:.6g} at {number}; {advice}"
        )
    plane = rotation[:2, :2]
    outline = shapely.transform(element.aperture.polygons, lambda p: p @ plane.T + shift[:2])
    field = element.aperture.illumination
    if field is None:
        return Aperture(outline)
    turned = Illumination(field.amplitudes, field.frequencies @ plane.T)
    return Aperture(outline).with_illumination(turned.moved(shift[:2]))
