"""Irradiance by Wigner rays: sums over places on the source, for many points at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution, kernels
from polywigner.execution import Engine
from polywigner.geometry import Aperture, Wavefront
from polywigner.illumination import Array
from polywigner.illumination.obliquities import Forms, irradiance_factor
from polywigner.kernels import Kernel, kernel_for, tables_of
from polywigner.kernels.cut.slice_sums import PART_COLUMNS, SliceSum, slice_parts
from polywigner.kernels.functions.moments import (
    PART_MOMENTS,
    PART_MOMENTS_ALONG,
    PART_PARTLY_COHERENT,
    PART_WIGNER,
)
from polywigner.kernels.kernel import Values
from polywigner.propagation.arrangement import Rule


def ray_kernel(source: Any, order: int, curved: bool = False) -> Kernel:
    """The integrand of (T2) for a source, to leading or to third order.

    Arguments: ``x, y`` on the source, ``X, Y, Z`` of the point, the wavelength, the coefficients
    of the four forms of obliquity (T4), and of a curved wave Q_xx, Q_xy, Q_yy and its centre: it
    is bilinear in place and lag, and so a frequency at each place to any order in the lag.

    Raises ArgumentError for what has no Wigner function of two dimensions, GeometryError for arrays
    whose elements do not lie in the plane z = 0.
    """
    name = "wigner" if order == 1 else "lag moments along" if curved else "lag moments"
    return _composed(kernels.kernel_for(name, source), order)


def part_kernel(order: int, curved: bool = False, partly: bool = False) -> Kernel:
    """The integrand of a part of the lag slice at a place: ``x, y``, its columns, the rest."""
    moments = PART_MOMENTS_ALONG if curved else PART_MOMENTS
    whole = PART_PARTLY_COHERENT if partly else PART_WIGNER
    return _composed(whole if order == 1 else moments, order, PART_COLUMNS)


@lru_cache(maxsize=64)
def _composed(base: Kernel, order: int, columns: int = 0) -> Kernel:
    """``columns``: arguments of the base besides place and frequency, between the two."""
    factors = FACTORS[order]
    count = 1 if order == 1 else 6

    def enter(ops: Any, frame: Any, x: Any, y: Any, *rest: Any) -> Values:
        own, rest = rest[:columns], rest[columns:]
        point, wavelength, forms, curved = rest[:3], rest[3], rest[4:8], rest[8:]
        along_x, along_y = point[0] - x, point[1] - y
        square = along_x * along_x + along_y * along_y + point[2] * point[2]
        inverse = 1.0 / ops.sqrt(square)
        scale = inverse / wavelength
        place = own or (x, y)
        nu: Values = (along_x * scale, along_y * scale)
        ray = nu
        if curved:
            (xx, xy, yy), (dx, dy) = curved[:3], (x - curved[3], y - curved[4])
            nu = nu[0] - (xx * dx + xy * dy), nu[1] - (xy * dx + yy * dy)
            nu = nu if order == 1 else (*nu, *ray)
        inner = base.enter(ops, frame, *place, *nu)
        return (*factors(point[2] * inverse, inverse, wavelength, forms), *inner)

    own = base.edge_sum

    def edge_sum(ops: Any, tables: Any, *inner: Any) -> Values:
        return own(ops, tables, *inner[count:])

    def leave(ops: Any, frame: Any, inner: Values, sums: Values) -> Values:
        values = base.leave(ops, frame, inner[count:], sums)
        return (sum(a * b for a, b in zip(inner[:count], values, strict=True)),)

    return replace(
        base,
        name=f"{base.name} along rays",
        enter=enter,
        edge_sum=own.after(count) if isinstance(own, SliceSum) else edge_sum,
        leave=leave,
    )


def _leading(c: Any, inverse: Any, wavelength: Any, forms: Values) -> Values:
    """The factor of W: g/(wavelength |r|)^2, for 1/|r| ``inverse``."""
    density = inverse / wavelength
    return (irradiance_factor(forms, c) * density * density,)


def _third_order(c: Any, inverse: Any, wavelength: Any, forms: Values) -> Values:
    """Factors of the moments (T1), from the factors of S0, S1, Smm, S2 and S3 in (T4)."""
    first, mixed, both, crossed = forms
    first, mixed, crossed = first * c * c, mixed * c, crossed * c
    h = wavelength / (2 * math.pi)  # 1/k
    square = inverse * inverse
    s0 = first * (1.0 + h * h * square) + mixed + both + crossed * h * inverse
    s1 = (first + mixed) * (h * square) - crossed * (0.5 * inverse)
    s_mm = (first + mixed * 0.875 + both * 0.5) * square
    s2 = (first * -0.5 - mixed * 0.375 - both * 0.25) * square
    s3 = (first + mixed + both) * (square / (8.0 * h))
    density = inverse * inverse / (wavelength * wavelength)
    s3 = s3 * density * wavelength
    return (
        s0 * density,
        s1 * density * wavelength,
        s_mm * density * (wavelength * wavelength),
        s2 * density,
        s3,
        s3 * -(wavelength * wavelength),
    )


FACTORS: dict[int, Callable[[Any, Any, Any, Values], Values]] = {1: _leading, 3: _third_order}
"""(cosine, 1/|r|, wavelength, forms) -> the factors of W, to third order of the moments (T1)."""

Floats = NDArray[np.float64]

# Cuts that are made in NumPy beforehand, a few seconds' work; of more edges or places they are part
# of the kernel.
_MOST_CUTS = 1 << 29
# Edges of all places whose parts are held at a time: of each perhaps one, in some 100 bytes.
_EDGES_AT_ONCE = 1 << 20


@dataclass(frozen=True)
class Rays:
    """A sum over rays: its sources, and its settings."""

    sources: Sequence[tuple[Aperture | Array, Forms]]
    """Sources and forms as of :func:`polywigner.illumination.obliquities.weighted_sources`."""
    wavelength: float
    order: int
    engine: Engine
    double: bool
    curved: tuple[float, ...] = ()
    """Q_xx, Q_xy, Q_yy and the centre of a curved wave on all sources; empty: flat."""
    coherence_width: float = math.inf
    """Width of coherence in m; finite to leading order only."""

    @property
    def is_partly_coherent(self) -> bool:
        return self.coherence_width < math.inf

    def _lit(self, source: Aperture | Array) -> Any:
        """A source with this light, as kernels take it."""
        if not self.is_partly_coherent:
            return source
        return Wavefront(source, coherence_width=self.coherence_width)

    def irradiance(self, rule: Rule, points: Floats) -> Floats:
        """The sum over a rule's nodes at points (n, 3), (n,)."""
        total = np.zeros(len(points))
        for source, forms in self.sources:
            for kernel, places, weights in self._listed(source, rule):
                total += execution.evaluate_sums(
                    kernel,
                    self._lit(source),
                    places,
                    weights,
                    points,
                    (self.wavelength, *forms, *self.curved),
                    double=self.double,
                    engine=self.engine,
                )
        return total

    def _listed(
        self, source: Aperture | Array, rule: Rule
    ) -> Iterator[tuple[Kernel, Floats, Floats]]:
        """Kernels with their places: parts of slices, or places as they are."""
        nodes, weights = rule
        if not self._is_by_parts(source, len(nodes)):
            yield ray_kernel(self._lit(source), self.order, bool(self.curved)), nodes, weights
            return
        tables = tables_of(source, True)
        host = execution.NumpyOperations(double=True)
        step = max(1, _EDGES_AT_ONCE // len(tables.edges))
        for start in range(0, len(nodes), step):
            some, share = nodes[start : start + step], weights[start : start + step]
            inner = tables.frame.position(host, *some.T)
            owners, rows = slice_parts(host, tables, *inner)
            yield (
                part_kernel(self.order, bool(self.curved), self.is_partly_coherent),
                np.column_stack([some[owners], rows]),
                share[owners],
            )

    def _is_by_parts(self, source: Aperture | Array, places: int) -> bool:
        """Whether W is a sum over the edges of all elements, not one of an array's short cuts."""
        by_edges = self.order == 3 or kernel_for("wigner", source).slices is not None
        return by_edges and tables_of(source, True).clips * places <= _MOST_CUTS

    def integrand(self, places: Floats, points: Floats) -> Floats:
        """Irradiance per area from each place (m, 2) at each point (n, 3), (n, m)."""
        total: Any = 0.0
        place, point = places.T[:, None, :], points.T[:, :, None]
        for source, forms in self.sources:
            numbers = (self.wavelength, *forms, *self.curved)
            constants = [np.array(value) for value in numbers]
            (values,) = execution.evaluate(
                ray_kernel(self._lit(source), self.order, bool(self.curved)),
                self._lit(source),
                [*place, *point, *constants],
                double=self.double,
                engine=self.engine,
                outputs=1,
            )
            total = total + values
        result: Floats = total
        return result
