"""Figures of volumes: isosurfaces of an irradiance in a box, and projections on its back walls."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np

from polywigner.errors import ArgumentError, require
from polywigner.figures import style
from polywigner.figures.levels import (
    check_floor,
    checked_dataset,
    even_axis,
    level_db,
    peak_of,
    printed_unit,
    quantity_of,
)
from polywigner.figures.transform_plots import outline_of
from polywigner.geometry.arguments import checked_choice, checked_length, checked_row
from polywigner.geometry.silhouettes import bodies_if_any, obstacle_of
from polywigner.numerics import Floats
from polywigner.quantities import length_unit
from polywigner.source.source_files import SOURCE_COORDINATE, read_source

if TYPE_CHECKING:
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

    from polywigner import Aperture, Array

Projection = Literal["maximum", "mean"]

_MOST = 128  # largest number of samples along an axis; longer axes are decimated
_SURFACES = (0.15, 0.3, 0.45, 0.6)  # default surface levels, as fractions of the floor in dB
_FAINTEST, _DENSEST = 0.28, 0.95  # opacities of the outermost and of the innermost surface
_SURFACE_COLOURS = ("#2f6be0", "#0fb5a6", "#ffb000", "#e01a10")
_WALL_COLOURS = ("#ffffff", "#c9ced6", "#6a7686")
_WALL_LEVELS = 80
_INKS = "white", "#101010"

# Viewing angles [degrees]: z points to the right and away from the viewer.
_ELEVATION, _AZIMUTH = 24.0, -133.0
# Distance below a surface at which levels are clipped [dB]; without clipping, interpolation towards
# a null would shift the surface.
_BELOW = 20.0
# Smallest ratio of a side of the drawn box to its longest side.
_FLATTEST = 0.25
_AMBIENT, _DIFFUSE = 0.45, 0.55


@style.typeset
def draw_volume(
    dataset: Any,
    source: Aperture | Array | None = None,
    *,
    obstacles: Any = (),
    name: str | None = None,
    surfaces: tuple[float, ...] | None = None,
    floor_db: float = -40.0,
    reference: float | None = None,
    projection: Projection = "maximum",
    title: str = "",
    ax: Axes3D | None = None,
) -> Axes3D | Figure:
    """Draw isosurfaces of an irradiance in a box, and its projections on the three back walls.

    All axes have equal scales, unless the box is more than four times as long as it is wide.
    scikit-image computes the surfaces (marching cubes), and matplotlib draws them.

    Parameters
    ----------
    dataset : xarray.Dataset
        Result of :func:`polywigner.volume`, or another dataset with a variable over x, y and z (in
        any order) in metres, each with at least two evenly spaced samples. Axes with more than 128
        samples are decimated.
    source : Aperture or Array, optional
        Source whose outline is drawn in the plane z = 0, by default the source in the dataset.
    obstacles : sequence of bodies and plates, default none
        Obstacles as in :func:`polywigner.volume`, whose outlines are drawn.
    name : str, optional
        Variable to draw, a power density. A dataset with one variable needs no name.
    surfaces : tuple of float, default four levels
        Levels of the isosurfaces in dB, from the floor to below 0. The default levels are evenly
        spaced.
    floor_db : float, default -40
        Lowest level of the walls in dB. Lower levels are drawn at the floor.
    reference : float, default the largest value in the box
        Value of 0 dB, in the unit of the variable.
    projection : {"maximum", "mean"}
        Projection of the values (not the levels) along the normals of the walls.
    title : str, optional
        Title of the figure.
    ax : mpl_toolkits.mplot3d.Axes3D, default new axes
        Axes to draw on, whose figure gets the colour bar.

    Returns
    -------
    Axes3D or matplotlib.figure.Figure
        The axes, or the new figure if ``ax`` is None.

    Raises
    ------
    ArgumentError
        If the dataset has other variables, a level is out of range, or the axes are not 3D.
    MissingExtraError
        If scikit-image is not installed.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    shells = check_volume_options(surfaces, floor_db, projection)
    volume = _samples(dataset, name)
    if reference is None:
        zero = peak_of(volume.values, volume.label)
    else:
        zero = checked_length(reference, "reference", meaning="a power above zero")
    front = np.array([*volume.lower[:2], min(volume.lower[2], 0.0)])
    unit = length_unit(float((volume.upper - front).max()))
    lower, upper = volume.lower / unit.metres, volume.upper / unit.metres
    volume = volume._replace(lower=lower, upper=upper)
    if ax is None:
        figure = style.new_figure(7.2, 5.4)
        figure.set_layout_engine("none")  # Layout engines add margins around 3D axes.
        axes: Any = figure.add_axes((0.03, 0.0, 0.84, 0.95), projection="3d")
        bar_options: dict[str, Any] = {"cax": figure.add_axes((0.88, 0.12, 0.02, 0.76))}
    elif hasattr(ax, "get_proj"):
        axes, bar_options = ax, {"ax": ax, "fraction": 0.03, "pad": 0.08}
    else:
        style.axes_on(ax, 0, 0)
        raise ArgumentError(
            'expected ax with projection="3d", got two-dimensional axes; create them with '
            'figure.add_subplot(projection="3d")')  # fmt: skip
    _draw_box(axes, front / unit.metres, upper, unit.name)
    count = len(shells)
    shades = _colour_map(_SURFACE_COLOURS)(np.linspace(0 if count > 1 else 1, 1, count))
    colours: Floats = np.array(shades)[:, :3]  # RGB, lowest level first
    with np.errstate(divide="ignore"):
        levels = 10 * np.log10(np.maximum(volume.values, 0) / zero)
    projected = np.max if projection == "maximum" else np.mean
    for axis in range(3):
        wall = level_db(projected(volume.values, axis=axis), zero, floor_db)
        _draw_wall(axes, volume, axis, wall, floor_db, shells, colours)
    opacities = np.geomspace(_FAINTEST, _DENSEST, len(shells))
    for k, (shell, colour, opacity) in enumerate(zip(shells, colours, opacities, strict=True)):
        # Surfaces of lower levels enclose surfaces of higher levels, so they are drawn on top.
        _draw_surface(axes, volume, levels, shell, colour, opacity, zorder=20 - k)
    if source is None and SOURCE_COORDINATE in dataset.coords:
        source = read_source(dataset)  # type: ignore[assignment]
    if source is not None:
        rings = outline_of(source).rings
        corners = [np.pad(np.asarray(ring) / unit.metres, ((0, 0), (0, 1))) for ring in rings]
        lines = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in corners]
        style.draw_outlines(axes, np.concatenate(lines), _INKS, 30)
    for body in bodies_if_any(obstacles):
        style.draw_outlines(
            axes, obstacle_of(body).outline(_view_direction()) / unit.metres, _INKS, 30
        )
    extend = "max" if np.max(volume.values) > zero else "neither"
    walls = ScalarMappable(Normalize(floor_db, 0.0), _colour_map(_WALL_COLOURS))
    bar = axes.figure.colorbar(walls, extend=extend, **bar_options)
    bar.outline.set_linewidth(0.6)
    bar.ax.hlines(shells, 0, 1, colors=[tuple(c) for c in colours], linewidth=3)
    size, floor = style.quantity_text(zero, volume.unit), style.floor_text(floor_db)
    bar.set_label(f"{volume.label}, dB relative to {size}; walls: {projection}, {floor}")
    axes.set_title(title)
    return figure if ax is None else axes


