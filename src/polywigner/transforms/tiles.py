"""The closed form behind every tile of :func:`polywigner.projections`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polywigner.execution import Engine
from polywigner.geometry import Slits
from polywigner.transforms.phase_space import (
    ambiguity,
    autocorrelation,
    lag_marginal,
    position_marginal,
    wigner,
)
from polywigner.transforms.sections import (
    Copies,
    PlaneField,
    bound_of,
    column_integrals,
    column_spectra,
    field_bound,
    field_of,
    is_lit_by_waves,
    mirrored_correlation,
    mutual_spectra,
    overlaps,
    phase,
)
from polywigner.transforms.spectrum import fourier

Array = NDArray[np.float64]
Values = Callable[[Any, Array, Array, Engine], Any]
Scale = Callable[[Any], float]
Sees = Literal["source", "field", "transposed"]

# Rounding error over a tile's scale: over the shapes of the tests, |nu| times diameter up to 1e3,
# 2e-13 was the largest.
_ROUNDING = 1e-12

_LINE = "P1"


@dataclass(frozen=True)
class Tile:
    """One pair of coordinates, and the function integrated over the others."""

    first: str
    second: str
    units: str
    meaning: str
    label: str
    """Label of the equation in docs/projections.md."""
    compute: Values
    """(field or slits, values along the first, along the second, engine) -> (n, m)."""
    scale: Scale
    """(field or slits) -> unit of the rounding error, in the tile's units."""
    sees: Sees = "source"
    """The field as ``compute`` takes it: transposed, x and y change roles in it."""

    @property
    def name(self) -> str:
        return f"{self.first}_{self.second}"

    @property
    def method(self) -> str:
        return f"closed form ({self.label})"

    def values(self, source: Any, first: Array, second: Array, engine: Engine) -> Any:
        seen = source if self.sees == "source" else self._field(source)
        return self.compute(seen, first, second, engine)

    def error(self, source: Any) -> float:
        """Bound on the absolute rounding error."""
        if self.label == _LINE:
            return _ROUNDING * self.scale(source)
        bound = bound_of(source)
        if self.scale is _nothing and is_lit_by_waves(source):
            return _ROUNDING * bound.amplitude**2
        return _ROUNDING * self.scale(bound.transposed() if self.sees == "transposed" else bound)

    def _field(self, source: Any) -> PlaneField:
        field = field_of(source)
        return field.transposed() if self.sees == "transposed" else field


def _grid(first: Array, second: Array) -> Array:
    return np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1)


def _power(field: PlaneField) -> float:
    """Bound on |F|^2."""
    return field.content**2


def _box(field: PlaneField) -> float:
    """Bound on the intensity, times the area of the bounds."""
    west, south, east, north = field.bounds
    return field.amplitude**2 * (east - west) * (north - south)


def _column(field: PlaneField) -> float:
    """Bound on the intensity, times the squared height."""
    return (field.amplitude * (field.bounds[3] - field.bounds[1])) ** 2


def _nothing(field: PlaneField) -> float:
    """Uniform fields are computed without rounding."""
    return 0.0


# --- autocorrelation


def _lag_integral(source: Any, x: Array, y: Array, engine: Engine) -> Any:
    return position_marginal(source, _grid(x, y), engine=engine)


def _position_integral(source: Any, xi_x: Array, xi_y: Array, engine: Engine) -> Any:
    return lag_marginal(source, _grid(xi_x, xi_y), engine=engine)


def _shadow_product(field: PlaneField, x: Array, xi_x: Array, engine: Engine) -> Any:
    ahead, behind = (x[:, None] + half for half in (xi_x / 2, -xi_x / 2))
    one, other = (column_integrals(field, at.ravel()) for at in (ahead, behind))
    return (one * np.conj(other)).reshape(ahead.shape)


