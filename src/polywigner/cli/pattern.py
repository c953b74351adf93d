"""``polywigner pattern``: the far field of a source as a data sheet, with files for other tools."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from polywigner.cli.fields import format_suffixes
from polywigner.cli.options import BoundaryCondition, DbFloor, Out, parse_step
from polywigner.cli.output import files_to_write, writing
from polywigner.cli.sources import (
    SourceOptions,
    check_is_coherent,
    field_title,
)
from polywigner.quantities import parse_power

_FORMATS = ("csv", "txt", "ffd", "cut", "msi", "pln")
# A lobe of a source D across is lambda/D wide; so many steps across it draw it smoothly.
_STEPS_PER_LOBE = 8
# Degrees, unasked: the finest makes 361 x 1440 directions, a second or two for most sources.
_FINEST, _COARSEST = 0.25, 1.0
# Directions in front: 0.2 GB.
_MOST = 4_000_000


def pattern(
    *,
    obliquity: BoundaryCondition = "rayleigh-sommerfeld-1",
    power: Annotated[
        str | None,
        typer.Option(
            help="Power that the antenna accepts, such as '10 dBm' or '10 mW'; without it, no EIRP."
        ),
    ] = None,
    efficiency: Annotated[
        float, typer.Option(help="Radiated over accepted power, up to 1 for no losses.")
    ] = 1.0,
    polarisation: Annotated[
        str, typer.Option(help="Polarisation of the field on the aperture, x or y; for the files.")
    ] = "y",
    step: Annotated[
        str | None,
        typer.Option(
            help="Step of the angles, such as '0.5 deg' (default: fine enough for the lobes)."
        ),
    ] = None,
    source: SourceOptions,
    floor_db: DbFloor = -40.0,
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            help="Format of the values: csv (default), txt (CST), ffd (HFSS), cut (GRASP), msi or "
            "pln; several times for several of them.",
        ),
    ] = None,
    out: Out = None,
) -> None:
    """Compute the radiation pattern of a source, and the numbers of its data sheet.

    Prints directivity, gain, EIRP, beam direction, half-power widths and first sidelobes. Writes a
    figure NAME_pattern.png (cuts, polar plot, u-v map, the numbers) and the values.
    """
    source.check()
    watts = None if power is None else parse_power(power)
    asked = None if step is None else parse_step(step, 15.0, _MOST)
    suffixes = format_suffixes(formats or ["csv"], _FORMATS)
    files = files_to_write(out, Path(source.source).stem + "_pattern", (".png", *suffixes))

    # Everything cheap has been checked: only now the libraries that take a second to import.
    import numpy as np

    import polywigner as pw
    from polywigner.figures import draw_pattern, outline_of
    from polywigner.figures.levels import check_floor

    check_floor(floor_db)
    radiator, length = source.read_with_wavelength()
    check_is_coherent(radiator, "pattern")
    degrees = asked or _degrees(outline_of(radiator).diameter / length)
    quarter = round(90.0 / degrees)
    # nothing goes backwards, but HFSS wants to read it
    reach_of_theta = 2 * quarter if ".ffd" in suffixes else quarter
    theta = np.radians(np.arange(reach_of_theta + 1) * 90.0 / quarter)
    phi = np.radians(np.arange(4 * quarter) * 90.0 / quarter)
    found = pw.radiation_pattern(radiator, length, theta, phi, obliquity=cast(Any, obliquity))
    metrics = pw.beam_metrics(found, power=watts, efficiency=efficiency)
    figure = draw_pattern(
        found, metrics=metrics, floor_db=floor_db, title=field_title(source.source, length)
    )
    with writing(files) as (picture, *values):
        figure.savefig(picture, format="png")
        for partial in values:
            pw.write_pattern(
                found, partial, polarisation=cast(Any, polarisation), efficiency=efficiency
            )
        print(metrics)


def _degrees(wavelengths: float) -> float:
    """The step for a source so many wavelengths across; a warning where lobes are finer."""
    wanted = math.degrees(1.0 / wavelengths) / _STEPS_PER_LOBE
    if 4 * wanted < _FINEST:
        warnings.warn(
            f"steps of {_FINEST:g} degrees are coarse for the lobes of a source "
            f"{wavelengths:.4g} wavelengths across, and miss some; give --step, or use "
            "polywigner.radiation_pattern on angles about the beam",
            RuntimeWarning,
            stacklevel=2,
        )
    return max(step for step in (_FINEST, 0.5, _COARSEST) if step <= max(wanted, _FINEST))
