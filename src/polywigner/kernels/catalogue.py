"""Catalogue of kernels: one for each transform and kind of source."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits, Wavefront
from polywigner.illumination import Array
from polywigner.illumination.lattices import Sites
from polywigner.kernels.arrays import lattice_arrays, pair_sums
from polywigner.kernels.arrays.array_factor import array_factor_kernel
from polywigner.kernels.arrays.element_pairs import distant_parts, is_scattered
from polywigner.kernels.functions import partly_coherent, plane, separable, simplices, solids
from polywigner.kernels.functions import slits as line
from polywigner.kernels.functions.moments import LAG_MOMENTS, LAG_MOMENTS_ALONG
from polywigner.kernels.functions.separable import is_separable
from polywigner.kernels.kernel import Kernel

_KERNELS: dict[tuple[str, type], Kernel] = {
    ("fourier", Slits): simplices.SLITS,
    ("fourier", Aperture): plane.FOURIER,
    ("fourier", PlacedAperture): plane.FOURIER_PLACED,
    ("fourier", Polyhedron): solids.FOURIER,
    ("complex fourier", Slits): simplices.SLITS_COMPLEX,
    ("complex fourier", Aperture): plane.FOURIER_COMPLEX,
    ("complex fourier", PlacedAperture): plane.FOURIER_PLACED_COMPLEX,
    ("complex fourier", Polyhedron): solids.FOURIER_COMPLEX,
    ("autocorrelation", Slits): line.AUTOCORRELATION,
    ("autocorrelation", Aperture): plane.AUTOCORRELATION,
    ("wigner", Slits): line.WIGNER,
    ("wigner", Aperture): plane.WIGNER,
    ("lag moments", Aperture): LAG_MOMENTS,
    ("lag moments along", Aperture): LAG_MOMENTS_ALONG,
    ("ambiguity", Slits): line.AMBIGUITY,
    ("ambiguity", Aperture): plane.AMBIGUITY,
    ("position_marginal", Slits): line.POSITION_MARGINAL,
    ("position_marginal", Aperture): plane.POSITION_MARGINAL,
    ("lag_marginal", Slits): line.LAG_MARGINAL,
    ("lag_marginal", Aperture): plane.LAG_MARGINAL,
    ("lag_marginal of weights", Slits): line.LAG_MARGINAL_OF_FIELDS,
    ("lag_marginal of weights", Aperture): plane.LAG_MARGINAL_OF_FIELDS,
    ("lag_marginal of waves", Slits): line.LAG_MARGINAL_OF_WAVES,
    ("lag_marginal of waves", Aperture): plane.LAG_MARGINAL_OF_WAVES,
    ("position_marginal of waves", Slits): line.POSITION_MARGINAL_OF_WAVES,
    ("position_marginal of waves", Aperture): plane.POSITION_MARGINAL_OF_WAVES,
}

_TILED: dict[tuple[str, type], Kernel] = {
    ("fourier", Aperture): simplices.TILED,
    ("fourier", PlacedAperture): simplices.TILED_PLACED,
    ("complex fourier", Aperture): simplices.TILED_COMPLEX,
    ("complex fourier", PlacedAperture): simplices.TILED_PLACED_COMPLEX,
}


def _tiled(transform: str, source: Any) -> Kernel | None:
    """The kernel of apertures so thin that the usual one loses digits, if this is one."""
    kernel = _TILED.get((transform, type(source)))
    if kernel is None:
        return None
    aperture = source.aperture if isinstance(source, PlacedAperture) else source
    return kernel if simplices.fan_cancels(aperture) else None


_ON_LATTICE: dict[str, Kernel] = {
    "autocorrelation": pair_sums.AUTOCORRELATION,
    "wigner": lattice_arrays.WIGNER,
    "ambiguity": lattice_arrays.AMBIGUITY,
    "position_marginal": lattice_arrays.POSITION_MARGINAL,
    "lag_marginal": lattice_arrays.LAG_MARGINAL,
}


_PRODUCTS: dict[str, Kernel] = {
    "autocorrelation": separable.AUTOCORRELATION,
    "wigner": separable.WIGNER,
    "ambiguity": separable.AMBIGUITY,
    "fourier of waves": separable.FOURIER,
    "position_marginal": separable.POSITION_MARGINAL,
    "lag_marginal": separable.LAG_MARGINAL,
}


_SCATTERED: dict[str, Kernel] = {
    "autocorrelation": pair_sums.AUTOCORRELATION,
    "wigner": pair_sums.WIGNER,
    "ambiguity": pair_sums.AMBIGUITY,
    "position_marginal": pair_sums.POSITION_MARGINAL,
    "lag_marginal": pair_sums.LAG_MARGINAL,
}


_DISTANT: dict[str, Kernel] = {
    "wigner": pair_sums.WIGNER_OF_PARTS,
    "ambiguity": pair_sums.AMBIGUITY_OF_PARTS,
    "position_marginal": pair_sums.POSITION_MARGINAL_OF_PARTS,
    "lag_marginal": pair_sums.LAG_MARGINAL_OF_PARTS,
    "lag_marginal of fields": pair_sums.LAG_MARGINAL_OF_FIELDS,
}


def _distant(transform: str, source: Any, double: bool) -> Kernel | None:
    """The kernel of sources that are small parts far from each other, if this is one."""
    if transform not in _DISTANT or distant_parts(source, double) is None:
        return None
    whole = isinstance(source, Array) or source.illumination is not None
    fields = transform == "lag_marginal" and whole
    return _DISTANT[f"{transform} of fields" if fields else transform]


_PARTLY_COHERENT: dict[Kernel, Kernel] = {
    plane.WIGNER: partly_coherent.WIGNER,
    line.WIGNER: partly_coherent.WIGNER_OF_SLITS,
    separable.WIGNER: partly_coherent.WIGNER_OF_PRODUCT,
}


MOST_WIDTHS = 1 << 15
"""Widths of coherence in the area of a source; a mean has some four tilts for each."""
# Elements of an array with a closed form, in which every pair of them has a slice: of any, and
# where the alternative is a mean over too many tilts.
_FEW_ELEMENTS, _MOST_ELEMENTS = 16, 256


def _widths_in(source: Wavefront) -> float:
    """Widths of coherence in the area of a source's box, or in its length."""
    low, high = np.reshape(source.bounds, (2, -1))
    return math.prod((1.0 + (high - low) / source.coherence_width).tolist())