def check_volume_options(
    surfaces: tuple[float, ...] | None, floor_db: float, projection: str
) -> tuple[float, ...]:
    """Return the ascending levels of the isosurfaces in dB.

    Raises ArgumentError for invalid options, and MissingExtraError without scikit-image.
    """
    require("skimage", "volume", "finds isosurfaces")
    check_floor(floor_db)
    checked_choice(projection, "projection", get_args(Projection))
    if surfaces is None:
        return tuple(sorted(floor_db * part for part in _SURFACES))
    known = checked_row(surfaces, "expected surfaces to be levels from the floor to below 0 dB")
    levels = tuple(sorted(set(known.tolist())))
    if not levels or not all(floor_db <= level < 0 for level in levels):
        raise ArgumentError(
            f"expected surfaces to be levels from the floor of {floor_db:g} dB to below 0 dB, got "
            f"{surfaces}; pass for example ({floor_db / 4:g}, {floor_db / 2:g})"
        )
    return levels


class _Volume(NamedTuple):
    """Samples of a quantity in a box."""

    label: str
    unit: str
    values: Floats  # shape (nx, ny, nz)
    lower: Floats  # position of the first sample, shape (3,)
    upper: Floats  # position of the last sample, shape (3,)


def _samples(dataset: Any, name: str | None) -> _Volume:
    """Return the samples of a real variable, at most 128 along each axis."""
    variables = checked_dataset(dataset).data_vars
    if name is None and len(variables) == 1:
        (name,) = variables
    if not isinstance(name, str) or name not in variables:
        raise ArgumentError(
            f"expected name to be one of the variables {', '.join(map(str, variables))}, "
            f"got {name!r}"
        )
    array = dataset[name]
    if sorted(array.dims) != ["x", "y", "z"]:
        raise ArgumentError(
            f"{name} must have the dimensions x, y and z, got {', '.join(map(str, array.dims))}"
        )
    array = array.transpose("x", "y", "z")
    array = array[tuple(slice(None, None, -(-n // _MOST)) for n in array.shape)]
    axes = [even_axis(d, np.asarray(array[d].values, dtype=np.float64)) for d in "xyz"]
    values = np.asarray(array.values)
    if np.iscomplexobj(values):
        raise ArgumentError(f"{name} must be real, got complex values; pass their squared moduli")
    if np.isnan(values).any():
        raise ArgumentError(
            f"{name} contains NaN at {np.isnan(values).mean():.1%} of the points; complete the "
            "computation first"
        )
    ends = (np.array([axis[k] for axis in axes]) for k in (0, -1))
    return _Volume(quantity_of(array), printed_unit(array), values.astype(np.float64), *ends)


def _view_direction() -> Floats:
    """Return the unit vector that points from the box to the viewer."""
    elevation, azimuth = np.radians([_ELEVATION, _AZIMUTH])
    across = np.cos(elevation) * np.array([np.sin(azimuth), np.cos(azimuth)])
    return np.array([across[0], np.sin(elevation), across[1]])


def _draw_box(axes: Any, lower: Floats, upper: Floats, unit: str) -> None:
    """Set the view and the axes of a box, and draw the edges of its back walls."""
    from matplotlib.ticker import MaxNLocator

    # By default, matplotlib would sort artists by their mean depth.
    axes.computed_zorder = False
    extent = upper - lower
    axes.set_proj_type("ortho")
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH, vertical_axis="y")
    axes.set_box_aspect(np.maximum(extent, _FLATTEST * extent.max()), zoom=1.0)
    axes.grid(False)
    ends = np.stack([lower, upper], axis=-1)
    for name, axis, limits in zip("xyz", (axes.xaxis, axes.yaxis, axes.zaxis), ends, strict=True):
        axes.set(**{f"{name}lim": limits, f"{name}label": f"${name}$ ({unit})"})
        axis.pane.set_visible(False)
        axis.labelpad = 10
        axis.set_major_locator(MaxNLocator(4 if name == "x" else 6))
    for corner, axis in product(product((0, 1), repeat=3), range(3)):
        start, end = list(corner), list(corner)
        end[axis] = 1
        fronts = sum((_view_direction()[k] > 0) == start[k] for k in range(3) if k != axis)
        if start[axis] == 0 and fronts < 2:
            line = [[ends[k][start[k]], ends[k][end[k]]] for k in range(3)]
            axes.plot(*line, color="0.25", lw=0.7, zorder=2)


def _draw_wall(
    axes: Any, volume: _Volume, axis: int, wall: Floats, floor_db: float,
    contours: tuple[float, ...], colours: Floats,
) -> None:  # fmt: skip
    """Draw levels ``wall`` in dB as filled contours and lines on the wall normal to an axis."""
    lower, upper = volume.lower, volume.upper
    position = (lower if _view_direction()[axis] > 0 else upper)[axis]
    shape = volume.values.shape
    along = [np.linspace(lower[k], upper[k], shape[k]) for k in range(3) if k != axis]
    arguments = list(np.meshgrid(*along, indexing="ij"))
    arguments.insert(axis, wall)
    at = {"zdir": "xyz"[axis], "offset": position}
    shades = np.linspace(floor_db, 0.0, _WALL_LEVELS + 1)
    axes.contourf(*arguments, shades, cmap=_colour_map(_WALL_COLOURS), extend="max", zorder=0, **at)
    if wall.min() < max(contours) and wall.max() > min(contours):
        axes.contour(*arguments, contours, colors=colours, linewidths=0.7, zorder=1, **at)


def _draw_surface(
    axes: Any, volume: _Volume, levels: Floats, shell: float, colour: Floats, opacity: float,
    zorder: float,
) -> None:  # fmt: skip
    """Draw an isosurface, closed at the faces of the box.

    The surface is drawn opaque, and the resulting image is made translucent. This method hides the
    back of the surface and the edges of its triangles.
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection
    from skimage.measure import marching_cubes

    if levels.max() <= shell:
        return
    outside = shell - _BELOW
    padded = np.pad(np.maximum(levels, outside), 1, constant_values=outside)
    vertices, faces, normals, _ = marching_cubes(padded, shell)
    lower, upper = volume.lower, volume.upper
    spacing = (upper - lower) / (np.array(levels.shape) - 1)
    vertices = np.clip(lower + (vertices - 1) * spacing, lower, upper)
    across = normals[faces].mean(axis=1) / spacing
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    shade = _AMBIENT + _DIFFUSE * np.abs(across @ _view_direction())
    colours = colour * shade[:, None]
    drawn = Poly3DCollection(
        vertices[faces], facecolors=colours, edgecolors=colours, linewidths=0.3, zorder=zorder
    )
    drawn.set_rasterized(True)  # Embed the surface in SVG and PDF files as an image.
    drawn.set_agg_filter(lambda image, _dpi: (image * [1.0, 1.0, 1.0, opacity], 0, 0))
    axes.add_collection3d(drawn, autolim=False)


def _colour_map(colours: tuple[str, ...]) -> Colormap:
    """Return a colour map that interpolates between colours."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("polywigner", colours)
