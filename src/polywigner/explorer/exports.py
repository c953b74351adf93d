"""Downloads for a visitor: outlines as GeoJSON and SVG, views as pictures and values."""

from __future__ import annotations

import io
import json
from typing import TYPE_CHECKING, Any

import numpy as np

from polywigner.explorer import views
from polywigner.explorer.results import final_samples
from polywigner.explorer.shown import FLOOR_DB, Shown, shown
from polywigner.explorer.sources import aperture_of, feeding_of
from polywigner.explorer.state import UNITS, State, to_query

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def geojson(state: State) -> str:
    """The outline of the element as a GeoJSON Feature, in mm, as it is read without a unit.

    Raises
    ------
    PolywignerError for what is no polygon, here as in all of this module.
    """
    scale = UNITS["mm"]
    polygons = [
        [[[*_exact(x, scale), *_exact(y, scale)] for x, y in ring.coords] for ring in rings]
        for rings in _parts(state)
    ]
    geometry: dict[str, Any] = {"type": "MultiPolygon", "coordinates": polygons}
    if len(polygons) == 1:
        geometry = {"type": "Polygon", "coordinates": polygons[0]}
    feature = {
        "type": "Feature",
        "properties": {"unit": "mm", "wave": state.wave},
        "geometry": geometry,
    }
    return json.dumps(feature, indent=1) + "\n"


def _exact(metres: float, scale: int) -> tuple[float]:
    # 15 digits give back the number that was typed
    return (float(f"{metres * scale:.15g}"),)


def _parts(state: State) -> list[list[Any]]:
    polygons = aperture_of(state.rings, state.per_metre).polygons.geoms
    return [[polygon.exterior, *polygon.interiors] for polygon in polygons]


def svg(state: State) -> str:
    """The outline of the element as an SVG drawing in millimetres, y upwards.

    :func:`polywigner.read_aperture` reads it back.
    """
    aperture = aperture_of(state.rings, state.per_metre)
    xmin, ymin, xmax, ymax = (1e3 * v for v in aperture.bounds)
    paths = "".join(
        "M" + " L".join(f"{1e3 * x:.15g},{-1e3 * y:.15g}" for x, y in ring.coords[:-1]) + "Z"
        for rings in _parts(state)
        for ring in rings
    )
    width, height = xmax - xmin, ymax - ymin
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" '
        f'width="{width:.15g}mm" height="{height:.15g}mm" '
        f'viewBox="{xmin:.15g} {-ymax:.15g} {width:.15g} {height:.15g}">\n'
        f'<path fill="#1f3b57" fill-rule="evenodd" d="{paths}"/>\n</svg>\n'
    )


def values_file(state: State, name: str) -> bytes:
    """The arrays of a view with their axes and the link of the state, as ``.npz``."""
    buffer = io.BytesIO()
    if name == "far":
        cuts = views.far_field(state)
        arrays: dict[str, Any] = {} if cuts.cross is None else {"cross_polar_dbi": cuts.cross}
        np.savez(
            buffer, theta_rad=cuts.theta, phi_rad=cuts.phi, directivity_dbi=cuts.directivity,
            link=to_query(state), **arrays,
        )  # fmt: skip
        return buffer.getvalue()
    picture = views.PICTURES[name](state, final_samples(state, name))
    axis = np.linspace(-picture.half, picture.half, picture.samples)
    arrays = dict(picture.arrays)
    np.savez(
        buffer, first=picture.centre[0] + axis, second=picture.centre[1] + axis,
        axis_unit=picture.axis_unit, unit=picture.unit, link=to_query(state), **arrays,
    )  # fmt: skip
    return buffer.getvalue()


def picture_file(state: State, name: str, suffix: str) -> bytes:
    """A view as it is shown, drawn by matplotlib: "png" or "svg"."""
    import matplotlib as mpl

    buffer = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "path"}):
        draw_view(state, name).savefig(buffer, format=suffix)
    return buffer.getvalue()


