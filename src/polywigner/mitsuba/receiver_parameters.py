"""The parameters of the ``wigner_receiver`` sensor, read from a scene and checked.

Their meaning is the table in ``docs/receivers.md``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import SceneError
from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.illumination.obliquities import DEFAULT
from polywigner.mitsuba.exact import check_estimator
from polywigner.mitsuba.given import SOURCE_PARAMETERS, Given
from polywigner.mitsuba.parameters import check_range
from polywigner.mitsuba.radiance import PLAIN, Mixture, check_mixture, check_obliquity, mixture_of
from polywigner.mitsuba.radiator import Radiator, norm_of, radiator_of
from polywigner.mitsuba.sampling import SAMPLINGS, check_sampling
from polywigner.quantities import NOISE_PARSERS
from polywigner.reception.norms import NORMALISATIONS, checked_normalise

RECEIVER_ESTIMATORS = ("exact", "wigner")

_NESTED = ("Film", "Sampler", "Medium")

RECEIVER_PARAMETERS = (
    *SOURCE_PARAMETERS,
    "obliquity",
    "estimator",
    "sampling",
    "scene_unit",
    "normalise",
    *NOISE_PARSERS,
)


@dataclass(frozen=True, eq=False)
class ReceiverSpec:
    """All that a ``wigner_receiver`` needs, in SI units."""

    radiator: Radiator
    """Of the field that the receiver would send."""
    wavelength: float
    norm: float
    """Power in W of the field that it would send, by which received powers are divided."""
    pose: npt.NDArray[np.float64]
    """(4, 4), read-only; the translation in scene units."""
    scene_unit: float = 1.0
    """Metres."""
    obliquity: str = DEFAULT
    estimator: str = RECEIVER_ESTIMATORS[0]
    sampling: str = SAMPLINGS[0]
    """Of positions, with the estimator ``wigner``."""
    bandwidth: float | None = None
    """Hz, of the noise; what is received is that of the one wavelength."""
    temperature: float | None = None
    """K, of the noise at the input."""
    noise_figure: float | None = None
    """dB."""
    normalise: str = NORMALISATIONS[0]
    """Which power ``norm`` is: radiated, or int |u|^2."""
    mixture: Mixture = PLAIN
    """Of the waves that it would send, and so receives: its width of coherence."""

    @property
    def source(self) -> Aperture | Array:
        """The source that the scene asked for."""
        return self.radiator.source


def read_receiver(props: Any) -> ReceiverSpec:
    """The checked parameters of a ``wigner_receiver`` from Mitsuba's ``Properties``.

    Raises
    ------
    SceneError for an unknown, missing, doubled or unusable parameter, or a sensor without a film;
    the errors of :func:`polywigner.read_aperture` and :func:`polywigner.read_source` for a file,
    and those of tapers, steering and layouts for their texts.
    """
    given = Given.of(props, "wigner_receiver sensor")
    given.check_names(RECEIVER_PARAMETERS)
    _check_nested(given.values)
    _check_film(given.values)
    obliquity = check_obliquity(given.text("obliquity", DEFAULT))
    wavelength = given.wavelength()
    scene_unit = given.scene_unit()
    source, mixture = mixture_of(given.source(wavelength), wavelength)
    radiator = radiator_of(source, obliquity)
    normalise = checked_normalise(given.text("normalise", NORMALISATIONS[0]), SceneError)
    norm = norm_of(source, wavelength, obliquity, mixture, normalise)
    # of power 1 W: a received power is that of the scene
    check_range(radiator, wavelength, 1.0, norm, scene_unit)
    estimator = given.text("estimator", RECEIVER_ESTIMATORS[0])
    check_estimator(estimator, radiator.source, wavelength, obliquity, False, False)
    check_mixture(mixture, source, wavelength, obliquity, estimator)
    return ReceiverSpec(
        radiator=radiator,
        wavelength=wavelength,
        norm=norm,
        normalise=normalise,
        pose=given.pose(),
        scene_unit=scene_unit,
        obliquity=obliquity,
        estimator=estimator,
        sampling=check_sampling(given.text("sampling", SAMPLINGS[0])),
        mixture=mixture,
        **{name: given.optional(name, parse) for name, parse in NOISE_PARSERS.items()},
    )


def _check_film(values: dict[str, Any]) -> None:
    """SceneError without a film, in whose place Mitsuba takes one of 768 x 576 pixels.

    And for a film whose pixels share samples, which adds to a pixel what came from elsewhere.
    """
    films = [value for value in values.values() if isinstance(value, mi.Object) and _is_film(value)]
    if not films:
        raise SceneError(
            "expected a film in the wigner_receiver sensor, got none; give it one of 1 x 1 pixel, "
            'which reads the received power: <film type="hdrfilm"> with width 1, height 1 and '
            '<rfilter type="box"/>'
        )
    name = films[0].rfilter().class_name()
    if name != "BoxFilter":
        raise SceneError(
            f"expected a film with a box filter in the wigner_receiver sensor, got {name}; give "
            'the film <rfilter type="box"/>: other filters share samples among pixels'
        )
    _check_whole(films[0])


def _check_whole(film: Any) -> None:
    """SceneError for a film that is cropped: its pixels add up to a part of the power."""
    size, part = (tuple(int(n) for n in pair) for pair in (film.size(), film.crop_size()))
    if size != part:
        raise SceneError(
            f"expected the whole film of the wigner_receiver sensor, got {part[0]} x {part[1]} of "
            f"{size[0]} x {size[1]} pixels; leave its crop window out"
        )


def _check_nested(values: dict[str, Any]) -> None:
    """SceneError for anything nested but a film, a sampler and a medium."""
    variants = {"scalar_rgb", mi.variant() or "scalar_rgb"}
    known = tuple(getattr(getattr(mi, v), kind) for v in variants for kind in _NESTED)
    for name, value in values.items():
        if isinstance(value, mi.Object) and not isinstance(value, known):
            raise SceneError(
                f"expected a film, a sampler or a medium in the wigner_receiver sensor, got "
                f"{name!r}, a {value.class_name()}; leave it out"
            )


def _is_film(value: Any) -> bool:
    return hasattr(value, "rfilter") and hasattr(value, "crop_size")
