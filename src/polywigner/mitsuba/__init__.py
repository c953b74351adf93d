"""Coherent apertures as light sources in Mitsuba 3.

Importing this module chooses the LLVM library for Dr.Jit (before Dr.Jit is loaded, because it can
be chosen only then) and makes the shape ``wigner`` and the sensor ``wigner_receiver`` known
to every Mitsuba variant. It never sets a variant.

- ``parameters`` of scenes' elements, read and checked; ``sources``
- ``plugins``: the shape, and entries of dictionaries; ``emitter``: its light, by the estimators
  ``wigner`` or ``exact``; ``sampling`` of positions and directions; ``placement`` of meshes and
  sources
- ``receiver``: the sensor; ``polarisation`` of both in Mitsuba's polarised variants
- ``received_power``: watts of receivers (``received``); ``direct_light`` by links and
  ``reflectors`` (flat mirrors, conducting bodies), and of ``delta_lights``; ``scattered`` light;
  ``channels``: paths that interfere
- ``ray_transmission``: rays through a scene, with thin panes and fog; ``surfaces``: order, bounds
  and triangles of a scene's shapes, and ends of rays
- ``scatterers``: lit scenes as ``clouds``, by ``scattering_steps``
- ``range_profile``: by lengths of paths, with the integrators and the film of ``range_film``
- ``scenes``: loading scenes (``scene_files``) and choosing variants; ``rendering``: their images
- ``films``: parts of a picture, and pictures on disk; ``scene_renders``: scene files on this
  machine or a cluster
"""

from polywigner.toolchain import llvm

llvm.require_drjit()  # before the next imports, which load Dr.Jit

from polywigner.illumination import obliquities  # noqa: E402
from polywigner.mitsuba.channels import channel  # noqa: E402
from polywigner.mitsuba.clouds import covariance, element_responses, write_scatterers  # noqa: E402
from polywigner.mitsuba.parameters import register_source  # noqa: E402
from polywigner.mitsuba.plugins import aperture, exclusive, receiver, register  # noqa: E402
from polywigner.mitsuba.polarisation import stokes_of  # noqa: E402
from polywigner.mitsuba.range_profile import range_frames, range_profile  # noqa: E402
from polywigner.mitsuba.received import Contribution, DirectPath, ReceivedPower  # noqa: E402
from polywigner.mitsuba.received_power import received_power, received_powers  # noqa: E402
from polywigner.mitsuba.rendering import receiving, render  # noqa: E402
from polywigner.mitsuba.scatterers import scatterers  # noqa: E402
from polywigner.mitsuba.scene_renders import render_file  # noqa: E402
from polywigner.mitsuba.scenes import (  # noqa: E402
    choose_variant,
    has_wigner_emitter,
    load_scene,
    translate_error,
)

register()

OBLIQUITIES = tuple(obliquities.OBLIQUITIES)
"""Names of the diffraction integrals that scenes know."""

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
