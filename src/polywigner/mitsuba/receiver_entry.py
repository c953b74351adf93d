"""A receiver as an entry of a scene's dictionary."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from typing import Any

import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import takes_frequency
from polywigner.illumination import Array
from polywigner.illumination.obliquities import DEFAULT
from polywigner.mitsuba.exact import check_estimator
from polywigner.mitsuba.given import as_source, pose_entry, register_source
from polywigner.mitsuba.parameters import check_range
from polywigner.mitsuba.parts import film_of
from polywigner.mitsuba.radiance import check_mixture, mixture_of
from polywigner.mitsuba.radiator import norm_of, radiator_of
from polywigner.mitsuba.receiver import RECEIVER_NAME
from polywigner.mitsuba.receiver_parameters import RECEIVER_ESTIMATORS
from polywigner.mitsuba.sampling import SAMPLINGS, check_sampling
from polywigner.quantities import parse_length, parse_noise
from polywigner.reception.norms import NORMALISATIONS, checked_normalise


@takes_frequency
def receiver(
    source: Aperture | Array | npt.ArrayLike,
    wavelength: float,
    to_world: Any = None,
    obliquity: str = DEFAULT,
    estimator: str = RECEIVER_ESTIMATORS[0],
    film: tuple[int, int] | Mapping[str, Any] | None = None,
    bandwidth: float | None = None,
    temperature: float | None = None,
    noise_figure: float | None = None,
    scene_unit: float = 1.0,
    sampling: str = SAMPLINGS[0],
    normalise: str = NORMALISATIONS[0],
) -> dict[str, Any]:
    """A coherent aperture or array that receives, as an entry of a dictionary for ``mi.load_dict``.

    Parameters
    ----------
    source: what it would radiate with, see :func:`polywigner.mitsuba.aperture`.
    wavelength: metres.
    to_world: rigid pose, as a (4, 4) matrix or a Mitsuba transform; the receiver lies in the plane
        z = 0 of its own frame and looks to +z. Default: none.
    obliquity: the diffraction integral that it would send by, and so receives by.
    estimator: ``exact``: rays weigh by the exact irradiance that the receiver would give to the
        surface they meet, never negative. ``wigner``: by its signed radiance; docs/receivers.md.
    film: None: one pixel, which reads the received power in W. (n, m): a map of n x m pixels over
        the direction cosines along the receiver's x and y, from -1 to 1, that adds up to the power.
        Or the entry of a film, with a box filter. The entry's ``sampler`` is ``multijitter``.
    bandwidth, temperature, noise_figure: of the noise of the receiver: Hz, K and dB, or texts such
        as "1 GHz", "290 K" and "3 dB". What is received is that of the one wavelength.
    scene_unit: metres in one unit of the scene, which is that of ``to_world``'s translation.
    sampling: density of positions with the estimator ``wigner``, see
        :func:`polywigner.mitsuba.aperture`.
    normalise: ``radiated``: its gain is the directivity, so that a sky of the radiance L gives
        lambda^2 L to any receiver. ``aperture``: received power counts as int |u|^2 does, less by
        the share of it that is evanescent; docs/receivers.md.

    The entry holds a key, see :func:`register_source`: load it in the process that made it. Render
    it with :func:`polywigner.mitsuba.render`, which hands the scene over to the estimator
    ``exact``.

    Raises
    ------
    ArgumentError, GeometryError, QuantityError, SceneError for an unusable argument.
    """
    length, unit = parse_length(wavelength), parse_length(scene_unit)
    given = as_source(source)
    coherent, mixture = mixture_of(given, length)
    radiator = radiator_of(coherent, obliquity)
    check_mixture(mixture, coherent, length, obliquity, estimator)
    check_estimator(estimator, radiator.source, length, obliquity, False, False)
    checked_normalise(normalise, SceneError)
    norm = norm_of(coherent, length, obliquity, mixture, normalise)
    check_range(radiator, length, 1.0, norm, unit)
    entry: dict[str, Any] = {
        "type": RECEIVER_NAME,
        "source": register_source(given),
        "wavelength": length,
        "obliquity": obliquity,
        "estimator": estimator,
        "sampling": check_sampling(sampling),
        "scene_unit": unit,
        "normalise": normalise,
        "film": _film(film),
        "sampler": {"type": "multijitter"},
    }
    noise = parse_noise(bandwidth, temperature, noise_figure)
    entry |= {name: value for name, value in noise.items() if value is not None}
    return entry | pose_entry(to_world)


def _film(film: Any) -> dict[str, Any]:
    """The entry of a film: as it is, or of so many pixels."""
    if isinstance(film, Mapping):
        if not isinstance(film.get("type"), str):
            raise SceneError(
                f"expected the film as a dictionary with its type, got {film!r}; give one such as "
                '{"type": "hdrfilm", "rfilter": {"type": "box"}}, or numbers of pixels'
            )
        return dict(film)
    return film_of(*_pixels((1, 1) if film is None else film))


def _pixels(film: Any) -> tuple[int, int]:
    try:
        width, height = map(operator.index, film)
    except (TypeError, ValueError):
        width, height = 0, 0
    if width < 1 or height < 1:
        raise ArgumentError(
            f"expected a film of (columns, rows), whole numbers from 1, got {film!r}; give a pair, "
            "or None for one pixel"
        )
    return width, height
