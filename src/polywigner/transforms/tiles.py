"""The closed form behind every tile of :func:`polywigner.projections`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.engines import Engine
from polywigner.geometry import Aperture, Slits
from polywigner.transforms.phase_space import (
    ambiguity,
    autocorrelation,
    lag_marginal,
    position_marginal,
    wigner,
)
from polywigner.transforms.sections import (
    mirrored_correlation,
    overlap_edges,
    overlap_spectra,
    phase,
    section_lengths,
    section_spectra,
    sections,
    transposed,
)
from polywigner.transforms.spectrum import fourier

__all__ = ["Tile", "tiles_of"]

Array = NDArray[np.float64]
Values = Callable[[Any, Array, Array, Engine], Any]
Scale = Callable[[Any], float]

# Of a tile's scale, the content or the box to its power: rounding errors measured over the shapes
# of the tests, |nu| times diameter up to 1e3, reach 2e-13 of it.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Tile:
    """One pair of coordinates, and what the function integrated over the others is."""

    first: str
    second: str
    units: str
    meaning: str
    label: str
    """Of the equation in docs/projections.md."""
    compute: Values
    """(source, values along the first, along the second, engine) -> (n, m)."""
    scale: Scale
    """(source) -> what the rounding error is proportional to, in the tile's units."""
    swapped: bool = False
    """Whether x and y change roles: then ``compute`` and ``scale`` get the transposed aperture."""

    @property
    def name(self) -> str:
        return f"{self.first}_{self.second}"

    @property
    def method(self) -> str:
        return f"closed form ({self.label})"

    def values(self, source: Any, first: Array, second: Array, engine: Engine) -> Any:
        return self.compute(self._seen(source), first, second, engine)

    def error(self, source: Any) -> float:
        """Bound on the absolute rounding error."""
        return _ROUNDING * self.scale(self._seen(source))

    def _seen(self, source: Any) -> Any:
        return transposed(source) if self.swapped else source


def _grid(first: Array, second: Array) -> Array:
    return np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1)


def _width(aperture: Aperture) -> float:
    return aperture.bounds[2] - aperture.bounds[0]


def _height(aperture: Aperture) -> float:
    return aperture.bounds[3] - aperture.bounds[1]


def _box(aperture: Aperture) -> float:
    return _width(aperture) * _height(aperture)


# --- autocorrelation


def _lag_integral(source: Aperture, x: Array, y: Array, engine: Engine) -> Any:
    return position_marginal(source, _grid(x, y), engine=engine)


def _position_integral(source: Aperture, xi_x: Array, xi_y: Array, engine: Engine) -> Any:
    return lag_marginal(source, _grid(xi_x, xi_y), engine=engine)


def _column_product(source: Aperture, x: Array, xi_x: Array, engine: Engine) -> Any:
    ahead, behind = (x[:, None] + half for half in (xi_x / 2, -xi_x / 2))
    lengths = [section_lengths(sections(source, at.ravel())) for at in (ahead, behind)]
    return (lengths[0] * lengths[1]).reshape(ahead.shape)


def _mirrored_overlap(source: Aperture, x: Array, xi_y: Array, engine: Engine) -> Any:
    return mirrored_correlation(source, x, xi_y)


# --- Wigner function


def _intensity(source: Aperture, x: Array, y: Array, engine: Engine) -> Any:
    return autocorrelation(source, _grid(x, y), np.zeros(2), engine=engine).real


def _power_spectrum(source: Aperture, nu_x: Array, nu_y: Array, engine: Engine) -> Any:
    return _squared(fourier(source, _grid(nu_x, nu_y), engine=engine))


def _wigner_of_rows(source: Aperture, x: Array, nu_x: Array, engine: Engine) -> Any:
    west, _, east, _ = source.bounds
    inside = np.flatnonzero((x > west) & (x < east))  # the extent of the automean
    centre = source.centre

    def copies(sign: float) -> list[Any]:
        def image(at: float) -> Any:
            return lambda v: (v - (at, centre[1])) * (2 * sign, 1.0)

        return [shapely.transform(source.polygons, image(at)) for at in x[inside]]

    values = np.zeros((len(x), len(nu_x)))
    # The overlap is its own mirror image, so its transform is real.
    values[inside] = overlap_spectra(overlap_edges(copies(1.0), copies(-1.0)), nu_x).real
    return values


def _column_spectra(source: Aperture, x: Array, nu_y: Array, engine: Engine) -> Any:
    return _squared(section_spectra(sections(source, x), nu_y))


def _squared(values: Any) -> Any:
    return values.real**2 + values.imag**2


# --- ambiguity function


def _at_opposite_points(source: Aperture, xi_x: Array, xi_y: Array, engine: Engine) -> Any:
    return autocorrelation(source, np.zeros(2), _grid(xi_x, xi_y), engine=engine)


