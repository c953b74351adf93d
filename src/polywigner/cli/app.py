"""The commands and their options; each imports its work when it is called."""

from __future__ import annotations

from typing import Annotated

import typer

__all__ = ["app"]

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Plain help text: half the start-up time of the boxed one, and it pipes into other tools.
    rich_markup_mode=None,
)

_OUT_HELP = "Folder, or path without suffix, of the files written (default: here)."


def _show_version(wanted: bool) -> None:
    if wanted:
        from polywigner import __version__

        typer.echo(f"polywigner {__version__}")
        raise typer.Exit


@app.callback()
def _polywigner(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Coherent radiation of polygonal apertures: transforms in closed form, and rendering."""


@app.command()
def render(
    scene: Annotated[
        str, typer.Argument(help="Mitsuba XML file with a <shape type='wigner'> in it.")
    ],
    spp: Annotated[
        int | None, typer.Option(help="Samples per pixel (default: the scene's).")
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
    db_floor: Annotated[
        float, typer.Option(help="Lowest level of the picture, in dB below its peak.")
    ] = -40.0,
    out: Annotated[str | None, typer.Option(help=_OUT_HELP)] = None,
) -> None:
    """Render a Mitsuba scene lit by a coherent aperture.

    Writes the signed radiance NAME.exr, a picture in dB NAME.png, and a record NAME.json.
    """
    from polywigner.cli.render import run_render

    run_render(
        scene,
        spp=spp,
        variant=variant,
        integrator=integrator,
        sampler=sampler,
        seed=seed,
        floor_db=db_floor,
        out=out,
    )


@app.command()
def transform(
    aperture: Annotated[
        str,
        typer.Argument(
            help="Aperture file: GeoJSON, WKT, SVG, DXF, or CSV with one ring; or a source file: "
            "TOML or JSON."
        ),
    ],
    unit: Annotated[
        str | None,
        typer.Option(help="Unit of an aperture file, where it does not say (default: mm)."),
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(help="Such as '1 um': how far chords may lie from curves (SVG, DXF)."),
    ] = None,
    taper: Annotated[
        str | None,
        typer.Option(help="Of the aperture: 'cosine', 'cosine 2 x', 'te10', 'taylor 30 dB 4'."),
    ] = None,
    array: Annotated[
        str | None, typer.Option(help="Copies of the aperture, such as '12 x 16, 2 mm'.")
    ] = None,
    window: Annotated[
        str | None,
        typer.Option(help="Of the array: 'taylor 25 dB', 'chebyshev 30 dB', 'hamming'."),
    ] = None,
    steering: Annotated[
        str | None, typer.Option(help="A beam towards theta, phi, such as '20 deg, 90 deg'.")
    ] = None,
    focus: Annotated[
        str | None, typer.Option(help="Of the array: a point, such as '0 mm, 0 mm, 80 mm'.")
    ] = None,
    frequency: Annotated[
        str | None,
        typer.Option(
            help="Such as '94 GHz': shows |nu| up to 1/wavelength. Default: a source file's own."
        ),
    ] = None,
    wavelength: Annotated[
        str | None, typer.Option(help="Such as '3.19 mm', instead of --frequency.")
    ] = None,
    x: Annotated[
        str | None,
        typer.Option(help="Position of the Wigner slice, such as '0 mm,2 mm' (default: centre)."),
    ] = None,
    xi: Annotated[
        str | None,
        typer.Option(help="Lag of the ambiguity slice (default: one with a good overlap)."),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(help="Samples along each frequency axis (default: 257, or up to 513)."),
    ] = None,
    db_floor: Annotated[
        float, typer.Option(help="Lowest level of the dB picture, below its peak.")
    ] = -40.0,
    out: Annotated[str | None, typer.Option(help=_OUT_HELP)] = None,
) -> None:
    """Draw and save the transforms of an aperture or an array.

    Writes a figure NAME.png (Fourier transform, automean, a Wigner and an ambiguity slice) and
    the values NAME.npz.
    """
    from polywigner.cli.transform import run_transform

    run_transform(
        aperture,
        unit=unit,
        tolerance=tolerance,
        feeding={
            "taper": taper,
            "array": array,
            "window": window,
            "steering": steering,
            "focus": focus,
        },
        frequency=frequency,
        wavelength=wavelength,
        x=x,
        xi=xi,
        samples=samples,
        floor_db=db_floor,
        out=out,
    )


@app.command()
def doctor(
    install_llvm: Annotated[
        bool,
        typer.Option("--install-llvm", help="Bring a good LLVM library into this environment."),
    ] = False,
) -> None:
    """Say what works here, and how to get what does not.

    Engines, LLVM library, GPU and extras; for each thing missing the command that brings it.
    """
    from polywigner.cli.doctor import run_doctor

    raise typer.Exit(run_doctor(install_llvm))
