"""Sources whose vertices or weights are Dr.Jit arrays, and their Fourier transforms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely

from polywigner import execution, kernels
from polywigner.errors import ArgumentError, GeometryError
from polywigner.execution import Differentiable, Drjit, is_drjit
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import DrJitArray
from polywigner.geometry.rings import signed_area
from polywigner.numerics import Complex, Floats
from polywigner.source import Array, Illumination
from polywigner.source.array import repeated_element

PlainFourier = Callable[[Aperture, Drjit], Drjit]
"""Function (source without Dr.Jit arrays, nu) that returns the Fourier transform of the source."""


def check_no_drjit(**arguments: object) -> None:
    """Raise ArgumentError if an argument is a Dr.Jit array, or a source with Dr.Jit arrays."""
    for name, value in arguments.items():
        if isinstance(value, Differentiable) or is_drjit(value):
            raise ArgumentError(
                f"expected {name} to be made of NumPy arrays, got a Dr.Jit {type(value).__name__}; "
                "convert it (.numpy()), and see docs/gradients.md for functions with "
                "derivatives"
            )


def differentiable(
    source: Aperture | Array | None = None,
    *,
    vertices: DrJitArray | None = None,
    weights: DrJitArray | None = None,
) -> Differentiable:
    """Return a source whose vertices or weights are Dr.Jit arrays with derivatives.

    The functions `fourier`, `wigner` and `ambiguity` accept the result as their source and return
    Dr.Jit arrays. The functions ``dr.backward`` and ``dr.forward`` differentiate these arrays in
    closed form (docs/gradients). All other numbers, and the division of vertices into rings, are
    taken from ``source``.

    Parameters
    ----------
    source : Aperture or Array, optional
        An Aperture, or an Array of apertures in the plane z = 0. By default, the source is the
        aperture with the ring ``vertices``.
    vertices : Array2f (2, n) or tensor (n, 2), optional
        Points in m that replace the vertices of all rings (``Aperture.rings``) of all elements, one
        ring after the other. An Aperture omits vertices on the line between their neighbours, but
        this source keeps them.
    weights : Complex2f or Float (k,), or tensor (k,) or (k, 2), optional
        Weights of the elements of an Array. The second axis of a tensor contains the real and
        imaginary parts.

    Returns
    -------
    Differentiable
        Source with derivatives. The attribute ``source`` is an Aperture or Array with the current
        values.

    Raises
    ------
    ArgumentError
        If an array has the wrong type or number of entries.
    GeometryError
        If the vertices do not form a valid outline, or reverse the orientation of an outline.
    IlluminationError
        If the weights are not finite numbers, or all zero.

    Examples
    --------
    >>> import polywigner as pw
    >>> import drjit as dr
    >>> from drjit.llvm.ad import Array2f64
    >>> corners = Array2f64([0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0])
    >>> dr.enable_grad(corners)
    >>> square = pw.differentiable(vertices=corners)
    >>> dr.backward(pw.wigner(square, Array2f64(0.5, 0.5), Array2f64(0.3, 0.0)))
    >>> dr.grad(corners).numpy().shape
    (2, 4)
    """
    if source is None and vertices is None:
        raise ArgumentError("expected a source or the vertices of a ring, got neither")
    is_plane = isinstance(source, Aperture | Array) and all(
        isinstance(element, Aperture) for element in source.elements_in_plane
    )
    if source is not None and not is_plane:
        raise ArgumentError(
            f"expected an Aperture, an Array of apertures, or None, got {type(source).__name__}"
        )
    if vertices is weights is None:
        raise ArgumentError("expected vertices or weights as Dr.Jit arrays, got neither")
    numbers: dict[str, Drjit] = {}
    if vertices is not None:
        corners = execution.numbers_of("vertices", vertices, "Array2f")
        source, numbers["vertices"] = _with_vertices(source, corners)
    if weights is not None:
        numbers["weights"] = execution.numbers_of("weights", weights, "Complex2f")
        real, imag = execution.columns_of(numbers["weights"]).T
        source = _with_weights(source, real + 1j * imag)
    return Differentiable(source, **numbers)


def _with_vertices(
    source: Aperture | Array | None, vertices: Drjit
) -> tuple[Aperture | Array, Drjit]:
    """Return a source with the values of Dr.Jit vertices, and the Dr.Jit vertices.

    Without a source, the vertices form a ring. The vertices are reversed if the ring is clockwise.
    Raises ArgumentError if the number of vertices differs from the number in the source.
    """
    points = execution.columns_of(vertices)
    if source is None:
        if len(points) > 2 and np.isfinite(points).all() and signed_area(points) < 0:
            vertices, points = (
                execution.entries(vertices, np.arange(len(points))[::-1]),
                points[::-1],
            )
        return _aperture_of_rings([[points]], None), vertices
    elements = source.elements_in_plane
    ends = np.cumsum([sum(len(ring) for ring in element.rings) for element in elements])
    if len(points) != ends[-1]:
        raise ArgumentError(
            f"expected {ends[-1]} vertices, the number of vertices of the source, got {len(points)}"
        )
    corners = np.split(points, ends[:-1])
    moved = [_with_points(element, part) for element, part in zip(elements, corners, strict=True)]
    if isinstance(source, Aperture):
        return moved[0], vertices
    return Array(moved, source.weights), vertices


def _with_points(aperture: Aperture, points: Floats) -> Aperture:
    """Return an aperture with other vertices (n, 2), in the order of its rings."""
    parts = aperture._parts
    ends = np.cumsum([len(ring) for ring in aperture.rings])
    rings = np.split(points, ends[:-1])
    holes = iter(rings[len(parts) :])
    regrouped = [[rings[k], *(next(holes) for _ in part[1:])] for k, part in enumerate(parts)]
    return _aperture_of_rings(regrouped, aperture.illumination)


def _aperture_of_rings(parts: list[list[Floats]], illumination: Illumination | None) -> Aperture:
    """Return an aperture that keeps all vertices. Raises GeometryError for invalid outlines."""
    for part in parts:
        for number, ring in enumerate(part):
            area = signed_area(ring) if len(ring) > 2 and np.isfinite(ring).all() else 0.0
            is_repeated = (ring == np.roll(ring, 1, axis=0)).all(axis=1).any()
            if is_repeated or not (area < 0 if number else area > 0):
                raise GeometryError(
                    "expected finite vertices without repetitions, in the orientation of the "
                    f"outline, got {ring.tolist()!r:.100}; take shorter steps, or remove "
                    "repeated vertices"
                )
    Aperture(shapely.MultiPolygon([(part[0], part[1:]) for part in parts]))
    result = Aperture._of_parts([tuple(part) for part in parts])
    return result.with_illumination(illumination)


def _with_weights(source: Aperture | Array | None, weights: Complex) -> Array:
    """Return an array with other weights; raise ArgumentError for an aperture."""
    if not isinstance(source, Array):
        raise ArgumentError("expected an Array for weights, got an Aperture")
    if source.repeated is not None:
        return repeated_element(*source.repeated, weights)
    return Array(source.elements, weights)


def fourier_of(source: Differentiable, nu: Drjit, plain: PlainFourier) -> Drjit:
    """Return the Fourier transform of a source with Dr.Jit vertices or weights.

    The transform is a sum over all plane waves on all elements, equations (C1) and (I1).
    """
    array = source.source
    is_array = isinstance(array, Array)
    if is_array and array.repeated is not None and source.vertices is None:
        element, positions = array.repeated
        return plain(element, nu) * execution.site_sum(nu, positions, source.weights)
    total, start = 0.0, 0
    for number, element in enumerate(array.elements_in_plane):
        end = start + sum(len(ring) for ring in element.rings)
        corners = source.vertices
        if corners is not None and is_array:
            corners = execution.entries(corners, np.arange(start, end))
        start = end
        value = _fourier_of_element(Differentiable(element, corners), nu)
        if source.weights is not None:
            value = value * execution.entries(source.weights, np.array([number]))
        elif is_array:
            value = execution.times_complex(value, complex(array.weights[number]))
        total = total + value
    return total


def _fourier_of_element(element: Differentiable, nu: Drjit) -> Drjit:
    """Return the Fourier transform of an element with Dr.Jit vertices, summed over its waves."""
    field = element.source.illumination or Illumination([1.0], [(0.0, 0.0)])
    uniform = Differentiable(element.source.with_illumination(None), element.vertices)
    total = 0.0
    waves = zip(field.amplitudes.tolist(), field.frequencies, strict=True)
    for amplitude, kappa in waves:
        points = {"nu": execution.shifted(nu, -kappa)}
        value = execution.evaluate_traced(kernels.FOURIER, uniform, points, complex_result=True)
        total = total + execution.times_complex(value, amplitude)
    return total
