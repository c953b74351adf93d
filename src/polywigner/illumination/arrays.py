"""Layouts and weights of arrays of equal elements, for :func:`polywigner.phased_array`.

- where: ``grid_positions``, ``triangular_positions``, ``ring_positions``, ``thinned``
- how strong: ``window_weights``
- in which phase: ``steering_weights``, ``focusing_weights``
"""

from polywigner.illumination.layouts import (
    grid_positions,
    ring_positions,
    thinned,
    triangular_positions,
)
from polywigner.illumination.weights import focusing_weights, steering_weights, window_weights

__all__ = [
    "focusing_weights",
    "grid_positions",
    "ring_positions",
    "steering_weights",
    "thinned",
    "triangular_positions",
    "window_weights",
]
