"""Source files: apertures with their fields, and arrays, in TOML or JSON.

- ``reading``, ``writing``: :func:`read_source`, :func:`write_source`
- ``tables``: sources and their outlines; ``fields``: fields on them, numbers and texts
"""

from polywigner.illumination.files.reading import Source, read_source
from polywigner.illumination.files.writing import write_source

__all__ = ["Source", "read_source", "write_source"]
