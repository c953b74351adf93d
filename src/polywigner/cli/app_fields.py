"""The commands for fields in front of a source, ``propagate`` and ``volume``."""

from __future__ import annotations

from typing import Annotated

import typer

from polywigner.cli.options import (
    Accuracy,
    Against,
    AllowOutside,
    Array,
    Bandwidth,
    Coherence,
    Curved,
    DbFloor,
    EngineName,
    Focus,
    Formats,
    Frequency,
    Layer,
    Obliquity,
    Order,
    Out,
    Precision,
    Scheduler,
    SourceFile,
    Steering,
    Taper,
    Threads,
    Tolerance,
    Union,
    Unit,
    Wavelength,
    Window,
    feeding_of,
)
from polywigner.cli.reading import Reading

__all__ = ["propagate", "volume"]


def _verify(context: typer.Context, store: str | None) -> None:
    if store is None or context.resilient_parsing:
        return
    from polywigner.cli.volume import run_verify

    run_verify(store)
    raise typer.Exit


def propagate(
    source: SourceFile,
    line: Annotated[
        str | None,
        typer.Option(help="Two points: '0 mm, 0 mm, 2 mm to 0 mm, 0 mm, 150 mm'."),
    ] = None,
    arc: Annotated[
        str | None,
        typer.Option(
            help="A cut at one distance: '50 mm', or '50 mm, 45 deg, 80 deg' with the angle of "
            "the cut from x, and the largest from the axis."
        ),
    ] = None,
    plane: Annotated[
        str | None,
        typer.Option(help="Ranges of two coordinates: '-30 mm to 30 mm, -30 mm to 30 mm, 90 mm'."),
    ] = None,
    hemisphere: Annotated[str | None, typer.Option(help="Its radius, such as '50 mm'.")] = None,
    samples: Annotated[
        str | None,
        typer.Option(help="'201' on lines and arcs, '101 x 81' elsewhere (default: enough)."),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            help="wigner, rayleigh-sommerfeld-1, rayleigh-sommerfeld-2, kirchhoff, fresnel or "
            "fraunhofer; several times to compare them (default: the first two). wigner with its "
            "own obliquity and order: 'wigner paper', 'wigner kirchhoff 3'."
        ),
    ] = None,
    order: Order = 1,
    obliquity: Obliquity = None,
    amplitude: Annotated[
        bool, typer.Option("--amplitude", help="Complex fields, with phases; not by wigner.")
    ] = False,
    against: Against = None,
    accuracy: Accuracy = None,
    frequency: Frequency = None,
    wavelength: Wavelength = None,
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
    bandwidth: Bandwidth = None,
    engine: EngineName = "auto",
    precision: Precision = None,
    db_floor: DbFloor = -40.0,
    formats: Formats = None,
    out: Out = None,
) -> None:
    """Compute the field of a source in front of it, by several methods side by side.

    On a line, an arc, a plane or a hemisphere. Writes a figure NAME.png and the values NAME.nc
    (or what --format says: nc, zarr, and of planes vti, for ParaView), and prints how far the
    methods are apart. For volumes, see `polywigner volume`.
    """
    from polywigner.cli.propagate import run_propagate

    run_propagate(
        source,
        where={"line": line, "arc": arc, "plane": plane, "hemisphere": hemisphere},
        samples=samples,
        methods=method or [],
        order=order,
        obliquity=obliquity,
        amplitude=amplitude,
        against=against,
        accuracy=accuracy,
        frequency=frequency,
        wavelength=wavelength,
        reading=Reading(unit, tolerance, layer, union, allow_outside),
        feeding=feeding_of(taper, array, window, steering, focus, curved, coherence),
        bandwidth=bandwidth,
        engine=engine,
        precision=precision,
        floor_db=db_floor,
        formats=formats or [],
        out=out,
    )


def volume(
    source: SourceFile,
    box: Annotated[
        str,
        typer.Option(help="Three ranges: '-30 mm to 30 mm, -30 mm to 30 mm, 2 mm to 120 mm'."),
    ],
    shape: Annotated[
        str | None,
        typer.Option(
            help="Samples along x, y and z, such as '64 x 64 x 96' (default: enough, from 64 to "
            "101 along each)."
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            help="wigner (default), rayleigh-sommerfeld-1, rayleigh-sommerfeld-2, kirchhoff, "
            "fresnel or fraunhofer; several times to compare them."
        ),
    ] = None,
    order: Order = 1,
    obliquity: Obliquity = None,
    against: Against = None,
    accuracy: Accuracy = None,
    frequency: Frequency = None,
    wavelength: Wavelength = None,
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
    bandwidth: Bandwidth = None,
    chunks: Annotated[
        str | None, typer.Option(help="Samples of a chunk, such as '32 x 32 x 32'.")
    ] = None,
    threads: Threads = None,
    scheduler: Scheduler = None,
    engine: EngineName = "auto",
    precision: Precision = None,
    surfaces: Annotated[
        str | None,
        typer.Option(help="Levels of the isosurfaces, dB, such as '-6, -12, -18' (default: four)."),
    ] = None,
    projection: Annotated[str, typer.Option(help="On the walls: maximum, or mean.")] = "maximum",
    renderer: Annotated[
        str, typer.Option(help="Of the isosurfaces: auto, pyvista or matplotlib.")
    ] = "auto",
    db_floor: DbFloor = -40.0,
    formats: Formats = None,
    out: Out = None,
    verify: Annotated[
        str | None,
        typer.Option(
            callback=_verify,
            is_eager=True,
            metavar="STORE",
            help="Compute nothing: read this store, such as field.zarr, and name its damaged and "
            "missing chunks (exit code 2), or print that all are whole.",
        ),
    ] = None,
) -> None:
    """Compute the irradiance of a source in a box, chunk by chunk, and draw it.

    Writes NAME.zarr and a figure NAME.png, and with --format vti or --format nc the values also for
    ParaView, or as NetCDF. A run that is killed goes on when the same command is started again;
    chunks that are damaged are computed anew.
    Of several methods, each has files of its own, NAME-METHOD.zarr and so on.
    """
    from polywigner.cli.volume import run_volume

    run_volume(
        source,
        box=box,
        shape=shape,
        methods=method or [],
        order=order,
        obliquity=obliquity,
        against=against,
        accuracy=accuracy,
        frequency=frequency,
        wavelength=wavelength,
        reading=Reading(unit, tolerance, layer, union, allow_outside),
        feeding=feeding_of(taper, array, window, steering, focus, curved, coherence),
        bandwidth=bandwidth,
        chunks=chunks,
        threads=threads,
        scheduler=scheduler,
        engine=engine,
        precision=precision,
        surfaces=surfaces,
        projection=projection,
        renderer=renderer,
        floor_db=db_floor,
        formats=formats or [],
        out=out,
    )
