"""Labelled arrays as figures read them: places, quantities and units, and methods to compare."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.figures.levels import checked_dataset
from polywigner.figures.style import floor_text, quantity_text
from polywigner.geometry.arguments import checked_choice
from polywigner.illumination.obliquities import OBLIQUITIES

Floats = NDArray[np.float64]

_EVEN = 1e-3
"""By how much of a step places may differ from even ones: single precision leaves 1e-5 on a hundred
wavelengths of a thousand samples, and a tenth of a pixel is not seen."""

# Fraction of the power that lies below the default floor of a figure.
_FAINT = 0.01

# Units as printed; files write W m-2.
_PRINTED = {"W m-2": "W/m²", "W0.5 m-1": "√W/m", "1": ""}


def even_axis(name: str, places: Floats) -> Floats:
    """The places themselves; ArgumentError unless they are at least two, rising in even steps."""
    if len(places) < 2:
        raise ArgumentError(
            f"expected at least two samples along {name} to draw, got {len(places)}"
        )
    steps = np.diff(places)
    step = (places[-1] - places[0]) / (len(places) - 1)
    if not (step > 0 and np.all(np.abs(steps - step) <= _EVEN * step)):
        raise ArgumentError(f"expected evenly spaced {name}, rising, got other places")
    return places


def peak_of(values: NDArray[Any], name: str) -> float:
    """The largest of real values; ArgumentError if that is not above zero."""
    peak = float(np.max(values))
    if not (peak > 0 and math.isfinite(peak)):
        raise ArgumentError(f"expected some {name} above zero, got {peak:g} at most")
    return peak


@dataclass(frozen=True, eq=False)
class Comparison:
    """One quantity by several methods at the same places, like a power: fields are squared.

    ``powers`` and ``labels`` are by the name of the variable, over ``dims``, the axes of more than
    one sample. 0 dB is ``zero``, the peak of the method ``against``. ``fields`` are the values as
    they were given, complex if ``is_field``.
    """

    fields: dict[str, NDArray[Any]]
    powers: dict[str, Floats]
    labels: dict[str, str]
    dims: tuple[str, ...]
    against: str
    zero: float
    quantity: str
    unit: str
    is_field: bool

    @staticmethod
    def of(found: Any, against: str | None) -> Comparison:
        """Read the variables of a dataset; 0 dB is the peak of ``against``, by default the last."""
        arrays = {
            str(name): array.squeeze()
            for name, array in checked_dataset(found, "found").data_vars.items()
        }
        if not arrays:
            raise ArgumentError("expected a field to draw, got a dataset without variables")
        first = next(iter(arrays.values()))
        quantity, unit = quantity_of(first), printed_unit(first)
        for name, array in arrays.items():
            if array.dims != first.dims or quantity_of(array) != quantity:
                raise ArgumentError(
                    f"expected fields of one quantity over the same axes, got {name!r}, another; "
                    "draw them one by one"
                )
        if against is not None:
            checked_choice(against, "against", list(arrays))
        against = list(arrays)[-1] if against is None else against
        fields = {name: np.asarray(array.values) for name, array in arrays.items()}
        is_field = np.iscomplexobj(fields[against])
        if is_field:
            quantity = f"|{quantity}|²"
            unit = {"√W/m": "W/m²", "": ""}.get(unit, f"({unit})²")
        powers = {name: np.abs(v) ** 2 if is_field else v for name, v in fields.items()}
        labels = {name: label_of(array, name) for name, array in arrays.items()}
        zero = peak_of(powers[against], quantity)
        dims = tuple(str(d) for d in first.dims)
        return Comparison(fields, powers, labels, dims, against, zero, quantity, unit, is_field)

    @property
    def zero_text(self) -> str:
        """The power of 0 dB with its unit."""
        return quantity_text(self.zero, self.unit)

    def level_text(self, floor_db: float) -> str:
        """Label of a bar of levels."""
        return f"{self.quantity}, dB relative to {self.zero_text}\n{floor_text(floor_db)}"

    @property
    def linear_text(self) -> str:
        """Label of an axis of values relative to 0 dB."""
        return f"{self.quantity} relative to {self.zero_text}"

    def default_floor_db(self) -> float:
        """Return the level in dB below which 1 % of the power lies, from -40 to -10.

        It is a multiple of 5 dB. Fresnel fringes then fill the colour scale, and so do sidelobes.
        """
        power = np.sort(np.maximum(self.powers[self.against], 0.0), axis=None)
        below = np.cumsum(power)
        level = power[int(np.searchsorted(below, _FAINT * below[-1]))]
        return float(np.clip(5.0 * math.floor(2.0 * math.log10(level / self.zero)), -40.0, -10.0))


def printed_unit(array: Any) -> str:
    """The unit of a labelled array, as it is printed."""
    unit = str(array.attrs.get("units", ""))
    return _PRINTED.get(unit, unit)


def quantity_of(array: Any) -> str:
    """The quantity of a variable: "irradiance" unless its attributes say something else."""
    return str(array.attrs.get("quantity", "irradiance"))


def label_of(array: Any, name: str) -> str:
    """Name of a method in a figure: ``Wigner, obliquity Kirchhoff``."""
    about = array.attrs
    method = str(about.get("method", name))
    label = _CALLED.get(method, name)
    if method == "wigner":
        obliquity = str(about.get("obliquity", ""))
        label += f", obliquity {_CALLED.get(obliquity, obliquity)}" if obliquity else ""
    return label


_CALLED = {"wigner": "Wigner", "fresnel": "Fresnel", "fraunhofer": "Fraunhofer"}
_CALLED |= {name: each.title for name, each in OBLIQUITIES.items()}
