"""Components of Dr.Jit points of any kind, and points and values made of components again."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from polywigner.execution.drjit_arrays import common_float
from polywigner.execution.drjit_points import (
    common_width,
    is_tensor,
    nothing,
    point_components,
    tensor_components,
)
from polywigner.execution.drjit_results import as_complex, as_tensor_of, product_of_complex
from polywigner.execution.operations import DrjitOperations
from polywigner.numerics.phases import cos_sin_turns

__all__ = ["PointKind", "components_of_all", "matrix_times"]


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
