"""The normal form of a source: elements with weights and plane waves, and one wavefront.

Users build an `Aperture`, `PlacedAperture`, `Slits`, `Array` or `Wavefront`. Public functions
convert it once with :func:`normal_form`, and all other code takes a :class:`Source`:

    u(x) = exp(i pi (x - c).Q (x - c)) sum_k w_k 1_k(x) sum_m c_km exp(2 pi i kappa_km.x)

Polyhedra have only a Fourier transform, and no normal form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import GeometryError
from polywigner.geometry import Aperture, PlacedAperture, Slits, Wavefront
from polywigner.geometry.arguments import checked_type
from polywigner.geometry.illumination import Illumination, shift_phases
from polywigner.numerics import Complex, Floats
from polywigner.source.array import Array, PathLengths, aperture_in_plane, repeated_element
from polywigner.source.lattices import Lattice, joint_bounds, lattice_of

PublicSource = Aperture | PlacedAperture | Slits | Array | Wavefront

# Largest relative deviation of amplitudes that count as proportional.
_PROPORTIONAL = 1e-15
# Smallest number of elements that are tested for being copies of one element.
_LEAST_COPIES = 24
# Largest relative deviations of the vertices and of the amplitudes of elements that count as
# copies; the phases of shifted amplitudes are rounded as well.
_COPIES, _COPIED_FIELDS = 1e-15, 1e-13


@final
@dataclass(frozen=True, eq=False)
class SourceElement:
    """An outline with a complex weight and a sum of plane waves."""

    outline: Aperture | Slits
    """Outline without a field, in the plane of its pose."""
    weight: complex
    amplitudes: Complex
    """Amplitudes of the plane waves, excluding the weight, shape (m,); 1 for a uniform field."""
    frequencies: Floats
    """Frequencies of the plane waves in 1/m, shape (m, d); 0 for a uniform field."""
    pose: Floats | None = None
    """Transformation from the outline's plane to the world, shape (4, 4); None for the plane z =
    0."""

    @property
    def is_uniform(self) -> bool:
        """Whether the field is constant."""
        return len(self.amplitudes) == 1 and not self.frequencies.any()

    @property
    def has_unit_field(self) -> bool:
        """Whether the field, excluding the weight, is 1."""
        return self.is_uniform and self.amplitudes[0] == 1.0

    @cached_property
    def illumination(self) -> Illumination | None:
        """The plane waves; None for the field 1."""
        if self.has_unit_field:
            return None
        return Illumination(self.amplitudes, self.frequencies)

    @cached_property
    def shape(self) -> Any:
        """The outline with its waves, but without weight and pose."""
        return self.outline.with_illumination(self.illumination)

    @property
    def rings(self) -> tuple[Floats, ...]:
        """Rings (n, 2) of an aperture; exteriors are counter-clockwise, holes clockwise."""
        rings: tuple[Floats, ...] = self.outline.rings  # type: ignore[union-attr]
        return rings

    def waves_at(self, x: Floats) -> Complex:
        """Return the sum of the plane waves at positions (..., d) in m, without the weight."""
        return np.asarray(np.exp(2j * np.pi * (x @ self.frequencies.T)) @ self.amplitudes)

    def tilted(self, kappa: ArrayLike) -> SourceElement:
        """Return the element multiplied by exp(2 pi i kappa.x), with kappa (d,) in 1/m."""
        return replace(self, frequencies=self.frequencies + np.asarray(kappa, np.float64))

    def moved(self, shift: Floats) -> SourceElement:
        """Return the element with its waves, shifted in its plane by a vector (d,) in m."""
        return replace(
            self, outline=self.outline.moved(shift), amplitudes=self.moved_amplitudes(shift)
        )

    def moved_amplitudes(self, shift: Floats) -> Complex:
        """Return the amplitudes (m,) of the waves after a shift by a vector (d,) in m."""
        return self.amplitudes * shift_phases(self.frequencies, shift)


@final
@dataclass(frozen=True, eq=False)
class RepeatedElement:
    """Shifted copies of an element, with weights."""

    element: SourceElement
    """The element at the origin, with weight 1."""
    positions: Floats
    """Shifts of the copies in m, shape (n, d)."""
    weights: Complex
    """Weights of the copies, shape (n,)."""

    @cached_property
    def lattice(self) -> Lattice | None:
        """The lattice of the positions in the plane; None if there is no lattice."""
        return lattice_of(self.positions, self.weights)


class WaveGroup(NamedTuple):
    """Elements with proportional waves."""

    members: list[int]
    """Indices of the elements."""
    factors: list[complex]
    """Ratio of the wave amplitudes of each element to those of the first element."""


@final
@dataclass(frozen=True, eq=False)
class Source:
    """Elements that radiate together, with a common curvature and coherence width."""

    content: tuple[SourceElement, ...] | RepeatedElement
    """The elements, or the repeated element of a phased array."""
    dimension: int
    """Number of components of a position: 2, or 1 for slits."""
    curvature: Floats
    """Symmetric matrix Q in 1/m^2, shape (d, d); zero for a flat wave."""
    centre: Floats
    """Point c in m at which the curved wave touches the plane, shape (d,)."""
    coherence_width: float = np.inf
    """Coherence width in m, the standard deviation of the degree of coherence; inf if coherent."""
    wavelength: float | None = None
    """Wavelength in m of the curvature; None: the curvature is the same at all wavelengths."""
    paths: PathLengths | None = None
    """Phases of the elements that are due to path lengths; None if there are none."""

    def with_elements(self, elements: Sequence[SourceElement], **changes: Any) -> Source:
        """Return a source with other elements, and with ``changes`` of its other fields."""
        return replace(self, content=tuple(elements), **changes)

    @property
    def repeated(self) -> RepeatedElement | None:
        """The repeated element of a phased array, or None."""
        return self.content if isinstance(self.content, RepeatedElement) else None

    @cached_property
    def elements(self) -> tuple[SourceElement, ...]:
        """The elements, in the order of the weights."""
        if not isinstance(self.content, RepeatedElement):
            return self.content
        copies = self.content
        return tuple(
            replace(copies.element.moved(position), weight=weight)
            for position, weight in zip(copies.positions, copies.weights.tolist(), strict=True)
        )

    @property
    def distinct(self) -> tuple[SourceElement, ...]:
        """The distinct elements; a phased array has only one."""
        return self.elements if self.repeated is None else (self.repeated.element,)

    @cached_property
    def weights(self) -> Complex:
        """Weights of the elements, shape (n,)."""
        if self.repeated is not None:
            return self.repeated.weights
        return np.array([element.weight for element in self.elements], np.complex128)

    def __len__(self) -> int:
        return len(self.weights)

    @cached_property
    def copies(self) -> RepeatedElement | None:
        """The elements as shifted copies of one element; None if they are not copies.

        Sources with fewer than 24 elements are not tested, so the value is None unless they are
        phased arrays.
        """
        if self.repeated is not None or len(self) < _LEAST_COPIES:
            return self.repeated
        try:
            return _as_copies(self.in_plane.elements)
        except GeometryError:
            return None

    @property
    def is_flat(self) -> bool:
        """Whether the curvature is zero."""
        return not self.curvature.any()

    @property
    def is_coherent(self) -> bool:
        """Whether all points of the source are coherent with one another."""
        return self.coherence_width == np.inf

    @cached_property
    def frequencies(self) -> Floats:
        """Distinct frequencies of all waves in 1/m, shape (m, d); 0 for uniform fields."""
        return np.unique(np.concatenate([e.frequencies for e in self.distinct]) + 0.0, axis=0)

    @cached_property
    def groups(self) -> tuple[WaveGroup, ...]:
        """Groups of elements with proportional waves."""
        if self.repeated is not None and self.repeated.element.is_uniform:
            return (WaveGroup(list(range(len(self))), [1.0] * len(self)),)
        groups: list[WaveGroup] = []
        for number, element in enumerate(self.elements):
            for group in groups:
                first = self.elements[group.members[0]]
                factor = _common_factor(element, first.frequencies, first.amplitudes)
                if factor is not None:
                    group.members.append(number)
                    group.factors.append(factor)
                    break
            else:
                groups.append(WaveGroup([number], [1.0]))
        return tuple(groups)

    @cached_property
    def rings(self) -> tuple[Floats, ...]:
        """Rings (n, 2) of all elements in the plane z = 0.

        Raises GeometryError for slits and for elements outside this plane.
        """
        return tuple(ring for element in self.in_plane.elements for ring in element.rings)

    @cached_property
    def bounds(self) -> tuple[float, ...]:
        """Bounds in m: (xmin, xmax) of slits, (xmin, ymin, xmax, ymax) of apertures in z = 0.

        Raises GeometryError if an element does not lie in this plane.
        """
        if self.repeated is not None:
            return joint_bounds([self.repeated.element.outline.bounds], self.repeated.positions)
        return joint_bounds([element.outline.bounds for element in self.in_plane.elements])

    @cached_property
    def in_plane(self) -> Source:
        """The source in the plane z = 0, with the poses of its elements applied.

        Raises GeometryError if an element does not lie in this plane.
        """
        if self.repeated is not None or all(e.pose is None for e in self.elements):
            return self
        flat = [
            element
            if element.pose is None
            else _element_of(
                aperture_in_plane(k, PlacedAperture(element.shape, element.pose)), element.weight
            )
            for k, element in enumerate(self.elements)
        ]
        return self.with_elements(flat)

    def moved(self, shift: ArrayLike) -> Source:
        """Return the source and its field, shifted in its plane by a vector in m.

        The vector has the shape (2,), or (1,) for slits. Raises GeometryError if an element of this
        source does not lie in the plane z = 0.
        """
        offset = np.asarray(shift, np.float64)
        if not offset.any():
            return self
        centre = self.centre + offset if self.curvature.any() else self.centre
        if self.repeated is not None:
            copies = replace(self.repeated, positions=self.repeated.positions + offset)
            return replace(self, content=copies, centre=centre)
        elements = [element.moved(offset) for element in self.in_plane.elements]
        return self.with_elements(elements, centre=centre)

    def with_weights(self, weights: ArrayLike) -> Source:
        """Return the source with the weights of its elements replaced by ``weights`` (n,)."""
        factors = np.asarray(weights, np.complex128)
        if self.repeated is not None:
            return replace(self, content=replace(self.repeated, weights=factors))
        pairs = zip(self.elements, factors.tolist(), strict=True)
        return self.with_elements([replace(e, weight=w) for e, w in pairs])

    def tilted(self, kappa: ArrayLike) -> Source:
        """Return the source multiplied by exp(2 pi i kappa.x), with kappa (d,) in 1/m.

        Raises GeometryError if an element does not lie in the plane z = 0.
        """
        tilt = np.asarray(kappa, np.float64)
        if not tilt.any():
            return self
        if self.repeated is None:
            return self.with_elements([e.tilted(tilt) for e in self.in_plane.elements])
        # For a copy at position p, the tilt adds the constant phase factor exp(2 pi i kappa.p).
        copies = self.repeated
        phases = np.exp(2j * np.pi * (copies.positions @ tilt))
        element = copies.element.tilted(tilt)
        tilted = RepeatedElement(element, copies.positions, copies.weights * phases)
        return replace(self, content=tilted)

    @cached_property
    def public(self) -> Any:
        """The source as a public object: an Aperture, PlacedAperture, Slits, Array or Wavefront."""
        if self.repeated is not None:
            flat: Any = repeated_element(
                self.repeated.element.shape, self.repeated.positions, self.repeated.weights
            )
        else:
            shapes = [
                element.shape if element.pose is None else element.shape.placed(element.pose)
                for element in self.elements
            ]
            is_single = len(shapes) == 1 and self.elements[0].weight == 1.0
            flat = shapes[0] if is_single else Array(shapes, self.weights)
            if self.paths is not None:
                flat = flat.with_paths(self.paths)
        if self.is_flat and self.is_coherent:
            return flat
        return Wavefront(flat, self.curvature, self.centre, self.coherence_width, self.wavelength)


def polygons_of(elements: Sequence[SourceElement]) -> NDArray[Any]:
    """Return the polygons (n,) of elements, in the planes of their poses."""
    return np.array([element.shape.polygons for element in elements], object)


def coherent_form(
    content: Sequence[SourceElement] | RepeatedElement,
    dimension: int,
    paths: PathLengths | None = None,
) -> Source:
    """Return the normal form of a source with a flat, coherent wave."""
    flat = np.zeros((dimension, dimension)), np.zeros(dimension)
    elements = content if isinstance(content, RepeatedElement) else tuple(content)
    return Source(elements, dimension, *flat, paths=paths)


def normal_form(public: PublicSource | Source) -> Source:
    """Return the normal form of a public source, cached in the source.

    Raises ArgumentError for other objects, including polyhedra.
    """
    if isinstance(public, Source):
        return public
    cached = getattr(public, "__dict__", {}).get("_normal_form")
    if cached is None:
        cached = _converted(public)
        cached.__dict__["public"] = public
        public.__dict__["_normal_form"] = cached
    return cached


def _converted(public: PublicSource) -> Source:
    """Return the normal form of a public source without reading or writing the cache."""
    if isinstance(public, Wavefront):
        return replace(
            normal_form(public.source),
            curvature=public.curvature,
            centre=public.centre,
            coherence_width=public.coherence_width,
            wavelength=public.wavelength,
        )
    if not isinstance(public, Array):
        return coherent_form([_element_of(public, 1.0)], 1 if isinstance(public, Slits) else 2)
    dimension = 1 if public.dimension == 1 else 2
    if public.repeated is not None:
        element, positions = public.repeated
        copies = RepeatedElement(_element_of(element, 1.0), positions, public.weights)
        return coherent_form(copies, dimension)
    pairs = zip(public.elements, public.weights.tolist(), strict=True)
    return coherent_form([_element_of(e, w) for e, w in pairs], dimension, public.paths)


def _element_of(public: Any, weight: complex) -> SourceElement:
    """Convert a public aperture, placed aperture or slits to an element with a weight."""
    pose = None
    if isinstance(public, PlacedAperture):
        public, pose = public.aperture, public.pose
    checked_type(public, "an Aperture, Slits or an Array of these", Aperture, Slits)
    field, d = public.illumination, 1 if isinstance(public, Slits) else 2
    if field is None:
        return SourceElement(public, weight, np.ones(1, np.complex128), np.zeros((1, d)), pose)
    outline = public.with_illumination(None)
    return SourceElement(outline, weight, field.amplitudes, field.frequencies, pose)


def _as_copies(elements: Sequence[SourceElement]) -> RepeatedElement | None:
    """Return elements as shifted copies of the first one; None if they are not copies."""
    first = elements[0]
    if not isinstance(first.outline, Aperture):
        return None
    corners = np.concatenate(first.rings)
    shifts, weights = [], []
    for element in elements:
        if [len(ring) for ring in element.rings] != [len(ring) for ring in first.rings]:
            return None
        vertices = np.concatenate(element.rings)
        shift = (vertices - corners).mean(axis=0)
        allowed = _COPIES * max(float(np.abs(vertices).max()), float(np.abs(corners).max()))
        amplitudes = first.moved_amplitudes(shift)
        factor = _common_factor(element, first.frequencies, amplitudes, _COPIED_FIELDS)
        if factor is None or float(np.abs(vertices - corners - shift).max()) > allowed:
            return None
        shifts.append(shift)
        weights.append(element.weight * factor)
    element = replace(first, weight=1.0)
    return RepeatedElement(element, np.array(shifts), np.array(weights, np.complex128))


def _common_factor(
    element: SourceElement,
    frequencies: Floats,
    amplitudes: Complex,
    tolerance: float = _PROPORTIONAL,
) -> complex | None:
    """Return the ratio of the amplitudes of an element's waves to ``amplitudes``.

    The result is None if the frequencies differ, or the amplitudes are not proportional.
    """
    if not np.array_equal(element.frequencies, frequencies):
        return None
    factor = complex(element.amplitudes[0] / amplitudes[0])
    error = np.abs(element.amplitudes - factor * amplitudes).max()
    return factor if error <= tolerance * np.abs(element.amplitudes).max() else None
