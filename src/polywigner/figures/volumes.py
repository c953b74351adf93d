"""The picture of a volume: lit isosurfaces of the irradiance in dB, and its projections."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, EngineError, MissingExtraError
from polywigner.figures import style
from polywigner.figures.fields import even_axis, peak_of, printed_unit, quantity_of
from polywigner.figures.levels import check_floor, checked_dataset, level_db
from polywigner.figures.volumes_layers import (
    Layers,
    View,
    cast_layers,
    closed,
    draw_box,
    draw_outline,
    draw_picture,
    draw_wall,
    pyvista_layers,
    shaded,
)
from polywigner.geometry.arguments import checked_choice, checked_length, checked_row
from polywigner.geometry.display import length_unit
from polywigner.geometry.silhouettes import bodies_if_any, obstacle_of
from polywigner.illumination.source_files import SOURCE_COORDINATE, read_source

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

    from polywigner import Aperture, Array


Renderer = Literal["auto", "pyvista", "matplotlib"]
Projection = Literal["maximum", "mean"]
Floats = NDArray[np.float64]

_TOWARDS = (-0.62, 0.42, -0.66)
"""From behind the aperture and above: z runs to the right and away from the viewer, so that the
beam falls on the wall at the far end of the box and hides nothing of the aperture."""

_MOST = 256
"""Samples along an axis that are drawn; of longer axes every second, third, ... sample."""

_PIXELS = 1000
"""Pixels of the surfaces along the larger side of the page: some two for each that is printed."""

_INCHES = 5.6  # the larger side of the box on the page
_LEFT, _RIGHT, _BELOW, _ABOVE = 0.75, 1.6, 0.55, 0.3

_SURFACES = (0.15, 0.3, 0.45, 0.6)  # parts of the floor
_FAINTEST, _DENSEST = 0.08, 0.95  # opacities of the outermost and innermost surface
_SURFACE_COLOURS = ("#2f6be0", "#0fb5a6", "#ffb000", "#e01a10")
_WALL_COLOURS = ("#ffffff", "#c9ced6", "#6a7686")  # quiet: surfaces stand before them


@style.typeset
def draw_volume(
    found: Any,
    source: Aperture | Array | None = None,
    *,
    obstacles: Any = (),
    name: str | None = None,
    surfaces: tuple[float, ...] | None = None,
    floor_db: float = -40.0,
    reference: float | None = None,
    projection: Projection = "maximum",
    renderer: Renderer = "auto",
    title: str = "",
    ax: Axes | None = None,
) -> Any:
    """Isosurfaces of an irradiance inside its box, and its projections on the three back walls.

    Lengths have one scale along all axes, unless the box is more than four times as long as wide.

    Parameters
    ----------
    found : xarray.Dataset, as from :func:`polywigner.volume`: ``found[name]`` over x, y and z (in
        any order) in metres, each with at least two evenly spaced samples. Of axes with more than
        256 samples every second, third, ... one is read.
    source : source whose outline is drawn in the plane z = 0; None: the one that the dataset
        contains.
    obstacles : bodies and plates, as :func:`polywigner.volume` takes them, drawn by their outlines.
    name : of the variable, which is like a power; None: the only one.
    surfaces : levels of the isosurfaces, dB, from the floor to below 0; None: four, evenly spaced.
    floor_db : lowest level of the walls, dB; all below it gets its colour.
    reference : the value that is 0 dB, in the unit of the quantity; None: the largest in the box.
    projection : on the walls, the "maximum" or the "mean" of the quantity along their normals.
    renderer : what finds the surfaces: "pyvista"; "matplotlib", for rays cast in NumPy, which
        needs no graphics library; "auto", pyvista where it is installed and works, else the other.
        The rest of the picture is the same.
    title : above the picture.
    ax : matplotlib axes to draw on, whose figure gets the colour bar; None: a new figure. What is
        drawn on is returned.

    Raises
    ------
    ArgumentError : no such volume, levels that are none, or what are no axes.
    MissingExtraError, EngineError : pyvista was asked for, and is missing or does not work here.
    """
    shells = check_volume_options(surfaces, floor_db, projection, renderer)
    style.checked_axes(ax)
    volume = field_samples(found, name, ("x", "y", "z"), _MOST)
    zero = volume.zero_db(reference)
    lower, upper = volume.corners
    front = np.array([*lower[:2], min(lower[2], 0.0)])
    view = View.of(front, upper, _TOWARDS)
    layers = _layers(volume, zero, shells, view, renderer)
    if ax is None:
        figure, axes, beside = _page(view, front, upper)
        place: dict[str, Any] = {"cax": beside}
    else:
        axes = ax
        place = {"ax": axes, "fraction": 0.03, "pad": 0.04}
    colours = _colours(len(shells))
    projected = np.max if projection == "maximum" else np.mean
    for axis in range(3):
        wall = level_db(projected(volume.values, axis=axis), zero, floor_db)
        shown = draw_wall(
            axes, view, axis, wall, (lower, upper), shells, colours,
            cmap=_map(_WALL_COLOURS), vmin=floor_db, vmax=0.0,
        )  # fmt: skip
    draw_box(axes, view, front, upper, length_unit(float((upper - front).max())))
    opacities = np.geomspace(_FAINTEST, _DENSEST, len(colours))
    drawn = shaded(layers, colours, opacities, view), layers.origin, layers.along, layers.down
    draw_picture(axes, *drawn, interpolation="antialiased", zorder=3)
    shown_source: Any = source
    if source is None and SOURCE_COORDINATE in found.coords:
        shown_source = read_source(found)
    if shown_source is not None:
        draw_outline(axes, view, shown_source)
    for body in bodies_if_any(obstacles):  # seen through all that is before it
        lines = view.on_page(obstacle_of(body).outline(view.towards / view.stretch))
        style.draw_cut(axes, lines, "wk", zorder=4)
    extend = "max" if np.max(volume.values) > zero else "neither"
    bar = axes.figure.colorbar(shown, extend=extend, **place)
    bar.outline.set_linewidth(0.6)
    bar.ax.hlines(shells, 0, 1, colors=[tuple(c) for c in colours], linewidth=3)
    bar.set_label(_label(volume, zero, floor_db, projection))
    axes.set_title(title)
    return figure if ax is None else axes


def check_volume_options(
    surfaces: tuple[float, ...] | None, floor_db: float, projection: str, renderer: str
) -> tuple[float, ...]:
    """The levels of the isosurfaces, dB, from the lowest to the highest."""
    check_floor(floor_db)
    checked_choice(projection, "projection", get_args(Projection))
    checked_choice(renderer, "renderer", get_args(Renderer))
    if surfaces is None:
        return tuple(sorted(floor_db * part for part in _SURFACES))
    known = checked_row(surfaces, "expected surfaces at levels from the floor to below 0 dB")
    levels = tuple(sorted(set(known.tolist())))
    if not levels or not all(floor_db <= level < 0 for level in levels):
        raise ArgumentError(
            f"expected surfaces at levels from the floor, {floor_db:g} dB, to below 0 dB, got "
            f"{surfaces}; give for example ({floor_db / 4:g}, {floor_db / 2:g})"
        )
    return levels


@dataclass(frozen=True, eq=False)
class Samples:
    """Real values (n1, n2, ...) of a quantity on evenly spaced axes in metres.

    ``corners`` are the places of the first and of the last sample, ``unit`` that of the values, as
    it is printed.
    """

    name: str
    unit: str
    values: Floats
    corners: tuple[Floats, Floats]

    @property
    def spacing(self) -> Floats:
        lower, upper = self.corners
        return (upper - lower) / (np.array(self.values.shape) - 1)

    def zero_db(self, reference: float | None) -> float:
        """The value of 0 dB: the reference, or the largest value; ArgumentError if not above 0."""
        if reference is None:
            return peak_of(self.values, self.name)
        return checked_length(reference, "reference", meaning="a power above zero")


def field_samples(
    found: Any, name: str | None, dims: tuple[str, ...], most: int | None = None
) -> Samples:
    """The real samples of ``found[name]`` over the axes ``dims``, in this order."""
    checked_dataset(found, "found")
    if name is None and len(found.data_vars) == 1:
        (name,) = found.data_vars
    if not isinstance(name, str) or name not in found.data_vars:
        raise ArgumentError(
            f"expected the name of one of {', '.join(map(str, found.data_vars))}, got {name!r}"
        )
    array = found[name]
    if sorted(array.dims) != sorted(dims):
        raise ArgumentError(
            f"expected {name} over {', '.join(dims)}, got it over {', '.join(map(str, array.dims))}"
        )
    array = array.transpose(*dims)
    if most is not None:
        array = array[tuple(slice(None, None, -(-n // most)) for n in array.shape)]
    axes = [even_axis(d, np.asarray(array[d].values, dtype=np.float64)) for d in dims]
    values = np.asarray(array.values)
    if np.iscomplexobj(values):
        raise ArgumentError(f"expected {name} as real values, got complex ones; draw their squares")
    values = values.astype(np.float64)
    if np.isnan(values).any():
        raise ArgumentError(
            f"expected {name} at all points, got nan at {np.isnan(values).mean():.1%} of them; "
            "finish the run that computes it"
        )
    ends = np.array([[a[0], a[-1]] for a in axes])
    return Samples(quantity_of(array), printed_unit(array), values, (ends[:, 0], ends[:, 1]))


def _layers(
    volume: Samples, zero: float, shells: tuple[float, ...], view: View, renderer: Renderer
) -> Layers:
    with np.errstate(divide="ignore"):
        levels, before = closed(10 * np.log10(np.maximum(volume.values, 0) / zero), shells[0], view)
    spacing = volume.spacing
    lower = volume.corners[0] - before * spacing
    upper = lower + spacing * (np.array(levels.shape) - 1)
    pixel = float(np.ptp(view.corners(lower, upper), axis=0).max()) / _PIXELS
    try:
        if renderer != "matplotlib":
            return pyvista_layers(levels, lower, spacing, shells, view, pixel)
    except MissingExtraError:
        if renderer == "pyvista":
            raise
    except EngineError as error:
        if renderer == "pyvista":
            raise
        warnings.warn(f"surfaces by casting rays: {error}", RuntimeWarning, stacklevel=3)
    return cast_layers(levels, lower, spacing, shells, view, pixel)


def _map(colours: tuple[str, ...]) -> Colormap:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("polywigner", colours)


def _colours(count: int) -> Floats:
    """RGB (count, 3) of surfaces from the lowest level to the highest."""
    return np.array(_map(_SURFACE_COLOURS)(np.linspace(0 if count > 1 else 1, 1, count)))[:, :3]


def _page(view: View, lower: Floats, upper: Floats) -> tuple[Figure, Axes, Axes]:
    """A figure as large as the box needs, with axes for the box and for a colour bar beside it."""
    page = view.corners(lower, upper)
    width, height = _INCHES * np.ptp(page, axis=0) / np.ptp(page, axis=0).max()
    size = np.array([_LEFT + width + _RIGHT, _BELOW + height + _ABOVE])
    figure = style.new_figure(*size)
    figure.set_layout_engine("none")  # it would make room for what is drawn outside of its box

    def axes_at(left: float, below: float, across: float, up: float) -> Axes:
        return figure.add_axes((left / size[0], below / size[1], across / size[0], up / size[1]))

    box = axes_at(_LEFT, _BELOW, width, height)
    bar = axes_at(_LEFT + width + 0.35, _BELOW + 0.05 * height, 0.16, 0.9 * height)
    return figure, box, bar


def _label(volume: Samples, zero: float, floor_db: float, projection: Projection) -> str:
    size = style.quantity_text(zero, volume.unit)
    return (
        f"{volume.name}, dB relative to {size}; walls: {projection}, {style.floor_text(floor_db)}"
    )
