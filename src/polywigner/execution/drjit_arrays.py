"""Kernels on Dr.Jit arrays: arrays of the caller's own type in and out, traced, differentiable.

Points come as components first (``Point2f``, ``Array2f``, ``ArrayXf`` of two rows) or as
``TensorXf`` with the components last; the result is a ``Float``, or a tensor without the last
axis. Complex results come as Dr.Jit's ``Complex2f``; for tensors as a tensor of shape (..., 2)
with real and imaginary part last, since Dr.Jit has no complex tensors.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from polywigner.errors import ArgumentError
from polywigner.execution.choice import request_for, takes_data
from polywigner.execution.drjit_points import (
    as_complex,
    as_tensor,
    as_tensor_of,
    common_width,
    host_points,
    is_drjit,
    is_tensor,
    nothing,
    own_float,
    point_components,
    product_of_complex,
    tensor_components,
)
from polywigner.execution.frozen import frozen, is_code, is_known
from polywigner.execution.gradients import kernel_with_derivatives
from polywigner.execution.on_drjit_data import OnDrjitData
from polywigner.execution.operations import DrjitOperations
from polywigner.execution.parameters import Parameters, Traced, TracedOperations, as_data, tensor_of
from polywigner.kernels import Kernel
from polywigner.kernels.outline.tables import Tables, cut_of
from polywigner.numerics.phases import cos_sin_turns
from polywigner.plans import launch_for, plan
from polywigner.plans.plan import DATA
from polywigner.toolchain import llvm


def evaluate_traced(
    kernel: Kernel,
    source: Any,
    points: Sequence[tuple[str, Any]],
    *,
    precision: str | None,
    engine: str,
    complex_result: bool,
    parameters: Parameters | None = None,
) -> Any:
    """Result of a kernel whose arguments are points, at least one of them a Dr.Jit array.

    ``points`` are (name, value); what is not a Dr.Jit array is converted to the arrays' type.
    ``parameters``: numbers of the source that are Dr.Jit arrays, of the same type.

    Raises
    ------
    ArgumentError when types, backends, precisions or numbers of points disagree, or a point has the
    wrong number of components.
    EngineError when the arrays are LLVM's and no usable LLVM library is loaded.
    """
    float_type = common_float(points, parameters)
    if not any(is_drjit(value) for _, value in points):
        points = [(name, tensor_of(float_type, host_points(name, value))) for name, value in points]
    ops = DrjitOperations(float_type)
    check_request(float_type, ops.double, precision, engine)
    tensors = any(is_tensor(value) for _, value in points)
    if tensors:
        shape, components = tensor_components(points, float_type, kernel.dimension)
    else:
        components = [
            component
            for name, value in points
            for component in point_components(name, value, float_type, kernel.dimension)
        ]
    if kernel.in_one_frame is not None and (parameters is not None or _follows(components)):
        kernel = kernel.in_one_frame
    tables = _tables(kernel, source, ops.double, parameters)
    components = [_unfolded(component) for component in components]
    results: tuple[Any, ...]
    outputs = 2 if complex_result else 1
    if common_width(components) == 0:  # Dr.Jit has no arithmetic of no numbers with one
        results = tuple(nothing(float_type) for _ in range(outputs))
    else:
        results = _launched(kernel, ops, tables, components, parameters, outputs)
    if tensors:
        return as_tensor(results, shape, points)
    if complex_result:
        return as_complex(results, None, None)
    return results[0]


def _launched(
    kernel: Kernel,
    ops: DrjitOperations,
    tables: Any,
    components: Sequence[Any],
    parameters: Parameters | None,
    outputs: int,
) -> tuple[Any, ...]:
    """Results of a kernel for components, one or more of them wide."""
    import drjit

    launch = launch_for(
        max(map(drjit.width, components)),
        changes=parameters is not None and bool(parameters.types),
        recordable=is_known(components)
        and (is_code(kernel, ops, tables) or takes_data(kernel, tables)),
        by_pairs=isinstance(tables, Tables) and cut_of(ops.target, tables) == "pairs",
    )
    if launch == "recorded":
        found = _by_data(kernel, ops, tables, components, outputs)
        if found is not None:
            return found
        if is_code(kernel, ops, tables):
            code, kind = partial(kernel, ops, tables), ops.float_type
            return frozen(lambda: (code, ()), (kernel, tables), kind, "as it is")(*components)
    traced = Traced() if parameters is None else parameters.traced(ops, tables)
    if launch == "data":
        ops = TracedOperations(ops.float_type)
        tables = as_data(ops, tables)
    return kernel_with_derivatives(kernel, ops, tables, components, traced)


def _by_data(
    kernel: Kernel, ops: DrjitOperations, tables: Any, components: Sequence[Any], outputs: int
) -> tuple[Any, ...] | None:
    """Results from the source as data, as planned; None where it is to be code of a kernel."""
    import drjit

    width = max(map(drjit.width, components))
    request = request_for(kernel, tables, width, double=ops.double, engine="llvm")
    if plan(request).way.name != DATA:
        return None
    data = OnDrjitData(kernel, tables, ops.double, "llvm", width, outputs)
    return data.of_arrays(components)


def checked_float(name: str, value: Any, precision: str | None, engine: str) -> tuple[Any, bool]:
    """The float type behind an array, and whether it is double. Raises ArgumentError."""
    import drjit

    found = own_float(name, value)
    double = drjit.itemsize_v(found) == 8
    check_request(found, double, precision, engine)
    return found, double


def _unfolded(component: Any) -> Any:
    """A component as it is, but a constant that is no number as one that is looked up.

    Dr.Jit folds constants into the code, and drops NaN in doing so.
    """
    import drjit

    if component.state != drjit.VarState.Literal or drjit.grad_enabled(component):
        return component
    value = component[0]
    if math.isfinite(value):
        return component
    return drjit.opaque(type(component), value, drjit.width(component))


def _follows(components: Sequence[Any]) -> bool:
    """Whether derivatives in any of the arguments may be asked for."""
    import drjit

    return any(map(drjit.grad_enabled, components))


def _tables(kernel: Kernel, source: Any, double: bool, parameters: Parameters | None) -> Any:
    """Tables of the kernel, with vertices numbered as the parameters are.

    Equal apertures may begin their rings elsewhere, and share tables of the cache.
    """
    if parameters is None or parameters.vertices is None:
        return kernel.tables(source, double)
    return getattr(kernel.tables, "__wrapped__", kernel.tables)(source, double)


def common_float(points: Sequence[tuple[str, Any]], parameters: Parameters | None) -> Any:
    types = {own_float(name, value) for name, value in points if is_drjit(value)}
    types |= set() if parameters is None else parameters.types
    if len(types) > 1:
        found = " and ".join(sorted(f"{t.__module__}.{t.__name__}" for t in types))
        raise ArgumentError(
            f"expected arrays of one backend and precision, got {found}; convert one of them"
        )
    return types.pop()


def check_request(float_type: Any, double: bool, precision: str | None, engine: str) -> None:
    own = "double" if double else "single"
    if precision not in (None, own):
        raise ArgumentError(
            f"expected precision={own!r} or None for arrays of {float_type.__name__}, got "
            f"{precision!r}; convert the arrays instead"
        )
    backend = "cuda" if ".cuda" in float_type.__module__ else "llvm"
    if engine not in ("auto", backend):
        raise ArgumentError(
            f"expected engine={backend!r} or 'auto' for arrays of {float_type.__module__}, got "
            f"{engine!r}; convert the arrays instead"
        )
    if backend == "llvm":
        llvm.require()


@dataclass(frozen=True)
class PointKind:
    """The kind of array that points are."""

    float_type: Any
    tensor: tuple[Any, tuple[int, ...]] | None
    """Of tensors: their type and broadcast shape, without the last axis."""

    def points(self, components: Sequence[Any]) -> Any:
        """Points of these components."""
        count = len(components)
        if self.tensor is not None:
            kind, shape = self.tensor
            if count == 1 or 0 in shape:
                return kind(components[0], (*shape, count))
            return as_tensor_of(kind, tuple(components), shape)
        if count == 1:
            return components[0]
        import drjit

        module = sys.modules[self.float_type.__module__]
        double = drjit.itemsize_v(self.float_type) == 8
        return (module.Array2f64 if double else module.Array2f)(*components)

    def turned(self, value: Any, turns: Any) -> Any:
        """A result, real or complex, times exp(2 pi i turns)."""
        import drjit

        wave = cos_sin_turns(DrjitOperations(self.float_type), turns)
        if self.tensor is not None:
            like: Any = self.tensor[0](nothing(self.float_type), (0,))
            return product_of_complex(value, as_complex(wave, self.tensor[1], like))
        factor = as_complex(wave, None, None)
        return value * factor if drjit.is_complex_v(value) else factor * value


def components_of_all(
    points: Sequence[tuple[str, Any]], dimension: int
) -> tuple[list[list[Any]], PointKind]:
    """The components of several points, at least one a Dr.Jit array, and the kind of all."""
    float_type = common_float(points, None)
    tensor = None
    if any(is_tensor(value) for _, value in points):
        shape, flat = tensor_components(points, float_type, dimension)
        tensor = next(type(value) for _, value in points if is_tensor(value)), shape
    else:
        flat = [c for name, p in points for c in point_components(name, p, float_type, dimension)]
        common_width(flat)  # its error
    rows = [list(flat[k : k + dimension]) for k in range(0, len(flat), dimension)]
    return rows, PointKind(float_type, tensor)


def matrix_times(matrix: Any, components: Sequence[Any]) -> list[Any]:
    """The components of a matrix times a vector, without the elements that are zero."""
    return [
        sum((c * m for c, m in zip(components, row, strict=True) if m), 0.0)
        for row in matrix.tolist()
    ]
