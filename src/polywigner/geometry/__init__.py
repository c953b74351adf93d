"""Apertures as polygons: regions, supports of their autocorrelations, shapes and files.

- ``aperture``: the immutable :class:`Aperture`, placed ones, unions and differences
- ``rings``, ``parts``: from raw vertices to valid, merged parts, and unions without cracks;
  ``exact``: predicates without rounding
- ``automean``: mutual support, lag and position slices; ``convex``: convex pieces, triangles and
  trapezoids
- ``slits``, ``polyhedron``: sources in one and three dimensions; ``faces``: their triangles and
  orientation; ``wavefront``: curved or partly
  coherent waves, and checks of a field
- ``arguments``: checks of numbers, arrays, wavelengths, poses and units; ``display``: sources in
  notebooks and on axes
- ``shapes``: catalogue; ``io``: files, a module for each format
"""

from polywigner.geometry import shapes
from polywigner.geometry.aperture import Aperture, PlacedAperture, triangulate
from polywigner.geometry.arguments import rigid_pose
from polywigner.geometry.automean import automean, lag_slice, position_slice
from polywigner.geometry.io.readers import read_aperture, read_polyhedron, read_sheets
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
    "read_sheets",
    "rigid_pose",
    "shapes",
    "triangulate",
]
