"""Choices for arrays: which sum over elements stands for their pairs."""

from __future__ import annotations

from polywigner.plans.costs import LIMITS

__all__ = ["has_own_factor", "sums_over_lattice", "sums_over_places", "tabulates_products"]


def sums_over_lattice(elements: int) -> bool:
    """Whether W and A of so many elements on a lattice are sums over its midpoints or steps."""
    return elements >= LIMITS["least elements of a lattice"]


def sums_over_places(elements: int) -> bool:
    """Whether W and A of so many equal elements anywhere are sums over lists of pairs."""
    return elements >= LIMITS["least elements in lists of pairs"]


def tabulates_products(weights: int, factors: int | None) -> bool:
    """Whether sums of products of so many weights are looked up in a table.

    ``factors`` : amplitudes in all of the row and the column that the weights are a product of;
    None where they are none.
    """
    if factors is not None and factors <= LIMITS["most amplitudes of factors"]:
        return False
    return weights >= LIMITS["least weights in a table"]


def has_own_factor(sites: int) -> bool:
    """Whether the array factor of so many sites is found by rows and columns."""
    return sites >= LIMITS["least sites of an array factor by rows"]
