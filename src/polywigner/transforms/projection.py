"""Projections of the four-dimensional phase-space functions onto pairs of coordinates.

Every tile has its closed form, a row of one table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, value_text
from polywigner.execution import Engine, checked_engine
from polywigner.geometry import Slits, Wavefront
from polywigner.geometry.arguments import checked_choice, checked_count, real_numbers
from polywigner.kernels import kernel_for
from polywigner.transforms.checked_calls import PhaseSpaceSource
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
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

if TYPE_CHECKING:
    import xarray


PhaseSpaceFunction = Literal["autocorrelation", "wigner", "ambiguity"]

LARGEST_SAMPLES = 4096
"""Along each axis: a tile of as many complex squares holds 256 MiB."""

# Default axes. Positions reach a sixteenth of the width beyond the outline on either side, lags as
# much beyond the largest, frequencies to eight lobes.
_MARGIN = 9 / 8
_LOBES = 8.0

Values = NDArray[np.float64]


def projections(
    source: PhaseSpaceSource,
    kind: PhaseSpaceFunction = "wigner",
    *,
    samples: int | Mapping[str, int] = 129,
    extent: Mapping[str, tuple[float, float]] | None = None,
    coordinates: Mapping[str, ArrayLike] | None = None,
    tiles: Iterable[str] | None = None,
    engine: Engine = "auto",
) -> xarray.Dataset:
    """The function integrated over two of its four coordinates, for every pair of the others.

    The tiles of the paper's Fig. (projs), and the two pairs that its grids leave out. Named after
    the coordinates that are kept:

    =================  ============================  ==========================================
    kind               coordinates                   tiles
    =================  ============================  ==========================================
    "autocorrelation"  x, y, xi_x, xi_y              x_y, xi_x_xi_y, x_xi_x, y_xi_y, x_xi_y,
                                                     y_xi_x
    "wigner"           x, y, nu_x, nu_y              x_y, nu_x_nu_y, x_nu_x, y_nu_y, x_nu_y,
                                                     y_nu_x
    "ambiguity"        upsilon_x, upsilon_y, xi_x,   xi_x_xi_y, upsilon_x_upsilon_y,
                       xi_y                          upsilon_x_xi_x, upsilon_y_xi_y,
                                                     upsilon_y_xi_x, upsilon_x_xi_y
    =================  ============================  ==========================================

    Every one of them is a closed form (docs/projections.md, (P2) to (P13)): no quadrature, and
    nothing is lost between samples. The functions of slits have two coordinates only and are
    their own projection: x_xi, x_nu or upsilon_xi.

    Where a tile jumps, at vertical and horizontal edges of the outline and, for |u|^2 itself,
    everywhere along it, its value is that on the right or upper side of the edge.

    Parameters
    ----------
    source : Aperture or Slits, with or without an illumination, or an Array of either.
    kind : which function.
    samples : points along every axis, from 2 to 4096, or a mapping from coordinates to that; an
        odd number has zero frequency and zero lag among them.
    extent : from coordinates to (lowest, highest), in m or 1/m. Left out: positions to a
        sixteenth of the width beyond the outline, lags to 9/8 of the width, frequencies to
        8/width; the same with the height along y.
    coordinates : from coordinates to (n,) values, n up to 4096, in m or 1/m, instead of both.
    tiles : only these.
    engine : see :func:`fourier`; computes the tiles that are marginals.

    Returns
    -------
    xarray.Dataset. Complex for
    "ambiguity", and for "autocorrelation" of an Array and under an illumination; real for all
    others. The attributes of a tile: ``units``, ``long_name``, ``method`` (its closed form),
    ``exact`` (1: no quadrature) and ``error``, the largest error that rounding makes in it, for
    \\|nu\\| times diameter up to 1e3.

    Cost, with s samples along an axis and n edges: s overlaps of the outline with its mirror image
    and plane waves on some n edges at s^2 points for x_nu_x and upsilon_x_xi_x; up to n^2 pairs
    of edges at s^2 points for x_xi_y of the autocorrelation; all other tiles less. Of an Array,
    overlaps of all pairs of elements whose boxes meet. Under an illumination plane waves count once
    for every different frequency along the axis that is integrated over, or every different shift
    that pairs of waves make (m^2 or fewer for m waves), and x_xi_y takes s^2 overlaps.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine.

    >>> import polywigner as pw
    >>> found = pw.projections(pw.shapes.square(1.0), samples=9, tiles=["x_y"])
    >>> list(found.data_vars)
    ['x_y']
    """
    checked_choice(kind, "kind", get_args(PhaseSpaceFunction))
    if isinstance(source, Wavefront):
        raise ArgumentError(
            "expected a source with a flat, coherent wave for projections, got a Wavefront, whose "
            "tiles of mixed coordinates have no closed form; use its .source, or sums of wigner"
        )
    dimension = kernel_for(kind, source).dimension
    checked_engine(engine)
    available = tiles_of(dimension, kind)
    chosen = _chosen(available, tiles)
    axes = _axes(source, available, samples, extent, coordinates)
    arrays = {tile.name: _array(tile, source, axes, engine) for tile in chosen}
    used = {name for array in arrays.values() for name in array.dims}
    return labelled_arrays(
        arrays,
        {name: _axis(name, axes[name]) for name in axes if name in used},
        {"kind": kind, "convention": "exp(-2 pi i nu.xi), exp(-2 pi i upsilon.x)"},
    )


def _array(
    tile: Tile, source: PhaseSpaceSource, axes: Mapping[str, Values], engine: Engine
) -> xarray.Variable:
    values = tile.values(source, axes[tile.first], axes[tile.second], engine)
    attrs = {
        "units": tile.units,
        "long_name": tile.meaning,
        "method": f"closed form ({tile.label})",
        "exact": 1,
        "error": tile.error(source),
    }
    return labelled_array(values, (tile.first, tile.second), attrs)


def _axis(name: str, values: Values) -> xarray.Variable:
    units = "1/m" if name.startswith(("nu", "upsilon")) else "m"
    return labelled_array(values, (name,), {"units": units})


def _chosen(available: Mapping[str, Tile], names: Iterable[str] | None) -> list[Tile]:
    if not isinstance(names, Iterable | None):
        raise ArgumentError(f"expected names of tiles, got {type(names).__name__}")
    wanted = [names] if isinstance(names, str) else list(available if names is None else names)
    _known(wanted, available, "tiles")
    return [available[name] for name in wanted]


def _known(names: Iterable[Any], known: Iterable[str], what: str) -> None:
    for name in names:
        if not isinstance(name, str) or name not in known:
            raise ArgumentError(f"expected {what} among {', '.join(known)}, got {name!r}")


def _axes(
    source: PhaseSpaceSource, tiles: Mapping[str, Tile], samples: Any, extent: Any, coordinates: Any
) -> dict[str, Values]:
    """The values along every coordinate that the tiles have."""
    names = dict.fromkeys(name for t in tiles.values() for name in (t.first, t.second))
    counts = dict(samples) if isinstance(samples, Mapping) else dict.fromkeys(names, samples)
    ranges, given = _by_name("extent", extent), _by_name("coordinates", coordinates)
    for what, keys in (("samples", counts), ("extent", ranges), ("coordinates", given)):
        _known(keys, names, f"{what} of coordinates")
    return {
        name: _given(name, given[name])
        if name in given
        else np.linspace(
            *_range(name, ranges[name] if name in ranges else _default(source, name)),
            checked_count(counts.get(name, 129), f"samples along {name}", 2, LARGEST_SAMPLES),
        )
        for name in names
    }


def _by_name(what: str, values: Any) -> dict[str, Any]:
    if values is not None and not isinstance(values, Mapping):
        raise ArgumentError(
            f"expected {what} as a mapping from the names of coordinates, got "
            f"{type(values).__name__}"
        )
    return dict(values or {})


def _given(name: str, values: Any) -> Values:
    try:
        array = real_numbers(values)
    except ValueError:
        array = np.empty(0)
    if array.ndim != 1 or not len(array) or not np.isfinite(array).all():
        raise ArgumentError(
            f"expected {name} as finite numbers of shape (n,), got {value_text(values)}"
        )
    if len(array) > LARGEST_SAMPLES:
        raise ArgumentError(
            f"expected up to {LARGEST_SAMPLES} values of {name}, got {len(array)}; make several "
            "datasets of them"
        )
    return array


def _range(name: str, values: Any) -> tuple[float, float]:
    array = _given(f"the extent of {name}", values)
    if len(array) != 2 or not array[0] < array[1]:
        raise ArgumentError(
            f"expected the extent of {name} as (lowest, highest), got {value_text(values)}"
        )
    return float(array[0]), float(array[1])


def _default(source: PhaseSpaceSource, name: str) -> tuple[float, float]:
    bounds = source.bounds
    first = int(name.endswith("y"))
    low, high = bounds[first], bounds[first + len(bounds) // 2]
    width = high - low
    if name.startswith(("nu", "upsilon")):
        return -_LOBES / width, _LOBES / width
    if name.startswith("xi"):
        return -_MARGIN * width, _MARGIN * width
    centre, half = low + width / 2, _MARGIN * width / 2
    return centre - half, centre + half


Compute = Callable[[Any, Values, Values, Engine], Any]
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
    compute: Compute
    """(field or slits, values along the first, along the second, engine) -> (n, m)."""
    scale: Scale
    """(field or slits) -> unit of the rounding error, in the tile's units."""
    sees: Sees = "source"
    """The field as ``compute`` takes it: transposed, x and y change roles in it."""

    @property
    def name(self) -> str:
        return f"{self.first}_{self.second}"

    def values(self, source: Any, first: Values, second: Values, engine: Engine) -> Any:
        seen = source if self.sees == "source" else field_of(source)
        return self.compute(self._turned(seen), first, second, engine)

    def error(self, source: Any) -> float:
        """Bound on the absolute rounding error."""
        if self.label == _LINE:
            return _ROUNDING * self.scale(source)
        bound = bound_of(source)
        if self.scale is _nothing and is_lit_by_waves(source):
            return _ROUNDING * bound.amplitude**2
        return _ROUNDING * self.scale(self._turned(bound))

    def _turned(self, seen: Any) -> Any:
        return seen.transposed() if self.sees == "transposed" else seen


