"""``polywigner rcs``: the radar cross section of a body or plate over azimuth and elevation."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from polywigner.cli import options
from polywigner.cli.options import Text
from polywigner.cli.sources import Reading, WaveOptions, field_title, required_wavelength
from polywigner.quantities import parse_angle

if TYPE_CHECKING:
    import xarray

    from polywigner.scattering.cross_sections import Pattern

_Format = StrEnum("_Format", "csv nc")
# Default steps of the map in degrees, and the time that it may take [s].
_STEPS, _MAP_SECONDS = (1.0, 2.0, 5.0, 10.0), 60.0
# Directions whose time is measured.
_TIMED = 8
# Directions of the map: some hours for a simple body, 0.1 GB.
_MOST = 4_000_000
# Steps per lobe of backscatter in the cuts, and the time that they may take [s].
_STEPS_PER_LOBE, _CUT_SECONDS = 4.0, 30.0
_FINEST, _MOST_OF_CUTS = 1e-3, 33_000_000_000


def rcs(
    *,
    body: Annotated[str, typer.Argument(help="Mesh of a body, or aperture file of a plate.")],
    wave: WaveOptions,
    polarisation: Annotated[Text, "vv, hh, vh or hv, receiver first (default: total)."] = None,
    step: Annotated[Text, "Step of the map: '2 deg' (default: 1 to 10 deg by time)."] = None,
    bounces: Annotated[
        int, typer.Option(min=1, max=3, help="Number of reflections (corner reflectors: 3).")
    ] = 1,
    cut_step: Annotated[Text, "Step of the cuts: '0.05 deg' (default: a quarter lobe)."] = None,
    cut_elevation: Annotated[str, "Elevation of the cut over azimuth, such as '35 deg'."] = "0 deg",
    cut_azimuth: Annotated[str, "Azimuth of the cut over elevation, such as '45 deg'."] = "0 deg",
    smooth: Annotated[Text, "Width of a running median over the cuts, such as '2 deg'."] = None,
    open_mesh: Annotated[bool, "Read the faces of a mesh as thin plates with two sides."] = False,
    reading: Reading,
    floor_db: options.DbFloor = -60.0,
    formats: Annotated[list[_Format] | None, "csv or nc (repeatable; default: csv)."] = None,
    out: options.Out = None,
) -> None:
    """Compute the radar cross section of a metal body or plate by physical optics.

    Prints the largest value and its direction. Writes a figure NAME_rcs.png (cuts over azimuth and
    over elevation, and a map of both, in dBsm), the values of the map, and the values of the cuts
    in NAME_rcs_cuts.csv.
    """
    reading.check_file(body)
    length = required_wavelength(wave.length())
    map_step = None if step is None else options.parse_step(step, 30.0, _MOST // 2)
    fine_step = None if cut_step is None else options.parse_step(cut_step, 30.0, _MOST_OF_CUTS)
    centre = parse_angle(cut_azimuth), parse_angle(cut_elevation)
    width = None if smooth is None else parse_angle(smooth)
    suffixes = options.suffixes_of(formats or ["csv"])
    files = options.files_to_write(out, Path(body).stem + "_rcs", (".png", "_cuts.csv", *suffixes))

    import numpy as np

    from polywigner.execution.progress import progress_bar
    from polywigner.figures import draw_rcs
    from polywigner.scattering.cross_sections import Pattern
    from polywigner.scattering.facets import facets_of

    metal = reading.read_body(body, open_mesh)
    pattern_of = partial(Pattern, metal, length, polarisation=polarisation, bounces=bounces)
    lobe = math.degrees(length / (2 * facets_of(metal).size))
    degrees, fine = _steps(pattern_of(0.0, 0.0), map_step, fine_step, lobe)
    count = round(90.0 / degrees)
    _warn_of_lobes("the map", 90.0 / count, lobe, "--step")
    _warn_of_lobes("the cuts", fine, lobe, "--cut-step")
    azimuth = np.radians(np.arange(-2 * count, 2 * count + 1) * 90.0 / count)
    elevation = np.radians(np.arange(-count, count + 1) * 90.0 / count)
    around = np.linspace(-np.pi, np.pi, round(360.0 / fine) + 1)
    above = np.linspace(-np.pi / 2, np.pi / 2, round(180.0 / fine) + 1)
    patterns = [
        pattern_of(around, centre[1]),
        pattern_of(centre[0] + np.array([0.0, np.pi]), above),
        pattern_of(azimuth, elevation),
    ]
    with progress_bar("directions", sum(math.prod(one.shape) for one in patterns)) as advance:
        *cuts, pattern = [one.dataset(one.values(advance)) for one in patterns]
    title = field_title(body, length)
    figure = draw_rcs(pattern, cuts=cuts, smooth=width, floor_db=floor_db, title=title)
    values = [pattern if name == ".nc" else partial(write_rows, [pattern]) for name in suffixes]
    contents = [figure, partial(write_rows, cuts), *values]
    options.write(files, contents, _summary([pattern, *cuts], floor_db))


def _steps(
    pattern: Pattern, map_step: float | None, fine_step: float | None, lobe: float
) -> tuple[float, float]:
    """Return the steps of map and cuts in degrees, by default from the time of a direction."""
    import numpy as np

    azimuth, elevation = np.linspace(-3.0, 3.0, _TIMED), np.linspace(-1.4, 1.5, _TIMED)
    pattern.at(azimuth[:1], elevation[:1])  # fills caches
    start = time.perf_counter()
    pattern.at(azimuth, elevation)
    seconds = (time.perf_counter() - start) / _TIMED
    if map_step is None:
        quick = [step for step in _STEPS if 2 * (180 / step) ** 2 * seconds <= _MAP_SECONDS]
        map_step = min(quick, default=_STEPS[-1])
    if fine_step is None:
        fine_step = max(lobe / _STEPS_PER_LOBE, 360.0 * seconds / _CUT_SECONDS, _FINEST)
        fine_step = min(360.0 / math.ceil(360.0 / fine_step), _STEPS[0])
    return map_step, fine_step


def write_rows(patterns: Sequence[xarray.Dataset], path: Path) -> None:
    """Write patterns as CSV, one row per direction; failed values are nan."""
    import numpy as np

    for number, pattern in enumerate(patterns):
        table = pattern["rcs"].to_series().reset_index()
        table.columns = ["azimuth_deg", "elevation_deg", "rcs_m2"]
        table.iloc[:, :2] = np.degrees(table.iloc[:, :2])
        settings: dict[str, Any] = {"mode": "a", "header": False} if number else {}
        table.to_csv(path, index=False, float_format="%.12g", na_rep="nan", **settings)


def _summary(patterns: Sequence[xarray.Dataset], floor_db: float) -> str:
    pattern = max(patterns, key=lambda each: float(each.attrs["largest_rcs"]))
    largest = pattern["rcs"].isel(pattern["rcs"].argmax(["azimuth", "elevation"]))
    peak = 10 * math.log10(float(largest))
    azimuth, elevation = (math.degrees(largest[name]) for name in ("azimuth", "elevation"))
    return (
        f"largest RCS   {peak:.2f} dBsm at azimuth {azimuth:.6g} deg, elevation {elevation:.6g} deg"
        f"\nfigure        down to {peak + floor_db:.2f} dBsm\n"
        f"triangles     {pattern.attrs['triangles']}\n"
        f"method        {pattern['rcs'].attrs['method']} (docs/rcs.md)"
    )


def _warn_of_lobes(name: str, step: float, lobe: float, option: str) -> None:
    """Warn of steps in degrees that are larger than lobes, lambda/(2 D) wide for a size D."""
    if step > lobe:
        warnings.warn(
            f"steps of {step:.3g} degrees miss lobes of {lobe:.2g} degrees in {name}; give "
            f"{option}, or use polywigner.rcs on directions about those you need",
            RuntimeWarning,
            stacklevel=3,
        )
