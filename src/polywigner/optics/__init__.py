"""First-order optics: systems that act on rays of light by a symplectic matrix."""

from __future__ import annotations

from polywigner.optics.first_order import FirstOrder

__all__ = ["FirstOrder"]
