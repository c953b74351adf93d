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

    def __getattr__(self, name: str) -> Any: ...


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

    def __getattr__(self, name: str) -> Any:
        return _looked_up(self, name, vars(self).get("attrs", {}))

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.attrs]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype, copy=True if copy is None else copy)


@dataclass(frozen=True, eq=False)
class LabelledArrays(Mapping[str, LabelledArray]):
    """Named arrays on common axes; iterates over the arrays, looks up axes as well.

    Arrays, axes and attributes whose names are free are attributes of the object too, as in xarray:
    ``found.directivity``.
    """

    data_vars: Mapping[str, LabelledArray]
    coords: Mapping[str, LabelledArray]
    attrs: dict[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> LabelledArray:
        return self.data_vars[name] if name in self.data_vars else self.coords[name]

    def __contains__(self, name: object) -> bool:
        return name in self.data_vars or name in self.coords

    def __getattr__(self, name: str) -> Any:
        # not self.attrs: an object that is being unpickled has none yet
        own = vars(self)
        places = (own.get(place, {}) for place in ("data_vars", "coords", "attrs"))
        return _looked_up(self, name, *places)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.data_vars, *self.coords, *self.attrs]

    def __iter__(self) -> Iterator[str]:
        return iter(self.data_vars)

    def __len__(self) -> int:
        return len(self.data_vars)


def _looked_up(owner: object, name: str, *places: Mapping[str, Any]) -> Any:
    for place in places:
        if name in place:
            return place[name]
    message = f"{type(owner).__name__!r} object has no attribute {name!r}"
    raise AttributeError(message, name=name, obj=owner)


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
