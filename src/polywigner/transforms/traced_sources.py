"""Sources whose vertices, weights, amplitudes or intervals are Dr.Jit arrays, and their F."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import execution, kernels
from polywigner.errors import ArgumentError, GeometryError
from polywigner.execution import Differentiable, Drjit, is_drjit
from polywigner.geometry import Aperture, Slits
from polywigner.geometry.arguments import DrJitArray
from polywigner.geometry.rings import signed_area
from polywigner.geometry.wavefront import Field
from polywigner.source import Array, Illumination

PlainFourier = Callable[[Aperture | Slits, Drjit], Drjit]
"""(source without Dr.Jit arrays, component array nu) -> F."""


def check_no_drjit(**arguments: object) -> None:
    """Raise ArgumentError for Dr.Jit arrays, and for sources that contain such arrays."""
    for name, value in arguments.items():
        if isinstance(value, Differentiable) or is_drjit(value):
            raise ArgumentError(
                f"{name} must be made of NumPy arrays, got a Dr.Jit {type(value).__name__}; convert"
                " it (.numpy()), and see docs/gradients.md for functions with derivatives"
            )


def differentiable(
    source: Aperture | Array | Slits | None = None,
    *,
    vertices: DrJitArray | None = None,
    weights: DrJitArray | None = None,
    amplitudes: DrJitArray | None = None,
    intervals: DrJitArray | None = None,
) -> Differentiable:
    """Return a source with Dr.Jit arrays as some of its numbers, to differentiate by them.

    `fourier`, `wigner` and `ambiguity` accept it instead of the source. They return Dr.Jit arrays,
    which ``dr.backward`` and ``dr.forward`` differentiate in closed form (docs/gradients). The
    source provides the other numbers and the rings of the vertices.

    Parameters
    ----------
    source : Aperture, Array or Slits, optional
        Arrays consist of apertures in the plane z = 0. None (default) stands for the aperture with
        the ring ``vertices``, or the slits ``intervals``.
    vertices : Array2f (2, n) or tensor (n, 2), optional
        Points in m that replace the vertices of all rings (``Aperture.rings``) of all elements, one
        ring after the other. Unlike an Aperture, the source keeps vertices on the line between
        their neighbours.
    weights : Complex2f or Float (k,), or tensor (k,) or (k, 2), optional
        Weights of the elements of an Array; a second axis has real and imaginary parts.
    amplitudes : Complex2f or Float (m,), or tensor (m,) or (m, 2), optional
        Amplitudes of the waves of an Aperture's illumination, in the order of its frequencies.
    intervals : Array2f (2, m) or tensor (m, 2), optional
        Begins and ends in m that replace the intervals, in ascending order without contact.

    Returns
    -------
    Differentiable
        Its ``source`` has the present values of all numbers.

    Raises
    ------
    ArgumentError
        If an array has the wrong kind or number of entries.
    GeometryError
        For vertices that form no valid outline or reverse its orientation, and for intervals that
        do not ascend or that touch.
    IlluminationError
        As `Array` and `Illumination` raise it.

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
    if intervals is not None or isinstance(source, Slits):
        if intervals is None or not (vertices is weights is amplitudes is None):
            raise ArgumentError("expected Slits with intervals as a Dr.Jit array alone")
        return _of_slits(source, execution.plane_points("intervals", intervals))
    if source is None and vertices is None:
        raise ArgumentError("expected a source or the vertices of a ring, got neither")
    is_plane = isinstance(source, Aperture | Array) and all(
        isinstance(element, Aperture) for element in source.elements_in_plane
    )
    if source is not None and not is_plane:
        raise ArgumentError(
            f"expected an Aperture, an Array of apertures, or None, got {type(source).__name__}"
        )
    if vertices is weights is amplitudes is None:
        raise ArgumentError("expected vertices, weights or amplitudes as Dr.Jit arrays, got none")
    numbers: dict[str, Drjit] = {}
    if vertices is not None:
        corners = execution.plane_points("vertices", vertices)
        source, numbers["vertices"] = _with_vertices(source, corners)
    for name, values in (("weights", weights), ("amplitudes", amplitudes)):
        if values is not None:
            numbers[name] = execution.complex_numbers(name, values)
            real, imag = execution.columns_of(numbers[name]).T
            change = _with_weights if name == "weights" else _with_amplitudes
            source = change(source, real + 1j * imag)
    return Differentiable(source, **numbers)


def _of_slits(source: Aperture | Array | Slits | None, ends: Drjit) -> Differentiable:
    if not isinstance(source, Slits | None):
        raise ArgumentError(f"expected Slits or None with intervals, got {type(source).__name__}")
    values = execution.columns_of(ends)
    if source is not None and len(values) != len(source.intervals):
        raise ArgumentError(
            f"expected {len(source.intervals)} intervals, as many as the source has, got "
            f"{len(values)}"
        )
    slits = Slits(values)
    if slits.intervals.shape != values.shape or (slits.intervals != values).any():
        raise GeometryError(
            "expected intervals in ascending order that do not touch, got "
            f"{values.tolist()}; sort them, or take shorter steps"
        )
    field = None if source is None else source.illumination
    return Differentiable(slits.with_illumination(field), intervals=ends)


