"""The commands and their options; each imports its work when it is called."""

from __future__ import annotations

from typing import Annotated

import typer

from polywigner.cli.app_far_fields import pattern, rcs
from polywigner.cli.app_fields import propagate, volume
from polywigner.cli.app_rays import rays
from polywigner.cli.app_scenes import receive, render, scatterers
from polywigner.cli.options import (
    AllowOutside,
    Array,
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

__all__ = ["app"]

app = typer.Typer(
    add_completion=True,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Plain help text: half the start-up time of the boxed one, and it pipes into other tools.
    rich_markup_mode=None,
)


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


app.command()(render)
app.command()(receive)
app.command()(scatterers)


@app.command()
def transform(
    aperture: SourceFile,
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
    frequency: Annotated[
        str | None,
        typer.Option(
            help="Such as '94 GHz': shows |nu| up to 1/wavelength. Default: a source file's own."
        ),
    ] = None,
    wavelength: Wavelength = None,
    x: Annotated[
        str | None,
        typer.Option(help="Position of the Wigner slice, such as '0 mm,2 mm' (default: centre)."),
    ] = None,
    xi: Annotated[
        str | None,
        typer.Option(help="Lag of the ambiguity slice (default: one with a good overlap)."),
    ] = None,
    through: Annotated[
        str | None,
        typer.Option(
            help="Lenses behind it, such as 'space 50 mm, lens 50 mm, space 50 mm', in the order "
            "of the light: shows W and the light behind them."
        ),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(help="Samples along each frequency axis (default: 257, or up to 513)."),
    ] = None,
    db_floor: DbFloor = -40.0,
    out: Out = None,
) -> None:
    """Draw and save the transforms of an aperture or an array.

    Writes a figure NAME.png (Fourier transform, automean, a Wigner and an ambiguity slice) and
    the values NAME.npz.
    """
    from polywigner.cli.transform import run_transform

    run_transform(
        aperture,
        reading=Reading(unit, tolerance, layer, union, allow_outside),
        feeding=feeding_of(taper, array, window, steering, focus, curved),
        frequency=frequency,
        wavelength=wavelength,
        x=x,
        xi=xi,
        through=through,
        samples=samples,
        floor_db=db_floor,
        out=out,
    )


app.command()(pattern)
app.command()(rcs)
app.command()(propagate)
app.command()(volume)
app.command()(rays)


@app.command()
def figures(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME",
            help="render, amp_spec, indmk, marginals, xforms, projs, volrender, volrender_fdtd, "
            "compar, error, emitters, sampling, appendix (default: all).",
        ),
    ] = None,
    quality: Annotated[
        str, typer.Option(help="draft, or print: more samples and pixels, several minutes.")
    ] = "draft",
    out: Annotated[str | None, typer.Option(help="Folder to write to (default: figures).")] = None,
) -> None:
    """Regenerate the figures of the paper.

    Writes NAME.png, NAME.pdf and the numbers behind them, NAME.npz, for each.
    """
    from polywigner.cli.figures import run_figures

    run_figures(names or [], quality=quality, out=out)


@app.command()
def explore(
    aperture: Annotated[
        str | None,
        typer.Argument(
            help="Aperture file to begin with: GeoJSON, WKT, CSV, SVG, DXF (default: a square)."
        ),
    ] = None,
    unit: Unit = None,
    layer: Layer = None,
    union: Union = False,
    frequency: Frequency = None,
    wavelength: Wavelength = None,
    port: Annotated[int, typer.Option(help="To serve at; 0: any that is free.")] = 5006,
    address: Annotated[
        str, typer.Option(help="To listen at; any other than this one lets other machines in.")
    ] = "127.0.0.1",
    allow_host: Annotated[
        list[str] | None,
        typer.Option(help="Another name that the page is opened by; several times for more."),
    ] = None,
    browser: Annotated[bool, typer.Option(help="Whether to open a browser.")] = True,
) -> None:
    """Open a page to draw an aperture in, and see its transforms and fields (extra: explorer).

    Prints the address of the page and serves it until Ctrl-C.
    """
    from polywigner.cli.explore import run_explore

    run_explore(
        aperture,
        reading=Reading(unit, None, layer, union),
        frequency=frequency,
        wavelength=wavelength,
        port=port,
        address=address,
        allow_host=allow_host or [],
        browser=browser,
    )


@app.command()
def cite(
    methods: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="METHOD",
            help="fourier, wigner, ambiguity, otf, radiometry, propagation, rendering, range, "
            "tapers, arrays (default: the paper and this software).",
        ),
    ] = None,
) -> None:
    """Print BibTeX of what to cite for work made with polywigner, the paper first."""
    from polywigner.citations import cite as citations

    typer.echo(citations(*methods or []), nl=False)


@app.command()
def doctor(
    install_llvm: Annotated[
        bool,
        typer.Option(
            "--install-llvm",
            help="Bring a good LLVM library into this environment; as root into the system.",
        ),
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="With --install-llvm, as root: do not ask.")
    ] = False,
) -> None:
    """Say what works here, and how to get what does not.

    Engines, LLVM library, GPU and extras; for each thing missing the command that brings it.
    """
    from polywigner.cli.doctor import run_doctor

    raise typer.Exit(run_doctor(install_llvm, yes))
