"""Readers of file formats for apertures and bodies.

- ``readers``: apertures and bodies from files; GeoJSON, WKT, CSV; ``meshes``: STL, PLY and OBJ
- ``outlines``: options of the caller, chords of curves, and polygons with holes from rings
- ``limits``: reading of bytes and text, with limits on their size
- ``svg``, ``dxf``: filled shapes of drawings; ``gds``, ``gerber``: layouts and boards
"""
