"""The eight views of a state: the code that computes each view, and its image and file."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polywigner.explorer import state as states
from polywigner.explorer.state import State, polygons_of, source_of, variables_of
from polywigner.figures import style
from polywigner.figures.levels import level_db
from polywigner.source.array import mutual_support

Polygon = list[NDArray[np.float64]]  # exterior and holes, each an array (n, 2)
Name = Literal["fourier", "wigner_nu", "wigner_x", "ambiguity", "otf", "far", "near", "lags"]

VIEWS: Mapping[Name, str] = {
    "fourier": "Fourier transform", "wigner_nu": "Wigner over ν", "wigner_x": "Wigner over x",
    "ambiguity": "Ambiguity", "otf": "OTF", "far": "Directivity", "near": "Near field",
    "lags": "Lag slice",
}  # fmt: skip
# largest number of samples along each axis; odd, so that the centre is a sample
SAMPLES = 161
FLOOR_DB = -40.0
_LOBES = 8.0  # half width of frequency axes [1/diagonal of the source]
_MARGIN = 1.05  # factor by which position and lag axes exceed the extent of the source
_BEAM = 3.0  # margin of the near-field image around the source [lobe widths]
_WIDE = 0.5  # largest direction cosine above which all directions are shown

_GRID = """
axis = np.linspace(-{half!r}, {half!r}, {samples})
x, y = {x!r} + axis, {y!r} + axis
grid = np.stack(np.meshgrid(x, y), axis=-1)
"""
# Code of each view for NumPy, because a compiled engine would compile kernels for each outline.
_CODE: Mapping[Name, str] = {
    "fourier": _GRID + 'values = pw.fourier(source, grid, engine="numpy")  # m², axes in 1/m',
    "wigner_nu": _GRID
    + 'values = pw.wigner(source, {position!r}, grid, engine="numpy")  # m², axes in 1/m',
    "wigner_x": _GRID + 'values = pw.wigner(source, grid, {nu!r}, engine="numpy")  # m²',
    "otf": _GRID + 'values = pw.otf(source, grid, {defocus!r}, engine="numpy")',
    "ambiguity": """
x = np.linspace(-{half!r}, {half!r}, {samples})  # lags in m
y = np.linspace(-{half_nu!r}, {half_nu!r}, {samples})  # frequencies in 1/m
xi, upsilon = (np.stack([v, 0 * v], axis=-1) for v in np.meshgrid(x, y))
values = pw.ambiguity(source, upsilon, xi, engine="numpy")  # m²""",
    "near": _GRID
    + """z = np.full((*grid.shape[:2], 1), {distance!r})
points = np.concatenate([grid, z], axis=-1)
values = pw.irradiance(source, points, wavelength, "kirchhoff")""",
    "lags": 'values = pw.lag_slice(getattr(source, "support", source), {position!r})  # m',
    "far": """
x = np.linspace(-{angle!r}, {angle!r}, 361)
pattern = pw.radiation_pattern(
    source, wavelength, x, np.radians({azimuths}), engine="numpy"
)
values = pattern["directivity"].values  # dBi""",
}


def view_code(state: State, name: Name, samples: int = SAMPLES) -> str:
    """Return the code of a view, to run after the code of the source."""
    xmin, ymin, xmax, ymax = source_of(state).bounds
    size, wavelength = _half_size(state), state.wavelength
    distance = state.distance / state.per_metre
    steered = math.sin(math.radians(state.theta))
    lobes = _LOBES * wavelength / (2 * math.sqrt(2) * size)
    reach = state.reach or min(1.0, lobes + steered)
    half_nu, lag = reach / wavelength, _MARGIN * 2 * size
    beam = min(0.7, _BEAM * wavelength / (2 * size) + steered)
    plane = size + distance * beam / math.sqrt(1 - beam**2)
    halves = {"wigner_x": _MARGIN * size, "otf": lag, "ambiguity": lag, "near": plane}
    is_centred = name in ("wigner_x", "near")
    numbers = {
        "samples": samples, "half": float(halves.get(name, half_nu)), "half_nu": float(half_nu),
        "x": (xmin + xmax) / 2 if is_centred else 0.0,
        "y": (ymin + ymax) / 2 if is_centred else 0.0,
        "position": tuple(v / state.per_metre for v in state.x),
        "nu": tuple(v * state.per_metre for v in state.nu),
        "defocus": state.defocus, "distance": distance, "azimuths": [state.phi, state.phi + 90],
        "angle": math.pi / 2 if reach > _WIDE and not state.reach else math.asin(reach),
    }  # fmt: skip
    return _CODE[name].format(**numbers) + "\n"


def _half_size(state: State) -> float:
    """Return half of the larger side of the bounds of the source in metres."""
    xmin, ymin, xmax, ymax = source_of(state).bounds
    return max(xmax - xmin, ymax - ymin) / 2


def snippet(state: State, name: Name, samples: int = SAMPLES) -> str:
    """Return Python code that computes the values of a view as ``values``."""
    imports = "import numpy as np\nimport shapely\n\nimport polywigner as pw\n\n"
    return imports + states.source_code(state) + view_code(state, name, samples)


@dataclass(frozen=True, eq=False)
class View:
    """An image, curves or outlines in units of the page, with the values in SI units."""

    title: str
    x_label: str
    y_label: str
    arrays: Mapping[str, NDArray[Any]]  # values and axes in SI units, by name
    columns: Mapping[str, Sequence[Any]]  # data of the Bokeh glyph
    edges: Sequence[Sequence[float]]  # limits of the horizontal and of the vertical axis
    samples: int = 0  # number of samples along each axis of an image
    limits: tuple[float, float] = (0.0, 1.0)  # limits of the colour scale
    colours: str = style.LEVEL_MAP
    quantity: str = ""  # label of the colour scale


