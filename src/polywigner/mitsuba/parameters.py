"""The parameters of the ``wigner`` shape, read from a scene and checked.

Their meaning is the table in ``docs/plugin.md``. What single precision, in which Mitsuba computes,
cannot hold is refused here: the picture would be black or not a number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import SceneError
from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.illumination.obliquities import DEFAULT
from polywigner.mitsuba.exact import ESTIMATORS, check_estimator
from polywigner.mitsuba.given import SOURCE_PARAMETERS, Given
from polywigner.mitsuba.radiance import PLAIN, Mixture, check_mixture, check_obliquity, mixture_of
from polywigner.mitsuba.radiator import Radiator, emitted_power, norm_of, radiator_of
from polywigner.mitsuba.sampling import SAMPLINGS, check_sampling
from polywigner.quantities import parse_frequency, parse_power

PARAMETERS = (
    *SOURCE_PARAMETERS,
    "power",
    "aperture_power",
    "obliquity",
    "estimator",
    "antithetic",
    "sampling",
    "control_variate",
    "scene_unit",
    "sampling_weight",
    "visible",
    "bandwidth",
)

# Decimal exponents of the normal numbers of single precision.
_SMALLEST = math.log10(np.finfo(np.float32).tiny)
_LARGEST = math.log10(np.finfo(np.float32).max)


@dataclass(frozen=True, eq=False)
class EmitterSpec:
    """All that the emitter of one ``wigner`` shape needs, in SI units."""

    radiator: Radiator
    wavelength: float
    power: float
    """Radiated, in W."""
    norm: float
    """Power in W that the field of the source radiates as it is."""
    pose: npt.NDArray[np.float64]
    """(4, 4), read-only; the translation in scene units."""
    obliquity: str = DEFAULT
    estimator: str = ESTIMATORS[0]
    scene_unit: float = 1.0
    """Metres."""
    sampling_weight: float = 1.0
    sampling: str = SAMPLINGS[0]
    control_variate: bool = False
    visible: bool = True
    """Whether rays meet its surface."""
    mixture: Mixture = PLAIN
    """Of its light."""

    @property
    def source(self) -> Aperture | Array:
        """The source that the scene asked for, in coherent light."""
        return self.radiator.source


def read_parameters(props: Any) -> EmitterSpec:
    """The checked parameters of a ``wigner`` shape from Mitsuba's ``Properties``.

    Raises
    ------
    SceneError for an unknown, missing, doubled or unusable parameter; the errors of
    :func:`polywigner.read_aperture` and :func:`polywigner.read_source` for a file, and those of
    tapers, steering and layouts for their texts.
    """
    given = Given.of(props, "wigner shape")
    _reject_nested(given.values)
    given.check_names(PARAMETERS)
    obliquity = check_obliquity(given.text("obliquity", DEFAULT))
    powers = [given.optional(name, parse_power) for name in ("power", "aperture_power")]
    wavelength = given.wavelength()
    scene_unit = given.scene_unit()
    antithetic = given.flag("antithetic", False)
    bandwidth = given.optional("bandwidth", parse_frequency)
    source, mixture = mixture_of(given.source(wavelength), wavelength, bandwidth)
    radiator = radiator_of(source, obliquity, antithetic)
    norm = norm_of(source, wavelength, obliquity, mixture)
    power = emitted_power(radiator, norm, *powers)
    check_range(radiator, wavelength, power, norm, scene_unit)
    varied = given.flag("control_variate", False)
    estimator = given.text("estimator", ESTIMATORS[0])
    check_estimator(estimator, radiator.source, wavelength, obliquity, antithetic, varied)
    check_mixture(mixture, source, wavelength, obliquity, estimator)
    return EmitterSpec(
        radiator=radiator,
        wavelength=wavelength,
        power=power,
        norm=norm,
        pose=given.pose(),
        obliquity=obliquity,
        estimator=estimator,
        scene_unit=scene_unit,
        sampling_weight=check_sampling_weight(given.values.get("sampling_weight", 1.0)),
        sampling=check_sampling(given.text("sampling", SAMPLINGS[0])),
        control_variate=varied,
        visible=given.flag("visible", True),
        mixture=mixture,
    )


def check_range(
    radiator: Radiator, wavelength: float, power: float, norm: float, scene_unit: float = 1.0
) -> None:
    """Raise SceneError where single precision cannot hold the emitter's numbers.

    `wavelength` and `scene_unit` in metres, `power` and `norm` in watts; none below zero.
    """
    # Logarithms, because the numbers themselves may leave double precision as well.
    energy, inverse_square = _exponent(norm), -2 * _exponent(wavelength)
    area_in_scene = _exponent(radiator.support.area) - 2 * _exponent(scene_unit)
    radiance = _exponent(power) + inverse_square
    _fits("wavelength", f"{wavelength:.6g} m", -inverse_square / 2, inverse_square)
    _fits("wavelength", f"{wavelength:.6g} m", inverse_square - energy)
    _fits("scene_unit", f"{scene_unit:.6g} m", area_in_scene)
    if power > 0:
        steps = (radiance, radiance - energy, radiance + area_in_scene)
        _fits("power", f"{power:.6g} W", _exponent(power), *steps)


def check_sampling_weight(value: Any) -> float:
    """The value as a float; SceneError unless it is a finite number of zero or more."""
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not number or not (value >= 0 and _exponent(value) < _LARGEST):
        raise SceneError(
            f"expected a finite sampling_weight of zero or more, got {value!r}; 1 is the default"
        )
    return float(value)


def check_flag(name: str, value: Any) -> bool:
    """The value as True or False; SceneError for anything else, such as the text "false"."""
    if not isinstance(value, bool | np.bool_):
        raise SceneError(f"expected {name} to be True or False, got {value!r}; give one of them")
    return bool(value)


def _exponent(value: Any) -> float:
    return math.log10(value) if value > 0 else -math.inf


def _fits(name: str, shown: str, *exponents: float) -> None:
    for exponent in exponents:
        if not _SMALLEST < exponent < _LARGEST:
            raise SceneError(
                f"expected a {name} that single precision can compute with, got {shown}, which "
                f"leads to numbers of the order 1e{exponent:+.0f}; check its unit"
            )


def _reject_nested(values: dict[str, Any]) -> None:
    for name, value in values.items():
        if isinstance(value, mi.Object) and type(value).__name__ in ("Emitter", "Sensor"):
            raise SceneError(
                f"expected no {type(value).__name__.lower()} inside a wigner shape, got "
                f"{name!r}; the shape brings its own emitter"
            )
