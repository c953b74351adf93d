"""Sources whose vertices, weights or amplitudes are Dr.Jit arrays, and their transforms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import execution, kernels
from polywigner.errors import ArgumentError, GeometryError
from polywigner.execution import Parameter, Parameters, is_drjit
from polywigner.geometry import Aperture, Slits
from polywigner.geometry.arguments import DrJitArray
from polywigner.geometry.rings import signed_area
from polywigner.kernels.outline.wave_pairs import waves_in_frame
from polywigner.kernels.slopes import slopes_in_ends
from polywigner.numerics.complex_pairs import Pair
from polywigner.source import Array, Illumination
from polywigner.transforms.checked_calls import in_plane


@dataclass(frozen=True, eq=False)
class Differentiable:
    """A source with the values that some of its numbers have now, and the arrays that hold these.

    Made by :func:`differentiable`.
    """

    source: Any
    """An Aperture or an Array, or Slits with ``intervals``."""
    vertices: Parameter | None = None
    weights: Parameter | None = None
    amplitudes: Parameter | None = None
    intervals: Parameter | None = None


def check_no_drjit(**arguments: Any) -> None:
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

    `fourier`, `wigner` and `ambiguity` take it in place of the source. They return Dr.Jit arrays,
    which ``dr.backward`` and ``dr.forward`` differentiate in closed form (docs/gradients). The
    source itself has the other numbers, and how vertices form rings.

    Parameters
    ----------
    source : an Aperture, or an Array of apertures in the plane z = 0; or Slits; None for the
        aperture with the ring ``vertices``, or the slits ``intervals``.
    vertices : (n,) points in m, ``Array2f`` or a tensor (n, 2), that take the place of the
        source's: of all rings (``Aperture.rings``) of all elements, one after the other. Unlike
        those of an Aperture, vertices on the line between their neighbours are kept.
    weights : (k,) of the elements of an Array: ``Complex2f``, ``Float``, or a tensor (k,) or
        (k, 2) of real and imaginary parts.
    amplitudes : (m,) of the waves of an Aperture's illumination, in the order of its frequencies;
        like weights.
    intervals : (m,) begins and ends in m, ``Array2f`` or a tensor (m, 2), that take the place of
        those of Slits; ascending, and apart from each other.

    Returns
    -------
    Differentiable; its ``source`` has the present values of all numbers.

    Raises
    ------
    ArgumentError for arrays of the wrong kind or number; GeometryError for vertices that make no
    valid outline or turn it over, and for intervals that do not ascend or that touch;
    IlluminationError as `Array` and `Illumination` do.

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
        others = {"vertices": vertices, "weights": weights, "amplitudes": amplitudes}
        return _of_slits(source, intervals, {**others, "intervals": intervals})
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
    found: dict[str, Parameter] = {}
    if vertices is not None:
        source, found["vertices"] = _with_vertices(
            source, execution.plane_points("vertices", vertices)
        )
    for name, numbers in (("weights", weights), ("amplitudes", amplitudes)):
        if numbers is not None:
            found[name] = execution.complex_numbers(name, numbers)
            change = _with_weights if name == "weights" else _with_amplitudes
            source = change(source, _complex(found[name]))
    return Differentiable(source, **found)


def parameters_of(source: Differentiable) -> Parameters:
    """The arrays, as kernels of the whole source take them."""
    fields = source.weights or source.amplitudes
    by_waves = source.amplitudes is not None
    factors = _wave_factors(source.source) if by_waves else _weight_factors
    return Parameters(source.vertices, fields, by_waves, factors)


def _of_slits(source: Any, intervals: Any, others: dict[str, Any]) -> Differentiable:
    given = [name for name, value in others.items() if value is not None]
    if given != ["intervals"] or not (source is None or isinstance(source, Slits)):
        got = f"{type(source).__name__} with {' and '.join(given) or 'nothing'}"
        raise ArgumentError(f"expected Slits with intervals as a Dr.Jit array alone, got {got}")
    ends = execution.plane_points("intervals", intervals)
    values = ends.values
    if source is not None and len(values) != len(source.intervals):
        raise ArgumentError(
            f"expected {len(source.intervals)} intervals, as many as the source has, got "
            f"{len(values)}"
        )
    plain = Slits(values)
    if plain.intervals.shape != values.shape or (plain.intervals != values).any():
        raise GeometryError(
            "expected intervals in ascending order that do not touch, got "
            f"{values.tolist()}; sort them, or take shorter steps"
        )
    field = None if source is None else source.illumination
    return Differentiable(plain.with_illumination(field), intervals=ends)


def _weight_factors(tables: Any) -> NDArray[np.complex128]:
    return np.array(tables.factors, np.complex128)


def _wave_factors(source: Any) -> Any:
    frequencies = source.illumination.frequencies
    unit = Illumination(np.ones(len(frequencies)), frequencies)

    def factors(tables: Any) -> NDArray[np.complex128]:
        waves = waves_in_frame(unit, tables.frame)
        return np.array([wave.amplitude for wave in waves], np.complex128)

    return factors


def _complex(numbers: Parameter) -> NDArray[np.complex128]:
    values = numbers.values
    result: NDArray[np.complex128] = values[:, 0] + 1j * values[:, 1]
    return result


def _with_vertices(
    source: Aperture | Array | None, vertices: Parameter
) -> tuple[Aperture | Array, Parameter]:
    points = vertices.values
    if source is None:
        # Outlines run counter-clockwise.
        if len(points) > 2 and np.isfinite(points).all() and signed_area(points) < 0:
            vertices, points = vertices.taken(np.arange(len(points))[::-1]), points[::-1]
        return _of_rings([[points]], None), vertices
    elements = source.elements_in_plane
    ends = np.cumsum([sum(len(ring) for ring in element.rings) for element in elements])
    if len(points) != ends[-1]:
        raise ArgumentError(
            f"expected {ends[-1]} vertices, as many as the source has, got {len(points)}"
        )
    own = np.split(points, ends[:-1])
    moved = [_moved(element, some) for element, some in zip(elements, own, strict=True)]
    if isinstance(source, Aperture):
        return moved[0], vertices
    return Array(moved, source.weights), vertices


def _moved(aperture: Aperture, points: NDArray[np.float64]) -> Aperture:
    """An aperture with other vertices, exteriors first as in ``rings``."""
    parts = aperture._parts
    ends = np.cumsum([len(ring) for ring in aperture.rings])
    rings = np.split(points, ends[:-1])
    holes = iter(rings[len(parts) :])
    regrouped = [[rings[k], *(next(holes) for _ in part[1:])] for k, part in enumerate(parts)]
    return _of_rings(regrouped, aperture.illumination)


def _of_rings(parts: list[list[NDArray[np.float64]]], illumination: Any) -> Aperture:
    """An aperture of exactly these vertices, if they make a valid one."""
    if not all(np.isfinite(ring).all() for part in parts for ring in part):
        raise GeometryError("expected finite vertices, got inf or nan")
    for part in parts:
        for number, ring in enumerate(part):
            if len(ring) < 3 or signed_area(ring) == 0:
                raise GeometryError("expected vertices around an area, got a ring without one")
            if (ring == np.roll(ring, 1, axis=0)).all(axis=1).any():
                raise GeometryError(
                    "expected vertices that differ from their neighbours, got a repeated one; "
                    "leave it out"
                )
            if (signed_area(ring) > 0) == bool(number):
                raise GeometryError(
                    "expected vertices that leave the outline's orientation as it is, got a ring "
                    "turned over; take shorter steps"
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
    kept = np.where(amplitudes == 0.0, tiny, amplitudes)
    return source.with_illumination(Illumination(kept, field.frequencies))


def phase_space_of(
    name: str,
    source: Differentiable,
    points: Mapping[str, Any],
    precision: str | None,
    engine: str,
    plain: Callable[..., Any],
) -> Any:
    """W or A, by the kernel of all outlines: short cuts of arrays have no derivatives.

    ``plain``: (name, source, points, precision, engine) -> values for a source without derivatives.
    """
    if source.intervals is not None:
        return _values_of_slits(name, source, points, precision, engine, plain)
    return execution.evaluate_traced(
        kernels.WIGNER if name == "wigner" else kernels.AMBIGUITY,
        source.source,
        list(points.items()),
        precision=execution.checked_precision(precision),
        engine=execution.checked_engine(engine),
        complex_result=name != "wigner",
        parameters=parameters_of(source),
    )


def fourier_of(
    source: Differentiable, nu: Any, precision: str | None, engine: str, plain: Callable[..., Any]
) -> Any:
    """F as a sum over all waves on all elements, (C1) and (I1).

    ``plain`` is :func:`polywigner.fourier`, for sources without derivatives.
    """
    if source.intervals is not None:

        def of_slits(name: str, slits: Any, points: Any, *how: Any) -> Any:
            return plain(slits, points["nu"], precision=how[0], engine=how[1])

        return _values_of_slits("fourier", source, {"nu": nu}, precision, engine, of_slits)
    if not execution.is_drjit(nu):
        float_type = next(iter(parameters_of(source).types))
        nu = execution.tensor_of(float_type, execution.host_points("nu", in_plane(nu)))
    nu = in_plane(nu)
    array = source.source
    if isinstance(array, Array) and array.repeated is not None and source.vertices is None:
        element, positions = array.repeated
        assert source.weights is not None
        value = plain(element, nu, precision=precision, engine=engine)
        return execution.product_of_complex(
            value, execution.site_sum(nu, positions, source.weights)
        )
    how = execution.checked_precision(precision), execution.checked_engine(engine)
    total: Any = None
    for number, (element, vertices) in enumerate(_elements(source)):
        value = _of_waves(element, vertices, source.amplitudes, nu, *how)
        if isinstance(array, Array):
            weight = complex(array.weights[number])
            value = execution.times_complex(value, _number(source.weights, number, weight))
        total = value if total is None else total + value
    return total


def _values_of_slits(
    name: str,
    source: Differentiable,
    points: Mapping[str, Any],
    precision: str | None,
    engine: str,
    plain: Callable[..., Any],
) -> Any:
    """Values of plain slits, with derivatives in their ends."""
    assert source.intervals is not None
    slits = source.source
    if not any(map(execution.is_drjit, points.values())):
        kind = source.intervals.float_type
        points = {
            n: execution.tensor_of(kind, execution.host_points(n, p)) for n, p in points.items()
        }
    values = plain(name, slits, points, precision, engine)

    def slopes(ops: Any, *places: Any) -> Any:
        return slopes_in_ends(ops, name, slits, *places)

    named = list(points.items())
    return execution.with_end_slopes(values, named, source.intervals, slopes, name != "wigner")


def _elements(source: Differentiable) -> Iterator[tuple[Aperture, Parameter | None]]:
    elements, vertices = source.source.elements_in_plane, source.vertices
    start = 0
    for element in elements:
        end = start + sum(len(ring) for ring in element.rings)
        own = vertices
        if vertices is not None and len(elements) > 1:
            own = vertices.taken(np.arange(start, end))
        yield element, own
        start = end


def _of_waves(
    element: Aperture,
    vertices: Parameter | None,
    amplitudes: Parameter | None,
    nu: Any,
    precision: Any,
    engine: Any,
) -> Any:
    field = element.illumination or Illumination([1.0], [(0.0, 0.0)])
    uniform = element.with_illumination(None)
    total: Any = None
    waves = zip(field.amplitudes.tolist(), field.frequencies, strict=True)
    for number, (amplitude, kappa) in enumerate(waves):
        value = execution.evaluate_traced(
            kernels.FOURIER,
            uniform,
            [("nu", execution.shifted_points(nu, -kappa))],
            precision=precision,
            engine=engine,
            complex_result=True,
            parameters=Parameters(vertices),
        )
        value = execution.times_complex(value, _number(amplitudes, number, amplitude))
        total = value if total is None else total + value
    return total


def _number(parameter: Parameter | None, number: int, value: complex) -> Any:
    if parameter is None:
        return value
    one = parameter.taken([number])
    return Pair(one.first, one.second)
