"""Arrays with names: an xarray.Dataset where xarray is installed, else the part needed here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Labelled", "LabelledArray", "LabelledArrays", "labelled"]


class Labelled(Protocol):
    """The interface that :class:`LabelledArrays` and ``xarray.Dataset`` have in common.

    ``found[name]`` has ``values``, ``dims``, ``attrs``; so has a coordinate, ``found[dim]``.
    """

    @property
    def attrs(self) -> Any: ...

    @property
    def coords(self) -> Any: ...

    @property
    def data_vars(self) -> Any: ...

    def __getitem__(self, name: str) -> Any: ...

    def __contains__(self, name: object) -> bool: ...


@dataclass(frozen=True, eq=False)
class LabelledArray:
    """Read-only values with the names of their axes; ``attrs`` hold the unit and the rest."""

    values: NDArray[Any]
    dims: tuple[str, ...]
    attrs: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.values.setflags(write=False)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.values.shape

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype, copy=True if copy is None else copy)


@dataclass(frozen=True, eq=False)
class LabelledArrays(Mapping[str, LabelledArray]):
    """Named arrays on common axes; iterates over the arrays, looks up axes as well."""

    data_vars: Mapping[str, LabelledArray]
    coords: Mapping[str, LabelledArray]
    attrs: dict[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> LabelledArray:
        return self.data_vars[name] if name in self.data_vars else self.coords[name]

    def __contains__(self, name: object) -> bool:
        return name in self.data_vars or name in self.coords

    def __iter__(self) -> Iterator[str]:
        return iter(self.data_vars)

    def __len__(self) -> int:
        return len(self.data_vars)


def labelled(found: LabelledArrays) -> Labelled:
    """The arrays as an ``xarray.Dataset`` if xarray can be imported."""
    try:
        import xarray
    except ImportError:
        return found

    def entry(array: LabelledArray) -> tuple[Any, ...]:
        return array.dims, np.array(array.values), array.attrs

    dataset: Labelled = xarray.Dataset(
        {name: entry(array) for name, array in found.data_vars.items()},
        coords={name: entry(array) for name, array in found.coords.items()},
        attrs=found.attrs,
    )
    return dataset
