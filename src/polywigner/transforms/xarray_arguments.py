"""``xarray.DataArray`` in, ``xarray.DataArray`` out, at the edge of the public functions.

The last dimension of such an argument holds the components, under any name. All others are
broadcast by name and kept, with their coordinates. Chunked arguments stay lazy. Everything else
that a caller may give passes through, and xarray is not imported here: whoever has a DataArray
has imported it.
"""

from __future__ import annotations

import functools
import inspect
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from polywigner.errors import ArgumentError
from polywigner.execution import Differentiable, is_drjit, kernel_threads
from polywigner.geometry import Polyhedron, Slits, Wavefront
from polywigner.source import Array


def labelled_array(
    values: ArrayLike, dims: Sequence[str], attrs: Mapping[str, Any] | None = None
) -> xarray.Variable:
    """Return values with the names of their axes; ``attrs`` hold the unit and the rest."""
    import xarray

    return xarray.Variable(tuple(dims), values, dict(attrs or {}))


def labelled_arrays(
    data_vars: Mapping[str, Any],
    coords: Mapping[str, Any],
    attrs: Mapping[str, Any] | None = None,
) -> xarray.Dataset:
    """Return arrays on common axes under their names."""
    import xarray

    return xarray.Dataset(dict(data_vars), coords=dict(coords), attrs=dict(attrs or {}))


if TYPE_CHECKING:
    import xarray

F = TypeVar("F", bound=Callable[..., Any])
Arguments = dict[str, Any]
Units = str | Callable[[Arguments], str]


def content_units(arguments: Mapping[str, Any]) -> str:
    """Unit of the source's length, area or volume, which its transforms have as well."""
    source = arguments["source"]
    source = source.source if isinstance(source, Wavefront) else source
    while isinstance(source, Array):
        source = source.elements[0]
    return {Slits: "m", Polyhedron: "m3"}.get(type(source), "m2")


def takes_xarray(
    *names: str, units: Units, long_name: str, components: Mapping[str, Sequence[str]] | None = None
) -> Callable[[F], F]:
    """A decorator: the arguments of these names may be DataArrays, and the result is one then.

    ``units``, ``long_name``: attributes of the result; the unit may depend on the arguments.
    ``components``: dimension and coordinate of results that are vectors. A function with
    ``return_error=True`` returns a pair.
    """

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def wrapper(*args: Any, **kwargs: Any) -> Any:
            kind = getattr(sys.modules.get("xarray"), "DataArray", None)
            if kind is None or not any(isinstance(v, kind) for v in (*args, *kwargs.values())):
                return function(*args, **kwargs)
            arguments = inspect.signature(function).bind(*args, **kwargs).arguments
            points = {name: arguments.pop(name) for name in names}
            if not any(isinstance(value, kind) for value in points.values()):
                return function(*args, **kwargs)
            call = _Call(function.__module__, function.__name__, names, arguments)
            unit = units if isinstance(units, str) else units(arguments)
            attrs = {"units": unit, "long_name": long_name}
            return _labelled(call, points, attrs, dict(components or {}))

        return wrapper  # type: ignore[return-value]

    return decorate


@dataclass(frozen=True, eq=False)
class _Call:
    """A public function with all but its points; goes to other processes as it is."""

    module: str
    name: str
    points: tuple[str, ...]
    others: Arguments
    is_lazy: bool = False

    def __call__(self, *values: Any) -> Any:
        function = getattr(import_module(self.module), self.name)
        # Dask calls from several threads, Dr.Jit has one pool of them.
        alone = self.is_lazy and self.others.get("engine") != "numpy"
        with kernel_threads() if alone else nullcontext():
            return function(**self.others, **dict(zip(self.points, values, strict=True)))


def _labelled(
    call: _Call, points: Arguments, attrs: dict[str, str], components: dict[str, Sequence[str]]
) -> Any:
    xarray = sys.modules["xarray"]
    if isinstance(call.others.get("source"), Differentiable):
        raise ArgumentError(
            f"expected {' and '.join(points)} as NumPy or Dr.Jit arrays for a differentiable "
            "source, got an xarray.DataArray; use its .values"
        )
    prepared = [_prepared(name, value, xarray.DataArray) for name, value in points.items()]
    named = [value for value in prepared if isinstance(value, xarray.DataArray)]
    try:
        xarray.align(*named, join="exact", copy=False)
    except ValueError as error:
        reason = str(error).partition("\n")[0]
        raise ArgumentError(
            f"expected {' and '.join(points)} of equal coordinates along the dimensions that they "
            f"share, got others ({reason}); rename a dimension, or use xarray.align"
        ) from None
    count = 2 if call.others.get("return_error") else 1
    lazily: dict[str, Any] = {}
    if any(value.chunks is not None for value in named):
        sizes = {name: len(labels) for name, labels in components.items()}
        lazily = {
            "dask": "parallelized",
            "output_dtypes": _dtypes_of(call, prepared),
            "dask_gufunc_kwargs": {"output_sizes": sizes},
        }
        call = _Call(call.module, call.name, call.points, call.others, is_lazy=True)
    found = xarray.apply_ufunc(
        call,
        *prepared,
        input_core_dims=[[_dimension(name)] for name in points],
        output_core_dims=[list(components)] * count,
        keep_attrs="override",  # those of coordinates; the result has its own
        **lazily,
    )
    results = [found] if count == 1 else list(found)
    for k, (result, prefix) in enumerate(zip(results, ("", "estimated error of "), strict=False)):
        result.attrs = {**attrs, "long_name": prefix + attrs["long_name"]}
        result.name = call.name if k == 0 else "error"
        results[k] = result.assign_coords({name: list(c) for name, c in components.items()})
    return results[0] if count == 1 else tuple(results)


def _dimension(name: str) -> str:
    return f"components of {name}"


def _prepared(name: str, value: Any, kind: Any) -> Any:
    """The value with its components along a dimension of its own, whatever it was called."""
    if not isinstance(value, kind):
        if is_drjit(value) or not _is_one_point(value):
            raise ArgumentError(
                f"expected {name} as an xarray.DataArray too, or as one point, got "
                f"{type(value).__name__}; name its dimensions by xarray.DataArray({name}, dims=...)"
            )
        return np.asarray(value)
    if not value.dims:
        raise ArgumentError(
            f"expected {name} with its components along the last dimension, got a DataArray "
            "without dimensions"
        )
    last = value.dims[-1]
    plain = value.drop_vars([c for c in value.coords if last in value.coords[c].dims])
    plain = plain.rename({last: _dimension(name)})
    return plain if plain.chunks is None else plain.chunk({_dimension(name): -1})


def _is_one_point(value: Any) -> bool:
    try:
        return np.ndim(value) == 1
    except ValueError:  # lists of unequal lengths
        return False


def _dtypes_of(call: _Call, values: list[Any]) -> list[Any]:
    """Types of the results, from a call without points, which checks all other arguments too."""
    none = [
        np.empty((0, v.shape[-1]), v.dtype) if hasattr(v, "dims") else np.asarray(v) for v in values
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they come with the values
        found = call(*none)
    return [np.asarray(part).dtype for part in (found if isinstance(found, tuple) else (found,))]
