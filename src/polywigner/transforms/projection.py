"""Projections of the four-dimensional phase-space functions onto pairs of coordinates.

Every tile has its closed form, a row of one table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, value_text
from polywigner.execution import Engine, checked_engine
from polywigner.geometry import Slits, Wavefront
from polywigner.geometry.arguments import checked_choice, checked_count, real_numbers
from polywigner.kernels import kernel_for
from polywigner.source.normal_form import normal_form
from polywigner.transforms.checked_calls import PhaseSpaceSource
from polywigner.transforms.phase_space import (
    ambiguity,
    autocorrelation,
    lag_marginal,
    position_marginal,
    wigner,
)
from polywigner.transforms.sections import (
    Image,
    PlaneField,
    column_integrals,
    column_spectra,
    field_of,
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
Array = NDArray[Any]


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
    available = _tiles_of(dimension, kind)
    names = _requested(available, tiles)
    axes = _axes(source, available, samples, extent, coordinates)
    bounds = _Bounds.of(source)
    arrays, used = {}, set()
    for name in names:
        tile = available[name]
        used |= {tile.first, tile.second}
        attrs = {
            "units": tile.units,
            "long_name": tile.meaning,
            "method": f"closed form ({tile.label})",
            "exact": 1,
            "error": _ROUNDING * tile.scale(bounds),
        }
        values = tile.values(source, axes[tile.first], axes[tile.second], engine)
        arrays[name] = labelled_array(values, (tile.first, tile.second), attrs)
    coords = {
        name: labelled_array(values, (name,), {"units": "1/m" if _is_frequency(name) else "m"})
        for name, values in axes.items()
        if name in used
    }
    attrs = {"kind": kind, "convention": "exp(-2 pi i nu.xi), exp(-2 pi i upsilon.x)"}
    return labelled_arrays(arrays, coords, attrs)


def _is_frequency(name: str) -> bool:
    return name.startswith(("nu", "upsilon"))


# --- arguments


def _requested(available: Mapping[str, Tile], names: Iterable[str] | None) -> list[str]:
    if not isinstance(names, Iterable | None):
        raise ArgumentError(f"expected names of tiles, got {type(names).__name__}")
    requested = [names] if isinstance(names, str) else list(available if names is None else names)
    _check_names(requested, available, "tiles")
    return requested


def _check_names(names: Iterable[object], known: Iterable[str], what: str) -> None:
    for name in names:
        if not isinstance(name, str) or name not in known:
            raise ArgumentError(f"expected {what} among {', '.join(known)}, got {name!r}")


def _axes(
    source: PhaseSpaceSource,
    tiles: Mapping[str, Tile],
    samples: int | Mapping[str, int],
    extent: Mapping[str, tuple[float, float]] | None,
    coordinates: Mapping[str, ArrayLike] | None,
) -> dict[str, Values]:
    """Return the values along every coordinate of the tiles."""
    names = dict.fromkeys(name for tile in tiles.values() for name in (tile.first, tile.second))
    counts = samples if isinstance(samples, Mapping) else dict.fromkeys(names, samples)
    options: dict[str, Any] = {
        "samples": counts,
        "extent": extent or {},
        "coordinates": coordinates or {},
    }
    for option, values in options.items():
        if not isinstance(values, Mapping):
            raise ArgumentError(
                f"expected {option} as a mapping from the names of coordinates, got "
                f"{type(values).__name__}"
            )
        _check_names(values, names, f"{option} of coordinates")
    axes = {}
    for name in names:
        if name in options["coordinates"]:
            axes[name] = _numbers(name, options["coordinates"][name])
            continue
        ends = options["extent"].get(name, _default(source, name))
        count = checked_count(counts.get(name, 129), f"samples along {name}", 2, LARGEST_SAMPLES)
        interval = _numbers(f"the extent of {name}", ends)
        if len(interval) != 2 or not interval[0] < interval[1]:
            raise ArgumentError(
                f"expected the extent of {name} as (lowest, highest), got {value_text(ends)}"
            )
        axes[name] = np.linspace(float(interval[0]), float(interval[1]), count)
    return axes


def _numbers(name: str, values: ArrayLike) -> Values:
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


def _default(source: PhaseSpaceSource, name: str) -> tuple[float, float]:
    bounds = source.bounds
    axis = int(name.endswith("y"))
    low, high = bounds[axis], bounds[axis + len(bounds) // 2]
    width = high - low
    if _is_frequency(name):
        return -_LOBES / width, _LOBES / width
    if name.startswith("xi"):
        return -_MARGIN * width, _MARGIN * width
    centre, half = low + width / 2, _MARGIN * width / 2
    return centre - half, centre + half


# --- rounding errors

# Rounding error relative to the scale of a tile; the largest over the shapes of the tests was
# 2e-13, for |nu| times diameter up to 1e3.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class _Bounds:
    """Upper bounds on a field, in which its waves count with the sum of their moduli."""

    content: float
    """Bound on |F|: the sum of areas or lengths times bounds on |u|."""
    amplitude: float
    """Bound on |u|: the elements whose boxes meet add up."""
    sides: Values
    """Sides of the box, (d,) in m."""
    is_uniform: bool

    @classmethod
    def of(cls, source: PhaseSpaceSource) -> _Bounds:
        form = normal_form(source).in_plane
        moduli = np.array([abs(e.weight) * np.abs(e.amplitudes).sum() for e in form.elements])
        sizes = [
            e.outline.length if isinstance(e.outline, Slits) else e.outline.area
            for e in form.elements
        ]
        ends = np.array([np.reshape(e.outline.bounds, (2, -1)) for e in form.elements])
        meets = (ends[:, None, 0] <= ends[:, 1]) & (ends[:, 0] <= ends[:, None, 1])
        sides = np.diff(np.reshape(form.bounds, (2, -1)), axis=0)[0]
        return cls(
            float(moduli @ sizes),
            float((meets.all(axis=-1) @ moduli).max()),
            sides,
            all(element.has_unit_field for element in form.distinct),
        )

    def transposed(self) -> _Bounds:
        return replace(self, sides=self.sides[::-1])


def _power(bounds: _Bounds) -> float:
    """Bound on |F|^2."""
    return bounds.content**2


def _box(bounds: _Bounds) -> float:
    """Bound on the intensity, times the area of the box."""
    return bounds.amplitude**2 * float(bounds.sides.prod())


def _column(bounds: _Bounds) -> float:
    """Bound on the intensity, times the squared height."""
    return (bounds.amplitude * float(bounds.sides[-1])) ** 2


def _intensity_bound(bounds: _Bounds) -> float:
    """Bound on the intensity of waves; uniform fields have no rounding error."""
    return 0.0 if bounds.is_uniform else bounds.amplitude**2


def _line_content(bounds: _Bounds) -> float:
    """Bound on |W|/2 and |A| of slits: the integral of |u| times a bound on |u|."""
    return bounds.content * bounds.amplitude


# --- tiles


Scale = Callable[[_Bounds], float]


@dataclass(frozen=True)
class Tile:
    """Two coordinates, and the function integrated over the other coordinates."""

    first: str
    second: str
    units: str
    meaning: str
    label: str
    """Label of the equation in docs/projections.md."""
    compute: Callable[..., Array]
    """(source, points of a grid, engine=...) or (field, first values, second values) -> (n, m)."""
    scale: Scale
    """Unit of the rounding error, in the tile's units."""
    takes: str = "source"
    """Argument of ``compute``: "source", "field", or "transposed" (x and y exchanged)."""

    def values(
        self, source: PhaseSpaceSource, first: Values, second: Values, engine: Engine
    ) -> Array:
        if self.label == "P1":
            points = first[:, None, None], second[None, :, None]
            return self.compute(source, *points, engine=engine)
        if self.takes == "source" or isinstance(source, Slits | Wavefront):
            grid = np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1)
            return self.compute(source, grid, engine=engine)
        field = field_of(source)
        if self.takes == "transposed":
            field = field.transposed()
        return self.compute(field, first, second)


