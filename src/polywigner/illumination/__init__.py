"""Fields on sources: weights of the elements of coherent collections."""

from polywigner.illumination.array import Array, Element

__all__ = ["Array", "Element"]
