"""Vertices and weights of a source as parameters of a scene, differentiable in a render."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.execution import Traced, UnrolledOperations, kernel_with_derivatives
from polywigner.geometry import Aperture, Wavefront
from polywigner.illumination import Array
from polywigner.kernels import FOURIER, WIGNER, new_outline_of, new_tables_of
from polywigner.mitsuba.radiator import Radiator
from polywigner.numerics.complex_pairs import Pair
from polywigner.plans import exposes_numbers
from polywigner.transforms import differentiable as differentiable_source

__all__ = ["TracedSource"]

# What overlaps by less than this fraction of an area does so by rounding.
_APART = 1e-9


class TracedSource:
    """The numbers of one emitter's source that a scene's parameters expose.

    ``vertices``: x and y of each in metres, of a uniform aperture, or of an array of uniform
    apertures that do not overlap. ``weights``: real and imaginary part of each, of such an array.
    None where they are not exposed; ``why_not`` says why.
    """

    def __init__(self, m: Any, radiator: Radiator) -> None:
        self._m, self._radiator = m, radiator
        self.vertices: Any = None
        self.weights: Any = None
        self.why_not = ""
        if not dr.is_jit_v(m.Float):
            self.why_not = "a variant of Mitsuba that compiles, such as llvm_ad_rgb"
        elif not _is_simple(radiator.source):
            self.why_not = "a uniform aperture, or an array of such that do not overlap"
        else:
            self._tables = new_tables_of(radiator.centred, dr.itemsize_v(m.Float) == 8)
            cuts = self._tables.clips
            if not exposes_numbers(cuts):
                self.why_not = (
                    f"a source of few edges, as code of the render's kernel, got {cuts} pairs of "
                    "edges; gradients of pw.wigner and pw.fourier have no such limit"
                )
        if self.why_not:
            return
        self.vertices = m.Float(_corners(radiator.source).ravel().tolist())
        if isinstance(radiator.source, Array):
            self.weights = m.Float(_pairs(radiator.source.weights).ravel().tolist())

    def is_followed(self) -> bool:
        """Whether derivatives are asked of any."""
        return any(v is not None and dr.grad_enabled(v) for v in (self.vertices, self.weights))

    def changed(self) -> Aperture | Array | None:
        """The source with the present values, or None if they are those of the source.

        Raises the errors of :func:`polywigner.differentiable`; SceneError for another number.
        """
        if self.vertices is None:
            return None
        source: Any = self._radiator.source
        known = _corners(source).astype(np.float32)
        points = self._values("vertices", self.vertices, len(known))
        has_changed = not np.array_equal(points, known)
        if has_changed:
            columns = (self._m.Float(column.tolist()) for column in points.T)
            moved = self._m.Point2f(*columns)
            source = differentiable_source(source, vertices=moved).source
        if isinstance(source, Array):
            known = _pairs(source.weights).astype(np.float32)
            pairs = self._values("weights", self.weights, len(known))
            if not np.array_equal(pairs, known):
                weights = self._m.TensorXf(pairs)  # a lattice stays one
                source, has_changed = differentiable_source(source, weights=weights).source, True
        return source if has_changed else None

    def _values(self, name: str, flat: Any, count: int) -> NDArray[np.float32]:
        values = np.array(dr.detach(flat), np.float32)
        if values.size != 2 * count or not np.isfinite(values).all():
            raise SceneError(
                f"expected {name} as {2 * count} finite numbers, two for each of {count}, got "
                f"{values.size} numbers"
            )
        return values.reshape(-1, 2)

    def wigner(self, ops: Any, *point: Any) -> Any:
        """W of the centred source, with derivatives in all numbers."""
        frame = self._tables.frame
        x, y = zip(*(frame.position(ops, *corner) for corner in self._centred()), strict=True)
        fields = None
        if self.weights is not None:
            real, imag = zip(*self._scaled_weights(), strict=True)
            fields = real, imag
        traced = Traced((x, y), fields)
        (value,) = kernel_with_derivatives(WIGNER, ops, self._tables, point, traced)
        return value

    def intensity(self, ops: Any, *nu: Any) -> Any:
        """|F|^2 of the source, with derivatives in all numbers."""
        code = UnrolledOperations(ops.float_type)
        corners = iter(self._centred())
        total = Pair(0.0, 0.0)
        for number, element in enumerate(self._radiator.centred.elements_in_plane):
            outline = new_outline_of(element)
            own = [outline.frame.position(ops, *next(corners)) for _ in outline.edges]
            x, y = zip(*own, strict=True)
            value = Pair(*kernel_with_derivatives(FOURIER, code, outline, nu, Traced((x, y))))
            if self.weights is not None:
                value = value * Pair(*self._pair(self.weights, number))
            total = total + value
        return total.real * total.real + total.imag * total.imag

    def _pair(self, flat: Any, number: int) -> tuple[Any, Any]:
        m = self._m
        first, second = (dr.gather(m.Float, flat, m.UInt32(2 * number + k)) for k in (0, 1))
        return first, second

    def _centred(self) -> list[tuple[Any, Any]]:
        cx, cy = self._radiator.centre.tolist()
        count = dr.width(self.vertices) // 2
        pairs = (self._pair(self.vertices, number) for number in range(count))
        return [(x - cx, y - cy) for x, y in pairs]

    def _scaled_weights(self) -> list[tuple[Any, Any]]:
        result = []
        for number, factor in enumerate(self._tables.factors):
            real, imag = self._pair(self.weights, number)
            a, b = factor.real, factor.imag
            result.append((real * a - imag * b, real * b + imag * a))
        return result


def _corners(source: Aperture | Array) -> NDArray[np.float64]:
    return np.concatenate([ring for element in source.elements_in_plane for ring in element.rings])


def _pairs(weights: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.stack([weights.real, weights.imag], axis=-1)


def _is_simple(source: Any) -> bool:
    """Whether the field is constant on each element, and its energy the sum of theirs."""
    if isinstance(source, Wavefront):
        return False
    elements = source.elements_in_plane
    if any(element.illumination is not None for element in elements):
        return False
    whole = shapely.union_all([element.polygons for element in elements]).area
    total = sum(element.area for element in elements)
    return bool(abs(whole - total) <= _APART * total)