def _mirrored_overlap(field: PlaneField, x: Array, xi_y: Array, engine: Engine) -> Any:
    if not field.is_lit:
        return mirrored_correlation(field, x, xi_y)
    centre = field.centre
    found = np.empty((len(x), len(xi_y)), np.complex128)
    for row, at in enumerate(x - centre[0]):
        common = overlaps(
            field,
            xi_y,
            lambda lag: lambda v: v - centre,
            lambda lag, at=at: lambda v: (v - centre) * (-1.0, 1.0) + (2 * at, lag),  # type: ignore[misc]
        )
        places = np.column_stack([np.full(len(xi_y), at), xi_y])
        spectra = mutual_spectra(field, common, np.zeros(1), places, _of_columns)
        found[row] = 2 * spectra[:, 0]
    return found


def _of_columns(one: Array, other: Array) -> tuple[Array, Array]:
    """(P5): the columns at a and 2x - a, one of them moved up."""
    shift = np.column_stack([one[:, 0] + other[:, 0], one[:, 1] - other[:, 1]])
    return shift, np.column_stack([-2 * other[:, 0], other[:, 1]])


# --- Wigner function


def _intensity(source: Any, x: Array, y: Array, engine: Engine) -> Any:
    return autocorrelation(source, _grid(x, y), np.zeros(2), engine=engine).real


def _power_spectrum(source: Any, nu_x: Array, nu_y: Array, engine: Engine) -> Any:
    return _squared(fourier(source, _grid(nu_x, nu_y), engine=engine))


def _wigner_of_rows(field: PlaneField, x: Array, nu_x: Array, engine: Engine) -> Any:
    def image(sign: float) -> Copies:
        return lambda at: lambda v: (v - (at, field.centre[1])) * (2 * sign, 1.0)

    # The overlap is its own mirror image, with the conjugate field: its transform is real.
    found = overlaps(field, x, image(1.0), image(-1.0))
    places = (x - field.centre[0])[:, None]
    return mutual_spectra(field, found, nu_x, places, _of_one_row).real


def _of_one_row(one: Array, other: Array) -> tuple[Array, Array]:
    """(P8): points of one row, their middle at x."""
    shift = np.column_stack([(one[:, 0] + other[:, 0]) / 2, one[:, 1] - other[:, 1]])
    return shift, one[:, :1] - other[:, :1]


def _column_powers(field: PlaneField, x: Array, nu_y: Array, engine: Engine) -> Any:
    return _squared(column_spectra(field, x, nu_y))


def _squared(values: Any) -> Any:
    return values.real**2 + values.imag**2


# --- ambiguity function


def _at_opposite_points(source: Any, xi_x: Array, xi_y: Array, engine: Engine) -> Any:
    return autocorrelation(source, np.zeros(2), _grid(xi_x, xi_y), engine=engine)


def _spectrum_product(source: Any, first: Array, second: Array, engine: Engine) -> Any:
    half = _grid(first, second) / 2
    ahead = fourier(source, half, engine=engine)
    return ahead * np.conj(fourier(source, -half, engine=engine))


def _ambiguity_of_rows(field: PlaneField, upsilon_x: Array, xi_x: Array, engine: Engine) -> Any:
    centre = float(field.centre[0])

    def image(sign: float) -> Copies:
        return lambda lag: lambda v: (v - (centre + sign * lag / 2, 0.0)) * (1.0, sign)

    found = overlaps(field, xi_x, image(1.0), image(-1.0))
    places = np.column_stack([xi_x, np.full(len(xi_x), field.centre[1])])
    spectra = mutual_spectra(field, found, upsilon_x, places, _of_opposite_rows)
    return 2 * (spectra * phase(centre, upsilon_x)).T


def _of_opposite_rows(one: Array, other: Array) -> tuple[Array, Array]:
    """(P12): points of the rows at eta and -eta, relative to the centre's x but not to its y."""
    shift = np.column_stack([one[:, 0] - other[:, 0], one[:, 1] + other[:, 1]])
    return shift, np.column_stack([(one[:, 0] + other[:, 0]) / 2, other[:, 1] - one[:, 1]])