def polygon_columns(polygons: Sequence[Polygon]) -> dict[str, list[Any]]:
    """Return the columns of a MultiPolygons glyph, with a row for each polygon."""
    return {
        axis: [[[ring[:, k].tolist() for ring in polygon]] for polygon in polygons]
        for k, axis in enumerate(("xs", "ys"))
    }


def compute_view(state: State, name: Name, samples: int = SAMPLES) -> View:
    """Compute a view of a state."""
    result = states.run(view_code(state, name, samples), **variables_of(state))
    values, scale, unit = result["values"], float(state.per_metre), state.unit
    at_x = f"at x = ({state.x[0]:.3g}, {state.x[1]:.3g}) {unit}"
    at_nu = f"at ν = ({state.nu[0]:.3g}, {state.nu[1]:.3g}) /{unit}"
    if name == "lags":
        polygons = polygons_of(values)
        reach = _MARGIN * 2 * _half_size(state) * scale
        return View(
            f"Lag slice {at_x}", f"ξ_x ({unit})", f"ξ_y ({unit})",
            {f"ring_{k}": ring for k, ring in enumerate(r for p in polygons for r in p)},
            polygon_columns([[ring * scale for ring in p] for p in polygons]),
            [(-reach, reach)] * 2,
        )  # fmt: skip
    if name == "far":
        azimuths, peak = [state.phi, state.phi + 90], float(values.max())
        top, theta = 5 * math.ceil((peak + 1) / 5), np.degrees(result["x"])
        return View(
            f"Directivity, peak {peak:.2f} dBi", "θ (degrees)", "directivity (dBi)",
            {"values": values, "theta": result["x"], "phi": np.radians(azimuths)},
            {
                "xs": [theta, theta], "ys": list(values.T),
                "label": [f"φ = {azimuth:.4g}°" for azimuth in azimuths],
                "colour": [style.BLUE, style.ACCENT], "dash": ["solid", "dashed"],
            },
            [(theta[0], theta[-1]), (top + FLOOR_DB, top)],
        )  # fmt: skip
    title, *symbols = {
        "fourier": ("Fourier transform F(ν)", "ν_x", "ν_y"),
        "wigner_nu": (f"W(x, ν) {at_x}", "ν_x", "ν_y"),
        "wigner_x": (f"W(x, ν) {at_nu}", "x", "y"),
        "otf": (f"OTF, defocus {state.defocus:.3g} waves", "ξ_x", "ξ_y"),
        "ambiguity": ("Ambiguity A(υ, ξ) along x", "ξ_x", "υ_x"),
        "near": (f"Near field at z = {state.distance:.3g} {unit}", "x", "y"),
    }[name]
    axes = [result["x"], result["y"]]
    x_label, y_label = (f"{s} ({'1/' if s[0] in 'νυ' else ''}{unit})" for s in symbols)
    shown = (a / scale if s[0] in "νυ" else a * scale for s, a in zip(symbols, axes, strict=True))
    halves = [(a, (a[1] - a[0]) / 2) for a in shown]  # axes, and half the size of a pixel
    (x0, x1), (y0, y1) = edges = [(float(a[0] - h), float(a[-1] + h)) for a, h in halves]
    image, limits, colours, quantity = _image(state, name, values)
    columns: dict[str, list[Any]] = {
        "image": [image.astype(np.float32)],
        "x": [x0], "y": [y0], "dw": [x1 - x0], "dh": [y1 - y0],
    }  # fmt: skip
    arrays = {"values": values, "x": axes[0], "y": axes[1]}
    return View(
        title, x_label, y_label, arrays, columns, edges, len(image), limits, colours, quantity
    )


def _image(
    state: State, name: Name, values: NDArray[Any]
) -> tuple[NDArray[np.float64], tuple[float, float], str, str]:
    """Return the displayed values of an image, their limits, colour map and label."""
    scale, unit, part = float(state.per_metre), state.unit, state.part
    if name == "otf":
        return np.abs(values), (0.0, 1.0), style.LEVEL_MAP, "|OTF|"
    if name == "fourier" and part == "phase":
        return np.degrees(np.angle(values)), (-180.0, 180.0), style.PHASE_MAP, "phase in degrees"
    if name.startswith("wigner") or (name == "fourier" and part == "real"):
        real = np.real(values) * scale**2
        peak = float(np.abs(real).max()) or 1.0
        symbol = "Re F" if name == "fourier" else "W"
        return real, (-peak, peak), style.SIGNED_MAP, f"{symbol} in {unit}²"
    power = values if name == "near" else np.abs(values) ** 2
    peak = float(power.max())
    symbol = {"fourier": "|F|²", "ambiguity": "|A|²"}.get(name, "irradiance")
    zero = f"{peak:.3g} |u|²" if name == "near" else f"{peak * scale**4:.3g} {unit}⁴"
    levels = level_db(power, peak if peak > 0 else None, FLOOR_DB)
    return levels, (FLOOR_DB, 0.0), style.LEVEL_MAP, f"{symbol} in dB re {zero}"


def support_of(state: State) -> list[Polygon]:
    """Return the region of positions outside which W is zero, in units of the page."""
    polygons = polygons_of(mutual_support(source_of(state)).polygons)
    return [[ring * state.per_metre for ring in polygon] for polygon in polygons]


def npz(view: View) -> bytes:
    """Return the values and axes of a view as the bytes of an .npz file."""
    buffer, labels = io.BytesIO(), {"title": view.title, "quantity": view.quantity}
    np.savez_compressed(buffer, **view.arrays, **labels)  # type: ignore[arg-type]
    return buffer.getvalue()
