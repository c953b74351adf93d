"""Public functions with ``xarray.DataArray`` objects as arguments and results.

The last dimension of an argument contains the components. All other dimensions are broadcast by
name, and remain in the result with their coordinates. Chunked arguments give lazy results. This
module does not import xarray, because a caller with a DataArray has already imported it.
"""

from __future__ import annotations

import inspect
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial, wraps
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.execution import Differentiable, is_drjit, kernel_threads
from polywigner.geometry import Polyhedron, Slits, Wavefront
from polywigner.source import Array


def labelled_array(
    values: ArrayLike, dims: Sequence[str], attrs: Mapping[str, Any] | None = None
) -> xarray.Variable:
    """Return an xarray variable with named axes and attributes, such as the unit."""
    import xarray

    return xarray.Variable(tuple(dims), values, dict(attrs or {}))


def labelled_arrays(
    data_vars: Mapping[str, Any],
    coords: Mapping[str, Any],
    attrs: Mapping[str, Any] | None = None,
) -> xarray.Dataset:
    """Return a Dataset of arrays with common axes."""
    import xarray

    return xarray.Dataset(dict(data_vars), coords=dict(coords), attrs=dict(attrs or {}))


def arrays_of(dataset: Any, axes: Mapping[str, str], maker: str, *attrs: str) -> list[Any]:
    """Return arrays of a dataset, transposed to the given axes, and attributes of the dataset.

    ``axes`` contains the axes of each array, separated by blanks; an empty string accepts any axes.
    ``maker`` is the name of the function that returns such datasets, for error messages. Raises
    ArgumentError if the dataset lacks an array, an axis or an attribute.
    """
    try:
        arrays = [dataset[n].transpose(*d.split()) if d else dataset[n] for n, d in axes.items()]
        return [np.asarray(a.values) for a in arrays] + [dataset.attrs[name] for name in attrs]
    except (TypeError, KeyError, IndexError, AttributeError, ValueError):
        got = type(dataset).__name__
        raise ArgumentError(f"expected the result of {maker}, got {got}") from None


if TYPE_CHECKING:
    import xarray

F = TypeVar("F", bound=Callable[..., object])
Arguments = dict[str, Any]
Units = str | Callable[[Arguments], str]


def content_units(arguments: Mapping[str, Any]) -> str:
    """Return the unit of a source's transforms, which is the unit of its length, area or volume."""
    source = arguments["source"]
    source = source.source if isinstance(source, Wavefront) else source
    while isinstance(source, Array):
        source = source.elements[0]
    return {Slits: "m", Polyhedron: "m3"}.get(type(source), "m2")


def takes_xarray(
    *names: str,
    units: Units,
    long_name: str,
    components: Mapping[str, Sequence[str]] | None = None,
    with_error: bool = False,
) -> Callable[[F], F]:
    """Return a decorator for functions that accept DataArrays for the named arguments.

    The results are then DataArrays with the attributes ``units`` and ``long_name``. ``components``
    contains the dimension and the coordinate of results that are vectors. ``with_error`` specifies
    that the function returns a pair of results and errors.
    """

    def decorate(function: F) -> F:
        """Return a function that also accepts DataArrays."""

        @wraps(function)
        def wrapper(*args: Any, **kwargs: Any) -> object:
            """Call the function, and return DataArrays if any point is a DataArray."""
            kind = getattr(sys.modules.get("xarray"), "DataArray", None)
            if kind is None or not any(isinstance(v, kind) for v in (*args, *kwargs.values())):
                return function(*args, **kwargs)
            arguments = inspect.signature(function).bind(*args, **kwargs).arguments
            arguments |= arguments.pop("options", {})
            points = {name: arguments.pop(name) for name in names}
            if not any(isinstance(value, kind) for value in points.values()):
                return function(*args, **kwargs)
            fixed = function.__module__, function.__name__, names, arguments
            unit = units if isinstance(units, str) else units(arguments)
            texts = {function.__name__: long_name}
            if with_error:
                texts["error"] = f"estimated error of {long_name}"
            return _labelled(fixed, points, unit, texts, components or {})

        return wrapper  # type: ignore[return-value]

    return decorate


def _call_by_name(
    module: str, name: str, names: Sequence[str], others: Arguments, *values: Any
) -> NDArray[Any] | tuple[NDArray[Any], ...]:
    """Call a public function by name, so that Dask can send the call to other processes."""
    result: NDArray[Any] | tuple[NDArray[Any], ...] = getattr(import_module(module), name)(
        **others, **dict(zip(names, values, strict=True))
    )
    return result


