"""Projections of the four-dimensional phase-space functions onto pairs of coordinates."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, checked_engine
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import checked_choice, real_numbers
from polywigner.kernels import kernel_for
from polywigner.transforms.arguments import PhaseSpaceSource
from polywigner.transforms.tiles import Tile, tiles_of
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
        "method": tile.method,
        "exact": 1,
        "error": tile.error(source),
    }
    return labelled_array(values, (tile.first, tile.second), attrs)


def _axis(name: str, values: Values) -> xarray.Variable:
    units = "1/m" if name.startswith(("nu", "upsilon")) else "m"
    return labelled_array(values, (name,), {"units": units})


def _chosen(available: Mapping[str, Tile], names: Iterable[str] | None) -> list[Tile]:
    if names is None:
        return list(available.values())
    if not isinstance(names, Iterable):
        raise ArgumentError(f"expected names of tiles, got {type(names).__name__}")
    wanted = [names] if isinstance(names, str) else list(names)
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
            _count(name, counts.get(name, 129)),
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
        raise ArgumentError(f"expected {name} as finite numbers of shape (n,), got {values!r}")
    if len(array) > LARGEST_SAMPLES:
        raise ArgumentError(
            f"expected up to {LARGEST_SAMPLES} values of {name}, got {len(array)}; make several "
            "datasets of them"
        )
    return array


def _range(name: str, values: Any) -> tuple[float, float]:
    array = _given(f"the extent of {name}", values)
    if len(array) != 2 or not array[0] < array[1]:
        raise ArgumentError(f"expected the extent of {name} as (lowest, highest), got {values!r}")
    return float(array[0]), float(array[1])


def _count(name: str, value: Any) -> int:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or not 2 <= value <= LARGEST_SAMPLES:
        raise ArgumentError(
            f"expected from 2 to {LARGEST_SAMPLES} samples along {name}, got {value!r}"
        )
    return int(value)


def _default(source: PhaseSpaceSource, name: str) -> tuple[float, float]:
    low, high = _reach(source, vertical=name.endswith("y"))
    width = high - low
    if name.startswith(("nu", "upsilon")):
        return -_LOBES / width, _LOBES / width
    if name.startswith("xi"):
        return -_MARGIN * width, _MARGIN * width
    centre, half = low + width / 2, _MARGIN * width / 2
    return centre - half, centre + half


def _reach(source: PhaseSpaceSource, vertical: bool) -> tuple[float, float]:
    """From where to where the source reaches, along y or along x."""
    bounds = source.bounds
    first = 1 if vertical else 0
    return bounds[first], bounds[first + len(bounds) // 2]