def _along_x(values: Values, y: float = 0.0) -> Values:
    """Return points (n, 2) at one y."""
    return np.stack([values, np.full_like(values, y)], axis=-1)


# --- autocorrelation


def _shadow_product(field: PlaneField, x: Values, xi_x: Values) -> Array:
    at = (x - field.centre[0])[:, None]
    ahead, behind = (column_integrals(field, (at + half).ravel()) for half in (xi_x / 2, -xi_x / 2))
    return (ahead * np.conj(behind)).reshape(len(x), len(xi_x))


def _mirrored_overlap(field: PlaneField, x: Values, xi_y: Values) -> Array:
    x = x - field.centre[0]
    if field.is_uniform:
        return mirrored_correlation(field, x, xi_y)
    values = np.empty((len(x), len(xi_y)), np.complex128)
    unmoved = (1.0, 1.0), np.zeros((len(xi_y), 2))
    for row, at in enumerate(x.tolist()):
        behind = np.column_stack([np.full(len(xi_y), 2 * at), xi_y])
        regions = overlaps(field, unmoved, ((-1.0, 1.0), behind))
        points = behind * (0.5, 1.0)
        spectra = mutual_spectra(field, regions, np.zeros(1), points, _of_columns)
        values[row] = 2 * spectra[:, 0]
    return values


