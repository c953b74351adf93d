"""Figures of point spread functions, images and modulation transfer functions."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.figures import style
from polywigner.figures.levels import check_floor, checked_dataset, level_db
from polywigner.quantities import LengthUnit, length_unit
from polywigner.source.normal_form import normal_form, polygons_of

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from polywigner import Aperture, Array

_STYLES = ("-", "-.", ":", (0, (1, 3)))
_ALIKE = 2e-3  # largest difference between curves that are drawn as one line


@style.typeset
def draw_psf(
    dataset: Any,
    floor_db: float | None = -40.0,
    title: str = "",
    *,
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw point spread functions, with one panel for each defocus.

    Parameters
    ----------
    dataset : xarray.Dataset
        Variable ``psf`` (defocus, y, x) in 1/m^2, with x and y in m.
    floor_db : float or None, default -40
        Lowest level in dB relative to the largest value of all panels; None: linear scale.
    title : str, optional
        Title of the figure.
    figure : matplotlib.figure.Figure or SubFigure, default a new figure
        Figure to draw on.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    ArgumentError
        If ``dataset`` has another variable or other axes, the floor is not below 0 dB, or
        ``figure`` has another type.
    """
    if floor_db is not None:
        check_floor(floor_db)
    spots = _checked_variable(dataset, "psf", ("defocus", "y", "x"))
    peak = float(spots.max())
    count = spots.sizes["defocus"]
    figure = style.figure_on(figure, 2.4 + 2.6 * count, 3.5, title)
    panels = figure.subplots(1, count, sharey=True, squeeze=False)[0]
    for axes, spot in zip(panels, spots, strict=True):
        shown, _ = _draw_image(axes, spot, peak, floor_db)
        axes.set_title(_defocus_text(spot))
        axes.set_adjustable("box")
        axes.label_outer()
    style.colour_bar(panels, shown, _scale_text(f"{peak:.3g} /m²", floor_db))
    return figure


def _draw_image(
    axes: Axes, image: xarray.DataArray, peak: float, floor_db: float | None
) -> tuple[style.Map, LengthUnit]:
    """Draw an image (y, x) relative to a peak, in dB above a floor or on a linear scale."""
    unit = length_unit(float(np.ptp(image["x"].values)))
    across, up = (image[name].values / unit.metres for name in ("x", "y"))
    if floor_db is None:
        shown = style.draw_levels(axes, image.values / peak, across, up, low=0.0, high=1.0)
    else:
        levels = level_db(image.values, peak, floor_db)
        shown = style.draw_levels(axes, levels, across, up, low=floor_db)
    style.length_axes(axes, "x", unit)
    return shown, unit


def _scale_text(peak: str, floor_db: float | None) -> str:
    """Return the label of a colour bar: dB relative to a peak, or a linear scale."""
    if floor_db is None:
        return f"fraction of {peak}"
    return f"dB relative to {peak}, {style.floor_text(floor_db)}"