def partly_coherent_kernel(source: Wavefront, double: bool = True) -> Kernel | None:
    """The kernel of W in light that is coherent over a width; None where it is a mean over tilts.

    Arrays whose elements share one outline, and parts far from each other, have sums of their own
    in coherent light: they are a mean over tilts, unless these are too many or the elements few.
    The kernel leaves the curvature of a wave to its frequencies.
    """
    flat = source.source
    kernel = _PARTLY_COHERENT.get(kernel_for("wigner", flat, double))
    if kernel is not None:
        return kernel
    many_tilts = _widths_in(source) > MOST_WIDTHS
    if isinstance(flat, Array):
        most = _MOST_ELEMENTS if many_tilts else _FEW_ELEMENTS
        if len(flat.elements_in_plane) > most:
            return None
    elif not many_tilts:
        return None
    return partly_coherent.WIGNER if source.dimension == 2 else partly_coherent.WIGNER_OF_SLITS


def _is_illuminated(source: Any) -> bool:
    return getattr(source, "illumination", None) is not None


def kernel_for(transform: str, source: Any, double: bool = True) -> Kernel:
    """The kernel of a transform of a source, for results in double precision or in single.

    An array has the kernels of its elements, slits or apertures of one plane; its Fourier transform
    is the sum of theirs and has none of its own.

    Raises ArgumentError where there is none: for what is not a source, and for phase-space
    functions of polyhedra (six dimensions) and of placed apertures, whose plane is not that of x.
    GeometryError for those of arrays that do not lie in the plane z = 0.
    """
    if isinstance(source, Wavefront):
        found = partly_coherent_kernel(source, double) if transform == "wigner" else None
        if found is None:
            raise ArgumentError(
                f"expected a flat, coherent source for {transform}, got {source!r}; use its .source"
            )
        return found
    if isinstance(source, Sites) and transform.removeprefix("complex ") == "array factor":
        return array_factor_kernel(source.dimension, transform.startswith("complex"))
    if isinstance(source, Aperture) and transform in _PRODUCTS and is_separable(source):
        return _PRODUCTS[transform]
    kind = type(source)
    elements: tuple[Any, ...] = (source,)
    name = transform
    if isinstance(source, Array):
        if transform in _ON_LATTICE and lattice_arrays.is_on_lattice(source):
            return _ON_LATTICE[transform]
        if transform in _SCATTERED and is_scattered(source):
            return _SCATTERED[transform]
        elements = source.elements_in_plane
        kind = type(elements[0])
        name = "lag_marginal of weights" if transform == "lag_marginal" else transform
    distant = _distant(transform, source, double) if kind is Aperture else None
    if distant is not None:
        return distant
    if "marginal" in transform and any(_is_illuminated(element) for element in elements):
        name = f"{transform} of waves"
    kernel = _tiled(transform, source) or _KERNELS.get((name, kind))
    if kernel is not None:
        return kernel
    accepted = ", ".join(kind.__name__ for name, kind in _KERNELS if name == transform)
    hint = "make one with polywigner.Aperture(vertices)"
    if isinstance(source, PlacedAperture):
        hint = "use its .aperture, with x and nu in the aperture's own plane"
    elif isinstance(source, Polyhedron):
        hint = "polyhedra have a Fourier transform only"
    raise ArgumentError(
        f"expected a source for {transform.removeprefix('complex ')} (one of {accepted}, Array), "
        f"got {type(source).__name__}; {hint}"
    )
