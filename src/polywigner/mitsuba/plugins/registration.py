"""The plugins made known to Mitsuba, their errors while a scene is loaded, and their entries."""

from __future__ import annotations

import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError, PolywignerError, SceneError
from polywigner.execution import uncompiled
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits, Wavefront, triangulate
from polywigner.geometry.arguments import takes_frequency
from polywigner.geometry.io.readers import read_triangles
from polywigner.mitsuba.plugins.emitter import emitter_class
from polywigner.mitsuba.plugins.parameters import (
    RECEIVER_ESTIMATOR,
    UNPOLARISED,
    SceneParameters,
    read_emitter,
    read_receiver,
    register_source,
    rigid_pose,
    values_of,
)
from polywigner.mitsuba.plugins.placement import cover, hide
from polywigner.mitsuba.plugins.polarisation import polarised_spec
from polywigner.mitsuba.plugins.sampling import SAMPLINGS
from polywigner.quantities import parse_frequency, parse_length, parse_noise, parse_power
from polywigner.reception.norms import NORMALISATIONS
from polywigner.source import Array
from polywigner.source.obliquities import DEFAULT
from polywigner.source.polarisation import checked_polarisation, polarisation_text

# Mitsuba wraps what a plugin raises into a RuntimeError with a traceback in its text. The errors
# themselves wait here until the scene's loader asks for them; loaders may run in parallel.
_recent_errors: deque[PolywignerError] = deque(maxlen=8)
# Each kernel is traced through all emitters and shapes alive, those that another thread is just
# making included: values would be wrong without a word.
_alone = threading.RLock()
_plugins: dict[tuple[str, str], Callable[[str, Any], Any]] = {}


@contextmanager
def exclusive() -> Iterator[None]:
    """Let no other thread load or render scenes by this package until the block ends.

    Mitsuba is not made for scenes that are loaded in one thread while another one renders. The
    functions of this package wait for each other; whoever calls Mitsuba itself in several threads
    (``mi.load_dict``, ``mi.render``) does so within this.

    >>> import polywigner.mitsuba as pm
    >>> with pm.exclusive():
    ...     pass  # scene = mi.load_dict(...)
    """
    with _alone:
        yield


one_at_a_time = exclusive()
"""Decorator of functions that wait until no other thread is at work on a scene."""


def add_plugin(kind: str, name: str, build: Callable[[str, Any], Any]) -> None:
    """A plugin for :func:`register`: ``build(variant, properties)`` makes one."""
    _plugins[kind, name] = build


def register() -> None:
    """Make the plugins known to every Mitsuba variant, those chosen later included."""
    mi.detail.add_variant_callback(_on_variant_change)
    if mi.variant() is not None:
        _on_variant_change(None, mi.variant())


def original_error(error: BaseException) -> PolywignerError | None:
    """The package's own error behind one that Mitsuba raised while loading, if there is one."""
    text = str(error)
    return next((own for own in reversed(_recent_errors) if str(own) in text), None)


def _on_variant_change(_old: str | None, new: str) -> None:
    # Mitsuba looks a plugin's kind up under scalar_rgb whatever the variant. Unknown there, two
    # equal shapes would count as one shared object and fail to load.
    for variant in ("scalar_rgb", new):
        for (kind, name), build in _plugins.items():
            register_one = getattr(getattr(mi, variant), f"register_{kind}")
            register_one(name, partial(_built, build, variant))


def _built(build: Callable[[str, Any], Any], variant: str, props: Any) -> Any:
    try:
        with uncompiled():
            return build(variant, props)
    except PolywignerError as error:
        _recent_errors.append(error)
        # Mitsuba puts the traceback before the message, where frames of this package are no help.
        raise error.with_traceback(None) from None


def nested_properties(name: str, props: Any) -> Any:
    """Properties of a plugin with the id and the nested objects of others."""
    inner = mi.Properties(name)
    inner.set_id(props.id())
    for key, value in dict(props.objects()).items():
        inner[key] = value
    return inner


PLUGIN_NAME, RECEIVER_NAME = "wigner", "wigner_receiver"


