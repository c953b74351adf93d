"""The copper of one layer of a board in Gerber (RS-274X), as gerbonara reads it."""

from __future__ import annotations

from polywigner.errors import FileFormatError
from polywigner.geometry.formats import gerber_process
from polywigner.geometry.formats.content import text_of
from polywigner.geometry.formats.drawing import Drawing, required
from polywigner.geometry.formats.gerber_layers import composed
from polywigner.geometry.formats.gerber_shapes import Shapes
from polywigner.geometry.formats.gerber_statements import checked_statements
from polywigner.geometry.formats.limits import LARGEST_GERBER, MOST_CURVES
from polywigner.geometry.formats.processes import in_process
from polywigner.geometry.formats.work import Work
from polywigner.geometry.grid import polygons_in
from polywigner.geometry.rings import rings_of_polygon

__all__ = ["read_gerber"]

_METRES = {"MM": 1e-3, "IN": 25.4e-3}
_REMEDIES = ("export a smaller part", "export it anew, or as DXF")


def read_gerber(content: bytes, tolerance: float | None) -> Drawing:
    """What is copper after all objects: dark ones add, clear ones cut, in the order of the file.

    `tolerance` in metres. Raises FileFormatError, MissingExtraError.
    """
    if len(content) > LARGEST_GERBER:
        raise FileFormatError(
            f"expected at most {LARGEST_GERBER >> 20} MiB of Gerber, got more; export one layer, "
            "or a part of it"
        )
    text, unit = checked_statements(text_of(content))
    required("gerbonara.rs274x", "Gerber")
    asked = {"text": text, "most": MOST_CURVES}
    found = in_process(gerber_process, asked, "Gerber", "gerbonara", _REMEDIES)
    metres = _METRES.get(unit, 1e-3)
    work = Work()
    shapes = Shapes(found["apertures"], None if tolerance is None else tolerance / metres, work)
    copper = composed([layer for told in found["objects"] for layer in shapes.of(told)], work)
    polygons = [rings_of_polygon(polygon) for polygon in polygons_in(copper)]
    if not polygons:
        raise FileFormatError(
            "expected copper (regions, flashes or strokes that are dark), got none; give another "
            "layer of the board"
        )
    return Drawing(polygons, metres)
