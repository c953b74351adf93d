"""How a field is computed on a grid: the options of its builders, checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypedDict, get_args

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.execution import Engine, Precision, checked_engine, checked_precision
from polywigner.geometry.arguments import checked_wavelength
from polywigner.illumination.obliquities import DEFAULT, checked_obliquity
from polywigner.propagation.irradiances import checked_order, checked_tolerance
from polywigner.propagation.places import (
    METHODS,
    checked_amplitude_tolerance,
    checked_method,
    checked_name,
)
from polywigner.radiometry.bands import checked_bandwidth

__all__ = ["WITH_OBLIQUITY", "FieldOptions", "FieldSettings", "Quantity", "checked_settings"]

Quantity = Literal["irradiance", "amplitude", "phase"]

# The others have the obliquity of their own boundary condition.
WITH_OBLIQUITY = ("wigner", "fraunhofer")


class FieldOptions(TypedDict, total=False):
    """Options of :func:`plane` and its like beside source, place and wavelength."""

    method: str | Sequence[str]
    """"wigner" (default), or one of the methods of :func:`amplitude`, or several of them."""
    quantity: Quantity
    """"irradiance" (default); "amplitude" or "phase", which "wigner" does not have."""
    obliquity: str | None
    """Boundary condition of "wigner" and "fraunhofer": see :func:`irradiance`."""
    order: int
    """Order in the lag of "wigner": 1 or 3."""
    bandwidth: float | None
    """Of the light, in Hz; None: one wavelength. See :func:`irradiance`."""
    tolerance: float | None
    """None: that of :func:`irradiance` and :func:`amplitude`."""
    dtype: str
    """"float64" or "float32" to store values as; for amplitudes complex numbers of these."""
    precision: Precision
    """To compute with: see :func:`fourier`."""
    engine: Engine
    progress: bool | None
    """Whether to draw a bar; None: on a terminal."""


@dataclass(frozen=True)
class FieldSettings:
    """How a field is computed: all that a value depends on beside its source and place."""

    wavelength: float
    methods: tuple[str, ...]
    quantity: str
    obliquity: str | None
    order: int
    tolerance: float | None
    dtype: str
    precision: str | None
    engine: str
    bandwidth: float | None = None

    @property
    def stored(self) -> np.dtype[Any]:
        """The type of the values."""
        real = np.dtype(self.dtype)
        return np.result_type(real, np.complex64) if self.quantity == "amplitude" else real

    def of(self, method: str) -> dict[str, Any]:
        """The settings that matter for one method, as texts and numbers."""
        settings: dict[str, Any] = {"method": method, "quantity": self.quantity}
        if method in WITH_OBLIQUITY:
            settings["obliquity"] = self.obliquity or DEFAULT
        if method == "wigner":
            settings["order"] = self.order
        if self.tolerance is not None:
            settings |= {"tolerance": self.tolerance}
        if self.bandwidth is not None:
            settings |= {"bandwidth": self.bandwidth}
        return settings


def checked_settings(
    wavelength: Any, options: FieldOptions, dtype: str = "float64"
) -> FieldSettings:
    """The settings of options, with defaults for what is not said.

    Raises ArgumentError for names and numbers that there are not.
    """
    known = FieldOptions.__annotations__
    unknown = [name for name in options if name not in known]
    if unknown:
        raise ArgumentError(f"expected options among {', '.join(known)}, got {unknown[0]!r}")
    quantity = checked_name("quantity", options.get("quantity", "irradiance"), get_args(Quantity))
    stored = checked_name("dtype", options.get("dtype", dtype), ("float32", "float64"))
    order, tolerance = checked_order(options.get("order", 1)), options.get("tolerance")
    obliquity = options.get("obliquity")
    methods = _checked_methods(options.get("method", "wigner"), quantity)
    precision = checked_precision(options.get("precision"))
    if tolerance is not None:
        tolerance = checked_tolerance(tolerance)
        if methods != ("wigner",):  # now, rather than when the first method is done
            most = tolerance if quantity != "irradiance" else min(tolerance, 0.1)
            checked_amplitude_tolerance(most, precision != "single")
    length, bandwidth = checked_wavelength(wavelength), options.get("bandwidth")
    if bandwidth is not None:
        bandwidth = checked_bandwidth(bandwidth, length)
        if quantity != "irradiance":
            raise ArgumentError(
                f"expected light of one wavelength for the {quantity}, got a bandwidth of "
                f"{bandwidth:g} Hz; a band has an irradiance only"
            )
    return FieldSettings(
        length,
        methods,
        quantity,
        None if obliquity is None else checked_obliquity(obliquity, order),
        order,
        tolerance,
        stored,
        precision,
        checked_engine(options.get("engine", "auto")),
        bandwidth,
    )


def _checked_methods(method: Any, quantity: str) -> tuple[str, ...]:
    one = isinstance(method, str) or not isinstance(method, Sequence)
    methods = (method,) if one else tuple(method)
    if not methods or len(set(map(str, methods))) < len(methods):
        raise ArgumentError(f"expected one method, or several different ones, got {method!r}")
    for name in methods:
        if quantity != "irradiance" and name == "wigner":
            raise ArgumentError(
                f'expected a method with a phase for the {quantity}, got "wigner", which has '
                f"irradiances only; use one of {', '.join(METHODS)}"
            )
        checked_method(name, ("wigner", *METHODS))
    return methods