def _call_in_dask_thread(*arguments: Any) -> NDArray[Any] | tuple[NDArray[Any], ...]:
    """Call a public function from a Dask thread. Only one thread may use Dr.Jit's thread pool."""
    with kernel_threads():
        return _call_by_name(*arguments)


def _labelled(
    fixed: tuple[str, str, Sequence[str], Arguments],
    points: Arguments,
    unit: str,
    names: Mapping[str, str],
    components: Mapping[str, Sequence[str]],
) -> xarray.DataArray | tuple[xarray.DataArray, ...]:
    """Call a function with DataArrays as points, and return DataArrays.

    ``fixed`` contains the module and the name of the function, the names of its points, and its
    other arguments. ``names`` contains the long names of the results.
    """
    xarray = sys.modules["xarray"]
    others = fixed[-1]
    if isinstance(others.get("source"), Differentiable):
        raise ArgumentError(
            f"expected {' and '.join(points)} to be NumPy or Dr.Jit arrays for a differentiable "
            "source, got an xarray.DataArray; use its attribute .values"
        )
    prepared = [_with_dimension(name, value, xarray.DataArray) for name, value in points.items()]
    labelled = [value for value in prepared if isinstance(value, xarray.DataArray)]
    try:
        xarray.align(*labelled, join="exact", copy=False)
    except ValueError as error:
        reason = str(error).partition("\n")[0]
        raise ArgumentError(
            f"expected {' and '.join(points)} with equal coordinates along their common "
            f"dimensions, got different coordinates ({reason}); rename a dimension, or use "
            "xarray.align"
        ) from None
    call, lazily = partial(_call_by_name, *fixed), dict[str, Any]()
    if any(value.chunks is not None for value in labelled):
        lazily = {
            "dask": "parallelized",
            "output_dtypes": _dtypes_of(call, prepared),
            "dask_gufunc_kwargs": {
                "output_sizes": {name: len(labels) for name, labels in components.items()}
            },
        }
        if others.get("engine") != "numpy":
            call = partial(_call_in_dask_thread, *fixed)
    values = xarray.apply_ufunc(
        call,
        *prepared,
        input_core_dims=[[_component_dimension(name)] for name in points],
        output_core_dims=[list(components)] * len(names),
        # Coordinates keep their attributes. The attributes of results are replaced below.
        keep_attrs="override",
        **lazily,
    )
    coords = {name: list(labels) for name, labels in components.items()}
    results = []
    for (name, text), result in zip(
        names.items(), values if len(names) > 1 else (values,), strict=True
    ):
        result.attrs = {"units": unit, "long_name": text}
        result.name = name
        results.append(result.assign_coords(coords))
    return tuple(results) if len(results) > 1 else results[0]


def _component_dimension(name: str) -> str:
    """Return the name of the dimension that contains the components of an argument."""
    return f"components of {name}"


def _with_dimension(name: str, value: Any, kind: type) -> xarray.DataArray | NDArray[Any]:
    """Return a DataArray whose last dimension is renamed, or one point as a NumPy array.

    ``kind``: the class DataArray. Raises ArgumentError for other values.
    """
    if not isinstance(value, kind):
        try:
            is_point = not is_drjit(value) and np.ndim(value) == 1
        # Lists with rows of different lengths raise a ValueError.
        except ValueError:
            is_point = False
        if not is_point:
            raise ArgumentError(
                f"expected {name} to be an xarray.DataArray like the other argument, or one "
                f"point, got {type(value).__name__}; name its dimensions with "
                f"xarray.DataArray({name}, dims=...)"
            )
        return np.asarray(value)
    data: xarray.DataArray = value
    if not data.dims:
        raise ArgumentError(
            f"expected {name} with its components along the last dimension, got a DataArray "
            "without dimensions"
        )
    last = data.dims[-1]
    plain = data.drop_vars([c for c in data.coords if last in data.coords[c].dims])
    plain = plain.rename({last: _component_dimension(name)})
    return plain if plain.chunks is None else plain.chunk({_component_dimension(name): -1})


def _dtypes_of(call: Callable[..., Any], values: Sequence[Any]) -> list[np.dtype[Any]]:
    """Call a function with empty arrays, and return the data types of the results."""
    empty = [
        np.empty((0, v.shape[-1]), v.dtype) if hasattr(v, "dims") else np.asarray(v) for v in values
    ]
    with warnings.catch_warnings():
        # The later call with points issues the warnings again.
        warnings.simplefilter("ignore")
        results = call(*empty)
    return [part.dtype for part in (results if isinstance(results, tuple) else (results,))]
