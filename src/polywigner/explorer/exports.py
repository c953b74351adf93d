"""Downloads for a visitor: outlines as GeoJSON and SVG, views as pictures and values."""

from __future__ import annotations

import io
import json
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from polywigner.explorer import views
from polywigner.explorer.computing import final_samples
from polywigner.explorer.outlines import aperture_of, feeding_of
from polywigner.explorer.state import UNITS, State, to_query

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def geojson(state: State) -> str:
    """The outline of the element as a GeoJSON Feature, in mm, as it is read without a unit.

    Raises PolywignerError for what is no polygon, here as in all of this module.
    """
    polygons = aperture_of(state.rings, state.per_metre).polygons
    # 15 digits give back the number that was typed
    typed = np.vectorize(lambda metres: float(f"{metres * UNITS['mm']:.15g}"))
    drawn = polygons if len(polygons.geoms) > 1 else polygons.geoms[0]
    feature = {
        "type": "Feature",
        "properties": {"unit": "mm", "wave": state.wave},
        "geometry": shapely.geometry.mapping(shapely.transform(drawn, typed)),
    }
    return json.dumps(feature, indent=1) + "\n"


def svg(state: State) -> str:
    """The outline of the element as an SVG drawing in millimetres, y upwards.

    :func:`polywigner.read_aperture` reads it back.
    """
    aperture = aperture_of(state.rings, state.per_metre)
    xmin, ymin, xmax, ymax = (1e3 * v for v in aperture.bounds)
    paths = "".join(
        "M" + " L".join(f"{1e3 * x:.15g},{-1e3 * y:.15g}" for x, y in ring.coords[:-1]) + "Z"
        for polygon in aperture.polygons.geoms
        for ring in (polygon.exterior, *polygon.interiors)
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
    arrays: dict[str, Any] = {}
    if name == "far":
        cuts = views.far_field(state)
        arrays = {"theta_rad": cuts.theta, "phi_rad": cuts.phi, "directivity_dbi": cuts.directivity}
        if cuts.cross is not None:
            arrays["cross_polar_dbi"] = cuts.cross
    else:
        picture = views.PICTURES[name](state, final_samples(state, name))
        axis = np.linspace(-picture.half, picture.half, picture.samples)
        first, second = (middle + axis for middle in picture.centre)
        units = {"axis_unit": picture.axis_unit, "unit": picture.unit}
        arrays = {"first": first, "second": second, **units, **picture.arrays}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays, link=to_query(state))
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
                _draw(axes, picture, views.shown(picture, key, state.part, state.unit), state)
        lit = [state.wave, *(f"{key} {text}" for key, text in feeding_of(state))]
        if state.coherence and name in ("wigner_nu", "wigner_x"):
            lit.append(f"coherent over {state.coherence:g} {state.unit}")
        figure.suptitle("; ".join([*lit, _chosen(state, name)]), fontsize=9, wrap=True)
    return figure


def _chosen(state: State, name: str) -> str:
    (x, y), nu, polarisation = state.x, state.nu, state.polarisation.strip()
    co_and_cross = f"polarisation {polarisation}: co- and cross-polar"
    return {
        "fourier": "Fourier transform",
        "wigner_nu": f"x = ({x:g}, {y:g}) {state.unit}",
        "wigner_x": f"ν = ({nu[0]:g}, {nu[1]:g}) / {state.unit}",
        "otf": f"defocus {state.defocus:g} waves",
        "near": f"z = {state.distance:g} {state.unit}, rays of order {state.order}",
        "far": co_and_cross if polarisation else "directivity",
    }[name]


def _draw(axes: Axes, picture: views.Picture, what: views.Shown, state: State) -> None:
    from polywigner.figures import style

    scale, unit = picture.axis_in(state.unit)
    along = np.linspace(-picture.half, picture.half, picture.samples)
    x, y = (scale * (middle + along) for middle in picture.centre)
    if what.scale == "signed":
        style.signed_bar(axes, style.draw_signed(axes, what.values, x, y), what.bar)
    else:
        how = {"cmap": views.COLOUR_MAPS[what.scale], "vmin": what.low, "vmax": what.high}
        image = style.draw_map(axes, what.values, x, y, **how)
        style.colour_bar(axes, image, what.bar)
    if what.scale == "difference":
        axes.set_facecolor("0.85")  # not compared
    axes.set_title(what.title)
    symbol = {"1/m": r"\nu"}.get(picture.axis_unit, r"\xi" if picture.name == "otf" else "")
    for label, component in ((axes.set_xlabel, "x"), (axes.set_ylabel, "y")):
        label(f"${symbol}_{component}$ ({unit})" if symbol else f"${component}$ ({unit})")


def _draw_cuts(axes: Any, cuts: views.Cuts) -> None:
    floor = cuts.largest + views.FLOOR_DB
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
