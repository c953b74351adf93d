"""Results as the kind of Dr.Jit array that points are, and products of complex ones."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from polywigner.execution.aligned import array_of
from polywigner.execution.drjit_points import is_drjit, is_tensor
from polywigner.execution.parameters import tensor_of

__all__ = [
    "as_complex",
    "as_result",
    "as_tensor",
    "as_tensor_of",
    "from_components",
    "product_of_complex",
    "times_complex",
]


def as_complex(results: tuple[Any, Any], shape: tuple[int, ...] | None, like: Any) -> Any:
    """Real and imaginary parts as the kind of complex result that points ``like`` give."""
    if shape is not None:
        return as_tensor(results, shape, [("", like)])
    float_type = type(results[0])
    module = sys.modules[float_type.__module__]
    double = sys.modules["drjit"].itemsize_v(float_type) == 8
    return (module.Complex2f64 if double else module.Complex2f)(*results)


def as_result(value: Any, shape: tuple[int, ...] | None, like: Any, float_type: Any) -> Any:
    """A real result for points of a kind: a ``Float``, or a tensor of a shape."""
    if shape is None:
        return value
    kind = type(like) if is_drjit(like) else type(tensor_of(float_type, [0.0]))
    return kind(value, shape)


def from_components(
    values: np.ndarray, float_type: Any, tensor: tuple[Any, tuple[int, ...]] | None
) -> Any:
    """NumPy values as a ``Float``, a ``Complex2f`` or, of (type, shape), a tensor."""
    is_complex = np.iscomplexobj(values)
    parts = (values.real, values.imag) if is_complex else (values,)
    floats = tuple(array_of(float_type, part) for part in parts)
    if tensor is not None:
        return as_tensor_of(tensor[0], floats, tensor[1])
    return as_complex((floats[0], floats[1]), None, None) if is_complex else floats[0]


def as_tensor(results: tuple[Any, ...], shape: tuple[int, ...], points: Any) -> Any:
    tensor_type = next(type(value) for _, value in points if is_tensor(value))
    return as_tensor_of(tensor_type, results, shape)


def as_tensor_of(tensor_type: Any, results: tuple[Any, ...], shape: tuple[int, ...]) -> Any:
    import drjit

    if len(results) == 1 or 0 in shape:
        return tensor_type(results[0], (*shape, 2)[: len(shape) + len(results) - 1])
    flat = drjit.empty(type(results[0]), 2 * int(np.prod(shape)))
    index = drjit.arange(drjit.uint32_array_t(type(results[0])), int(np.prod(shape)))
    for k, part in enumerate(results):
        drjit.scatter(flat, part, 2 * index + k)
    return tensor_type(flat, (*shape, 2))


def times_complex(value: Any, factor: Any) -> Any:
    """A complex result of any kind (NumPy, ``Complex2f``, tensor (..., 2)) times a number.

    Of Dr.Jit, ``factor`` may have arrays of one entry as real and imaginary part.
    """
    if not is_drjit(value):
        if factor.imag:
            return value * factor
        # By parts: the product with a complex number makes NaN of an infinite value.
        scaled = np.array(value)
        scaled.real *= factor.real
        scaled.imag *= factor.real
        return scaled[()]
    import drjit

    if not drjit.width(value):
        return value
    if not is_tensor(value):
        return value * type(value)(factor.real, factor.imag)
    flat = value.array
    index = drjit.arange(drjit.uint32_array_t(type(flat)), len(flat))
    other = drjit.gather(type(flat), flat, index ^ 1)  # the imaginary part's place is odd
    imag = type(flat)(factor.imag)  # a choice between Python's floats is one of float32
    signed = drjit.select(index & 1 == 1, imag, -imag) * other
    return type(value)(flat * factor.real + signed, value.shape)


def product_of_complex(a: Any, b: Any) -> Any:
    """The product of two complex results of one kind, shape and type."""
    if not is_tensor(a):
        return a * b
    import drjit

    if not len(a.array):
        return a
    kind = type(a.array)
    even = 2 * drjit.arange(drjit.uint32_array_t(kind), len(a.array) // 2)
    a_real, a_imag, b_real, b_imag = (
        drjit.gather(kind, value.array, even + odd) for value in (a, b) for odd in (0, 1)
    )
    flat = drjit.empty(kind, len(a.array))
    drjit.scatter(flat, a_real * b_real - a_imag * b_imag, even)
    drjit.scatter(flat, a_real * b_imag + a_imag * b_real, even + 1)
    return type(a)(flat, a.shape)
