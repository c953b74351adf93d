"""Rays as a dataset: positions, directions and weights in watts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import real_numbers, shape_of

if TYPE_CHECKING:
    import xarray


Values = NDArray[np.float64]

_UNITS = {"position": "m", "direction": "1", "weight": "W"}
_LONG_NAMES = {
    "position": "a point of the ray",
    "direction": "unit vector along the ray",
    "weight": "power of the ray, signed",
}
# Of directions from ray traces in single precision.
_UNIT = 1e-4
MOST_BATCHES = 1024
"""Independent sets: many more than scatter needs."""


def bundle(
    position: Values,
    direction: Values,
    weight: Values,
    batch: NDArray[Any] | None,
    attrs: dict[str, Any],
) -> xarray.Dataset:
    """The dataset of rays (n, 3), (n, 3), (n,); ``batch``: which independent set each is of."""
    found = {"position": position, "direction": direction, "weight": weight}
    coords: dict[str, Any] = {"component": list("xyz")}
    if batch is not None:
        about = {"long_name": "independent set of quasi-random numbers"}
        coords["batch"] = ("ray", np.asarray(batch, np.int32), about)
    import xarray

    dataset = xarray.Dataset(
        {
            name: (
                ("ray", "component")[: values.ndim],
                values,
                {"units": _UNITS[name], "long_name": _LONG_NAMES[name]},
            )
            for name, values in found.items()
        },
        coords=coords,
        attrs=attrs,
    )
    return dataset


def traced(
    rays: xarray.Dataset,
    position: ArrayLike,
    direction: ArrayLike,
    weight: ArrayLike | None = None,
) -> xarray.Dataset:
    """Rays after ray optics of your own: positions, directions and powers.

    For :func:`rebuild`. Keep the order of the rays; one that is lost on the way has NaN for its
    position, or a weight of zero.

    Parameters
    ----------
    rays : those that were traced, from :func:`polywigner.sample_rays` or :func:`load`.
    position : (n, 3) in m, a point of each ray behind the optics.
    direction : (n, 3) unit vectors.
    weight : (n,) in W, where the optics absorb; None: as before.

    Returns
    -------
    xarray.Dataset, as that of :func:`polywigner.sample_rays`.

    Raises
    ------
    ArgumentError for anything but rays, and for arrays of other shapes.

    >>> import numpy as np
    >>> import polywigner as pw
    >>> rays = pw.sample_rays(pw.shapes.square(10e-3), 3.2e-3, 100)
    >>> mirror = rays.direction.values * [1.0, 1.0, -1.0]  # at the plane z = 0.1 m
    >>> reach = (0.1 - rays.position.values[:, 2:]) / rays.direction.values[:, 2:]
    >>> back = pw.rays.traced(rays, rays.position + reach * rays.direction, mirror)
    >>> bool((back.direction[:, 2] < 0).all())
    True
    """
    _, _, weights, batch = checked_bundle(rays)
    n = len(weights)
    found = (
        _values("position", position, (n, 3)),
        _values("direction", direction, (n, 3)),
        weights if weight is None else _values("weight", weight, (n,)),
    )
    return bundle(*found, batch, {**rays.attrs, "count": count_of(rays)})


def checked_bundle(rays: Any) -> tuple[Values, Values, Values, NDArray[Any] | None]:
    """Positions, directions, weights and batches of a dataset of rays.

    Rays with a component that is not finite are lost: they may be there. Raises ArgumentError for
    anything but such a dataset, and for directions that are no unit vectors.
    """
    import xarray

    if not isinstance(rays, xarray.Dataset) or not set(_UNITS) <= set(rays.variables):
        raise ArgumentError(
            "expected rays as a dataset with position, direction and weight, got "
            f"{type(rays).__name__}; draw them by sample_rays, or read them by rays.load"
        )
    order = {name: ("ray", "component")[: rays[name].ndim] for name in _UNITS}
    try:
        arrays = {name: rays[name].transpose(*order[name]).values for name in _UNITS}
    except ValueError as error:
        raise ArgumentError(
            f"expected position and direction over ray and component, weight over ray: {error}"
        ) from None
    n = len(arrays["weight"])
    position = _values("position", arrays["position"], (n, 3))
    direction = _values("direction", arrays["direction"], (n, 3))
    weight = _values("weight", arrays["weight"], (n,))
    return position, direction, weight, _batch(rays) if "batch" in rays.coords else None


def _batch(rays: Any) -> NDArray[Any]:
    """Numbers of the sets of rays, (n,)."""
    found: NDArray[Any] = rays["batch"].values
    whole = found.dtype.kind in "iu" and found.shape == (rays.sizes["ray"],)
    if not whole or not (found.min(initial=0) >= 0 and found.max(initial=0) < MOST_BATCHES):
        raise ArgumentError(
            f"expected batch as whole numbers from 0 to {MOST_BATCHES - 1}, one for each ray, got "
            f"{found.dtype} of shape {found.shape}"
        )
    return found


def count_of(rays: xarray.Dataset) -> int:
    """Number of rays drawn, including rays that a selection has left out."""
    told = rays.attrs.get("count", 0)
    return max(int(told) if isinstance(told, (int, np.integer)) else 0, rays.sizes["ray"])


def _values(name: str, values: Any, shape: tuple[int, ...]) -> Values:
    try:
        found = real_numbers(values)
    except ValueError as error:
        raise ArgumentError(f"expected {name} of shape {shape}, got {error}") from None
    if found.shape != shape:
        raise ArgumentError(f"expected {name} of shape {shape}, got {shape_of(values)}")
    if name == "direction":
        wrong = np.abs(np.linalg.norm(found, axis=1) - 1) > _UNIT  # false for lost rays
        if wrong.any():
            raise ArgumentError(
                f"expected direction as unit vectors, got {found[wrong][0].tolist()}; divide by "
                "their lengths"
            )
    return found
