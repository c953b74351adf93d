"""W and A by the program of docs/theory/short_program.md, whose code blocks are run as they are."""

import re
from pathlib import Path

import numpy as np

_PAGE = Path(__file__).parents[2] / "docs" / "theory" / "short_program.md"


def _run():
    names = {}
    for block in re.findall(r"^```python\n(.*?)^```", _PAGE.read_text("utf-8"), re.S | re.M):
        exec(block, names)  # our own page
    return names["wigner"], names["ambiguity"]


wigner, ambiguity = _run()


def rings_and_weights(source):
    """The rings of an aperture or of an array of apertures in the plane, and their weights."""
    elements = getattr(source, "elements_in_plane", [source])
    weights = getattr(source, "weights", [1.0])
    pairs = [(ring, w) for e, w in zip(elements, weights, strict=True) for ring in e.rings]
    return [np.asarray(ring) for ring, _ in pairs], [weight for _, weight in pairs]
