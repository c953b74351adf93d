"""File formats of apertures and bodies.

- ``readers``: files to apertures and bodies; ``meshes``: STL, PLY and OBJ; ``drawing``: options and
polygons
- ``limits``: a file's bytes or text within bounds; ``outlines``: rings to polygons with holes
- ``text``: GeoJSON, WKT, CSV; ``svg`` with ``svg_shapes``, ``dxf``: filled shapes of drawings
- ``gds``, ``gerber``: layouts and boards
- ``curves``: curves flattened to a tolerance
"""
