"""Run in a process of its own by ``readings``: a visitor's file to outlines."""

from __future__ import annotations

import sys
from typing import Any


def answer(asked: dict[str, Any]) -> dict[str, Any]:
    """Return outlines in units, or the error of the file."""
    sys.path.append(asked["package"])  # where the server found it
    import polywigner as pw
    from polywigner.errors import PolywignerError
    from polywigner.explorer.editing import rings_of_aperture
    from polywigner.explorer.state import State

    try:
        aperture = pw.read_aperture(asked["path"], unit=asked["unit"])
        rings = rings_of_aperture(aperture, asked["per_metre"])
        return {"rings": State(rings=rings).rings}  # its limits
    except PolywignerError as error:
        return {"error": str(error)}
