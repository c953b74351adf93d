"""The transforms of differentiable sources."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from polywigner import execution, kernels
from polywigner.execution import Parameter, Parameters
from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.kernels.slopes.slopes import slopes_in_ends
from polywigner.numerics.complex_pairs import Pair
from polywigner.transforms.arguments import in_plane, transform
from polywigner.transforms.traced_sources import Differentiable, parameters_of

__all__ = ["fourier_of", "phase_space_of"]


def phase_space_of(
    name: str,
    source: Differentiable,
    points: Sequence[tuple[str, Any]],
    precision: str | None,
    engine: str,
) -> Any:
    """W or A, by the kernel of all outlines: short cuts of arrays have no derivatives."""
    if source.intervals is not None:
        return _of_slits(name, source, points, precision, engine)
    return execution.evaluate_traced(
        kernels.WIGNER if name == "wigner" else kernels.AMBIGUITY,
        source.source,
        points,
        precision=execution.checked_precision(precision),
        engine=execution.checked_engine(engine),
        complex_result=name != "wigner",
        parameters=parameters_of(source),
    )


def fourier_of(
    source: Differentiable, nu: Any, precision: str | None, engine: str, plain: Callable[..., Any]
) -> Any:
    """F as a sum over all waves on all elements, (C1) and (I1).

    ``plain`` is :func:`polywigner.fourier`, for the values of slits.
    """
    if source.intervals is not None:
        return _of_slits("fourier", source, [("nu", nu)], precision, engine, plain)
    float_type = next(iter(parameters_of(source).types))
    if not execution.is_drjit(nu):
        nu = execution.tensor_of(float_type, execution.host_points("nu", in_plane(nu)))
    nu = in_plane(nu)
    how = {
        "precision": execution.checked_precision(precision),
        "engine": execution.checked_engine(engine),
    }
    plain = source.source
    total: Any = None
    if isinstance(plain, Array) and plain.repeated is not None and source.vertices is None:
        element, positions = plain.repeated
        assert source.weights is not None and isinstance(element, Aperture)
        value = _of_waves(element, None, None, nu, how)
        factor = execution.site_sum(nu, positions, source.weights)
        return execution.product_of_complex(value, factor)
    for number, (element, vertices) in enumerate(_elements(source)):
        value = _of_waves(element, vertices, source.amplitudes, nu, how)
        if isinstance(plain, Array):
            weight = complex(plain.weights[number])
            value = execution.times_complex(value, _number(source.weights, number, weight))
        total = value if total is None else total + value
    return total


def _of_slits(
    name: str,
    source: Differentiable,
    points: Sequence[tuple[str, Any]],
    precision: str | None,
    engine: str,
    plain_fourier: Callable[..., Any] | None = None,
) -> Any:
    """Values of plain slits, with derivatives in their ends."""
    assert source.intervals is not None
    if not any(execution.is_drjit(value) for _, value in points):
        kind = source.intervals.float_type
        points = [(n, execution.tensor_of(kind, execution.host_points(n, p))) for n, p in points]
    plain, is_complex = source.source, name != "wigner"
    if plain_fourier is not None:
        values = plain_fourier(plain, points[0][1], precision=precision, engine=engine)
    else:
        values = transform(name, plain, points, precision, engine, outputs=1 + is_complex)

    def slopes(ops: Any, *places: Any) -> Any:
        return slopes_in_ends(ops, name, plain, *places)

    return execution.with_end_slopes(values, points, source.intervals, slopes, is_complex)


def _elements(source: Differentiable) -> Iterator[tuple[Aperture, Parameter | None]]:
    plain = source.source
    elements = plain.elements_in_plane
    start = 0
    for element in elements:
        count = sum(len(ring) for ring in element.rings)
        own = source.vertices
        if own is not None and len(elements) > 1:
            own = own.taken(np.arange(start, start + count))
        start += count
        yield element, own


def _of_waves(
    element: Aperture, vertices: Parameter | None, amplitudes: Parameter | None, nu: Any, how: Any
) -> Any:
    field = element.illumination
    uniform = element.with_illumination(None)
    if field is None:
        return _uniform(uniform, vertices, nu, how)
    total: Any = None
    waves = zip(field.amplitudes.tolist(), field.frequencies, strict=True)
    for number, (amplitude, kappa) in enumerate(waves):
        value = _uniform(uniform, vertices, execution.shifted_points(nu, -kappa), how)
        value = execution.times_complex(value, _number(amplitudes, number, amplitude))
        total = value if total is None else total + value
    return total


def _uniform(element: Aperture, vertices: Parameter | None, nu: Any, how: Any) -> Any:
    return execution.evaluate_traced(
        kernels.FOURIER,
        element,
        [("nu", nu)],
        complex_result=True,
        parameters=Parameters(vertices),
        **how,
    )


def _number(parameter: Parameter | None, number: int, value: complex) -> Any:
    if parameter is None:
        return value
    one = parameter.taken([number])
    return Pair(one.first, one.second)
