"""File formats of apertures and bodies.

- ``content``: a file's bytes or text, within bounds; ``drawing``: what a reader hands over
- ``geojson``, ``simple_text`` (WKT, CSV): polygons as text
- ``svg``, ``svg_style``, ``svg_values``: filled shapes of SVG
- ``dxf``, ``dxf_entities``, ``chains``: outlines of DXF, and loose lines joined
- ``gds``, ``gds_process``: polygons of GDSII, read in a process of its own
- ``layers``: those of a drawing that are asked for
- ``curves``: curves flattened to a tolerance; ``outlines``: rings to polygons with holes
- ``work``: pairs of edges and outlines counted, before GEOS compares them
- ``meshes``: STL, PLY and OBJ
"""
