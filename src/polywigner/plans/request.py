"""A call to an engine, as numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace

__all__ = ["Outline", "Request"]


@dataclass(frozen=True)
class Outline:
    """Counts for a kernel that cuts the edges of one copy by those of another."""

    edges: int
    pieces: int
    """Convex pieces."""
    cuts: int
    """Pairs of an edge and a side of a piece, with the waves that count as further sides."""
    lines: int
    """Different lines of the sides."""
    exact: float = 0.0
    """The share of the lines whose cuts need twice the digits: nearly parallel ones."""
    waves: int = 1
    """Waves of the field on a cut edge: each takes as long as a uniform one."""
    copies: int = 1
    """Number of copies of the edges that are cut: 1 for W, 2 for A."""
    is_uniform: bool = True
    """Whether one compiled kernel serves all such sources."""
    allows_lists: bool = True
    """Whether slices can be listed once for many frequencies."""
    weighs_lags: bool = False
    """Whether lags have a weight, as in partly coherent light: an edge's term is a sum of nodes."""


@dataclass(frozen=True)
class Request:
    """A function of a source at some samples."""

    function: str
    samples: int
    outline: Outline | None = None
    """None where nothing is cut: then ``terms`` are summed."""
    terms: int = 1
    """Terms of a plain sum for each sample; of an array, pairs of copies near it."""
    is_array: bool = False
    """Whether the outline is that of an element of many copies."""
    rows: int = 0
    """Places, where each meets every one of ``columns`` frequencies; 0 where samples are points."""
    columns: int = 0
    families: int | None = None
    """Families of parallel edges, where frequencies are a grid that they can be computed on."""
    double: bool = True
    engine: str = "auto"
    compiles: bool = True
    """Whether kernels can be compiled here."""
    takes_data: bool = False
    """Whether there is a kernel that takes any source of this kind as data."""

    def times(self, count: int) -> Request:
        """The same with so many times the samples, at as many places where these are rows."""
        return replace(self, samples=count * self.samples, columns=count * self.columns)
