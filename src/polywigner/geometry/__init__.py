"""Apertures as polygons: the region itself, what its autocorrelation spans, shapes and files.

- ``aperture``: the immutable :class:`Aperture`; ``triangulate`` for meshes
- ``outline_inputs``, ``rings``, ``parts``, ``weld``, ``winding``: from raw vertices to valid,
  merged parts; ``set_operations``: unions, intersections and differences of apertures
- ``convex``: convex cover and triangulation; ``exact``: predicates without rounding
- ``automean``: mutual support, lag and position slices; ``grid``: unions without cracks
- ``trapezoids``: uniform positions; ``display``: sources in notebooks and on axes
- ``slits``, ``polyhedron``, ``placed``, ``pose``: sources in one and three dimensions;
  ``wavefront``: with a curved or partly coherent wave
- ``array_types``: names of what arguments may be; ``plausibility``: questions about units
- ``shapes``: catalogue; ``readers``: files, by the ``formats``
"""

from polywigner.geometry import shapes
from polywigner.geometry.aperture import Aperture, triangulate
from polywigner.geometry.automean import automean, lag_slice, position_slice
from polywigner.geometry.placed import PlacedAperture
from polywigner.geometry.polyhedron import Polyhedron
from polywigner.geometry.pose import rigid_pose
from polywigner.geometry.readers import read_aperture, read_polyhedron
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
