"""Checks of the arguments of transforms, and selection of the kernel of a call."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution, kernels
from polywigner.errors import ArgumentError
from polywigner.execution import Drjit
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits, Wavefront
from polywigner.geometry.arguments import checked_vectors
from polywigner.kernels import Kernel
from polywigner.source import Array

PhaseSpaceSource = Aperture | Slits | Array | Wavefront
Source = PhaseSpaceSource | PlacedAperture | Polyhedron
Values = NDArray[Any] | Drjit

# Number of frequencies per block, for transforms that are computed as sums. The temporary arrays
# take some 60 MiB.
_BLOCK = 1 << 19
_LEAST_ROWS = 8


def in_plane(nu: Any) -> Values:
    """Return nu without its third component, because an aperture without a pose lies in z = 0.

    Other numbers of components are returned unchanged.
    """
    if execution.is_drjit(nu):
        components = execution.split(nu)
        return execution.joined(components[:2]) if len(components) == 3 else nu
    try:
        shape = np.shape(nu)
    # checked_points raises an ArgumentError for lists with rows of different lengths.
    except ValueError:
        return nu
    return np.asanyarray(nu)[..., :2] if shape and shape[-1] == 3 else nu


def kernel_of(name: str, source: Any, precision: str | None, engine: str) -> Kernel:
    """Return the kernel of a transform from the cache of the source, and check the options.

    Raises ArgumentError for unknown options, and the errors of `kernels.kernel_for`.
    """
    if precision is not None:
        execution.checked_precision(precision)
    if engine != "auto":
        execution.checked_engine(engine)
    known = getattr(source, "__dict__", {}).setdefault("_kernels", {})
    if name not in known:
        kernel = kernels.kernel_for(name, source)
        source.__dict__.setdefault("_tables", {})
        known[name] = kernel
    result: Kernel = known[name]
    return result


def broadcast_shape(arrays: Sequence[Any]) -> tuple[int, ...]:
    """Return the broadcast shape of points without the last axis, or raise ArgumentError."""
    try:
        return np.broadcast(*[a[..., 0] for a in arrays]).shape
    except ValueError:
        shapes = " and ".join(str(a.shape) for a in arrays)
        raise ArgumentError(
            f"expected shapes that broadcast before the last axis, got {shapes}; insert axes "
            "of length 1, as in x[:, None, :]"
        ) from None


def array_on_grid(
    array: Array,
    nu: Any,
    precision: str | None,
    engine: str,
    point_by_point: Callable[[NDArray[np.float64]], NDArray[np.complexfloating[Any]]],
) -> NDArray[np.complexfloating[Any]] | None:
    """Return the Fourier transform of an array of apertures on a grid of frequencies.

    The result is None if the frequencies are not a grid, if an aperture has a pose, or if another
    method is faster. ``point_by_point`` computes the transform at frequencies at which the formula
    for grids loses digits.
    """
    if execution.is_drjit(nu) or array.dimension != 2:
        return None
    execution.checked_precision(precision)
    points = checked_points("nu", in_plane(nu), 2, keep_single=True)

    def parts(components: Sequence[NDArray[np.float64]]) -> Sequence[NDArray[np.floating[Any]]]:
        """Return the real and the imaginary part of the transform at frequencies (nu_x, nu_y)."""
        values = point_by_point(np.stack(components, axis=-1))
        return values.real, values.imag

    value, into = empty_result(points.shape[:-1], precision, 2)
    is_grid = execution.evaluate_on_grid(
        kernels.kernel_for("fourier", array),
        array,
        [points[..., 0], points[..., 1]],
        parts,
        into,
        execution.checked_engine(engine),
    )
    return value if is_grid else None


def empty_result(
    shape: tuple[int, ...], precision: str | None, outputs: int
) -> tuple[Any, list[Any]]:
    """Return an uninitialised array, and views of its real and imaginary part.

    The array is real for one output, and complex for two outputs. For a real array, the only view
    is the array itself.
    """
    single = precision == "single"
    if outputs == 1:
        value = np.empty(shape, np.float32 if single else np.float64)
        return value, [value]
    value = np.empty(shape, np.complex64 if single else np.complex128)
    return value, [value.real, value.imag]


def in_blocks(evaluate: Callable[[Any], Values], nu: Any) -> Values:
    """Return ``evaluate(nu)``, computed in blocks of rows if the number of frequencies is large."""
    if not isinstance(nu, np.ndarray) or nu.ndim < 2 or nu.size <= nu.shape[-1] * _BLOCK:
        return evaluate(nu)
    # A block of a frequency grid needs enough rows to use the axes of the grid.
    rows = max(_LEAST_ROWS, _BLOCK // math.prod(nu.shape[1:-1]))
    values: Any = None
    for start in range(0, len(nu), rows):
        block = evaluate(nu[start : start + rows])
        if values is None:
            values = np.empty(nu.shape[:-1], block.dtype)
        values[start : start + rows] = block
    return values


def checked_points(
    name: str, value: Any, dimension: int, keep_single: bool = False
) -> NDArray[Any]:
    """Return points as a float64 array with ``dimension`` components on the last axis.

    Raises ArgumentError if this is impossible. With ``keep_single``, float32 arrays are returned
    unchanged, because a float64 copy may not fit into memory.
    """
    if isinstance(value, np.ndarray) and not isinstance(value, np.ma.MaskedArray):
        is_kept = value.dtype == np.float64 or (keep_single and value.dtype == np.float32)
        if is_kept and value.shape[-1:] == (dimension,):
            return np.asarray(value)
    expected = f"expected {name} of shape (..., {dimension}), with real numbers as components"
    return checked_vectors(value, f"{expected} on the last axis", (dimension,))
