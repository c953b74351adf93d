"""File formats of apertures and bodies.

- ``limits``: a file's bytes or text within bounds; libraries in a process of their own
- ``texts``: GeoJSON, WKT, CSV; ``svg`` with ``svg_shapes``, ``dxf``: filled shapes of drawings
- ``gds``, ``gerber`` with ``gerber_statements``: layouts and boards; ``meshes``: STL, PLY and OBJ
- ``curves``: curves flattened to a tolerance; ``outlines``: rings to polygons with holes, layers
"""
