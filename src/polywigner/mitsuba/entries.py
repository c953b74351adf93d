"""Emitters and receivers as entries of a scene's dictionary."""

from __future__ import annotations

import operator
import warnings
from collections.abc import Mapping
from typing import Any

import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import takes_frequency
from polywigner.illumination import Array
from polywigner.illumination.obliquities import DEFAULT
from polywigner.illumination.polarisation import checked_polarisation, polarisation_text
from polywigner.mitsuba.films import film_of
from polywigner.mitsuba.parameters import (
    RECEIVER_ESTIMATOR,
    UNPOLARISED,
    as_source,
    pose_entry,
    read_emitter,
    read_receiver,
    register_source,
)
from polywigner.mitsuba.plugins import PLUGIN_NAME
from polywigner.mitsuba.receiver import RECEIVER_NAME
from polywigner.mitsuba.sampling import SAMPLINGS
from polywigner.quantities import parse_frequency, parse_length, parse_noise, parse_power
from polywigner.reception.norms import NORMALISATIONS

# Python's own, where NumPy's were given.
_EMITTER_FLAGS = ("diffraction", "antithetic", "control_variate", "visible", "sampling_weight")


@takes_frequency
def aperture(
    source: Aperture | Array | npt.ArrayLike,
    wavelength: float,
    to_world: Any = None,
    obliquity: str = DEFAULT,
    power: float | str | None = None,
    bsdf: Mapping[str, Any] | None = None,
    scene_unit: float = 1.0,
    sampling_weight: float = 1.0,
    antithetic: bool = False,
    sampling: str = SAMPLINGS[0],
    control_variate: bool = False,
    visible: bool = True,
    radiated_power: float | str | None = None,
    estimator: str = "wigner",
    bandwidth: float | str | None = None,
    aperture_power: float | str | None = None,
    diffraction: bool = False,
    polarisation: Any = None,
) -> dict[str, Any]:
    """A coherent aperture or array as an entry of a dictionary for ``mi.load_dict``.

    Parameters
    ----------
    source: an Aperture with its field, or what makes one; or an Array of apertures in the plane
        z = 0. Coordinates in metres.
    wavelength: metres.
    to_world: rigid pose, as a (4, 4) matrix or a Mitsuba transform; the aperture lies in the plane
        z = 0 of its own frame and radiates to +z. Default: none.
    obliquity: the diffraction integral whose |U|^2, times its own cosine, a surface receives:
        ``rayleigh-sommerfeld-1``, ``kirchhoff``, ``rayleigh-sommerfeld-2``; or ``paper``, the
        paper's radiance W/lambda^2.
    power: watts or a text such as "10 dBm", radiated through the hemisphere in front, as
        :func:`polywigner.radiated_power` counts it. Default: what the field radiates as it is,
        with |u|^2 in W/m^2.
    bsdf: entry of the surface that radiates. Default: ``null``, which light passes through, but
        not with ``direct``, ``path`` and ``prb`` when they sample a light behind: docs/plugin.md.
    scene_unit: metres in one unit of the scene and of ``to_world``'s translation. Use 1e-3 and
        millimetres when receivers stand within centimetres of the aperture.
    sampling_weight: relative number of samples spent on this source.
    antithetic: a sample of an array on a lattice stands for nine midpoints of elements, which
        cancel off its beams; clears noise beside steered beams, docs/plugin.md.
    sampling: density of samples in the region that radiates: ``uniform``; ``marginal``, in
        proportion to the position marginal; or ``root-marginal``, to its root. Unbiased all.
    control_variate: less noise on diffuse surfaces that see all of the source, bias where they see
        a part of it or gloss: docs/plugin.md.
    visible: False leaves the surface out: it lights the scene as before and stands in no other
        light, but no camera, mirror or irradiance meter sees it.
    aperture_power: in place of power, watts or a text: the integral of |u|^2 over the source, of
        which small sources radiate little; the rest is evanescent.
    radiated_power: the former name of power; deprecated.
    estimator: ``wigner``: points are lit by signed radiance from a random place of the source.
        ``exact``: by their exact irradiance |U|^2, to 1e-4 of its peak at any distance, with no
        noise where all of the source is seen; docs/plugin.md.
    bandwidth: of the light about its frequency, not of noise, in Hz or a text such as "4 GHz"; each
        sample is of one frequency of the band, docs/coherence.md. Default: one wavelength.
    diffraction: with the estimator ``exact``: shadows of the scene's opaque surfaces diffract, one
        edge at a time, as of black bodies; docs/shadows.md.
    polarisation: of the field, in Mitsuba's polarised variants: "x", "y", "right", "left", a slant
        from x towards y such as "45 deg", or a Jones vector (2,) along the source's x and y; of an
        array also one for each element, (n, 2) or a list; or "unpolarised". Default: "y";
        docs/polarised.md.

    The entry holds a key, see :func:`register_source`: load it in the process that made it. With a
    polarisation, loading it in a variant that is not polarised raises a SceneError.

    Raises
    ------
    ArgumentError, GeometryError, QuantityError, SceneError for an unusable argument.
    """
    entry = _entry(PLUGIN_NAME, source, wavelength, to_world, scene_unit, polarisation)
    entry |= {"obliquity": obliquity, "estimator": estimator, "sampling": sampling}
    entry |= {"diffraction": diffraction, "antithetic": antithetic, "visible": visible}
    entry |= {"control_variate": control_variate, "sampling_weight": sampling_weight}
    if radiated_power is not None:
        warnings.warn(
            "radiated_power is deprecated: power is the radiated power now; write power=",
            DeprecationWarning,
            stacklevel=3,
        )
        if power is not None:
            raise SceneError("expected power, got radiated_power as well; both are one number")
        power = radiated_power
    numbers = {"power": power, "aperture_power": aperture_power}
    entry |= {name: parse_power(value) for name, value in numbers.items() if value is not None}
    if bandwidth is not None:
        entry["bandwidth"] = parse_frequency(bandwidth)
    if bsdf is not None:
        entry["bsdf"] = _nested("bsdf", bsdf, '{"type": "diffuse"}')
    spec = read_emitter(entry)
    entry |= {name: getattr(spec, name) for name in _EMITTER_FLAGS}
    if entry.pop("aperture_power", None) is not None:
        entry["power"] = spec.power
    return entry