def _grid(first: Values, second: Values) -> Values:
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


def _lag_integral(source: Any, x: Values, y: Values, engine: Engine) -> Any:
    return position_marginal(source, _grid(x, y), engine=engine)


def _position_integral(source: Any, xi_x: Values, xi_y: Values, engine: Engine) -> Any:
    return lag_marginal(source, _grid(xi_x, xi_y), engine=engine)


def _shadow_product(field: PlaneField, x: Values, xi_x: Values, engine: Engine) -> Any:
    ahead, behind = (x[:, None] + half for half in (xi_x / 2, -xi_x / 2))
    one, other = (column_integrals(field, at.ravel()) for at in (ahead, behind))
    return (one * np.conj(other)).reshape(ahead.shape)


def _mirrored_overlap(field: PlaneField, x: Values, xi_y: Values, engine: Engine) -> Any:
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


def _of_columns(one: Values, other: Values) -> tuple[Values, Values]:
    """(P5): the columns at a and 2x - a, one of them moved up."""
    shift = np.column_stack([one[:, 0] + other[:, 0], one[:, 1] - other[:, 1]])
    return shift, np.column_stack([-2 * other[:, 0], other[:, 1]])


# --- Wigner function


def _intensity(source: Any, x: Values, y: Values, engine: Engine) -> Any:
    return autocorrelation(source, _grid(x, y), np.zeros(2), engine=engine).real


