"""Commands of ``polywigner``. Each checks its options before it imports the large libraries."""

from __future__ import annotations

import os
from functools import partial
from typing import Annotated

import typer

from polywigner.cli import options
from polywigner.cli.doctor import doctor
from polywigner.cli.lens_commands import mtf, psf
from polywigner.cli.options import Text
from polywigner.cli.pattern import pattern
from polywigner.cli.propagate import propagate, volume
from polywigner.cli.rcs import rcs
from polywigner.cli.receive import receive
from polywigner.cli.render import render
from polywigner.cli.sources import Reading, WaveOptions
from polywigner.cli.transform import transform

app = typer.Typer(
    add_completion=True,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Plain help takes half the start-up time of help in boxes, and other tools can read it.
    rich_markup_mode=None,
)


def _show_version(is_requested: bool) -> None:
    if is_requested:
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


def explore(
    aperture: Annotated[Text, typer.Argument(help="Aperture file (default: a chevron).")] = None,
    *,
    reading: Reading,
    wave: WaveOptions,
    port: Annotated[int, "Port of the server; 0: any free port."] = 5006,
    browser: Annotated[bool, "Open the page in a browser."] = True,
) -> None:
    """Serve a page to draw an aperture and see its transforms and fields (extra: explorer).

    Prints the address of the page, and serves it until Ctrl-C.
    """
    if aperture is not None:
        reading.check_file(aperture)
    wave.length()  # raises for a wrong option
    from polywigner.explorer import serve, start_state

    state = start_state(aperture, wave.frequency or wave.wavelength, **reading.reading_arguments())
    serve(state, port=port, browser=browser, say=partial(print, flush=True))
    os._exit(0)  # does not wait for a computation in progress


_COMMANDS = (render, receive, transform, pattern, rcs, propagate, volume, psf, mtf, explore, doctor)
for command in _COMMANDS:
    app.command()(options.with_options(command))
