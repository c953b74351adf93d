"""Methods as commands are given them, and how far they turn out to be apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from polywigner.cli.where import shown
from polywigner.errors import ArgumentError

__all__ = ["MethodText", "compared_with", "parse_methods", "print_differences"]

_ORDERS = {"1": 1, "3": 3}


class MethodText(NamedTuple):
    """A method with its settings; ``name`` tells it from the others of a run."""

    name: str
    method: str
    obliquity: str | None
    order: int

    @property
    def options(self) -> dict[str, Any]:
        """The argument that :func:`polywigner.line` and its like take for it."""
        if self.method != "wigner":
            return {"method": self.method}
        return {"method": self.method, "obliquity": self.obliquity, "order": self.order}


def parse_methods(
    texts: Sequence[str], obliquity: str | None, order: int
) -> tuple[MethodText, ...]:
    """Methods, of wigner rays perhaps with an obliquity and an order: ``"wigner kirchhoff 3"``.

    Parameters
    ----------
    texts : one or several.
    obliquity, order : of rays where a text says none.

    Raises
    ------
    ArgumentError for other names, and for one method twice.
    """
    from polywigner.illumination.obliquities import OBLIQUITIES
    from polywigner.propagation import METHODS

    known = ("wigner", *METHODS)
    methods = tuple(_method(text, known, tuple(OBLIQUITIES), obliquity, order) for text in texts)
    names = [method.name for method in methods]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ArgumentError(f"--method: expected different methods, got {twice[0]!r} twice")
    return methods


def _method(
    text: str, methods: Sequence[str], obliquities: Sequence[str], obliquity: str | None, order: int
) -> MethodText:
    words = text.split()
    method = words[0] if words else ""
    if method not in methods:
        raise ArgumentError(f"--method: expected one of {', '.join(methods)}, got {shown(text)}")
    for word in words[1:]:
        if method != "wigner" or word not in (*obliquities, *_ORDERS):
            raise ArgumentError(
                "--method: expected words after wigner only, an obliquity "
                f"({', '.join(obliquities)}) or an order (1, 3), got {shown(text)}"
            )
        if word in _ORDERS:
            order = _ORDERS[word]
        else:
            obliquity = word
    return MethodText("-".join(words), method, obliquity, order)


def compared_with(wanted: Sequence[MethodText], against: str | None) -> str:
    """The name of the method that the others are compared with: by default the last exact one.

    Raises
    ------
    ArgumentError for one that is not among them.
    """
    names = [method.name for method in wanted]
    if against is not None:
        name = "-".join(against.split())
        if name not in names:
            raise ArgumentError(
                f"--against: expected one of the methods, {', '.join(names)}, got {against!r}"
            )
        return name
    exact = [m.name for m in wanted if m.method not in ("wigner", "fresnel", "fraunhofer")]
    return (exact or names)[-1]


def print_differences(fields: Mapping[str, Any], reference: str) -> None:
    """One line for each method, of its largest and its rms difference from the reference.

    ``fields`` : name -> xarray.DataArray, all over the same points; lazy ones are read by chunks.
    """
    from polywigner.figures.differences import COMPARED_DB, summary

    print(f"Differences from {reference}, where it is above {COMPARED_DB:g} dB of its peak, in dB:")
    width = max(len(name) for name in fields)
    print(f"  {'method':{width}}  largest      rms  points")
    for name, field in fields.items():
        if name == reference:
            continue
        apart = summary(field, fields[reference])
        left = f", {apart.negative} not above zero left out" if apart.negative else ""
        print(
            f"  {name:{width}}  {apart.largest:+7.3f}  {apart.rms:7.4f}  "
            f"{apart.points} of {field.size}{left}"
        )
