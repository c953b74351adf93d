"""Readers of file formats for apertures and bodies.

- ``readers``: files to apertures and bodies; GeoJSON, WKT, CSV; ``meshes``: STL, PLY and OBJ
- ``outlines``: options of the caller, chords of curves, and rings to polygons with holes
- ``limits``: a file's bytes or text, of limited size
- ``svg``, ``dxf``: filled shapes of drawings; ``gds``, ``gerber``: layouts and boards
"""