def _of_columns(one: Values, other: Values) -> tuple[Values, Values]:
    """(P5): the columns at a and 2x - a, one of them moved up."""
    shift = np.column_stack([one[:, 0] + other[:, 0], one[:, 1] - other[:, 1]])
    return shift, np.column_stack([-2 * other[:, 0], other[:, 1]])


# --- Wigner function


def _intensity(source: PhaseSpaceSource, grid: Values, *, engine: Engine) -> Array:
    return np.asarray(autocorrelation(source, grid, np.zeros(2), engine=engine).real)


def _power_spectrum(source: PhaseSpaceSource, grid: Values, *, engine: Engine) -> Array:
    return _squared(fourier(source, grid, engine=engine))


def _wigner_of_rows(field: PlaneField, x: Values, nu_x: Values) -> Array:
    x = x - field.centre[0]
    # The overlap is its own mirror image, with the conjugate field: its transform is real.
    ahead: Image = (2.0, 1.0), _along_x(-2 * x)
    behind: Image = (-2.0, 1.0), _along_x(2 * x)
    regions = overlaps(field, ahead, behind)
    return mutual_spectra(field, regions, nu_x, x[:, None], _of_one_row).real


def _of_one_row(one: Values, other: Values) -> tuple[Values, Values]:
    """(P8): points of one row with their midpoint at x."""
    shift = np.column_stack([(one[:, 0] + other[:, 0]) / 2, one[:, 1] - other[:, 1]])
    return shift, one[:, :1] - other[:, :1]


def _column_powers(field: PlaneField, x: Values, nu_y: Values) -> Array:
    return _squared(column_spectra(field, x - field.centre[0], nu_y))


def _squared(values: Array) -> Array:
    return np.asarray(values.real**2 + values.imag**2)


# --- ambiguity function


def _at_opposite_points(source: PhaseSpaceSource, grid: Values, *, engine: Engine) -> Array:
    return np.asarray(autocorrelation(source, np.zeros(2), grid, engine=engine))


def _spectrum_product(source: PhaseSpaceSource, grid: Values, *, engine: Engine) -> Array:
    ahead = fourier(source, grid / 2, engine=engine)
    return np.asarray(ahead * np.conj(fourier(source, -grid / 2, engine=engine)))


def _ambiguity_of_rows(field: PlaneField, upsilon_x: Values, xi_x: Values) -> Array:
    x, y = field.centre.tolist()
    ahead: Image = (1.0, 1.0), _along_x(-xi_x / 2, y)
    behind: Image = (1.0, -1.0), _along_x(xi_x / 2, -y)
    regions = overlaps(field, ahead, behind)
    points = np.column_stack([xi_x, np.full(len(xi_x), y)])
    spectra = mutual_spectra(field, regions, upsilon_x, points, _of_opposite_rows)
    return 2 * (spectra * phase(x, upsilon_x)).T


def _of_opposite_rows(one: Values, other: Values) -> tuple[Values, Values]:
    """(P12): points of the rows at eta and -eta, relative to the centre's x but not to its y."""
    shift = np.column_stack([one[:, 0] - other[:, 0], one[:, 1] + other[:, 1]])
    return shift, np.column_stack([(one[:, 0] + other[:, 0]) / 2, other[:, 1] - one[:, 1]])


