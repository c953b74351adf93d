"""Projections of the four-dimensional phase-space functions onto pairs of coordinates.

Each projection, called a tile, has a closed form, which a table at the end of the module lists.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from types import NoneType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, checked_engine
from polywigner.geometry import Slits, Wavefront
from polywigner.geometry.arguments import (
    check_most,
    checked_choice,
    checked_count,
    checked_type,
    finite_array,
)
from polywigner.geometry.rings import sides_of
from polywigner.kernels import kernel_for
from polywigner.numerics import Floats
from polywigner.source.normal_form import normal_form
from polywigner.transforms.checked_calls import PhaseSpaceSource
from polywigner.transforms.public_transforms import (
    ambiguity,
    autocorrelation,
    fourier,
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
    phase_factor,
)
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

if TYPE_CHECKING:
    import xarray


PhaseSpaceFunction = Literal["autocorrelation", "wigner", "ambiguity"]

LARGEST_SAMPLES = 4096
"""Largest number of samples along each axis. A complex tile of this size takes 256 MiB."""

# Default range of lags, in widths of the source. Positions extend a sixteenth of the width beyond
# the outline.
_MARGIN = 9 / 8
# Default range of frequencies, in reciprocal widths of the source.
_LOBES = 8.0

# Bound on the rounding error of a tile, relative to its scale. The largest error in the tests was
# 2e-13, with |nu| times diameter up to 1e3.
_ROUNDING = 1e-12

Array = NDArray[Any]


def projections(
    source: PhaseSpaceSource,
    kind: PhaseSpaceFunction = "wigner",
    *,
    samples: int = 129,
    coordinates: Mapping[str, ArrayLike] | None = None,
    tiles: Iterable[str] | None = None,
    engine: Engine = "auto",
) -> xarray.Dataset:
    """Compute the projections of a phase-space function onto pairs of its four coordinates.

    A projection, also called a tile, is the integral of the function over two of its coordinates.
    The tiles are the projections in the paper's Fig. (projs), and the projections onto two further
    pairs of coordinates. Each tile is named after its two remaining coordinates:

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

    Every tile is computed in closed form without quadrature (docs/projections.md, (P2) to (P13)),
    so its values do not depend on the sampling. The functions of slits have only two coordinates.
    Their single tile x_xi, x_nu or upsilon_xi is the function itself.

    Tiles may be discontinuous at vertical and horizontal edges of the outline, and the tile |u|^2
    is discontinuous at all edges. The value at an edge is the limit from its right or upper side.

    The computing time depends on the number n of edges and the number s of samples along an axis.
    The tiles x_nu_x and upsilon_x_xi_x need s overlaps of the outline with its mirror image, and n
    plane-wave integrals at each of s^2 points. The tile x_xi_y of the autocorrelation needs up to
    n^2 pairs of edges at each of s^2 points. All other tiles take less time. For an Array, all
    pairs of elements with overlapping bounding boxes contribute. For an illumination with m plane
    waves, the time is multiplied by up to m^2, and the tile x_xi_y needs s^2 overlaps.

    Parameters
    ----------
    source : Aperture, Slits or Array
        Apertures and slits with or without an illumination.
    kind : {"autocorrelation", "wigner", "ambiguity"}, default "wigner"
        Function to be integrated.
    samples : int, default 129
        Number of samples along each axis not in ``coordinates``, from 2 to 4096. An odd number
        includes zero frequency and zero lag. With the width b of the source, positions extend
        beyond the outline by b/16, lags extend to 9 b/8, and frequencies extend to 8/b. Along y, b
        is the height of the source.
    coordinates : mapping of str to array_like, shape (n,), optional
        Values along an axis in m or 1/m, with the name of the coordinate as the key. Each axis may
        have up to 4096 values.
    tiles : iterable of str, optional
        Names of the tiles to compute. By default all tiles are computed.
    engine : str, default "auto"
        Engine for tiles that are marginals, see :func:`fourier`.

    Returns
    -------
    xarray.Dataset
        The tiles. They are complex for "ambiguity", and for the "autocorrelation" of an Array or of
        a source with an illumination. All other tiles are real. Each tile has the attributes
        ``units``, ``long_name``, ``method`` (the name of its closed form) and ``error`` (an upper
        bound on the rounding error for \\|nu\\| times diameter up to 1e3).

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range.
    GeometryError
        If an Array has elements outside the plane z = 0.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> tiles = pw.projections(pw.shapes.square(1.0), samples=9, tiles=["x_y"])
    >>> list(tiles.data_vars)
    ['x_y']
    """
    checked_choice(kind, "kind", get_args(PhaseSpaceFunction))
    if isinstance(source, Wavefront):
        raise ArgumentError(
            "projections require a source with a flat, coherent wave, got a Wavefront, for which "
            "some projections have no closed form; use its attribute .source, or sum values of "
            "wigner"
        )
    dimension = kernel_for(kind, source).dimension
    checked_engine(engine)
    available = _tiles_of(dimension, kind)
    names = _requested_tiles(available, tiles)
    axes = _coordinate_values(source, available, samples, coordinates)
    amplitude, side = _largest_amplitude(source), max(sides_of(source.bounds).tolist())
    arrays, used = {}, set()
    for name in names:
        tile = available[name]
        used |= {tile.first, tile.second}
        attrs = {
            "units": tile.units,
            "long_name": tile.meaning,
            "method": f"closed form ({tile.label})",
            "error": _ROUNDING * amplitude**2 * side ** _POWERS[tile.units],
        }
        values = tile.values(source, axes[tile.first], axes[tile.second], engine)
        arrays[name] = labelled_array(values, (tile.first, tile.second), attrs)
    coords = {
        name: labelled_array(values, (name,), {"units": "1/m" if is_frequency(name) else "m"})
        for name, values in axes.items()
        if name in used
    }
    attrs = {"kind": kind, "convention": "exp(-2 pi i nu.xi), exp(-2 pi i upsilon.x)"}
    return labelled_arrays(arrays, coords, attrs)


def is_frequency(name: str) -> bool:
    """Return whether the name of a coordinate denotes a spatial frequency, nu or upsilon."""
    return name.startswith(("nu", "upsilon"))


def _requested_tiles(available: Mapping[str, Tile], names: Iterable[str] | None) -> list[str]:
    """Return the names of the tiles to compute, by default all available tiles.

    Raises ArgumentError for unknown names.
    """
    checked_type(names, "tiles to be a list of names", Iterable, NoneType)
    requested = [names] if isinstance(names, str) else list(available if names is None else names)
    return [checked_choice(name, "each of the tiles", available) for name in requested]


def _coordinate_values(
    source: PhaseSpaceSource,
    tiles: Mapping[str, Tile],
    samples: int,
    coordinates: Mapping[str, ArrayLike] | None,
) -> dict[str, Floats]:
    """Return the values of each coordinate, which are specified by the caller or evenly spaced.

    Raises ArgumentError for unknown coordinates and invalid values.
    """
    names = dict.fromkeys(name for tile in tiles.values() for name in (tile.first, tile.second))
    count = checked_count(samples, "samples", 2, LARGEST_SAMPLES)
    requested = {} if coordinates is None else coordinates
    expected = "coordinates to be a mapping from names of coordinates to values"
    checked_type(requested, expected, Mapping)
    for name in requested:
        checked_choice(name, "each of the coordinates", names)
    low, widths = np.reshape(source.bounds, (2, -1))[0], sides_of(source.bounds).tolist()
    axes = {}
    for name in names:
        axis = int(name.endswith("y"))
        width, centre = widths[axis], 0.0
        half_range = _LOBES / width if is_frequency(name) else _MARGIN * width
        if name in ("x", "y"):
            centre, half_range = low[axis] + width / 2, half_range / 2
        axes[name] = (
            _checked_values(name, requested[name])
            if name in requested
            else np.linspace(centre - half_range, centre + half_range, count)
        )
    return axes


def _checked_values(name: str, values: ArrayLike) -> Floats:
    """Return the values of a coordinate as an array (n,) with up to 4096 entries.

    Raises ArgumentError for other values.
    """
    array = finite_array(values, f"expected {name} to be finite numbers of shape (n,)", (None,))
    check_most(len(array), LARGEST_SAMPLES, f"values of {name}", "compute several datasets")
    return array


def _largest_amplitude(source: PhaseSpaceSource) -> float:
    """Return an upper bound on |u|; the fields of elements that may overlap are added."""
    elements = normal_form(source).in_plane.elements
    moduli = np.array([abs(e.weight) * np.abs(e.amplitudes).sum() for e in elements])
    low, high = np.array([np.reshape(e.outline.bounds, (2, -1)) for e in elements]).swapaxes(0, 1)
    meets = ((low[:, None] <= high) & (low <= high[:, None])).all(axis=-1)
    return float((meets @ moduli).max())


# Exponent of the metre in each unit of tiles.
_POWERS = {"1": 0, "m": 1, "m2": 2, "m4": 4}

Compute = Callable[[PhaseSpaceSource, Floats, Floats, Engine], Array]


class Tile(NamedTuple):
    """A projection onto two coordinates, and the function that computes it."""

    first: str
    second: str
    units: str
    meaning: str
    label: str
    """Label of the tile's formula in docs/projections.md."""
    values: Compute
    """Function (source, first coordinates, second coordinates, engine)."""


