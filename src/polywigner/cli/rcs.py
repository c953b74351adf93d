"""``polywigner rcs``: the radar cross section of a body or plate over azimuth and elevation."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from polywigner.cli.fields import format_suffixes
from polywigner.cli.options import (
    DbFloor,
    Frequency,
    Layer,
    Out,
    Tolerance,
    Union,
    Unit,
    Wavelength,
    parse_step,
)
from polywigner.cli.output import files_to_write, writing
from polywigner.cli.sources import (
    Reading,
    check_source_file,
    field_title,
    required_wavelength,
    wavelength_from,
)
from polywigner.errors import ArgumentError

_FORMATS = ("csv", "json", "nc")
_MESHES = (".stl", ".ply", ".obj")
# Degrees, unasked: the finest that takes a minute or less. Measured, seconds a direction: triangles
# alone, and those that cast shadows.
_STEPS = (1.0, 2.0, 5.0, 10.0)
_A_MINUTE = 60.0
_PER_TRIANGLE, _PER_SHADOWING = 1e-6, 2e-5
_PER_CUT = 2e-3
# Directions: some hours of a simple body, 0.1 GB.
_MOST = 4_000_000


def rcs(
    body: Annotated[
        str,
        typer.Argument(
            help="Mesh of a body: STL, PLY or OBJ; or an aperture file, whose outline is a plate "
            "in the plane z = 0."
        ),
    ],
    frequency: Frequency = None,
    wavelength: Wavelength = None,
    polarisation: Annotated[
        str | None,
        typer.Option(help="vv, hh, vh or hv, receiver first (default: all that returns)."),
    ] = None,
    step: Annotated[
        str | None,
        typer.Option(help="Step of the angles, such as '2 deg' (default: the finest in a minute)."),
    ] = None,
    unit: Unit = None,
    tolerance: Tolerance = None,
    layer: Layer = None,
    union: Union = False,
    floor_db: DbFloor = -40.0,
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            help="Format of the values: csv (default), json, nc; several times for more.",
        ),
    ] = None,
    out: Out = None,
) -> None:
    """Compute the radar cross section of a metal body or plate, by physical optics.

    Prints the largest value and its direction. Writes a figure NAME_rcs.png (polar cuts, and a map
    over azimuth and elevation, in dBsm) and the values.
    """
    reading = Reading(unit, tolerance, layer, union)
    check_source_file(body, reading)
    length = required_wavelength(wavelength_from(frequency, wavelength))
    asked = None if step is None else parse_step(step, 30.0, _MOST // 2)
    suffixes = format_suffixes(formats or ["csv"], _FORMATS)
    files = files_to_write(out, Path(body).stem + "_rcs", (".png", *suffixes))

    # Everything cheap has been checked: only now the libraries that take a second to import.
    import numpy as np

    import polywigner as pw
    from polywigner.figures import draw_rcs
    from polywigner.figures.levels import check_floor
    from polywigner.scattering.facets import facets_of

    check_floor(floor_db)
    metal = _read(body, reading)
    facets = facets_of(metal)
    degrees = _enough(len(facets.corner), facets.casts_shadows) if asked is None else asked
    count = round(90.0 / degrees)
    _warn_of_lobes(90.0 / count, facets.size / length)
    azimuth = np.radians(np.arange(-2 * count, 2 * count + 1) * 90.0 / count)
    elevation = np.radians(np.arange(-count, count + 1) * 90.0 / count)
    pattern = pw.rcs_pattern(
        metal, length, azimuth, elevation, polarisation=cast(Any, polarisation)
    )
    figure = draw_rcs(pattern, floor_db=floor_db, title=field_title(body, length))
    with writing(files) as (picture, *values):
        figure.savefig(picture, format="png")
        for partial in values:
            _write(pattern, partial)
        print(_summary(pattern, floor_db))


def _read(path: str, reading: Reading) -> Any:
    """The body of a mesh, or the plate of an aperture file."""
    import polywigner as pw

    if Path(path).suffix.lower() not in _MESHES:
        return pw.read_aperture(path, **reading.of_aperture())
    for name in ("tolerance", "layer", "union"):
        if getattr(reading, name):
            raise ArgumentError(f"expected no --{name} with a mesh; it is for drawings")
    return pw.read_polyhedron(path, unit=reading.unit or "mm")


def _write(pattern: Any, path: Path) -> None:
    import numpy as np

    if path.suffix == ".nc":
        import polywigner as pw

        pw.write_netcdf(pattern, path)
        return
    azimuth, elevation, values = (pattern[n].values for n in ("azimuth", "elevation", "rcs"))
    if path.suffix == ".json":
        content = {
            **pattern.attrs,
            "azimuth_deg": np.degrees(azimuth).tolist(),
            "elevation_deg": np.degrees(elevation).tolist(),
            "rcs_m2": values.tolist(),
        }
        path.write_text(json.dumps(content) + "\n", encoding="utf-8")
        return
    rows = np.column_stack(
        [
            np.repeat(np.degrees(azimuth), len(elevation)),
            np.tile(np.degrees(elevation), len(azimuth)),
            values.ravel(),
        ]
    )
    np.savetxt(path, rows, "%.12g", ",", header="azimuth_deg,elevation_deg,rcs_m2", comments="")


def _summary(pattern: Any, floor_db: float) -> str:
    import numpy as np

    values = pattern["rcs"].values
    i, j = np.unravel_index(int(values.argmax()), values.shape)
    peak = 10 * math.log10(values[i, j])
    azimuth, elevation = (
        math.degrees(pattern[name].values[k]) for name, k in (("azimuth", i), ("elevation", j))
    )
    return (
        f"largest RCS   {peak:.2f} dBsm at azimuth {azimuth:g} deg, elevation {elevation:g} deg\n"
        f"picture       down to {peak + floor_db:.2f} dBsm\n"
        f"triangles     {pattern.attrs['triangles']}\n"
        "method        physical optics: one reflection, no waves of edges (docs/rcs.md)"
    )


def _warn_of_lobes(step: float, wavelengths: float) -> None:
    """Backscatter of a body D across has lobes lambda/(2 D) wide."""
    lobe = math.degrees(0.5 / wavelengths)
    if step > lobe:
        warnings.warn(
            f"steps of {step:.3g} degrees miss lobes of {lobe:.2g} degrees, those of a body "
            f"{wavelengths:.4g} wavelengths across; give --step, or use polywigner.rcs on "
            "directions about those you need",
            RuntimeWarning,
            stacklevel=3,
        )


def _enough(triangles: int, casts_shadows: bool) -> float:
    """The finest step that takes about a minute, or the coarsest."""
    seconds = triangles * _PER_TRIANGLE
    if casts_shadows:
        seconds += triangles * _PER_SHADOWING + _PER_CUT
    for step in _STEPS:
        if 2 * (180 / step) ** 2 * seconds <= _A_MINUTE:
            return step
    return _STEPS[-1]
