"""Fields on sources: sums of plane waves, and weights of the elements of coherent collections."""

from polywigner.illumination.array import Array, Element, phased_array
from polywigner.illumination.waves import Illumination

__all__ = ["Array", "Element", "Illumination", "phased_array"]
