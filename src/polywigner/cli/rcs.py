"""``polywigner rcs``: the radar cross section of a body or plate over azimuth and elevation."""

from __future__ import annotations

import json
import math
import shutil
import sys
import time
import warnings
from collections.abc import Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from polywigner.cli import options
from polywigner.cli.sources import Reading, WaveOptions, field_title, required_wavelength
from polywigner.quantities import parse_angle

if TYPE_CHECKING:
    from polywigner.scattering.cross_sections import Pattern

_Format = StrEnum("_Format", "csv json nc")
# Default steps in degrees: the finest one that takes a minute or less.
_STEPS = (1.0, 2.0, 5.0, 10.0)
_A_MINUTE, _MOMENTS = 60.0, 10.0
# Directions whose time is measured first, from the fewest on until they take so many seconds.
_FEWEST_TIMED, _MOST_TIMED, _TIMED = 8, 512, 0.5
# Directions: some hours of a simple body, 0.1 GB.
_MOST = 4_000_000
# Steps to a lobe of backscatter in cuts, which take half a minute each or less.
_TO_A_LOBE, _OF_A_CUT = 4.0, 30.0
_FINEST, _MOST_OF_CUTS = 1e-3, 33_000_000_000


def rcs(
    *,
    body: Annotated[
        str,
        typer.Argument(
            help="Mesh of a body: STL, PLY or OBJ; or an aperture file, whose outline is a plate "
            "in the plane z = 0."
        ),
    ],
    wave: WaveOptions,
    polarisation: Annotated[
        str | None, "vv, hh, vh or hv, receiver first (default: all that returns)."
    ] = None,
    step: Annotated[
        str | None, "Step of the angles, such as '2 deg' (default: the finest in a minute)."
    ] = None,
    bounces: Annotated[
        int, typer.Option(min=1, max=3, help="Reflections that count (corner reflectors: 3).")
    ] = 1,
    cut_step: Annotated[
        str | None,
        "Step of both cuts, such as '0.05 deg' (default: a fourth of a lobe, or the "
        "finest in a minute).",
    ] = None,
    cut_elevation: Annotated[str, "Elevation of the cut over azimuth, such as '35 deg'."] = "0 deg",
    cut_azimuth: Annotated[str, "Azimuth of the cut over elevation, such as '45 deg'."] = "0 deg",
    smooth: Annotated[
        str | None, "Width of a running median, drawn over the cuts, such as '2 deg'."
    ] = None,
    open_mesh: Annotated[
        bool, "Take a mesh as thin plates with two sides; it may be open."
    ] = False,
    reading: Reading,
    resumable: options.Resumable = False,
    floor_db: options.DbFloor = -60.0,
    formats: Annotated[
        list[_Format] | None,
        "Format of the values: csv (default), json, nc; several times for more.",
    ] = None,
    out: options.Out = None,
) -> None:
    """Compute the radar cross section of a metal body or plate, by physical optics.

    Measures first how long it takes. Prints the largest value and its direction. Writes a figure
    NAME_rcs.png (cuts over azimuth and over elevation, and a map of both, in dBsm), the values of
    the map, and those of the cuts in NAME_rcs_cuts.csv.
    """
    reading.check_file(body)
    length = required_wavelength(wave.length())
    asked = None if step is None else options.parse_step(step, 30.0, _MOST // 2)
    asked_of_cuts = None if cut_step is None else options.parse_step(cut_step, 30.0, _MOST_OF_CUTS)
    places = parse_angle(cut_azimuth), parse_angle(cut_elevation)
    width = None if smooth is None else parse_angle(smooth)
    suffixes = options.suffixes_of(formats or ["csv"])
    files = options.files_to_write(out, Path(body).stem + "_rcs", (".png", "_cuts.csv", *suffixes))

    import numpy as np

    from polywigner.figures import draw_rcs
    from polywigner.propagation.stores import require_stores
    from polywigner.scattering.cross_sections import Pattern
    from polywigner.scattering.facets import facets_of
    from polywigner.scattering.near_fields import checked_channel

    channel = None if polarisation is None else checked_channel(polarisation)
    metal = reading.read_body(body, open_mesh)
    find = partial(Pattern, metal, length, polarisation=channel, bounces=bounces)
    one = find(0.0, 0.0)
    store = files[0].with_suffix(".parts.zarr") if resumable else None
    if store is not None:
        require_stores()
    wavelengths = facets_of(metal).size / length
    steps = None if store is None else _steps_in(store)
    if steps is None:
        seconds = seconds_of_direction(one)
        degrees = _enough(seconds) if asked is None else asked
        fine = _of_cuts(seconds, wavelengths) if asked_of_cuts is None else asked_of_cuts
        _say_time(seconds, 90.0 / round(90.0 / degrees), fine)
    else:
        degrees, fine = steps
    count = round(90.0 / degrees)
    _warn_of_lobes("the map", 90.0 / count, wavelengths, "--step")
    _warn_of_lobes("the cuts", fine, wavelengths, "--cut-step")
    azimuth = np.radians(np.arange(-2 * count, 2 * count + 1) * 90.0 / count)
    elevation = np.radians(np.arange(-count, count + 1) * 90.0 / count)
    around = np.linspace(-np.pi, np.pi, round(360.0 / fine) + 1)
    above = np.linspace(-np.pi / 2, np.pi / 2, round(180.0 / fine) + 1)
    wanted = [
        find(around, places[1]),
        find(places[0] + np.array([0.0, np.pi]), above),
        find(azimuth, elevation),
    ]
    settings = {"requested": [asked, asked_of_cuts, *places], "steps": [degrees, fine]}
    *cuts, pattern = _computed(wanted, store, settings)
    title = field_title(body, length)
    figure = draw_rcs(pattern, cuts=cuts, smooth=width, floor_db=floor_db, title=title)
    values = [pattern if name == ".nc" else partial(write_values, pattern) for name in suffixes]
    contents = [figure, partial(_write_rows, cuts), *values]
    options.write(files, contents, _summary([pattern, *cuts], floor_db))
    if store is not None:
        shutil.rmtree(store, ignore_errors=True)


def _steps_in(store: Path) -> tuple[float, float] | None:
    """Return the steps of the map and of the cuts of an interrupted run; None without a store."""
    from polywigner.propagation.stores import open_store

    steps = open_store(store).attrs.get("steps") if store.exists() else None
    return None if steps is None else (steps[0], steps[1])


def _computed(patterns: Sequence[Pattern], store: Path | None, settings: dict[str, Any]) -> Any:
    """Compute the datasets of patterns, with a store of complete parts if there is one."""
    if store is None:
        from polywigner.execution.progress import progress_bar

        with progress_bar("directions", sum(math.prod(one.shape) for one in patterns)) as advance:
            return [one.dataset(one.values(advance)) for one in patterns]
    from polywigner.propagation.stores import lazy_array, write_store
    from polywigner.transforms.xarray_arguments import labelled_arrays

    tables = {}
    for k, one in enumerate(patterns):
        one.warn()
        chunks = one.together, len(one.elevation)
        values = lazy_array(one.part, one.shape, chunks, "float64")
        tables[f"rcs_{k}"] = (f"azimuth_{k}", f"elevation_{k}"), values
    settings |= patterns[0].settings()
    with write_store(store, labelled_arrays(tables, {}, settings)) as stored:
        return [one.dataset(stored[f"rcs_{k}"].values) for k, one in enumerate(patterns)]


def _say_time(seconds: float, step: float, fine: float) -> None:
    """Write on stderr the time that the map and the cuts will take."""
    total = seconds * (2 * (180 / step) ** 2 + 720 / fine)
    about = f"about {round(total)} s" if total < 2 * _A_MINUTE else f"about {total / 60:.0f} min"
    about = about if total > _MOMENTS else "some seconds"
    sys.stderr.write(
        f"polywigner: takes {about}: a map in steps of {step:.3g} deg, cuts in steps of "
        f"{fine:.3g} deg\n"
    )
    sys.stderr.flush()


def _write_rows(patterns: Sequence[Any], path: Path) -> None:
    """Write all values of patterns as CSV, one a row."""
    import numpy as np

    for number, pattern in enumerate(patterns):
        table = pattern["rcs"].to_series().reset_index()
        table.columns = ["azimuth_deg", "elevation_deg", "rcs_m2"]
        table.iloc[:, :2] = np.degrees(table.iloc[:, :2])
        how = {"mode": "a", "header": False} if number else {"mode": "w"}
        table.to_csv(path, index=False, float_format="%.12g", na_rep="nan", **how)


def write_values(pattern: Any, path: Path) -> None:
    """Write the values of a pattern as CSV or JSON, with null or nan for failed directions."""
    import numpy as np

    if path.suffix != ".json":
        _write_rows([pattern], path)
        return
    azimuth, elevation, values = (pattern[n].values for n in ("azimuth", "elevation", "rcs"))
    content = {
        **pattern.attrs,
        "azimuth_deg": np.degrees(azimuth).tolist(),
        "elevation_deg": np.degrees(elevation).tolist(),
        "rcs_m2": [[None if math.isnan(v) else v for v in row] for row in values.tolist()],
    }
    path.write_text(json.dumps(content) + "\n", encoding="utf-8")


def _summary(patterns: Sequence[Any], floor_db: float) -> str:
    import numpy as np

    pattern = max(patterns, key=lambda found: float(found.attrs["largest_rcs"]))
    values = pattern["rcs"].values
    i, j = np.unravel_index(int(np.nanargmax(values)), values.shape)
    peak = 10 * math.log10(values[i, j])
    azimuth, elevation = (
        math.degrees(pattern[name].values[k]) for name, k in (("azimuth", i), ("elevation", j))
    )
    return (
        f"largest RCS   {peak:.2f} dBsm at azimuth {azimuth:.6g} deg, elevation {elevation:.6g} deg"
        f"\npicture       down to {peak + floor_db:.2f} dBsm\n"
        f"triangles     {pattern.attrs['triangles']}\n"
        f"method        {pattern['rcs'].attrs['method']} (docs/rcs.md)"
    )


def _warn_of_lobes(name: str, step: float, wavelengths: float, option: str) -> None:
    """Backscatter of a body D across has lobes lambda/(2 D) wide."""
    lobe = math.degrees(0.5 / wavelengths)
    if step > lobe:
        warnings.warn(
            f"steps of {step:.3g} degrees miss lobes of {lobe:.2g} degrees in {name}, those of a "
            f"body {wavelengths:.4g} wavelengths across; give {option}, or use polywigner.rcs on "
            "directions about those you need",
            RuntimeWarning,
            stacklevel=3,
        )


def seconds_of_direction(pattern: Pattern) -> float:
    """Measure the seconds that a direction takes, on directions spread evenly over all angles."""
    import numpy as np

    count = _FEWEST_TIMED
    while True:
        numbers = np.arange(count) + 0.5
        azimuth = 2 * np.pi * (numbers * (math.sqrt(5) - 1) / 2 % 1)
        begun = time.perf_counter()
        pattern.at(azimuth, np.pi * (numbers / count - 0.5))
        elapsed = time.perf_counter() - begun
        if elapsed > _TIMED or count >= _MOST_TIMED:
            return elapsed / count
        count = min(_MOST_TIMED, max(2 * count, round(count * _TIMED / elapsed)))


def _enough(seconds: float) -> float:
    """The finest step that takes about a minute, or the coarsest."""
    for step in _STEPS:
        if 2 * (180 / step) ** 2 * seconds <= _A_MINUTE:
            return step
    return _STEPS[-1]


def _of_cuts(seconds: float, wavelengths: float) -> float:
    """The step in degrees that resolves lobes in cuts, or the finest that takes a minute."""
    lobe = math.degrees(0.5 / wavelengths)
    step = max(lobe / _TO_A_LOBE, 360.0 * seconds / _OF_A_CUT, _FINEST)
    return min(360.0 / math.ceil(360.0 / step), _STEPS[0])
