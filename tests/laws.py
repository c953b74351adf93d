"""Sources of every kind and exact values of their transforms, for `test_laws`.

``oracles.exact`` cuts outlines in rational arithmetic and transforms slices with 25 digits.
``oracles/generate.py exact_slices`` stores the values.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any
from zlib import crc32

import mpmath
import numpy as np
import shapely

import polywigner as pw
from oracles import exact, kinds
from oracles.references import DATA

Values = Any
Element = tuple[Any, list[tuple[complex, Values]]]
"""An outline (Aperture or Slits), and the waves (amplitude, frequency) on it."""

WAVES = pw.Illumination([1, 0.3 - 0.5j, -0.2 + 1j], [[1.5, 0.5], [0.7, -0.4], [1.6, 0.4]])
SQUARE = pw.shapes.square(1.0)
FRAME = pw.Aperture(shapely.box(2, -0.5, 3, 0.5) - shapely.box(2.25, -0.25, 2.75, 0.25))
TRIANGLE = pw.Aperture([[0, 0], [1, 0.25], [0.25, 1.125]])
ELL = pw.Aperture([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
LEANING = pw.Aperture([[-1, -0.5], [-0.5, -0.5], [-0.5, 0.5], [-1, 0.5 + 1e-6]])


def _weights(count: int) -> Values:
    rng = np.random.default_rng(count)
    return rng.normal(size=count) + 1j * rng.normal(size=count)


def _phases(turns: float, count: int) -> Values:
    return np.exp(2j * np.pi * turns * np.arange(count))


def _taper(count: int) -> Values:
    return np.hanning(count + 2)[1:-1]


def _product(angle: float, shift: Any) -> pw.Aperture:
    """Return a rotated rectangle with a field that is a product along its sides."""
    along_x = pw.Illumination([1.0, 0.4j, -0.3 + 0.2j], [[0.0, 0.0], [0.71, 0.0], [-0.27, 0.0]])
    along_y = pw.Illumination([0.8, 0.5 - 0.4j], [[0.0, 1.3], [0.0, -0.45]])
    lit = pw.shapes.rectangle(2.0, 1.25).with_illumination(along_x * along_y)
    return lit.turned(angle).moved(shift)


def _small_rings(size: float) -> list[Values]:
    """Return distant rotated squares."""
    centres = (0.3, (0.27, -0.46)), (1.1, (-0.92, -0.97)), (2.0, (0.63, 0.83))
    return [pw.shapes.square(size).turned(turn).rings[0] + centre for turn, centre in centres]


_grid = pw.arrays.grid_positions
SOURCES: dict[str, Callable[[], Any]] = {
    **kinds.SOURCES,
    "touching": lambda: pw.Array([SQUARE, SQUARE.moved((1.0, 0.0))], [1.0, 0.5 - 1.5j]),
    "overlapping": lambda: pw.Array(
        [SQUARE, SQUARE.moved((0.75, 0.5)), SQUARE.moved((1.0, 0.0))], [1.0, 1j, -0.75]
    ),
    "coinciding": lambda: pw.Array([SQUARE, SQUARE, FRAME], [1.0, -0.25 + 0.5j, 1 + 1j]),
    "leaning": lambda: pw.Array([SQUARE, LEANING, TRIANGLE.moved((2, 0))], [1.0, -1j, 0.5]),
    "fields of their own": lambda: pw.Array(
        [SQUARE.with_illumination(pw.cosine_taper(2, 2)), TRIANGLE.with_illumination(WAVES), ELL],
        [1, 1j, -0.5],
    ),
    "steered far": lambda: ELL.with_illumination(
        pw.cosine_taper(4, 4) * pw.Illumination([1.0], [[50.0, 20.0]])
    ),
    "small parts with waves": lambda: pw.Aperture(_small_rings(1e-2)).with_illumination(WAVES),
    "product": lambda: _product(0.0, (0.0, 0.0)),
    "product, turned and moved": lambda: _product(-1.1, (3.0, 2.0)),
    "product, far away": lambda: _product(0.4, (7313.1, -2111.7)),
    "lattice of products": lambda: pw.phased_array(
        _product(0.0, (0.0, 0.0)), _grid(3, 2, 2.5, 1.5), _phases(0.1, 6) ** np.arange(6)
    ),
    "touching lattice, steered": lambda: pw.phased_array(
        SQUARE, _grid(3, 3, 1.0), np.repeat(_phases(0.2, 3), 3)
    ),
    "lattice far away": lambda: pw.phased_array(
        SQUARE, _grid(3, 2, 2.0) + np.array([100.0, -30.0])
    ),
    "tapered, steered lattice": lambda: pw.phased_array(
        SQUARE, _grid(5, 2, 1.2, 2.5), np.outer(_taper(5) * _phases(0.13, 5), [1.0, 1.2]).ravel()
    ),
    "lattice of any weights": lambda: pw.phased_array(SQUARE, _grid(7, 5, 1.3), _weights(35)),
    "small lattice of any weights": lambda: pw.phased_array(SQUARE, _grid(3, 2, 1.2), _weights(6)),
    "overlapping lattice": lambda: pw.phased_array(
        ELL, _grid(3, 2, 1.5, 1.2), np.repeat(_taper(3), 2)
    ),
    "triangular lattice": lambda: pw.phased_array(
        SQUARE, pw.arrays.triangular_positions(3, 3, 1.3), _weights(9)
    ),
    "lattice of waves": lambda: pw.phased_array(
        ELL.with_illumination(WAVES), _grid(2, 2, 2.5, 3.0), _weights(4)
    ),
    "lattice within an element": lambda: pw.phased_array(SQUARE, _grid(3, 2, 1e-6), _weights(6)),
    "oblique row": lambda: pw.phased_array(SQUARE, np.outer(np.arange(5), [1.1, 0.3])),
    "row of any weights": lambda: pw.phased_array(SQUARE, _grid(70, 1, 1.3), _weights(70)),
    "long row of any weights": lambda: pw.phased_array(SQUARE, _grid(300, 1, 1.3), _weights(300)),
    "scattered far away": lambda: pw.phased_array(
        ELL, np.random.default_rng(2).uniform(0, 6, (7, 2)) + np.array([50.0, -20.0]), _weights(7)
    ),
    "narrow slits": lambda: pw.Slits([[-0.5, -0.499999], [0.1, 0.100002], [0.4, 0.400001]]),
    "slits of any weights": lambda: pw.Array(
        [
            pw.Slits([[-1.0, -0.4], [0.1, 0.9]]).with_illumination(
                pw.Illumination([0.5, 0.5, 0.25j], [[0.25], [-0.25], [1.5]])
            ),
            pw.Slits([0.5, 1.5]),
            pw.Slits([-0.4, 0.1]),
        ],
        [1.0, 0.5 - 1j, 2j],
    ),
    "row of slits, any weights": lambda: pw.phased_array(
        pw.Slits([0.0, 0.75]).with_illumination(pw.Illumination([1, 0.5], [[0.0], [0.5]])),
        np.arange(4.0)[:, None],
        _weights(4),
    ),
    "partly coherent slits": lambda: pw.Slits([(0.0, 0.3), (0.5, 0.9)]).partially_coherent(0.2),
    "partly coherent array": lambda: pw.Array(
        [SQUARE, TRIANGLE.moved((1.2, 0.1))], [1.0, 0.5j]
    ).partially_coherent(1.5),
}


@cache
def source_of(name: str) -> Any:
    return SOURCES[name]()


def flat(source: Any) -> Any:
    """Return the source without curvature, and fully coherent."""
    return getattr(source, "source", source)


@cache
def elements_of(name: str) -> list[Element]:
    """Return outlines with all their waves, including weights of arrays."""
    source = flat(source_of(name))
    weights = source.weights if isinstance(source, pw.Array) else [1.0]
    result = []
    for element, weight in zip(source.elements_in_plane, weights, strict=True):
        field = element.illumination or pw.uniform(len(element.bounds) // 2)
        waves = zip(complex(weight) * field.amplitudes, field.frequencies, strict=True)
        result.append((element.with_illumination(None), list(waves)))
    return result


def dimension_of(name: str) -> int:
    return len(elements_of(name)[0][0].bounds) // 2


def corners_of(outline: Any) -> Values:
    return (
        outline.intervals.reshape(-1, 1)
        if isinstance(outline, pw.Slits)
        else np.concatenate(outline.rings)
    )


def scale_of(name: str, function: str) -> float:
    """Return the unit of errors: a bound on F, or on W and A for pairs of elements."""
    parts = [
        (
            sum(abs(c) for c, _ in waves),
            outline.length if isinstance(outline, pw.Slits) else outline.area,
        )
        for outline, waves in elements_of(name)
    ]
    if function == "fourier":
        return float(sum(s * content for s, content in parts))
    total = sum(s * s * content for s, content in parts)
    return float(
        total * (2.0 ** dimension_of(name) if function in ("wigner", "position_marginal") else 1)
    )


@dataclass(frozen=True)
class Points:
    """Positions x (n, d), lags xi (n, d) and frequencies nu (n, d)."""

    x: Values
    xi: Values
    nu: Values


@cache
def hard_points(name: str) -> Points:
    """Return points at coincident corners of the copies, some an ulp off, and random points.

    The frequencies are zero, tiny, a few cycles over an element, and the frequencies of its waves.
    """
    rng = np.random.default_rng(crc32(name.encode()))
    elements = elements_of(name)
    # Rational arithmetic is slow for many pairs of elements and waves.
    terms = sum(len(waves) for _, waves in elements)
    count = 12 if terms < 10 else 6 if len(elements) < 50 else 4
    d, corners = dimension_of(name), [corners_of(outline) for outline, _ in elements]
    one, other = (
        np.array(
            [
                c[rng.integers(len(c))]
                for c in (corners[k] for k in rng.integers(len(corners), size=count))
            ]
        )
        for _ in range(2)
    )
    near = np.array(
        [
            c[rng.integers(len(c), size=2)].mean(axis=0)
            for c in (corners[k] for k in rng.integers(len(corners), size=count))
        ]
    )
    size = float(np.ptp(corners[0], axis=0).max())
    aside = rng.choice([0.0, 1e-16, 1e-13, 1e-9, 0.1, 0.3], (count, 1)) * rng.normal(
        size=(count, d)
    )
    x, xi = (one + other) / 2 + size * aside, one - other + size * aside
    third = count // 3
    x[:third] = near[:third] + 0.05 * size * rng.normal(size=(third, d))
    xi[:third] = 0.3 * size * rng.normal(size=(third, d))
    xi[0] = 0.0
    nu = rng.normal(size=(count, d)) * 10.0 ** rng.uniform(-1, 1, (count, 1)) / size
    nu[1], nu[2] = 0.0, nu[2] * 1e-9
    nu[third:-1] += elements[0][1][0][1]
    return Points(x, xi, nu)


def _intervals(outline: pw.Slits) -> list[tuple[Fraction, Fraction]]:
    return [(Fraction(a), Fraction(b)) for a, b in outline.intervals.tolist()]


def _overlaps(first: Any, second: Any) -> list[tuple[Fraction, Fraction]]:
    pairs = ((max(a, c), min(b, d)) for a, b in first for c, d in second)
    return [(low, high) for low, high in pairs if low < high]


def _over_intervals(intervals: list[tuple[Fraction, Fraction]], nu: float) -> complex:
    with mpmath.workdps(30):
        total = mpmath.mpc(0)
        for a, b in intervals:
            width, twice = (mpmath.mpf(v.numerator) / v.denominator for v in (b - a, a + b))
            total += width * mpmath.sincpi(mpmath.mpf(nu) * width) * mpmath.expjpi(-nu * twice)
        return complex(total)


def _slice(first: Any, second: Any, place: Values, mirrored: bool) -> Callable[[Values], complex]:
    """Return the transform of the lag slice at x, or of the position slice at xi."""
    if isinstance(first, pw.Slits):
        p = Fraction(place.tolist()[0])
        one, other = _intervals(first), _intervals(second)
        if mirrored:
            here = [(2 * (a - p), 2 * (b - p)) for a, b in one]
            there = [(2 * (p - b), 2 * (p - a)) for a, b in other]
        else:
            here = [(a - p / 2, b - p / 2) for a, b in one]
            there = [(a + p / 2, b + p / 2) for a, b in other]
        common = _overlaps(here, there)
        return lambda nu: _over_intervals(common, float(nu[0]))
    cut = exact.lag_region if mirrored else exact.position_region
    region = cut(first.rings, place, second.rings)
    return lambda nu: complex(exact.transform(region, nu, digits=25)) if region.trapezoids else 0j


def _turn(frequency: Values, place: Values) -> complex:
    """Return exp(2 pi i frequency.place), with the phase reduced in rational arithmetic."""
    pairs = zip(np.ravel(frequency).tolist(), np.ravel(place).tolist(), strict=True)
    turns = sum((Fraction(f) * Fraction(p) for f, p in pairs), Fraction(0))
    return complex(mpmath.expjpi(2 * float(turns - round(turns))))


def _meeting(name: str, place: Values, mirrored: bool) -> Iterator[tuple[Element, Element]]:
    """Yield pairs of elements whose bounds overlap."""
    elements = elements_of(name)
    boxes = np.array([[c.min(axis=0), c.max(axis=0)] for c in (corners_of(o) for o, _ in elements)])
    low, high = boxes[:, 0], boxes[:, 1]
    if mirrored:
        meet = (low[:, None] + low <= 2 * place) & (2 * place <= high[:, None] + high)
    else:
        meet = (low[:, None] - high <= place) & (place <= high[:, None] - low)
    for j, k in np.argwhere(meet.all(axis=-1)):
        yield elements[j], elements[k]


def _at_pair(name: str, place: Values, nu: Values, mirrored: bool) -> complex:
    """Return W(place, nu) or A(nu, place) of the flat source, a sum over pairs of elements."""
    total = 0j
    for (first, waves), (second, others) in _meeting(name, place, mirrored):
        transform, factors = _slice(first, second, place, mirrored), defaultdict(complex)
        for (c, k), (d, q) in itertools.product(waves, others):
            mean, apart = (k + q) / 2, k - q
            shift, rate = (mean, apart) if mirrored else (apart, mean)
            factors[tuple((nu - shift).tolist())] += c * np.conj(d) * _turn(rate, place)
        total += sum(factor * transform(inner) for inner, factor in factors.items())
    return total


def _bend(name: str, point: Values) -> Values:
    """Return Q point in cycles, by which a curved wave shears phase space."""
    wave = source_of(name)
    return point @ wave.curvature if isinstance(wave, pw.Wavefront) else 0.0 * point


def _centre(name: str) -> Values:
    """Return the centre of the curved wave."""
    wave = source_of(name)
    return wave.centre if isinstance(wave, pw.Wavefront) else np.zeros(dimension_of(name))


@cache
def exact_values(name: str, function: str) -> Values:
    """Return the stored values (n,) of a coherent source at its hard points."""
    count = len(hard_points(name).x)
    counts = [count // 3 if "marginal" in other else count for other in kinds.FUNCTIONS]
    number = kinds.FUNCTIONS.index(function)
    begin = sum(counts[:number])
    values = _stored()[name][begin : begin + counts[number]]
    return values.real if function in ("wigner", "position_marginal") else values


@cache
def _stored() -> dict[str, Values]:
    with np.load(DATA / "exact_slices.npz") as archive:
        return dict(archive)


def computed_values(name: str, function: str) -> Values:
    """Return the computed values (n,) of a coherent source at its hard points."""
    at = hard_points(name)
    if function == "fourier":
        return np.array([_fourier(name, row) for row in at.nu])
    nu = at.nu if function in ("wigner", "ambiguity") else 0.0 * at.nu[: len(at.nu) // 3]
    centre = _centre(name)
    if function in ("wigner", "position_marginal"):
        inner = [q - _bend(name, p - centre) for p, q in zip(at.x, nu, strict=False)]
        return np.array(
            [_at_pair(name, p, q, True).real for p, q in zip(at.x, inner, strict=False)]
        )
    bends = [_bend(name, p) for p in at.xi[: len(nu)]]
    result = [_at_pair(name, p, q - b, False) for p, q, b in zip(at.xi, nu, bends, strict=False)]
    return np.array([_turn(-centre, b) for b in bends]) * np.array(result)


def _fourier(name: str, nu: Values) -> complex:
    repeated = getattr(source_of(name), "repeated", None)
    if repeated is None:
        return sum(_fourier_of(outline, waves, nu) for outline, waves in elements_of(name))
    element, places = repeated
    field = element.illumination or pw.uniform(len(nu))
    waves = list(zip(field.amplitudes, field.frequencies, strict=True))
    factor = sum(w * _turn(-nu, p) for p, w in zip(places, source_of(name).weights, strict=True))
    return complex(factor * _fourier_of(element.with_illumination(None), waves, nu))


def _fourier_of(outline: Any, waves: list[tuple[complex, Values]], nu: Values) -> complex:
    if isinstance(outline, pw.Slits):
        return sum(c * _over_intervals(_intervals(outline), float((nu - k)[0])) for c, k in waves)
    return sum(c * exact.fourier(outline.rings, nu - k) for c, k in waves)


def size_of(name: str) -> float:
    """Return the larger side of the bounds of the first element."""
    return float(np.ptp(corners_of(elements_of(name)[0][0]), axis=0).max())


def degree_of_coherence(name: str, xi: Values) -> Values:
    width = getattr(source_of(name), "coherence_width", None)
    return 1.0 if width is None else np.exp(-(xi**2).sum(axis=-1) / (2 * width**2))


def field_of(name: str, points: Values) -> Values:
    """Return u (n,) of a coherent source."""
    inner = points - _centre(name)
    total = np.exp(1j * np.pi * (_bend(name, inner) * inner).sum(axis=-1))
    return total * sum(_field_on(outline, waves, points) for outline, waves in elements_of(name))


def _field_on(outline: Any, waves: list[tuple[complex, Values]], points: Values) -> Values:
    if isinstance(outline, pw.Slits):
        begin, end = outline.intervals.T
        inside = ((begin < points) & (points < end)).any(axis=-1)
    else:
        inside = shapely.contains_xy(outline.polygons, *points.T)
    return inside * sum(c * np.exp(2j * np.pi * points @ k) for c, k in waves)
