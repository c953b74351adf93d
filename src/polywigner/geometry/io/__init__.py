"""Readers of file formats for apertures and bodies.

- ``readers``: files to apertures and bodies; GeoJSON, WKT, CSV; ``meshes``: STL, PLY and OBJ
- ``outlines``: options of the caller, and rings to polygons with holes
- ``limits``: a file's bytes or text, of limited size; ``curves``: chords within a tolerance
- ``svg``, ``dxf``: filled shapes of drawings; ``gds``, ``gerber``: layouts and boards
"""