def _with_vertices(
    source: Aperture | Array | None, vertices: Drjit
) -> tuple[Aperture | Array, Drjit]:
    points = execution.columns_of(vertices)
    if source is None:
        # Outlines run counter-clockwise.
        if len(points) > 2 and np.isfinite(points).all() and signed_area(points) < 0:
            vertices, points = (
                execution.entries(vertices, np.arange(len(points))[::-1]),
                points[::-1],
            )
        return _of_rings([[points]], None), vertices
    elements = source.elements_in_plane
    ends = np.cumsum([sum(len(ring) for ring in element.rings) for element in elements])
    if len(points) != ends[-1]:
        raise ArgumentError(
            f"expected {ends[-1]} vertices, as many as the source has, got {len(points)}"
        )
    corners = np.split(points, ends[:-1])
    moved = [_moved(element, some) for element, some in zip(elements, corners, strict=True)]
    if isinstance(source, Aperture):
        return moved[0], vertices
    return Array(moved, source.weights), vertices


def _moved(aperture: Aperture, points: NDArray[np.float64]) -> Aperture:
    """Return an aperture with other vertices, exteriors first as in ``rings``."""
    parts = aperture._parts
    ends = np.cumsum([len(ring) for ring in aperture.rings])
    rings = np.split(points, ends[:-1])
    holes = iter(rings[len(parts) :])
    regrouped = [[rings[k], *(next(holes) for _ in part[1:])] for k, part in enumerate(parts)]
    return _of_rings(regrouped, aperture.illumination)


def _of_rings(parts: list[list[NDArray[np.float64]]], illumination: Field | None) -> Aperture:
    """Return an aperture of exactly these vertices. Raises GeometryError if it is not valid."""
    for part in parts:
        for number, ring in enumerate(part):
            area = signed_area(ring) if len(ring) > 2 and np.isfinite(ring).all() else 0.0
            is_repeated = (ring == np.roll(ring, 1, axis=0)).all(axis=1).any()
            if is_repeated or not (area < 0 if number else area > 0):
                raise GeometryError(
                    "expected finite vertices that differ from their neighbours, around areas with "
                    f"the orientation of the outline, got {ring.tolist()!r:.100}; take shorter "
                    "steps, or leave out repeated vertices"
                )
    Aperture(shapely.MultiPolygon([(part[0], part[1:]) for part in parts]))
    result = Aperture._of_parts([tuple(part) for part in parts])
    return result.with_illumination(illumination)


def _with_weights(source: Aperture | Array | None, weights: NDArray[np.complex128]) -> Array:
    if not isinstance(source, Array):
        raise ArgumentError("expected weights for an Array only, got some for an Aperture")
    if source.repeated is not None:
        from polywigner.source.array import repeated_element

        return repeated_element(*source.repeated, weights)
    return Array(source.elements, weights)


def _with_amplitudes(
    source: Aperture | Array | None, amplitudes: NDArray[np.complex128]
) -> Aperture:
    field = source.illumination if isinstance(source, Aperture) else None
    if not isinstance(source, Aperture) or field is None:
        raise ArgumentError("expected amplitudes for an Aperture with an illumination only")
    if len(amplitudes) != len(field.amplitudes):
        raise ArgumentError(
            f"expected {len(field.amplitudes)} amplitudes, one for each wave, got {len(amplitudes)}"
        )
    # A wave of amplitude zero would be dropped, and with it the derivative.
    tiny = 1e-200 * np.abs(amplitudes).max(initial=1e-100)
    nonzero = np.where(amplitudes == 0.0, tiny, amplitudes)
    return source.with_illumination(Illumination(nonzero, field.frequencies))


def fourier_of(source: Differentiable, nu: Drjit, plain: PlainFourier) -> Drjit:
    """Return F at a component array as a sum over all waves on all elements, (C1) and (I1)."""
    if source.intervals is not None:
        slits = source.source
        value = plain(slits, nu)
        return execution.with_end_slopes(value, "fourier", slits, source.intervals, {"nu": nu})
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
        value = _of_waves(Differentiable(element, corners, amplitudes=source.amplitudes), nu)
        if is_array:
            value = _times(value, source.weights, number, complex(array.weights[number]))
        total = total + value
    return total


def _of_waves(element: Differentiable, nu: Drjit) -> Drjit:
    field = element.source.illumination or Illumination([1.0], [(0.0, 0.0)])
    uniform = Differentiable(element.source.with_illumination(None), element.vertices)
    total = 0.0
    waves = zip(field.amplitudes.tolist(), field.frequencies, strict=True)
    for number, (amplitude, kappa) in enumerate(waves):
        points = {"nu": execution.shifted(nu, -kappa)}
        value = execution.evaluate_traced(kernels.FOURIER, uniform, points, complex_result=True)
        total = total + _times(value, element.amplitudes, number, amplitude)
    return total


def _times(value: Drjit, numbers: Drjit | None, index: int, constant: complex) -> Drjit:
    """Return a value times an entry of ``numbers``, or times a constant if ``numbers`` is None."""
    if numbers is None:
        return execution.times_complex(value, constant)
    return value * execution.entries(numbers, np.array([index]))