def _build(variant: str, props: Any) -> Any:
    """The mesh for the parameters of one ``wigner`` element."""
    spec = read_emitter(values_of(props))
    spec = polarised_spec(variant, spec, "wigner shape")
    m = getattr(mi, variant)
    vertices, triangles = triangulate(spec.centred.support)
    inner = nested_properties(PLUGIN_NAME, props)
    if not any(isinstance(value, m.BSDF) for _, value in props.objects()):
        inner["bsdf"] = mi.load_dict({"type": "null"})
    inner["emitter"] = emitter_class(variant)(spec, id=f"{props.id()}_emitter")
    mesh = m.Mesh(
        props.id() or PLUGIN_NAME,
        len(vertices),
        len(triangles),
        props=inner,
        has_vertex_texcoords=True,
    )
    centre = spec.centred.centre / spec.scene_unit
    cover(mesh, spec.centred.support, spec.pose, centre, spec.scene_unit)
    if not spec.visible:
        hide(mesh)
    return mesh


add_plugin("shape", PLUGIN_NAME, _build)


STL_NAME = "stl"


def _build_stl(variant: str, props: Any) -> Any:
    """The mesh of an STL file, whose numbers are units of the scene, with its faces flat."""
    given = SceneParameters(values_of(props), f"{STL_NAME} shape")
    given.check_names(("filename", "to_world"))
    path = str(mi.file_resolver().resolve(given.text("filename", None)))
    vertices, triangles = read_triangles(path, "m")
    matrix = np.eye(4)
    if "to_world" in given.values:
        matrix = np.array(given.values["to_world"].matrix, np.float64).reshape(4, 4)
    vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    if not (np.abs(vertices) <= np.finfo(np.float32).max).all() or not len(triangles):
        raise SceneError(f"expected finite triangles of {path}, got none or others; export it anew")
    if np.linalg.det(matrix[:3, :3]) < 0:  # outsides stay outsides in mirror images
        triangles = triangles[:, ::-1]
    inner = nested_properties(STL_NAME, props)
    mesh = getattr(mi, variant).Mesh(
        props.id() or STL_NAME, len(vertices), len(triangles), props=inner
    )
    params = mi.traverse(mesh)
    params["vertex_positions"] = vertices.ravel().tolist()
    params["faces"] = triangles.ravel().tolist()
    params.update()
    return mesh


add_plugin("shape", STL_NAME, _build_stl)


# ---- entries of dictionaries for ``mi.load_dict`` -----------------------------------------------

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
        entry["bsdf"] = dict(bsdf)
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
    own = _as_source(source)
    entry = {
        "type": kind,
        "source": register_source(own),
        "wavelength": parse_length(wavelength),
        "scene_unit": parse_length(scene_unit),
        **_pose_entry(to_world),
    }
    if isinstance(polarisation, str) and polarisation.strip().lower() == UNPOLARISED:
        entry["polarisation"] = UNPOLARISED
    elif polarisation is not None:
        entry["polarisation"] = polarisation_text(checked_polarisation(polarisation, own))
    return entry


def _as_source(given: Any) -> Any:
    """A source as it is; an Aperture of anything else. GeometryError for no outline."""
    kinds = Aperture | Array | Wavefront | PlacedAperture | Slits | Polyhedron
    return given if isinstance(given, kinds) else Aperture(given)


def _pose_entry(to_world: Any) -> dict[str, Any]:
    """The key ``to_world`` for a matrix or a transform of any variant; nothing for None."""
    if to_world is None:
        return {}
    pose = rigid_pose(getattr(to_world, "matrix", to_world))
    return {"to_world": mi.scalar_rgb.ScalarTransform4f(pose)}


def film_of(width: int, height: int) -> dict[str, Any]:
    """The entry of a film that a receiver can have."""
    return {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "pixel_format": "luminance",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }


def _film(film: Any) -> dict[str, Any]:
    """The entry of a film: as it is, or of so many pixels."""
    if isinstance(film, Mapping):
        return dict(film)
    pixels = np.array((1, 1) if film is None else film)
    if pixels.shape != (2,) or pixels.dtype.kind not in "iu" or pixels.min() < 1:
        raise ArgumentError(
            f"expected a film of (columns, rows), whole numbers from 1, got {film!r}; give a pair, "
            "or None for one pixel"
        )
    return film_of(*pixels.tolist())