def draw_view(state: State, name: str) -> Figure:
    """A view with its axes, units and colour bars: one panel, or three of the near field."""
    import matplotlib as mpl

    from polywigner.figures.style import TYPOGRAPHY, new_figure

    with mpl.rc_context(TYPOGRAPHY):
        if name == "far":
            figure = new_figure(4.6, 4.6)
            _draw_cuts(figure.add_subplot(projection="polar"), views.far_field(state))
        else:
            picture = views.PICTURES[name](state, final_samples(state, name))
            figure = new_figure(0.4 + 4.4 * len(picture.arrays), 4.2)
            panels = figure.subplots(1, len(picture.arrays), squeeze=False)[0]
            for axes, key in zip(panels, picture.arrays, strict=True):
                _draw(axes, picture, shown(picture, key, state.part, state.unit), state)
        lit = [state.wave, *(f"{key} {text}" for key, text in feeding_of(state))]
        if state.coherence and name in ("wigner_nu", "wigner_x"):
            lit.append(f"coherent over {state.coherence:g} {state.unit}")
        figure.suptitle("; ".join([*lit, _chosen(state, name)]), fontsize=9, wrap=True)
    return figure


def _chosen(state: State, name: str) -> str:
    x, y = state.x
    if name == "wigner_nu":
        return f"x = ({x:g}, {y:g}) {state.unit}"
    if name == "wigner_x":
        return f"ν = ({state.nu[0]:g}, {state.nu[1]:g}) / {state.unit}"
    if name == "otf":
        return f"defocus {state.defocus:g} waves"
    if name == "near":
        return f"z = {state.distance:g} {state.unit}, rays of order {state.order}"
    if name == "far" and state.polarisation.strip():
        return f"polarisation {state.polarisation.strip()}: co- and cross-polar"
    return "directivity" if name == "far" else "Fourier transform"


def _draw(axes: Axes, picture: views.Picture, what: Shown, state: State) -> None:
    from polywigner.figures import style

    scale = 1 / state.per_metre if picture.axis_unit == "1/m" else state.per_metre
    along = np.linspace(-picture.half, picture.half, picture.samples)
    x, y = (scale * (middle + along) for middle in picture.centre)
    if what.scale == "signed":
        style.signed_bar(axes, style.draw_signed(axes, what.values, x, y), what.bar)
    else:
        maps = {"level": style.LEVEL_MAP, "unit": style.LEVEL_MAP, "phase": style.PHASE_MAP}
        how = {"cmap": maps.get(what.scale, style.SIGNED_MAP), "vmin": what.low, "vmax": what.high}
        image = style.draw_map(axes, what.values, x, y, **how)
        style.colour_bar(axes, image, what.bar)
    if what.scale == "difference":
        axes.set_facecolor("0.85")  # not compared
    axes.set_title(what.title)
    symbol = {"1/m": r"\nu"}.get(picture.axis_unit, r"\xi" if picture.name == "otf" else "")
    unit = f"1/{state.unit}" if picture.axis_unit == "1/m" else state.unit
    for label, component in ((axes.set_xlabel, "x"), (axes.set_ylabel, "y")):
        label(f"${symbol}_{component}$ ({unit})" if symbol else f"${component}$ ({unit})")


def _draw_cuts(axes: Any, cuts: views.Cuts) -> None:
    floor = cuts.largest + FLOOR_DB
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    for k, (name, levels) in enumerate(cuts.lines):
        style = {"ls": ("-", "--", ":", "-.")[k], "color": f"C{k % 2}", "lw": 1}
        axes.plot(cuts.theta, np.maximum(levels, floor), label=name, **style)
    axes.set_thetamin(-90)
    axes.set_thetamax(90)
    axes.set_ylim(floor, cuts.largest + 2)
    axes.set_yticks(np.arange(10 * np.ceil(floor / 10), cuts.largest, 10))
    axes.set_ylabel("directivity (dBi)", labelpad=28)
    axes.legend(loc="lower center", ncols=2, frameon=False)
