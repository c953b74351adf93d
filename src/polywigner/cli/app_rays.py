"""The command ``rays``."""

from __future__ import annotations

from typing import Annotated

import typer

from polywigner.cli.options import (
    AllowOutside,
    Array,
    BoundaryCondition,
    Coherence,
    Curved,
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

__all__ = ["rays"]


def rays(
    source: SourceFile,
    frequency: Frequency = None,
    wavelength: Wavelength = None,
    count: Annotated[int, typer.Option(help="How many rays.")] = 100_000,
    seed: Annotated[int, typer.Option(help="Of the random numbers.")] = 0,
    sampling: Annotated[
        str, typer.Option(help="Of positions: uniform, marginal or quasi-random.")
    ] = "uniform",
    directions: Annotated[
        str,
        typer.Option(help="beam (most of them near the normal, or along the wave), or uniform."),
    ] = "beam",
    cone: Annotated[
        str | None,
        typer.Option(help="Half angle about the normal, such as '2 deg' (default: hemisphere)."),
    ] = None,
    obliquity: BoundaryCondition = "rayleigh-sommerfeld-1",
    power: Annotated[
        str | None,
        typer.Option(help="Radiated in all directions, such as '1 mW' (default: the field's own)."),
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
    coherence: Coherence = None,
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            help="npz, csv, nc, or dat (source file of OpticStudio); several times for several of "
            "them (default: that of --out, or npz).",
        ),
    ] = None,
    split: Annotated[
        bool,
        typer.Option(
            "--split", help="With dat: positive and negative rays, by modulus, in a file each."
        ),
    ] = False,
    out: Out = None,
) -> None:
    """Draw rays that carry the Wigner function of a source, for any program that traces rays.

    A ray has a position (m), a direction and a power (W), negative where W is: only sums over rays
    mean something. Prints the power and writes NAME_rays.npz. Of a steered source say --directions
    uniform.
    """
    from polywigner.cli.rays import run_rays

    run_rays(
        source,
        count=count,
        seed=seed,
        drawing={"sampling": sampling, "directions": directions, "obliquity": obliquity},
        cone=cone,
        power=power,
        split=split,
        frequency=frequency,
        wavelength=wavelength,
        reading=Reading(unit, tolerance, layer, union, allow_outside),
        feeding=feeding_of(taper, array, window, steering, focus, curved, coherence),
        formats=formats or [],
        out=out,
    )
