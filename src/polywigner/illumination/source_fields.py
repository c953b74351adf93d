"""Fields of sources, and positions and weights of arrays, from tables of source files.

The keys of a table are the parameters of the function that it names. Directions may be given as
angles, and wavelengths as frequencies, which the whole file may share.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import FileFormatError
from polywigner.illumination import arrays, tapers
from polywigner.illumination.lattices import checked_positions
from polywigner.illumination.source_values import (
    Around,
    Kind,
    Kinds,
    Positions,
    at,
    complex_numbers,
    coordinates,
    made,
    name_in,
    wavelength_in,
)
from polywigner.illumination.waves import Illumination

# Tapers or weights that are multiplied: some for either axis, and a steering.
_MOST_FACTORS = 20


def field_of(value: Any, around: Around) -> Illumination:
    """The field of a table, or the product of fields in a list of tables."""
    product: Illumination | None = None
    for factor in _factors(value, _FIELDS, around):
        # counted before they are multiplied
        around.count(waves=len(factor) * (1 if product is None else len(product)))
        product = factor if product is None else product * factor
    assert product is not None
    return product


def _factors(value: Any, kinds: Kinds, around: Around) -> Iterator[Any]:
    """The object of a table, or of each of a list of tables."""
    if not isinstance(value, list):
        yield _named(value, kinds, around)
        return
    if not 0 < len(value) <= _MOST_FACTORS:
        got = f"a list of {len(value)}" if value else "an empty list"
        raise FileFormatError(
            f"expected a table or a list of tables, at most {_MOST_FACTORS}, got {got}"
        )
    for k, item in enumerate(value):
        with at(f"number {k}"):
            factor = _named(item, kinds, around)
        yield factor


def _named(table: Any, kinds: Kinds, around: Around) -> Any:
    """The object of a table, with its kind in the place of errors."""
    with at(name_in(table, kinds)):
        return made(table, kinds, around)


def _direction(values: dict[str, Any], dimension: int) -> Any:
    """The direction, from itself or from the angles off the normal and around it."""
    if ("direction" in values) == ("theta" in values):
        got = "both" if "theta" in values else "neither"
        raise FileFormatError(f"expected a direction or the angle theta, got {got}")
    if "direction" in values:
        if "phi" in values:
            raise FileFormatError("expected phi with theta only, got it with a direction")
        return values["direction"]
    if dimension == 1 and "phi" in values:
        raise FileFormatError("expected no phi for slits, got one; theta may be negative")
    return tapers.direction_of(values["theta"], values.get("phi", 0.0))[:dimension]


def _wavelength(values: dict[str, Any], around: Around) -> float:
    found = wavelength_in(values, around.wavelength)
    if found is None:
        raise FileFormatError(
            'expected a frequency such as "77 GHz" or a wavelength, got none; give one here or at '
            "the top of the file"
        )
    return found


def _taper(function: Callable[..., Illumination]) -> Callable[[dict[str, Any], Around], Any]:
    return lambda values, around: function(**{"width": None, **values}, dimension=around.dimension)


def _series(values: dict[str, Any], around: Around) -> Illumination:
    with at("coefficients"):
        depth = 2 if "height" in values else 1
        values["coefficients"] = complex_numbers(values["coefficients"], depth)
    return tapers.fourier_taper(**values, dimension=around.dimension)


def _mode(values: dict[str, Any], around: Around) -> Illumination:
    if around.dimension == 1:
        raise FileFormatError("expected an aperture for a mode of a guide, got slits")
    return tapers.te_mode(**values)


_STEERING = "direction theta phi frequency wavelength"
_FIELDS: dict[str, Kind] = {
    "uniform": Kind(lambda v, around: tapers.uniform(around.dimension)),
    "steering": Kind(
        lambda v, around: tapers.steering(_direction(v, around.dimension), _wavelength(v, around)),
        "",
        _STEERING,
    ),
    "cosine_taper": Kind(_taper(tapers.cosine_taper), "", "width height power"),
    "taylor_taper": Kind(_taper(tapers.taylor_taper), "", "width height sll nbar"),
    "te_mode": Kind(_mode, "width height", "m n component"),
    "fourier_taper": Kind(_series, "width coefficients", "height"),
    "waves": Kind(lambda v, around: Illumination(**v), "amplitudes frequencies"),
}


def positions_of(value: Any, around: Around) -> Positions:
    """Positions (n, d) from a list, or from a table that names a layout."""
    if isinstance(value, dict):
        layout: Positions = _named(value, _LAYOUTS, around)
        return layout
    return Positions(checked_positions(coordinates(value), (around.dimension,)))


def _row(values: dict[str, Any], around: Around) -> Positions:
    count = values["count"]
    return Positions(arrays.grid_positions(count, 1, values["pitch"])[:, :1], (count,))


def _lattice(layout: Callable[..., Any]) -> Callable[[dict[str, Any], Around], Positions]:
    return lambda values, around: Positions(layout(**values), (values["nx"], values["ny"]))


_LAYOUTS: dict[str, Kind] = {
    "row": Kind(_row, "count pitch"),
    "grid": Kind(_lattice(arrays.grid_positions), "nx ny pitch_x", "pitch_y"),
    "triangular": Kind(_lattice(arrays.triangular_positions), "nx ny pitch_x", "pitch_y"),
    "rings": Kind(lambda v, around: Positions(arrays.ring_positions(**v)), "radii counts"),
}


def weights_of(value: Any, around: Around) -> Any:
    """Complex weights (n,) from a list of numbers, or the product of a table or several."""
    if isinstance(value, list) and not any(isinstance(item, dict) for item in value):
        return complex_numbers(value)
    return functools.reduce(operator.mul, _factors(value, _WEIGHTS, around))


def _window(values: dict[str, Any], around: Around) -> NDArray[np.float64]:
    assert around.positions is not None  # weights are read with positions only
    if around.positions.shape is None:
        raise FileFormatError(
            "expected positions of kind row, grid or triangular for the weights of a window, got "
            "others; give the weights as numbers"
        )
    return arrays.window_weights(around.positions.shape, **values)


def _steered(values: dict[str, Any], around: Around) -> NDArray[np.complex128]:
    assert around.positions is not None
    towards = _direction(values, around.dimension)
    return arrays.steering_weights(around.positions.places, towards, _wavelength(values, around))


def _focused(values: dict[str, Any], around: Around) -> NDArray[np.complex128]:
    assert around.positions is not None
    point = values["point"]
    return arrays.focusing_weights(around.positions.places, point, _wavelength(values, around))


_WEIGHTS: dict[str, Kind] = {
    "window": Kind(_window, "window", "sll nbar"),
    "steering": Kind(_steered, "", _STEERING),
    "focusing": Kind(_focused, "point", "frequency wavelength"),
}
