"""Python code that computes a view, digit for digit."""

from __future__ import annotations

from polywigner.explorer import views
from polywigner.explorer.computing import final_samples
from polywigner.explorer.outlines import feeding_of, polygons_of
from polywigner.explorer.state import State

SNIPPETS = ("fourier", "wigner_nu", "wigner_x", "otf", "near", "far")
"""The views that have one."""


def snippet(state: State, name: str, samples: int | None = None) -> str:
    """Script that computes the view's arrays as ``values`` (for "near" ``rays`` and ``exact``).

    ``name`` is one of :data:`SNIPPETS`; ``samples`` along each axis, None: as the page shows in
    the end. Raises PolywignerError for a state without a source.
    """
    lines = ["import numpy as np", "import shapely", "", "import polywigner as pw", ""]
    lines += _source_lines(state)
    lines += _view_lines(state, name, samples)
    return "\n".join(lines) + "\n"


def _source_lines(state: State) -> list[str]:
    polygons = polygons_of(state.rings, state.per_metre)
    lines = [
        f"wavelength = {state.wavelength!r}  # m, {state.wave!r}",
        "source = pw.Aperture(",
        "    [",
    ]
    for exterior, *holes in polygons:
        inner = f", {[ring.tolist() for ring in holes]}" if holes else ""
        lines.append(f"        shapely.Polygon({exterior.tolist()}{inner}),")
    lines += ["    ]", ")  # m"]
    feeding = dict(feeding_of(state))
    if feeding:
        lines += [
            "from polywigner.illumination.texts import fed",
            "",
            f"source = fed(source, {feeding!r}, wavelength)",
        ]
    if state.coherence:
        width = state.metres(state.coherence)
        lines.append(f"light = source.partially_coherent({width!r})")
    return [*lines, ""]


def _axis_lines(half: float, samples: int, x: float = 0.0, y: float = 0.0) -> list[str]:
    shifted = f"{x!r} + axis, {y!r} + axis" if (x, y) != (0.0, 0.0) else "axis, axis"
    return [
        f"axis = np.linspace({-half!r}, {half!r}, {samples})",
        f"grid = np.stack(np.meshgrid({shifted}), axis=-1)",
    ]


def _view_lines(state: State, name: str, samples: int | None) -> list[str]:
    count = samples or final_samples(state, name)
    engine = f'engine="{views.ENGINE}"'
    x, y = (state.metres(v) for v in state.x)
    nu = tuple(v * state.per_metre for v in state.nu)
    centre = views.position_window(state)
    light = "light" if state.coherence else "source"
    if name == "fourier":
        return [
            *_axis_lines(views.frequency_half(state), count),
            f"values = pw.fourier(source, grid, {engine})  # m^2",
        ]
    if name == "wigner_nu":
        return [
            *_axis_lines(views.frequency_half(state), count),
            f"values = pw.wigner({light}, ({x!r}, {y!r}), grid, {engine})  # m^2",
        ]
    if name == "wigner_x":
        return [
            *_axis_lines(centre[2], count, *centre[:2]),
            f"values = pw.wigner({light}, grid, {nu!r}, {engine})  # m^2",
        ]
    if name == "otf":
        return [
            *_axis_lines(views.lag_half(state), count),
            f"values = pw.otf(source, grid, {state.defocus!r}, {engine})",
        ]
    if name == "near":
        return [
            *_axis_lines(views.plane_half(state), count, *centre[:2]),
            f"z = np.full((*grid.shape[:2], 1), {state.metres(state.distance)!r})",
            "points = np.concatenate([grid, z], axis=-1)",
            f"parts = np.array_split(points, {views.near_strips(state, count)})",
            "rays = np.concatenate(",
            "    [",
            "        pw.irradiance(",
            '            source, part, wavelength, obliquity="kirchhoff",',
            f"            order={state.order}, tolerance={views.NEAR_TOLERANCE!r},",
            "        )",
            "        for part in parts",
            "    ]",
            ")",
            "exact = np.concatenate(",
            '    [pw.irradiance(source, part, wavelength, "kirchhoff") for part in parts]',
            ")",
        ]
    theta = views.angles(state)
    lines = [
        f"theta = np.linspace({float(theta[0])!r}, {float(theta[-1])!r}, {len(theta)})",
        f"phi = {views.azimuths(state)!r}",
    ]
    if not state.polarisation.strip():
        return [
            *lines,
            f"pattern = pw.radiation_pattern(source, wavelength, theta, phi, {engine})",
            'values = np.asarray(pattern["directivity"].values)  # dBi',
        ]
    return [
        *lines,
        "pattern = pw.radiation_pattern(",
        f"    source, wavelength, theta, phi, {engine}, polarisation={state.polarisation!r}",
        ")",
        'power = pattern.attrs["radiated_power"]',
        'with np.errstate(divide="ignore"):',
        "    values, cross = (  # dBi, co- and cross-polar",
        "        10 * np.log10(4 * np.pi / power * np.abs(pattern[part].values) ** 2)",
        '        for part in ("field", "cross_field")',
        "    )",
    ]
