"""``polywigner explore``: serve the browser page."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from polywigner.cli import options
from polywigner.cli.sources import Reading, check_source_file, wavelength_from


def explore(
    aperture: Annotated[
        str | None,
        typer.Argument(
            help="Aperture file to begin with: GeoJSON, WKT, CSV, SVG, DXF (default: a square)."
        ),
    ] = None,
    unit: options.Unit = None,
    layer: options.Layer = None,
    union: options.Union = False,
    frequency: options.Frequency = None,
    wavelength: options.Wavelength = None,
    port: Annotated[int, "Port to serve at; 0: any that is free."] = 5006,
    address: Annotated[
        str, "Address to listen at; any other than this one lets other machines in."
    ] = "127.0.0.1",
    allow_host: Annotated[
        list[str] | None, "Another name that the page is opened by; several times for more."
    ] = None,
    browser: Annotated[bool, "Whether to open a browser."] = True,
) -> None:
    """Open a page to draw an aperture in, and see its transforms and fields (extra: explorer).

    Prints the address of the page and serves it until Ctrl-C.
    """
    if aperture is not None:
        check_source_file(aperture, Reading(unit, None, layer, union))
    wavelength_from(frequency, wavelength)  # its error
    from polywigner.explorer import check_installed, serve, start_state

    check_installed()
    state = start_state(aperture, unit or "mm", frequency or wavelength, layer, union)
    hosts = allow_host or []
    if not serve(state, port=port, address=address, browser=browser, say=_say, allow_host=hosts):
        os._exit(0)  # not after the seconds or minutes of a computation nobody waits for


def _say(text: str) -> None:
    print(text, flush=True)