@style.typeset
def draw_image(
    image: xarray.DataArray,
    mask: Aperture | Array | None = None,
    floor_db: float | None = None,
    title: str = "",
    *,
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw an image or a focal spot, with the outlines of a mask.

    Parameters
    ----------
    image : xarray.DataArray
        Values (y, x), at least 0, with the coordinates x and y in m, such as
        :func:`polywigner.partially_coherent_image` and :func:`polywigner.psf` return for points on
        a grid.
    mask : Aperture or Array, optional
        Openings or lines in the plane of the image, drawn as outlines.
    floor_db : float, optional
        Lowest level in dB relative to the peak; default: linear scale.
    title : str, optional
        Title of the figure.
    figure : matplotlib.figure.Figure or SubFigure, default a new figure
        Figure to draw on.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    ArgumentError
        If the image has other dimensions, or the floor is not below 0 dB.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> import polywigner as pw
    >>> x = np.linspace(-20e-6, 20e-6, 41)
    >>> spot = pw.psf(pw.shapes.disc(5e-3), np.stack(np.meshgrid(x, x), axis=-1), 0.5e-6, 0.1)
    >>> image = xr.DataArray(spot, coords=[("y", x), ("x", x)], attrs={"units": "m-2"})
    >>> figure = pw.figures.draw_image(image, title="a spot")
    """
    if floor_db is not None:
        check_floor(floor_db)
    if getattr(image, "dims", None) != ("y", "x") or not {"x", "y"} <= set(image.coords):
        raise ArgumentError(
            "expected image to be a DataArray with the axes (y, x) and the coordinates x and y, "
            f"got {type(image).__name__} with the axes {getattr(image, 'dims', None)}"
        )
    figure = style.figure_on(figure, 5.0, 4.2, title)
    axes, peak = figure.subplots(), float(image.max())
    shown, unit = _draw_image(axes, image, peak, floor_db)
    units = image.attrs.get("units", "1")
    text = f"{peak:.3g}" if units == "1" else f"{peak:.3g} {units}"
    style.colour_bar(axes, shown, _scale_text(text, floor_db))
    if mask is not None:
        axes.autoscale(False)  # Keep the limits of the image.
        for polygon in polygons_of(normal_form(mask).in_plane.elements):
            style.draw_polygons(axes, polygon, unit, edgecolor="white", facecolor="none", lw=0.8)
    return figure


@style.typeset
def draw_mtf(dataset: Any, title: str = "", *, figure: Figure | SubFigure | None = None) -> Figure:
    """Draw modulation transfer functions along x and y, with a line style for each defocus.

    Parameters
    ----------
    dataset : xarray.Dataset
        Variable ``mtf`` (defocus, direction, frequency), with the frequency in cycles/mm. Two
        variables are optional: ``limit`` (direction, frequency), the function of the pupil without
        aberrations, which is drawn dashed, and ``reversed``, a mask of the points of ``mtf`` with
        reversed contrast, which are drawn wide.
    title : str, optional
        Title of the figure.
    figure : matplotlib.figure.Figure or SubFigure, default a new figure
        Figure to draw on.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    ArgumentError
        If ``dataset`` has another variable or other axes, or ``figure`` has another type.
    """
    curves = _checked_variable(dataset, "mtf", ("defocus", "direction", "frequency"))
    figure = style.figure_on(figure, 6.4, 3.8, title)
    axes = figure.subplots()
    frequency = dataset["frequency"].values
    if "limit" in dataset:
        limit = dataset["limit"].values
        some = limit[:1] if np.ptp(limit, axis=0).max() <= _ALIKE else limit
        axes.plot(
            frequency, some.T, "k--", lw=0.8, label=["without aberrations", None][: len(some)]
        )
    for part, dashes in zip(curves, cycle(_STYLES), strict=False):
        lines = dict(zip(("along x", "along y"), part.values, strict=True))
        if np.ptp(part.values, axis=0).max() <= _ALIKE:
            lines = {"along x and y": part.values[0]}
        state = f", {_defocus_text(part)}" if len(curves) > 1 or float(part["defocus"]) else ""
        for (name, line), colour in zip(lines.items(), (style.RED, style.BLUE), strict=False):
            axes.plot(frequency, line, color=colour, ls=dashes, label=name + state)
    if "reversed" in dataset and dataset["reversed"].values.any():
        values = np.where(dataset["reversed"].values, dataset["mtf"].values, np.nan)
        marked = values.reshape(-1, len(frequency)).T
        names = ["contrast reversed", *[None] * (marked.shape[1] - 1)]
        axes.plot(frequency, marked, color="0.5", lw=5, alpha=0.4, label=names)
    style.format_line_axes(
        axes, legend=9, xlim=(0.0, frequency.max()), ylim=(0.0, 1.05),
        xlabel="frequency (cycles/mm)", ylabel="modulation transfer function",
    )  # fmt: skip
    return figure


def _defocus_text(part: Any) -> str:
    """Return the defocus of a part of a dataset, such as "2 waves of defocus"."""
    waves = float(part["defocus"])
    unit = "wave" if waves == 1.0 else "waves"
    return f"{waves:g} {unit} of defocus" if waves else "in focus"


def _checked_variable(dataset: Any, name: str, dims: tuple[str, ...]) -> xarray.DataArray:
    """Return a variable of a dataset; raise ArgumentError if its axes are not ``dims``."""
    values = checked_dataset(dataset).get(name)
    if values is None or values.dims != dims or not all(dim in dataset.coords for dim in dims):
        raise ArgumentError(
            f"expected a dataset with {name} over {', '.join(dims)}; use a dataset written by "
            f"`polywigner {name}`"
        )
    return values
