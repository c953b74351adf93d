"""W and A by the program of docs/theory/short_program.md, from the code blocks of the page."""

import re
from pathlib import Path

import numpy as np

_PAGE = Path(__file__).parents[2] / "docs" / "theory" / "short_program.md"


def _run():
    names = {}
    for block in re.findall(r"^```python\n(.*?)^```", _PAGE.read_text("utf-8"), re.S | re.M):
        exec(block, names)  # code of this repository
    return names["wigner"], names["ambiguity"]


wigner, ambiguity = _run()


def rings_and_weights(source):
    """Return the rings and weights of an aperture or a plane array."""
    elements = getattr(source, "elements_in_plane", [source])
    weights = getattr(source, "weights", [1.0])
    pairs = [(ring, w) for e, w in zip(elements, weights, strict=True) for ring in e.rings]
    return [np.asarray(ring) for ring, _ in pairs], [weight for _, weight in pairs]
