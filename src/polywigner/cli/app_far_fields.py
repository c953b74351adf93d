"""The commands for fields far away, ``pattern`` and ``rcs``."""

from __future__ import annotations

from typing import Annotated

import typer

from polywigner.cli.options import (
    AllowOutside,
    Array,
    BoundaryCondition,
    Curved,
    DbFloor,
    Focus,
    Frequency,
    Layer,
    Out,
    SourceFile,
    Steering,
    Taper,
    Tolerance,
    Union,
    Unit,
    Wavelength,
    Window,
    feeding_of,
)
from polywigner.cli.reading import Reading

__all__ = ["pattern", "rcs"]


def pattern(
    source: SourceFile,
    frequency: Frequency = None,
    wavelength: Wavelength = None,
    obliquity: BoundaryCondition = "rayleigh-sommerfeld-1",
    power: Annotated[
        str | None,
        typer.Option(
            help="That the antenna accepts, such as '10 dBm' or '10 mW'; without it, no EIRP."
        ),
    ] = None,
    efficiency: Annotated[
        float, typer.Option(help="Radiated over accepted power: what losses leave, up to 1.")
    ] = 1.0,
    polarisation: Annotated[
        str, typer.Option(help="x or y, of the field on the aperture; for the files.")
    ] = "y",
    step: Annotated[
        str | None, typer.Option(help="Of the angles, such as '0.5 deg' (default: enough).")
    ] = None,
    unit: Unit = None,
    tolerance: Tolerance = None,
    layer: Layer = None,
    union: Union = False,
    allow_outside: AllowOutside = False,
    taper: Taper = None,
    array: Array = None,
    window: Window = None,
    steering: Steering = None,
    focus: Focus = None,
    curved: Curved = None,
    db_floor: DbFloor = -40.0,
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            help="Of the values: csv (default), txt (CST), ffd (HFSS), cut (GRASP), msi or pln; "
            "several times for several of them.",
        ),
    ] = None,
    out: Out = None,
) -> None:
    """Compute the radiation pattern of a source, and what a data sheet says of it.

    Prints directivity, gain, EIRP, beam direction, half-power widths and first sidelobes. Writes a
    figure NAME_pattern.png (cuts, polar plot, u-v map, the numbers) and the values.
    """
    from polywigner.cli.pattern import run_pattern

    run_pattern(
        source,
        obliquity=obliquity,
        power=power,
        efficiency=efficiency,
        polarisation=polarisation,
        step=step,
        frequency=frequency,
        wavelength=wavelength,
        reading=Reading(unit, tolerance, layer, union, allow_outside),
        feeding=feeding_of(taper, array, window, steering, focus, curved),
        floor_db=db_floor,
        formats=formats or [],
        out=out,
    )


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
        typer.Option(help="Of the angles, such as '2 deg' (default: the finest in a minute)."),
    ] = None,
    unit: Unit = None,
    tolerance: Tolerance = None,
    layer: Layer = None,
    union: Union = False,
    db_floor: DbFloor = -40.0,
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format", help="Of the values: csv (default), json, nc; several times for several."
        ),
    ] = None,
    out: Out = None,
) -> None:
    """Compute the radar cross section of a metal body or plate, by physical optics.

    Prints the largest value and its direction. Writes a figure NAME_rcs.png (polar cuts, and a map
    over azimuth and elevation, in dBsm) and the values.
    """
    from polywigner.cli.rcs import run_rcs

    run_rcs(
        body,
        polarisation=polarisation,
        step=step,
        frequency=frequency,
        wavelength=wavelength,
        reading=Reading(unit, tolerance, layer, union),
        floor_db=db_floor,
        formats=formats or [],
        out=out,
    )