def _spectrum_product(source: Aperture, first: Array, second: Array, engine: Engine) -> Any:
    half = _grid(first, second) / 2
    ahead = fourier(source, half, engine=engine)
    return ahead * np.conj(fourier(source, -half, engine=engine))


def _ambiguity_of_rows(source: Aperture, upsilon_x: Array, xi_x: Array, engine: Engine) -> Any:
    centre = source.centre[0]

    def copies(sign: float) -> list[Any]:
        def image(lag: float) -> Any:
            return lambda v: (v - (centre + sign * lag / 2, 0.0)) * (1.0, sign)

        return [shapely.transform(source.polygons, image(lag)) for lag in xi_x]

    spectra = overlap_spectra(overlap_edges(copies(1.0), copies(-1.0)), upsilon_x)
    return 2 * (spectra * phase(centre, upsilon_x)).T


def _opposite_columns(source: Aperture, upsilon_y: Array, xi_x: Array, engine: Engine) -> Any:
    ahead, behind = (
        section_spectra(sections(source, sign * xi_x / 2), sign * upsilon_y / 2)
        for sign in (1.0, -1.0)
    )
    return (ahead * np.conj(behind) * phase(source.centre[1], upsilon_y)).T


# --- the tables


def _both(
    first: str, second: str, units: str, meaning: str, label: str, compute: Values, scale: Scale
) -> list[Tile]:
    """A tile and the one with x and y exchanged; {0} and {1} stand for x and y in the texts."""
    made = []
    for axes in ("xy", "yx"):
        one, other, said = (text.format(*axes) for text in (first, second, meaning))
        swapped = axes == "yx"
        made.append(Tile(one, other, units, said, label, compute, scale, swapped))
    return made


_APERTURE: dict[str, list[Tile]] = {
    "autocorrelation": [
        Tile("x", "y", "m2", "R integrated over xi_x, xi_y", "P2", _lag_integral, _box),
        Tile("xi_x", "xi_y", "m2", "R integrated over x, y", "P3", _position_integral, _box),
        *_both(
            *("{0}", "xi_{0}", "m2", "R integrated over {1}, xi_{1}"),
            *("P4", _column_product, lambda a: _height(a) ** 2),
        ),
        *_both(
            *("{0}", "xi_{1}", "m2", "R integrated over {1}, xi_{0}"),
            *("P5", _mirrored_overlap, _box),
        ),
    ],
    "wigner": [
        Tile("x", "y", "1", "W integrated over nu_x, nu_y", "P6", _intensity, lambda a: 0.0),
        Tile(
            *("nu_x", "nu_y", "m4", "W integrated over x, y"),
            *("P7", _power_spectrum, lambda a: a.area**2),
        ),
        *_both(
            *("{0}", "nu_{0}", "m2", "W integrated over {1}, nu_{1}"),
            *("P8", _wigner_of_rows, _box),
        ),
        *_both(
            *("{0}", "nu_{1}", "m2", "W integrated over {1}, nu_{0}"),
            *("P9", _column_spectra, lambda a: _height(a) ** 2),
        ),
    ],
    "ambiguity": [
        Tile(
            *("xi_x", "xi_y", "1", "A integrated over upsilon_x, upsilon_y"),
            *("P10", _at_opposite_points, lambda a: 0.0),
        ),
        Tile(
            *("upsilon_x", "upsilon_y", "m4", "A integrated over xi_x, xi_y"),
            *("P11", _spectrum_product, lambda a: a.area**2),
        ),
        *_both(
            *("upsilon_{0}", "xi_{0}", "m2", "A integrated over upsilon_{1}, xi_{1}"),
            *("P12", _ambiguity_of_rows, _box),
        ),
        *_both(
            *("upsilon_{1}", "xi_{0}", "m2", "A integrated over upsilon_{0}, xi_{1}"),
            *("P13", _opposite_columns, lambda a: _height(a) ** 2),
        ),
    ],
}


def _on_line(transform: Callable[..., Any]) -> Values:
    def compute(source: Slits, first: Array, second: Array, engine: Engine) -> Any:
        return transform(source, first[:, None, None], second[None, :, None], engine=engine)

    return compute


def _real_part(source: Slits, x: Any, xi: Any, engine: Engine) -> Any:
    return autocorrelation(source, x, xi, engine=engine).real


_SLITS = {
    "autocorrelation": Tile("x", "xi", "1", "R", "P1", _on_line(_real_part), lambda s: 0.0),
    "wigner": Tile("x", "nu", "m", "W", "P1", _on_line(wigner), lambda s: s.length),
    "ambiguity": Tile("upsilon", "xi", "m", "A", "P1", _on_line(ambiguity), lambda s: s.length),
}


def tiles_of(source: Aperture | Slits, kind: str) -> Mapping[str, Tile]:
    """The tiles of a kind of function of a source, by name."""
    tiles = [_SLITS[kind]] if isinstance(source, Slits) else _APERTURE[kind]
    return {tile.name: tile for tile in tiles}
