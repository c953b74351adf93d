"""Geometry: apertures, slits and polyhedra, their shapes, silhouettes and waves, and outline files.

- ``aperture``: the immutable :class:`Aperture`, in the plane or placed in space, its automean,
  lag and position slices; ``slits``: one-dimensional sources; ``shapes``: a catalogue of shapes
- ``rings``, ``parts``: conversion of raw vertices to valid, merged parts, and unions without cracks
- ``convex``: convex pieces, triangles and trapezoids
- ``polyhedron``: solid bodies, and the triangles and closed surfaces of polygonal faces
- ``silhouettes``: opaque bodies and plates, their contacts, and the edges of their shadows;
  ``contours``, ``hidden_parts``: the shadow edges of bodies that hide each other
- ``illumination``: fields as sums of plane waves; ``wavefront``: curved or partially coherent waves
- ``arguments``: checks of numbers, arrays, wavelengths, poses and units
- ``io``: file readers, one module for each format
"""

from polywigner.geometry import shapes
from polywigner.geometry.aperture import (
    Aperture,
    PlacedAperture,
    automean,
    lag_slice,
    position_slice,
    triangulate,
)
from polywigner.geometry.arguments import rigid_pose
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
