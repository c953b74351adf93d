"""Coherent apertures as light sources in Mitsuba 3.

Importing this module chooses the LLVM library for Dr.Jit (before Dr.Jit is loaded, because it can
be chosen only then) and makes the shape ``wigner`` and the sensor ``wigner_receiver`` known
to every Mitsuba variant. It never sets a variant.

- ``parameters``: what the shape accepts; ``given``: one by one; ``sources``: from memory
- ``shape``: the plugin; ``emitter``: the Wigner radiance; ``obliquity``; ``sampling``
- ``receiver``: the sensor, with its ``receiver_parameters`` and ``receiver_entry``
- ``plugins``: both made known to Mitsuba
- ``received_power``: what receivers get; ``direct_light`` by links and ``mirrors``;
  ``scattered`` light, while sources are ``unseen``; ``arrival_map`` for pictures
- ``scatterers``: lit scenes as clouds, by ``scattering_steps`` and ``scattering_events``;
  ``scatterer_files``; ``covariances`` of arrays that receive them
- ``range_profile``, ``range_frames``: by lengths of paths, with the integrators of ``transients``
  and ``range_film``
- ``exact``: exact irradiances in its place, for points that a source lights
- ``scenes``: loading scenes and choosing variants; ``rendering``: their images, with fog
- ``parts``: those of a picture; ``scene_renders``, ``scene_receptions``: scene files on this
  machine or a cluster, whose workers have ``sent_scenes``
- ``images``: on disk; ``logs``: what Mitsuba itself has to say
"""

from polywigner.toolchain import llvm

llvm.require_drjit()  # before the next imports, which load Dr.Jit

from polywigner.mitsuba.covariances import covariance, element_responses  # noqa: E402
from polywigner.mitsuba.obliquity import OBLIQUITIES  # noqa: E402
from polywigner.mitsuba.plugins import register  # noqa: E402
from polywigner.mitsuba.range_frames import range_frames  # noqa: E402
from polywigner.mitsuba.range_profile import range_profile  # noqa: E402
from polywigner.mitsuba.received import Contribution, DirectPath, ReceivedPower  # noqa: E402
from polywigner.mitsuba.received_power import received_power, received_powers  # noqa: E402
from polywigner.mitsuba.receiver import receiving  # noqa: E402
from polywigner.mitsuba.receiver_entry import receiver  # noqa: E402
from polywigner.mitsuba.rendering import render  # noqa: E402
from polywigner.mitsuba.scatterer_files import write_scatterers  # noqa: E402
from polywigner.mitsuba.scatterers import scatterers  # noqa: E402
from polywigner.mitsuba.scene_renders import render_file  # noqa: E402
from polywigner.mitsuba.scenes import (  # noqa: E402
    aperture,
    choose_variant,
    has_wigner_emitter,
    load_scene,
    translate_error,
)
from polywigner.mitsuba.sources import register_source  # noqa: E402

register()

__all__ = [
    "OBLIQUITIES",
    "Contribution",
    "DirectPath",
    "ReceivedPower",
    "aperture",
    "choose_variant",
    "covariance",
    "element_responses",
    "has_wigner_emitter",
    "load_scene",
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
    "translate_error",
    "write_scatterers",
]