def _on_grid(function: Callable[..., Array]) -> Compute:
    """Return a tile function that evaluates a function of points at all pairs of coordinates."""

    def values(source: PhaseSpaceSource, first: Floats, second: Floats, engine: Engine) -> Array:
        """Return the values at all pairs of coordinates, one row for each first coordinate."""
        grid = np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1)
        return np.asarray(function(source, grid, engine=engine))

    return values


def _of_field(function: Callable[..., Array], is_transposed: bool) -> Compute:
    """Return a tile function from a function of a field and the two coordinates of the tile."""

    def values(source: Any, first: Floats, second: Floats, engine: Engine) -> Array:
        """Return the tile of a source, one row for each first coordinate."""
        field = field_of(source)
        return function(field.transposed() if is_transposed else field, first, second)

    return values


def _of_slits(function: Callable[..., Array]) -> Compute:
    """Return a tile function that evaluates a phase-space function of slits."""

    def values(source: PhaseSpaceSource, first: Floats, second: Floats, engine: Engine) -> Array:
        """Return the phase-space function, one row for each first coordinate."""
        result = function(source, first[:, None, None], second[None, :, None], engine=engine)
        is_uniform = isinstance(source, Slits) and source.illumination is None
        return np.asarray(result.real if is_uniform and function is autocorrelation else result)

    return values


