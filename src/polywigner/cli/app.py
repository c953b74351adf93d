"""The commands of ``polywigner``; each imports the heavy libraries when it is called."""

from __future__ import annotations

from typing import Annotated

import typer

from polywigner.cli.explore import explore
from polywigner.cli.figures import figures
from polywigner.cli.lens import mtf, psf
from polywigner.cli.options import with_options
from polywigner.cli.pattern import pattern
from polywigner.cli.propagate import propagate
from polywigner.cli.rays import rays
from polywigner.cli.rcs import rcs
from polywigner.cli.receive import receive
from polywigner.cli.render import render
from polywigner.cli.scatterers import scatterers
from polywigner.cli.transform import transform
from polywigner.cli.volume import volume

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


for command in (
    render,
    receive,
    scatterers,
    transform,
    pattern,
    rcs,
    propagate,
    volume,
    psf,
    mtf,
    rays,
    figures,
    explore,
):
    app.command()(with_options(command))


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
    """Say which parts work here, and how to get the others.

    Engines, LLVM library, GPU and extras; for each thing missing the command that brings it.
    """
    from polywigner.cli.doctor import run_doctor

    raise typer.Exit(run_doctor(install_llvm, yes))