def _opposite_columns(field: PlaneField, upsilon_y: Values, xi_x: Values) -> Array:
    x, y = field.centre.tolist()
    ahead, behind = (
        column_spectra(field, sign * xi_x / 2 - x, sign * upsilon_y / 2) for sign in (1.0, -1.0)
    )
    return (ahead * np.conj(behind) * phase(y, upsilon_y)).T


# --- the tables


# first and second coordinate, unit, coordinates integrated over, label, values, scale; {0} and {1}
# stand for x and y, and once more for y and x
_APERTURE: dict[str, list[tuple[str, str, str, str, str, Callable[..., Array], Scale]]] = {
    "autocorrelation": [
        ("x", "y", "m2", "xi_x, xi_y", "P2", position_marginal, _box),
        ("xi_x", "xi_y", "m2", "x, y", "P3", lag_marginal, _box),
        ("{0}", "xi_{0}", "m2", "{1}, xi_{1}", "P4", _shadow_product, _column),
        ("{0}", "xi_{1}", "m2", "{1}, xi_{0}", "P5", _mirrored_overlap, _box),
    ],
    "wigner": [
        ("x", "y", "1", "nu_x, nu_y", "P6", _intensity, _intensity_bound),
        ("nu_x", "nu_y", "m4", "x, y", "P7", _power_spectrum, _power),
        ("{0}", "nu_{0}", "m2", "{1}, nu_{1}", "P8", _wigner_of_rows, _box),
        ("{0}", "nu_{1}", "m2", "{1}, nu_{0}", "P9", _column_powers, _column),
    ],
    "ambiguity": [
        ("xi_x", "xi_y", "1", "upsilon_x, upsilon_y", "P10", _at_opposite_points, _intensity_bound),
        ("upsilon_x", "upsilon_y", "m4", "xi_x, xi_y", "P11", _spectrum_product, _power),
        ("upsilon_{0}", "xi_{0}", "m2", "upsilon_{1}, xi_{1}", "P12", _ambiguity_of_rows, _box),
        ("upsilon_{1}", "xi_{0}", "m2", "upsilon_{0}, xi_{1}", "P13", _opposite_columns, _column),
    ],
}
_LETTERS = {"autocorrelation": "R", "wigner": "W", "ambiguity": "A"}


def _on_line(source: PhaseSpaceSource, x: Values, xi: Values, *, engine: Engine) -> Array:
    values = autocorrelation(source, x, xi, engine=engine)
    is_real = isinstance(source, Slits) and source.illumination is None
    return np.asarray(values.real if is_real else values)


_SLITS: dict[str, tuple[str, str, str, Callable[..., Array], Scale]] = {
    "autocorrelation": ("x", "xi", "1", _on_line, _intensity_bound),
    "wigner": ("x", "nu", "m", wigner, _line_content),
    "ambiguity": ("upsilon", "xi", "m", ambiguity, _line_content),
}


def _tiles_of(dimension: int, kind: str) -> dict[str, Tile]:
    """Return the tiles of a kind of function of slits (1) or plane sources (2), by name."""
    letter, tiles = _LETTERS[kind], []
    if dimension == 1:
        first, second, units, compute, scale = _SLITS[kind]
        tiles.append(Tile(first, second, units, letter, "P1", compute, scale))
    for row in _APERTURE[kind] if dimension == 2 else ():
        first, second, units, over, label, compute, scale = row
        meaning = f"{letter} integrated over {over}"
        if "{" not in over:
            tiles.append(Tile(first, second, units, meaning, label, compute, scale))
            continue
        for takes, letters in (("field", "xy"), ("transposed", "yx")):
            x, y, over_both = (text.format(*letters) for text in (first, second, meaning))
            scaled = partial(_transposed, scale) if takes == "transposed" else scale
            tiles.append(Tile(x, y, units, over_both, label, compute, scaled, takes))
    return {f"{tile.first}_{tile.second}": tile for tile in tiles}


def _transposed(scale: Scale, bounds: _Bounds) -> float:
    return scale(bounds.transposed())