def _points_on_row(values: Floats, y: float = 0.0) -> Floats:
    """Return points (n, 2) with the specified x coordinates and a common y coordinate."""
    return np.stack([values, np.full_like(values, y)], axis=-1)


def _shadow_product(field: PlaneField, x: Floats, xi_x: Floats) -> Array:
    """Return R at all pairs of x (n,) and xi_x (m,), integrated over y and xi_y, equation (P4)."""
    at = (x - field.centre[0])[:, None]
    ahead, behind = (column_integrals(field, (at + half).ravel()) for half in (xi_x / 2, -xi_x / 2))
    return (ahead * np.conj(behind)).reshape(len(x), len(xi_x))


def _mirrored_overlap(field: PlaneField, x: Floats, xi_y: Floats) -> Array:
    """Return R at all pairs of x (n,) and xi_y (m,), integrated over y and xi_x, equation (P5)."""
    x = x - field.centre[0]
    if field.is_uniform:
        return mirrored_correlation(field, x, xi_y)
    values = np.empty((len(x), len(xi_y)), np.complex128)
    unmoved = (1.0, 1.0), np.zeros((len(xi_y), 2))
    for row, at in enumerate(x.tolist()):
        behind = np.column_stack([np.full(len(xi_y), 2 * at), xi_y])
        regions = overlaps(field, unmoved, ((-1.0, 1.0), behind))
        points = behind * (0.5, 1.0)
        spectra = mutual_spectra(field, regions, np.zeros(1), points, _pairing_of_columns)
        values[row] = 2 * spectra[:, 0]
    return values


