"""The commands on Mitsuba scenes and their options; each imports its work when it is called."""

from __future__ import annotations

from typing import Annotated

import typer

from polywigner.cli.options import DbFloor, Out, Resumable, Scheduler, Threads

__all__ = ["receive", "render", "scatterers"]


def render(
    scene: Annotated[
        str, typer.Argument(help="Mitsuba XML file with a <shape type='wigner'> in it.")
    ],
    spp: Annotated[
        int | None, typer.Option(help="Samples per pixel (default: the scene's).")
    ] = None,
    error_db: Annotated[
        float | None,
        typer.Option(
            help="In place of --spp: rms error in dB of what lies 20 dB below the peak, as far as "
            "the source makes it (docs/sampling.md)."
        ),
    ] = None,
    variant: Annotated[
        str | None,
        typer.Option(help="Mitsuba variant (default: the fastest monochromatic one that works)."),
    ] = None,
    integrator: Annotated[
        str | None, typer.Option(help="path, direct, volpath, ... (default: the scene's).")
    ] = None,
    sampler: Annotated[
        str | None, typer.Option(help="multijitter, independent, ... (default: the scene's).")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.")] = 0,
    range_: Annotated[
        str | None,
        typer.Option(
            "--range",
            help="A frame for each bin of range as well, such as '0 m to 30 m' (docs/range.md).",
        ),
    ] = None,
    bins: Annotated[int | None, typer.Option(help="Of the range (default: 64).")] = None,
    resumable: Resumable = False,
    threads: Threads = None,
    scheduler: Scheduler = None,
    db_floor: DbFloor = -40.0,
    out: Out = None,
) -> None:
    """Render a Mitsuba scene lit by a coherent aperture.

    Writes the signed radiance NAME.exr, a picture in dB NAME.png, and a record NAME.json; with
    --range the animated picture NAME_range.gif and its frames NAME_range.nc. With --scheduler, the
    workers of a cluster share the parts of the picture, and the run is resumable.
    """
    from polywigner.cli.render import RenderSettings, run_render

    settings = RenderSettings(
        scene=scene,
        spp=spp,
        error_db=error_db,
        variant=variant,
        integrator=integrator,
        sampler=sampler,
        seed=seed,
        range_text=range_,
        bins=bins,
        floor_db=db_floor,
        resumable=resumable,
        threads=threads,
        scheduler=scheduler,
    )
    run_render(settings, out)


def receive(
    scene: Annotated[
        str,
        typer.Argument(help="Mitsuba XML file with a <sensor type='wigner_receiver'> in it."),
    ],
    spp: Annotated[
        int | None,
        typer.Option(help="Samples of the scattered light of each emitter (default: the scene's)."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.")] = 0,
    variant: Annotated[
        str | None,
        typer.Option(help="Mitsuba variant (default: the fastest monochromatic one that works)."),
    ] = None,
    reflections: Annotated[
        int, typer.Option(help="Most flat mirrors on a direct way, 0 to 3.")
    ] = 2,
    accuracy: Annotated[
        float, typer.Option(help="Relative error allowed of the fields of direct light.")
    ] = 1e-6,
    bandwidth: Annotated[
        str | None, typer.Option(help="Such as '1 GHz' (default: the receiver's own).")
    ] = None,
    temperature: Annotated[
        str | None,
        typer.Option(help="Of the noise, such as '290 K' (default: the receiver's own)."),
    ] = None,
    noise_figure: Annotated[
        str | None, typer.Option(help="Such as '3 dB' (default: the receiver's own, else 0 dB).")
    ] = None,
    range_: Annotated[
        str | None,
        typer.Option(
            "--range",
            help="Sort what is scattered by range as well, such as '0 m to 60 m' (docs/range.md).",
        ),
    ] = None,
    bins: Annotated[int | None, typer.Option(help="Of the range (default: 256).")] = None,
    define: Annotated[
        list[str] | None,
        typer.Option(help="NAME=VALUE of a $parameter of the scene; several times for more."),
    ] = None,
    resumable: Resumable = False,
    threads: Threads = None,
    scheduler: Scheduler = None,
    db_floor: DbFloor = -40.0,
    out: Out = None,
) -> None:
    """Say what power the receivers of a scene get, straight, by mirrors and scattered.

    Prints a table, writes all of it NAME.json, and a picture of where scattered power comes from
    NAME.png; with --range, power by half the length of its path NAME_range.nc and NAME_range.png
    too. With --scheduler, the workers of a cluster share the batches of samples, and the run is
    resumable.
    """
    from polywigner.cli.receive import run_receive

    run_receive(
        scene,
        spp=spp,
        seed=seed,
        variant=variant,
        reflections=reflections,
        accuracy=accuracy,
        bandwidth=bandwidth,
        temperature=temperature,
        noise_figure=noise_figure,
        range_text=range_,
        bins=bins,
        define=define or [],
        floor_db=db_floor,
        resumable=resumable,
        threads=threads,
        scheduler=scheduler,
        out=out,
    )


def scatterers(
    scene: Annotated[
        str,
        typer.Argument(help="Mitsuba XML file with a <sensor type='wigner_receiver'> in it."),
    ],
    count: Annotated[int, typer.Option(help="Scatterers wanted.")] = 20_000,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.")] = 0,
    receiver: Annotated[
        str | None, typer.Option(help="Id of the receiver (default: the only one).")
    ] = None,
    max_depth: Annotated[
        int | None,
        typer.Option(help="Longest path: 2 is one reflection, -1 no limit (default: the scene's)."),
    ] = None,
    rays: Annotated[
        int | None, typer.Option(help="From the receiver (default: four times --count).")
    ] = None,
    velocity: Annotated[
        list[str] | None,
        typer.Option(
            help="ID=VX,VY,VZ in m/s of a shape, an emitter or the receiver; several times for "
            "more."
        ),
    ] = None,
    variant: Annotated[
        str | None,
        typer.Option(help="Mitsuba variant (default: the fastest monochromatic one that works)."),
    ] = None,
    define: Annotated[
        list[str] | None,
        typer.Option(help="NAME=VALUE of a $parameter of the scene; several times for more."),
    ] = None,
    out: Annotated[
        str | None,
        typer.Option(help="File or folder; .csv (default), .vtp for ParaView, or .nc."),
    ] = None,
) -> None:
    """Write what a receiver gets of a scene as a cloud of scatterers, for radar signal chains.

    Each has a place, a normal, a power in W, the length of its path, the ids of its shape and of
    its emitter, and with --velocity what its path grows by per second.
    """
    from polywigner.cli.scatterers import run_scatterers

    run_scatterers(
        scene,
        count=count,
        seed=seed,
        receiver=receiver,
        max_depth=max_depth,
        rays=rays,
        velocities=velocity or [],
        variant=variant,
        define=define or [],
        out=out,
    )
