"""Coherent apertures as light sources in Mitsuba 3.

Importing this module selects the LLVM library of Dr.Jit, which is possible only before Dr.Jit is
loaded. The import also registers the shape ``wigner`` and the sensor ``wigner_receiver`` for all
variants of Mitsuba. It does not set a variant.

- ``plugins``: the emitter shape and the receiver sensor, with their parameters and estimators
- ``scenes``: scene files, the surfaces and flat mirrors of a scene, and image rendering
- ``receive``: received power and complex channels, along direct, specular and scattered paths
- ``radar``: received power by range, clouds of scatterers, and radar data cubes
"""

from polywigner import llvm

llvm.require_drjit()  # The LLVM library must be chosen before the next imports, which load Dr.Jit.

from polywigner.mitsuba.plugins.emitter import aperture  # noqa: E402
from polywigner.mitsuba.plugins.polariser import stokes_of  # noqa: E402
from polywigner.mitsuba.plugins.receiver import receiver  # noqa: E402
from polywigner.mitsuba.plugins.registration import (  # noqa: E402
    exclusive,
    register,
    register_source,
)
from polywigner.mitsuba.radar.clouds import covariance, element_responses, write_scatterers  # noqa: E402
from polywigner.mitsuba.radar.radar_cubes import radar_cube  # noqa: E402
from polywigner.mitsuba.radar.range_profile import range_frames, range_profile  # noqa: E402
from polywigner.mitsuba.radar.scatterers import scatterers  # noqa: E402
from polywigner.mitsuba.receive.channels import channel  # noqa: E402
from polywigner.mitsuba.receive.power_results import Contribution, DirectPath, ReceivedPower  # noqa: E402
from polywigner.mitsuba.receive.received_power import received_power, received_powers  # noqa: E402
from polywigner.mitsuba.scenes.rendering import receiving, render  # noqa: E402
from polywigner.mitsuba.scenes.scene_renders import render_file  # noqa: E402
from polywigner.mitsuba.scenes.scenes import (  # noqa: E402
    choose_variant,
    has_wigner_emitter,
    load_scene,
    translate_error,
)
from polywigner.source import obliquities  # noqa: E402

register()

OBLIQUITIES = tuple(obliquities.OBLIQUITIES)
"""Names of the diffraction integrals for sources in scenes."""

__all__ = [
    "OBLIQUITIES",
    "Contribution",
    "DirectPath",
    "ReceivedPower",
    "aperture",
    "channel",
    "choose_variant",
    "covariance",
    "element_responses",
    "exclusive",
    "has_wigner_emitter",
    "load_scene",
    "radar_cube",
    "range_frames",
    "range_profile",
    "received_power",
    "received_powers",
    "receiver",
    "receiving",
    "register_source",
    "render",
    "render_file",
    "scatterers",
    "stokes_of",
    "translate_error",
    "write_scatterers",
]