def _pairing_of_columns(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Return shifts (m, 2) and phase rates (m, 2) in 1/m for m pairs of waves, equation (P5)."""
    shift = np.column_stack([first[:, 0] + second[:, 0], first[:, 1] - second[:, 1]])
    return shift, np.column_stack([-2 * second[:, 0], second[:, 1]])


def _intensity(source: PhaseSpaceSource, grid: Floats, *, engine: Engine) -> Array:
    """Return |u|^2, the integral of W over frequencies, at positions (..., 2), equation (P6)."""
    return np.asarray(autocorrelation(source, grid, np.zeros(2), engine=engine).real)


def _power_spectrum(source: PhaseSpaceSource, grid: Floats, *, engine: Engine) -> Array:
    """Return |F|^2, the integral of W over positions, at frequencies (..., 2), equation (P7)."""
    return _squared(fourier(source, grid, engine=engine))


def _wigner_of_rows(field: PlaneField, x: Floats, nu_x: Floats) -> Array:
    """Return W at all pairs of x (n,) and nu_x (m,), integrated over y and nu_y, equation (P8)."""
    x = x - field.centre[0]
    # The field on the overlap is Hermitian, so its Fourier transform is real.
    ahead: Image = (2.0, 1.0), _points_on_row(-2 * x)
    behind: Image = (-2.0, 1.0), _points_on_row(2 * x)
    regions = overlaps(field, ahead, behind)
    return mutual_spectra(field, regions, nu_x, x[:, None], _pairing_of_row).real


def _pairing_of_row(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Return shifts (m, 2) and phase rates (m, 1) in 1/m for m pairs of waves, equation (P8)."""
    shift = np.column_stack([(first[:, 0] + second[:, 0]) / 2, first[:, 1] - second[:, 1]])
    return shift, first[:, :1] - second[:, :1]


def _column_powers(field: PlaneField, x: Floats, nu_y: Floats) -> Array:
    """Return W at all pairs of x (n,) and nu_y (m,), integrated over y and nu_x, equation (P9)."""
    return _squared(column_spectra(field, x - field.centre[0], nu_y))


def _squared(values: Array) -> Array:
    """Return the squared moduli of complex values."""
    return np.asarray(values.real**2 + values.imag**2)


def _at_opposite_points(source: PhaseSpaceSource, grid: Floats, *, engine: Engine) -> Array:
    """Return R(0, xi), the integral of A over frequency shifts, at lags xi, equation (P10)."""
    return np.asarray(autocorrelation(source, np.zeros(2), grid, engine=engine))


def _spectrum_product(source: PhaseSpaceSource, grid: Floats, *, engine: Engine) -> Array:
    """Return F(upsilon/2) F*(-upsilon/2), the integral of A over all lags, equation (P11)."""
    ahead = fourier(source, grid / 2, engine=engine)
    return np.asarray(ahead * np.conj(fourier(source, -grid / 2, engine=engine)))


def _ambiguity_of_rows(field: PlaneField, upsilon_x: Floats, xi_x: Floats) -> Array:
    """Return A at upsilon_x (n,) and xi_x (m,), integrated over upsilon_y and xi_y, as in (P12)."""
    x, y = field.centre.tolist()
    ahead: Image = (1.0, 1.0), _points_on_row(-xi_x / 2, y)
    behind: Image = (1.0, -1.0), _points_on_row(xi_x / 2, -y)
    regions = overlaps(field, ahead, behind)
    points = np.column_stack([xi_x, np.full(len(xi_x), y)])
    spectra = mutual_spectra(field, regions, upsilon_x, points, _pairing_of_opposite_rows)
    return 2 * (spectra * phase_factor(x, upsilon_x)).T


def _pairing_of_opposite_rows(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Return shifts (m, 2) and phase rates (m, 2) in 1/m for m pairs of waves, equation (P12)."""
    shift = np.column_stack([first[:, 0] - second[:, 0], first[:, 1] + second[:, 1]])
    return shift, np.column_stack([(first[:, 0] + second[:, 0]) / 2, second[:, 1] - first[:, 1]])


def _opposite_columns(field: PlaneField, upsilon_y: Floats, xi_x: Floats) -> Array:
    """Return A at upsilon_y (n,) and xi_x (m,), integrated over upsilon_x and xi_y, as in (P13)."""
    x, y = field.centre.tolist()
    ahead, behind = (
        column_spectra(field, sign * xi_x / 2 - x, sign * upsilon_y / 2) for sign in (1.0, -1.0)
    )
    return (ahead * np.conj(behind) * phase_factor(y, upsilon_y)).T


_LETTERS = {"autocorrelation": "R", "wigner": "W", "ambiguity": "A"}

_SLITS: dict[str, tuple[str, str, str, Callable[..., Any]]] = {
    "autocorrelation": ("x", "xi", "1", autocorrelation),
    "wigner": ("x", "nu", "m", wigner),
    "ambiguity": ("upsilon", "xi", "m", ambiguity),
}
# Tiles computed point by point: both coordinates, unit, coordinates of integration, formula label,
# and function.
_OF_POINTS: dict[str, list[tuple[str, str, str, str, str, Callable[..., Any]]]] = {
    "autocorrelation": [
        ("x", "y", "m2", "xi_x, xi_y", "P2", position_marginal),
        ("xi_x", "xi_y", "m2", "x, y", "P3", lag_marginal),
    ],
    "wigner": [
        ("x", "y", "1", "nu_x, nu_y", "P6", _intensity),
        ("nu_x", "nu_y", "m4", "x, y", "P7", _power_spectrum),
    ],
    "ambiguity": [
        ("xi_x", "xi_y", "1", "upsilon_x, upsilon_y", "P10", _at_opposite_points),
        ("upsilon_x", "upsilon_y", "m4", "xi_x, xi_y", "P11", _spectrum_product),
    ],
}
# Tiles [m2] computed from the field: both coordinates, coordinates of integration, formula label,
# and function. {0} and {1} are replaced by x and y for one tile, and by y and x for a second tile.
_OF_FIELD: dict[str, list[tuple[str, str, str, str, Callable[..., Any]]]] = {
    "autocorrelation": [
        ("{0}", "xi_{0}", "{1}, xi_{1}", "P4", _shadow_product),
        ("{0}", "xi_{1}", "{1}, xi_{0}", "P5", _mirrored_overlap),
    ],
    "wigner": [
        ("{0}", "nu_{0}", "{1}, nu_{1}", "P8", _wigner_of_rows),
        ("{0}", "nu_{1}", "{1}, nu_{0}", "P9", _column_powers),
    ],
    "ambiguity": [
        ("upsilon_{0}", "xi_{0}", "upsilon_{1}, xi_{1}", "P12", _ambiguity_of_rows),
        ("upsilon_{1}", "xi_{0}", "upsilon_{0}, xi_{1}", "P13", _opposite_columns),
    ],
}


def _tiles_of(dimension: int, kind: str) -> dict[str, Tile]:
    """Return the tiles of a phase-space function, with their names as keys."""
    letter = _LETTERS[kind]
    if dimension == 1:
        first, second, units, function = _SLITS[kind]
        tiles = [Tile(first, second, units, letter, "P1", _of_slits(function))]
    else:
        tiles = [
            Tile(first, second, units, f"{letter} integrated over {over}", label, _on_grid(compute))
            for first, second, units, over, label, compute in _OF_POINTS[kind]
        ]
        for *texts, label, compute in _OF_FIELD[kind]:
            for axes in ("xy", "yx"):
                first, second, over = (text.format(*axes) for text in texts)
                values = _of_field(compute, is_transposed=axes == "yx")
                meaning = f"{letter} integrated over {over}"
                tiles.append(Tile(first, second, "m2", meaning, label, values))
    return {f"{tile.first}_{tile.second}": tile for tile in tiles}
