"""Selection of the kernel for a transform and a kind of source."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits, Wavefront
from polywigner.geometry.rings import sides_of
from polywigner.kernels import element_pairs, lattice_arrays
from polywigner.kernels.array_factors import array_factor_kernel
from polywigner.kernels.element_pairs import is_scattered
from polywigner.kernels.functions import fourier, partly_coherent, plane, separable
from polywigner.kernels.functions import intervals as line
from polywigner.kernels.functions.separable import is_separable
from polywigner.kernels.kernel import Kernel
from polywigner.source import Array
from polywigner.source.lattices import Sites

_TRANSFORMS = ("autocorrelation", "wigner", "ambiguity")

# Kernels by transform and kind of source. The kind is a Python type or a key of `_SPECIAL`.
_KERNELS: dict[tuple[str, Any], Kernel] = {
    (name, kind): getattr(home, name.replace(" ", "_").upper())
    for kind, home, names in (
        (Slits, line, _TRANSFORMS),
        (Aperture, plane, _TRANSFORMS),
        ("product", separable, _TRANSFORMS),
        ("lattice", lattice_arrays, _TRANSFORMS[1:]),
        ("scattered", element_pairs, _TRANSFORMS),
    )
    for name in names
} | {
    ("lag_marginal", Aperture): plane.LAG_MARGINAL,
    ("fourier", Slits): line.FOURIER,
    ("fourier", Aperture): plane.FOURIER,
    ("fourier", PlacedAperture): plane.FOURIER_PLACED,
    ("fourier", Polyhedron): fourier.BODY,
    ("fourier of waves", "product"): separable.FOURIER,
    ("autocorrelation", "lattice"): element_pairs.AUTOCORRELATION,
}

# Conditions for faster kernels, in descending order of priority.
_SPECIAL: dict[str, Callable[[Any], bool]] = {
    "product": lambda source: isinstance(source, Aperture) and is_separable(source),
    "lattice": lambda source: isinstance(source, Array) and lattice_arrays.is_on_lattice(source),
    "scattered": lambda source: isinstance(source, Array) and is_scattered(source),
}

_PARTLY_COHERENT: dict[Kernel, Kernel] = {
    plane.WIGNER: partly_coherent.WIGNER,
    line.WIGNER: partly_coherent.WIGNER_OF_SLITS,
    separable.WIGNER: partly_coherent.WIGNER_OF_PRODUCT,
}


MOST_WIDTHS = 1 << 15
"""Largest area of a source, in squared coherence widths, for which W is computed as an average over
tilts. The average needs four tilts per squared coherence width."""
# Largest numbers of array elements for which W in partially coherent light is computed in closed
# form, at a cost proportional to the number of element pairs. The larger limit applies if an
# average over tilts would need too many tilts.
_FEW_ELEMENTS, _MOST_ELEMENTS = 16, 256


def partly_coherent_kernel(source: Wavefront) -> Kernel | None:
    """Return the kernel of W in partially coherent light, or None if W is averaged over tilts.

    The kernel ignores the curvature of the wavefront, which the caller represents by shifted
    frequencies.
    """
    flat = source.source
    kernel = _PARTLY_COHERENT.get(kernel_for("wigner", flat))
    if kernel is not None:
        return kernel
    widths = 1.0 + sides_of(source.bounds) / source.coherence_width
    most = _MOST_ELEMENTS if math.prod(widths.tolist()) > MOST_WIDTHS else _FEW_ELEMENTS
    if len(flat.elements_in_plane) > most:
        return None
    return partly_coherent.WIGNER if source.dimension == 2 else partly_coherent.WIGNER_OF_SLITS


def kernel_for(transform: str, source: Any) -> Kernel:
    """Return the kernel that computes a transform of a source.

    The Fourier transform of an array has no kernel, because it is a sum over the elements.

    Raises
    ------
    ArgumentError
        If the source is not supported. Phase-space functions of a polyhedron are not supported
        because they have six arguments, and phase-space functions of a placed aperture because its
        plane differs from the plane of x.
    GeometryError
        If the transform is a phase-space function and the array does not lie in the plane z = 0.
    """
    if isinstance(source, Wavefront):
        kernel = partly_coherent_kernel(source) if transform == "wigner" else None
        if kernel is None:
            raise ArgumentError(
                f"expected a flat, coherent source for {transform}, got {source!r}; pass the "
                "attribute .source of the wavefront"
            )
        return kernel
    if isinstance(source, Sites) and transform == "array factor":
        return array_factor_kernel(source.dimension)
    if isinstance(source, Array) and source.dimension == 3:
        # Reading this property raises GeometryError if the elements lie in different planes.
        _ = source.elements_in_plane
    for kind, holds in _SPECIAL.items():
        if (transform, kind) in _KERNELS and holds(source):
            return _KERNELS[transform, kind]
    elements = source.elements_in_plane if isinstance(source, Array) else (source,)
    kernel = _KERNELS.get((transform, type(elements[0])))
    if kernel is not None:
        return kernel
    kinds = [kind for name, kind in _KERNELS if name == transform and isinstance(kind, type)]
    accepted = ", ".join(kind.__name__ for kind in kinds)
    hint = "make one with polywigner.Aperture(vertices)"
    if isinstance(source, PlacedAperture):
        hint = "pass its attribute .aperture, with x and nu in the plane of the aperture"
    elif isinstance(source, Polyhedron):
        hint = "only polywigner.fourier accepts a Polyhedron"
    raise ArgumentError(
        f"expected a source for {transform} ({accepted} or Array), got "
        f"{type(source).__name__}; {hint}"
    )
