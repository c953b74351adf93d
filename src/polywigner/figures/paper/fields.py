"""Fields of the square by the methods that the paper compares, and by those that improve on it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from polywigner.errors import PolywignerWarning

__all__ = ["RAYS", "compared", "limits_known"]

RAYS: Mapping[str, Mapping[str, Any]] = {
    "paper": {"obliquity": "paper"},
    "matched": {"obliquity": "kirchhoff"},
    "third order": {"obliquity": "kirchhoff", "order": 3},
}
"""Wigner rays with the paper's obliquity, with that of Kirchhoff's integral, and to third order."""


def compared(place: Callable[..., Any], rays: tuple[str, ...], *others: str) -> Any:
    """Fields at a place by some of ``RAYS``, by other methods, and last by Kirchhoff's integral.

    Parameters
    ----------
    place : :func:`polywigner.line` and the like, with all but the method and the bar given.
    rays : names in ``RAYS``.
    others : methods.
    """
    with limits_known():
        found = place(method=(*others, "kirchhoff"), progress=False)
        for name in rays:
            found[name] = place(method="wigner", progress=False, **RAYS[name])["wigner"]
    return found[[*rays, *others, "kirchhoff"]]


@contextmanager
def limits_known() -> Iterator[None]:
    """No warnings of points too close for rays: figures show just where rays cease to hold."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PolywignerWarning)
        yield