def _power_spectrum(source: Any, nu_x: Values, nu_y: Values, engine: Engine) -> Any:
    return _squared(fourier(source, _grid(nu_x, nu_y), engine=engine))


def _wigner_of_rows(field: PlaneField, x: Values, nu_x: Values, engine: Engine) -> Any:
    def image(sign: float) -> Copies:
        return lambda at: lambda v: (v - (at, field.centre[1])) * (2 * sign, 1.0)

    # The overlap is its own mirror image, with the conjugate field: its transform is real.
    found = overlaps(field, x, image(1.0), image(-1.0))
    places = (x - field.centre[0])[:, None]
    return mutual_spectra(field, found, nu_x, places, _of_one_row).real


def _of_one_row(one: Values, other: Values) -> tuple[Values, Values]:
    """(P8): points of one row, their middle at x."""
    shift = np.column_stack([(one[:, 0] + other[:, 0]) / 2, one[:, 1] - other[:, 1]])
    return shift, one[:, :1] - other[:, :1]


def _column_powers(field: PlaneField, x: Values, nu_y: Values, engine: Engine) -> Any:
    return _squared(column_spectra(field, x, nu_y))


def _squared(values: Any) -> Any:
    return values.real**2 + values.imag**2


# --- ambiguity function


def _at_opposite_points(source: Any, xi_x: Values, xi_y: Values, engine: Engine) -> Any:
    return autocorrelation(source, np.zeros(2), _grid(xi_x, xi_y), engine=engine)


def _spectrum_product(source: Any, first: Values, second: Values, engine: Engine) -> Any:
    half = _grid(first, second) / 2
    ahead = fourier(source, half, engine=engine)
    return ahead * np.conj(fourier(source, -half, engine=engine))


def _ambiguity_of_rows(field: PlaneField, upsilon_x: Values, xi_x: Values, engine: Engine) -> Any:
    centre = float(field.centre[0])

    def image(sign: float) -> Copies:
        return lambda lag: lambda v: (v - (centre + sign * lag / 2, 0.0)) * (1.0, sign)

    found = overlaps(field, xi_x, image(1.0), image(-1.0))
    places = np.column_stack([xi_x, np.full(len(xi_x), field.centre[1])])
    spectra = mutual_spectra(field, found, upsilon_x, places, _of_opposite_rows)
    return 2 * (spectra * phase(centre, upsilon_x)).T


def _of_opposite_rows(one: Values, other: Values) -> tuple[Values, Values]:
    """(P12): points of the rows at eta and -eta, relative to the centre's x but not to its y."""
    shift = np.column_stack([one[:, 0] - other[:, 0], one[:, 1] + other[:, 1]])
    return shift, np.column_stack([(one[:, 0] + other[:, 0]) / 2, other[:, 1] - one[:, 1]])


def _opposite_columns(field: PlaneField, upsilon_y: Values, xi_x: Values, engine: Engine) -> Any:
    ahead, behind = (
        column_spectra(field, sign * xi_x / 2, sign * upsilon_y / 2) for sign in (1.0, -1.0)
    )
    return (ahead * np.conj(behind) * phase(float(field.centre[1]), upsilon_y)).T


# --- the tables


# first and second coordinate, unit, coordinates integrated over, label, values, scale; {0} and {1}
# stand for x and y, and once more for y and x
_APERTURE: dict[str, list[tuple[str, str, str, str, str, Compute, Scale]]] = {
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


def _on_line(transform: Callable[..., Any]) -> Compute:
    def compute(source: Any, first: Values, second: Values, engine: Engine) -> Any:
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