@takes_frequency
def receiver(
    source: Aperture | Array | npt.ArrayLike,
    wavelength: float,
    to_world: Any = None,
    obliquity: str = DEFAULT,
    estimator: str = RECEIVER_ESTIMATOR,
    film: tuple[int, int] | Mapping[str, Any] | None = None,
    bandwidth: float | None = None,
    temperature: float | None = None,
    noise_figure: float | None = None,
    scene_unit: float = 1.0,
    sampling: str = SAMPLINGS[0],
    normalise: str = NORMALISATIONS[0],
    diffraction: bool = False,
    polarisation: Any = None,
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
    diffraction: with the estimator ``exact``: light comes around the edges of the scene's opaque
        surfaces as well, by reciprocity; docs/shadows.md.
    polarisation: of the wave that it would send, as of :func:`polywigner.mitsuba.aperture`: it
        takes all of a matched wave, nothing of the crossed one, half of unpolarised light.
        "unpolarised": all waves alike. Default: "y"; docs/polarised.md.

    The entry holds a key, see :func:`register_source`: load it in the process that made it. Render
    it with :func:`polywigner.mitsuba.render`, which hands the scene over to the estimator
    ``exact``.

    Raises
    ------
    ArgumentError, GeometryError, QuantityError, SceneError for an unusable argument.
    """
    entry = _entry(RECEIVER_NAME, source, wavelength, to_world, scene_unit, polarisation)
    entry |= {"obliquity": obliquity, "estimator": estimator, "sampling": sampling}
    entry |= {"diffraction": diffraction, "normalise": normalise}
    entry |= {"film": _film(film), "sampler": {"type": "multijitter"}}
    noise = parse_noise(bandwidth, temperature, noise_figure)
    entry |= {name: value for name, value in noise.items() if value is not None}
    read_receiver(entry)
    return entry


def _entry(
    kind: str, source: Any, wavelength: Any, to_world: Any, scene_unit: Any, polarisation: Any
) -> dict[str, Any]:
    """Parameters of a source that are not given as they are."""
    own = as_source(source)
    entry = {
        "type": kind,
        "source": register_source(own),
        "wavelength": parse_length(wavelength),
        "scene_unit": parse_length(scene_unit),
        **pose_entry(to_world),
    }
    if isinstance(polarisation, str) and polarisation.strip().lower() == UNPOLARISED:
        entry["polarisation"] = UNPOLARISED
    elif polarisation is not None:
        entry["polarisation"] = polarisation_text(checked_polarisation(polarisation, own))
    return entry


def _film(film: Any) -> dict[str, Any]:
    """The entry of a film: as it is, or of so many pixels."""
    if isinstance(film, Mapping):
        return _nested("film", film, '{"type": "hdrfilm", "rfilter": {"type": "box"}}')
    return film_of(*_pixels((1, 1) if film is None else film))


def _nested(name: str, entry: Any, example: str) -> dict[str, Any]:
    if not isinstance(entry, Mapping) or not isinstance(entry.get("type"), str):
        raise SceneError(
            f"expected the {name} as a dictionary with its type, got {entry!r}; give one such as "
            f"{example}"
        )
    return dict(entry)


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
