"""Integrators that keep the lengths of paths: those of mitransient, imported when asked for.

mitransient is written for one variant of Mitsuba, that of the moment when it is imported; here it
is imported anew for another one.
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

import mitsuba as mi

from polywigner.errors import EngineError, MissingExtraError, SceneError, install_command
from polywigner.mitsuba.rendering import depths_of
from polywigner.mitsuba.scenes import translate_error

__all__ = ["TRANSIENT_INTEGRATORS", "is_transient", "require_transients", "transient_integrator"]

_NAME = "mitransient"
_PATH, _VOLUME = "transient_path", "transient_prbvolpath"

TRANSIENT_INTEGRATORS = (_PATH, _VOLUME)
"""Plugins that sample receivers and cameras. ``transient_nlos_path`` needs a sensor of its own."""

_OWN = ("TransientPath", "TransientPRBVolpathIntegrator")

# The same light transport, by the class of the integrator without path lengths.
_COUNTERPARTS = {
    "PathIntegrator": _PATH,
    "DirectIntegrator": _PATH,
    "PRBIntegrator": _PATH,
    "BasicPRBIntegrator": _PATH,
    "VolumetricPathIntegrator": _VOLUME,
    "VolpathMisIntegratorImpl": _VOLUME,
    "PRBVolpathIntegrator": _VOLUME,
}
# Mitsuba's `direct` has no depth to tell: emitter, surface, receiver.
_DEPTH_OF_DIRECT = 2


def require_transients(variant: str | None = None) -> Any:
    """mitransient for the variant that is set, its plugins registered.

    ``variant``: set first, if given.

    Raises
    ------
    MissingExtraError without it; EngineError for a scalar variant, which it has no integrators for.
    """
    if variant is not None:
        mi.set_variant(variant)
    variant = mi.variant()
    if variant is None or variant.startswith("scalar"):
        raise EngineError(
            f"expected a compiled variant such as llvm_ad_mono, got {variant}: ranges need "
            "mitransient, which has no integrators for others; set one that compiles"
        )
    found = sys.modules.get(_NAME)
    if found is not None and _is_for_this_variant():
        return found
    if found is not None:
        for name in [name for name in sys.modules if name.split(".")[0] == _NAME]:
            del sys.modules[name]
    # an import of it chooses a variant for child processes too
    chosen = os.environ.get("MI_DEFAULT_VARIANT")
    try:
        return importlib.import_module(_NAME)
    except ImportError as error:
        raise MissingExtraError(
            f"expected mitransient to be installed, by which ranges are told, got none ({error}); "
            f"run {install_command('radar')}"
        ) from error
    finally:
        if chosen is None:
            os.environ.pop("MI_DEFAULT_VARIANT", None)


def _is_for_this_variant() -> bool:
    films = sys.modules.get(f"{_NAME}.films.transient_hdr_film")
    return films is not None and issubclass(films.TransientHDRFilm, mi.Film)


def is_transient(integrator: Any) -> bool:
    """Whether an integrator is one of mitransient."""
    return type(integrator).__module__.startswith(f"{_NAME}.")


def transient_integrator(integrator: Any, scene: Any, sensor: Any) -> Any:
    """The integrator that follows the same paths as this one and tells their lengths.

    ``integrator``: of Mitsuba, whose depths are taken over; or one of mitransient, as it is.

    Raises
    ------
    What :func:`require_transients` does; SceneError for a scene of another variant, an integrator
    without path lengths, lights that are infinitely far, and fog that mitransient cannot measure
    paths in.
    """
    require_transients()
    if not isinstance(scene, mi.Scene):
        raise SceneError(
            f"expected a scene of the variant that is set, {mi.variant()}, got one of another; set "
            "that one, or load the scene anew"
        )
    _check_lights(scene)
    found = _counterpart(integrator)
    if type(found).__name__ == _OWN[1]:
        _check_fog(scene, sensor)
    return found


def _check_lights(scene: Any) -> None:
    """SceneError for lights without a place: Mitsuba puts them on a sphere about the scene."""
    for emitter in scene.emitters():
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite):
            raise SceneError(
                "expected lights at places for ranges, got one that is infinitely far "
                f"({emitter.class_name()}); leave it out"
            )


def _check_fog(scene: Any, sensor: Any) -> None:
    """SceneError for fog around the sensor, which mitransient leaves out, and for uneven fog.

    It adds no length where it passes an imagined particle of uneven fog.
    """
    if sensor.get_medium() is not None:
        raise SceneError(
            "expected a sensor outside of fog for ranges, got one with a medium; take the medium "
            "out of the sensor, and set the bounds of the fog in front of it"
        )
    media = [
        medium
        for shape in scene.shapes()
        for medium in (shape.interior_medium(), shape.exterior_medium())
    ]
    if not all(medium is None or medium.is_homogeneous() for medium in media):
        raise SceneError(
            "expected even fog for ranges, got a heterogeneous medium, in which mitransient "
            "measures paths too short; use homogeneous ones"
        )


def _counterpart(integrator: Any) -> Any:
    if is_transient(integrator):
        _check_own(integrator)
        return integrator
    known = integrator.class_name()  # the same of all that are written in Python
    name = known if known in _COUNTERPARTS else type(integrator).__name__
    if name not in _COUNTERPARTS:
        raise SceneError(
            "expected an integrator whose paths have lengths, got "
            f"{name}; use path, direct, prb, volpath, volpathmis, prbvolpath or "
            f"{' or '.join(TRANSIENT_INTEGRATORS)}"
        )
    entry = {"type": _COUNTERPARTS[name], "hide_emitters": bool(integrator.hide_emitters)}
    if name == "DirectIntegrator":
        return _loaded({**entry, "max_depth": _DEPTH_OF_DIRECT})
    return _loaded({**entry, **depths_of(integrator)})


def _check_own(integrator: Any) -> None:
    name = type(integrator).__name__
    if name not in _OWN:
        raise SceneError(
            f"expected {' or '.join(TRANSIENT_INTEGRATORS)}, got {name} of mitransient; it needs a "
            "sensor of its own"
        )
    if integrator.camera_unwarp:
        raise SceneError(
            "expected whole lengths of paths, got camera_unwarp, which leaves the last way out; "
            "leave it out of the integrator"
        )


def _loaded(entry: dict[str, Any]) -> Any:
    try:
        return mi.load_dict(entry)
    except RuntimeError as error:
        raise translate_error(error) from None
