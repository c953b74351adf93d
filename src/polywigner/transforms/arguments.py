"""Arguments of all transforms: checked once; then kernel and engine are found."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from polywigner import execution, kernels
from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits, Wavefront
from polywigner.source import Array
from polywigner.source.lattices import Sites

PhaseSpaceSource = Aperture | Slits | Array | Wavefront
Source = PhaseSpaceSource | PlacedAperture | Polyhedron
_COMPLEX = ("fourier", "array factor")  # of real and complex nu

# Frequencies at a time where several arrays of their number are held: some 60 MiB.
_BLOCK = 1 << 19
_LEAST_ROWS = 8


def in_plane(nu: Any) -> Any:
    """The first two components of three: an aperture without a pose lies in the plane z = 0."""
    if execution.is_drjit(nu):
        return execution.in_plane(nu)
    try:
        shape = np.shape(nu)
    except ValueError:  # lists of unequal lengths: checked_points says what is expected
        return nu
    return np.asanyarray(nu)[..., :2] if shape and shape[-1] == 3 else nu


def transform(
    name: str,
    source: Source | Sites,
    points: Sequence[tuple[str, Any]],
    precision: str | None,
    engine: str,
    *,
    outputs: int = 1,
    shear: execution.Shear | None = None,
) -> Any:
    """Check the arguments once, and hand them to the engine of their type.

    ``shear``: of NumPy's components, as :func:`polywigner.execution.evaluate` has it.
    """
    if any(execution.is_drjit(value) for _, value in points):
        return execution.evaluate_traced(
            _kernel_for(name, source, precision, engine),
            source,
            points,
            precision=precision,
            engine=engine,
            complex_result=outputs == 2,
        )
    kernel, components = checked_call(name, source, points, precision, engine)
    shape = np.broadcast_shapes(*(c.shape for c in components))
    value, parts = _empty(shape, precision, outputs)
    execution.evaluate(
        kernel,
        source,
        components,
        double=precision != "single",
        engine=engine,
        outputs=outputs,
        into=parts,
        shear=shear,
    )
    return value[()]


def _kernel_for(name: str, source: Any, precision: str | None, engine: str) -> Any:
    execution.checked_precision(precision)
    execution.checked_engine(engine)
    return kernels.kernel_for(name, source)


def broadcast_shape(arrays: Sequence[Any]) -> tuple[int, ...]:
    """The shape of a call with points (..., d); ArgumentError if they do not broadcast."""
    try:
        return np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
    except ValueError:
        shapes = " and ".join(str(a.shape) for a in arrays)
        raise ArgumentError(
            f"expected shapes that broadcast before the last axis, got {shapes}; "
            "insert axes of length 1, as in x[:, None, :]"
        ) from None


def checked_call(
    name: str, source: Any, points: Sequence[tuple[str, Any]], precision: str | None, engine: str
) -> tuple[Any, list[Any]]:
    """Return the kernel and the checked components of a call with NumPy arrays."""
    kernel = _kernel_for(name, source, precision, engine)
    arrays = [
        checked_points(*point, kernel.dimension, name in _COMPLEX, keep_single=True)
        for point in points
    ]
    components = [a[..., k] for a in arrays for k in range(kernel.dimension)]
    if any(np.iscomplexobj(a) for a in arrays):
        kernel = kernels.kernel_for(f"complex {name}", source)
        components = [part for c in components for part in (c.real, c.imag)]
    broadcast_shape(arrays)
    return kernel, components


def array_on_grid(
    array: Array,
    nu: Any,
    precision: str | None,
    engine: str,
    point_by_point: Callable[[Any], Any],
) -> Any:
    """F of a whole array of apertures without poses on a grid of real nu; None if that is none.

    ``point_by_point``: nu (..., 2) -> F, for the points that the grid's formula is not for.
    """
    if execution.is_drjit(nu) or array.dimension != 2:
        return None
    execution.checked_precision(precision)
    points = checked_points("nu", in_plane(nu), 2, complex_allowed=True, keep_single=True)
    if np.iscomplexobj(points):
        return None

    def parts(components: Sequence[Any]) -> tuple[Any, Any]:
        values = point_by_point(np.stack(components, axis=-1))
        return values.real, values.imag

    value, into = _empty(points.shape[:-1], precision, 2)
    found = execution.evaluate_on_grid(
        kernels.kernel_for("fourier", array),
        array,
        [points[..., 0], points[..., 1]],
        parts,
        double=precision != "single",
        engine=execution.checked_engine(engine),
        into=into,
    )
    return None if found is None else value


def _empty(shape: tuple[int, ...], precision: str | None, outputs: int) -> tuple[Any, list[Any]]:
    """An array for a real or complex result, and its parts to write into."""
    single = precision == "single"
    if outputs == 1:
        value = np.empty(shape, np.float32 if single else np.float64)
        return value, [value]
    value = np.empty(shape, np.complex64 if single else np.complex128)
    return value, [value.real, value.imag]


def in_blocks(evaluate: Callable[[Any], Any], nu: Any) -> Any:
    """``evaluate(nu)``, of many frequencies some rows at a time.

    For sums of transforms, which hold several arrays as large as what they are given.
    """
    if not isinstance(nu, np.ndarray) or nu.ndim < 2 or nu.size <= nu.shape[-1] * _BLOCK:
        return evaluate(nu)
    # of grids not fewer rows than a grid has
    rows = max(_LEAST_ROWS, _BLOCK // math.prod(nu.shape[1:-1]))
    values: Any = None
    for start in range(0, len(nu), rows):
        found = evaluate(nu[start : start + rows])
        if values is None:
            values = np.empty(nu.shape[:-1], found.dtype)
        values[start : start + rows] = found
    return values


def checked_points(
    name: str, value: Any, dimension: int, complex_allowed: bool, keep_single: bool = False
) -> Any:
    """An array (..., dimension) of float64 or complex128.

    ``keep_single``: one of float32 as it is; a copy in double precision may not fit into memory.
    """
    shape = f"(..., {dimension})"
    if np.ma.is_masked(value):
        raise ArgumentError(
            f"expected {name} without masked elements, got {np.ma.count_masked(value)}; use "
            f"{name}.filled(numpy.nan) or {name}.compressed()"
        )
    try:
        array = np.asarray(value)
    except ValueError:
        array = np.empty(0, dtype=object)
    if array.dtype.kind not in "biufc":
        raise ArgumentError(
            f"expected {name} as numbers of shape {shape}, got {type(value).__name__} that is "
            "not an array of numbers"
        )
    if array.ndim == 0 or array.shape[-1] != dimension:
        raise ArgumentError(
            f"expected {name} of shape {shape}, components last, got shape {array.shape}"
        )
    if array.dtype.kind == "c":
        if not complex_allowed:
            raise ArgumentError(f"expected {name} to be real, got complex numbers; use {name}.real")
        return array.astype(np.complex128, copy=False)
    if keep_single and array.dtype == np.float32:
        return array
    return array.astype(np.float64, copy=False)
