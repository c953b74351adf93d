"""File formats of apertures and bodies.

- ``readers``: files to apertures and bodies; ``meshes``: STL, PLY and OBJ
- ``outlines``: options of the caller, and rings to polygons with holes
- ``limits``: a file's bytes or text within bounds; ``curves``: chords within a tolerance
- ``text``: GeoJSON, WKT, CSV; ``svg``, ``dxf``: filled shapes of drawings
- ``gds``, ``gerber``: layouts and boards
"""