def _opposite_columns(field: PlaneField, upsilon_y: Array, xi_x: Array, engine: Engine) -> Any:
    ahead, behind = (
        column_spectra(field, sign * xi_x / 2, sign * upsilon_y / 2) for sign in (1.0, -1.0)
    )
    return (ahead * np.conj(behind) * phase(float(field.centre[1]), upsilon_y)).T


# --- the tables


# first and second coordinate, unit, coordinates integrated over, label, values, scale; {0} and {1}
# stand for x and y, and once more for y and x
_APERTURE: dict[str, list[tuple[str, str, str, str, str, Values, Scale]]] = {
    "autocorrelation": [
        ("x", "y", "m2", "xi_x, xi_y", "P2", _lag_integral, _box),
        ("xi_x", "xi_y", "m2", "x, y", "P3", _position_integral, _box),
        ("{0}", "xi_{0}", "m2", "{1}, xi_{1}", "P4", _shadow_product, _column),
        ("{0}", "xi_{1}", "m2", "{1}, xi_{0}", "P5", _mirrored_overlap, _box),
    ],
    "wigner": [
        ("x", "y", "1", "nu_x, nu_y", "P6", _intensity, _nothing),
        ("nu_x", "nu_y", "m4", "x, y", "P7", _power_spectrum, _power),
        ("{0}", "nu_{0}", "m2", "{1}, nu_{1}", "P8", _wigner_of_rows, _box),
        ("{0}", "nu_{1}", "m2", "{1}, nu_{0}", "P9", _column_powers, _column),
    ],
    "ambiguity": [
        ("xi_x", "xi_y", "1", "upsilon_x, upsilon_y", "P10", _at_opposite_points, _nothing),
        ("upsilon_x", "upsilon_y", "m4", "xi_x, xi_y", "P11", _spectrum_product, _power),
        ("upsilon_{0}", "xi_{0}", "m2", "upsilon_{1}, xi_{1}", "P12", _ambiguity_of_rows, _box),
        ("upsilon_{1}", "xi_{0}", "m2", "upsilon_{0}, xi_{1}", "P13", _opposite_columns, _column),
    ],
}
_LETTERS = {"autocorrelation": "R", "wigner": "W", "ambiguity": "A"}


def _on_line(transform: Callable[..., Any]) -> Values:
    def compute(source: Any, first: Array, second: Array, engine: Engine) -> Any:
        values = transform(source, first[:, None, None], second[None, :, None], engine=engine)
        uniform = isinstance(source, Slits) and source.illumination is None
        real = transform is autocorrelation and uniform
        return values.real if real else values

    return compute


def _line_content(source: Any) -> float:
    """Bound on |W|/2 and |A|: the integral of |u| times the largest |u|, or more."""
    if isinstance(source, Slits):
        return field_bound(source) ** 2 * source.length
    moduli = abs(source.weights)
    return float(
        moduli.sum()
        * sum(m * _line_content(s) for m, s in zip(moduli, source.elements_in_plane, strict=True))
    )


_SLITS = {
    "autocorrelation": Tile("x", "xi", "1", "R", _LINE, _on_line(autocorrelation), _nothing),
    "wigner": Tile("x", "nu", "m", "W", _LINE, _on_line(wigner), _line_content),
    "ambiguity": Tile("upsilon", "xi", "m", "A", _LINE, _on_line(ambiguity), _line_content),
}


def tiles_of(dimension: int, kind: str) -> Mapping[str, Tile]:
    """The tiles of a kind of function of sources of a line (1) or a plane (2), by name."""
    tiles = [_SLITS[kind]] if dimension == 1 else list(_of_planes(kind))
    return {tile.name: tile for tile in tiles}


def _of_planes(kind: str) -> Iterator[Tile]:
    for first, second, units, over, label, compute, scale in _APERTURE[kind]:
        seen: list[tuple[Sees, str]] = [("source", "xy")]
        if "{" in over:
            seen = [("field", "xy"), ("transposed", "yx")]
        for sees, axes in seen:
            one, other, left = (text.format(*axes) for text in (first, second, over))
            meaning = f"{_LETTERS[kind]} integrated over {left}"
            yield Tile(one, other, units, meaning, label, compute, scale, sees)
