"""Apertures as polygons: regions, supports of their autocorrelations, shapes and files.

- ``aperture``: the immutable :class:`Aperture`, placed ones, unions and differences
- ``rings``, ``parts``: from raw vertices to valid, merged parts; ``exact``: predicates without
  rounding; ``grid``: unions without cracks
- ``automean``: mutual support, lag and position slices; ``trapezoids``: uniform positions
- ``slits``, ``polyhedron``: sources in one and three dimensions; ``wavefront``: curved or partly
  coherent waves; ``field``: what all of them check of a field
- ``arguments``: checks of numbers, arrays, wavelengths, poses and units; ``display``: sources in
  notebooks and on axes
- ``shapes``: catalogue; ``readers``: files, by the ``formats``
"""

from polywigner.geometry import shapes
from polywigner.geometry.aperture import Aperture, PlacedAperture, triangulate
from polywigner.geometry.arguments import rigid_pose
from polywigner.geometry.automean import automean, lag_slice, position_slice
from polywigner.geometry.io.readers import read_aperture, read_polyhedron
from polywigner.geometry.polyhedron import Polyhedron
from polywigner.geometry.slits import Slits
from polywigner.geometry.wavefront import Wavefront

__all__ = [
    "Aperture",
    "PlacedAperture",
    "Polyhedron",
    "Slits",
    "Wavefront",
    "automean",
    "lag_slice",
    "position_slice",
    "read_aperture",
    "read_polyhedron",
    "rigid_pose",
    "shapes",
    "triangulate",
]
