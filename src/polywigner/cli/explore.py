"""``polywigner explore``: serve the browser page."""

from __future__ import annotations

import os
from collections.abc import Sequence

from polywigner.cli.reading import Reading
from polywigner.cli.sources import check_source_file, wavelength_from

__all__ = ["run_explore"]


def run_explore(
    aperture: str | None,
    *,
    reading: Reading,
    frequency: str | None,
    wavelength: str | None,
    port: int,
    address: str,
    allow_host: Sequence[str],
    browser: bool,
) -> None:
    """Serve the page until it is stopped; prints its address.

    Raises
    ------
    PolywignerError : a file that cannot be read, an address that cannot be had, no Bokeh.
    """
    if aperture is not None:
        check_source_file(aperture, reading)
    wavelength_from(frequency, wavelength)  # its error
    from polywigner.explorer import check_installed, serve, start_state

    check_installed()
    state = start_state(
        aperture, reading.unit or "mm", frequency or wavelength, reading.layer, reading.union
    )
    if not serve(
        state, port=port, address=address, browser=browser, say=_say, allow_host=allow_host
    ):
        os._exit(0)  # not after the seconds or minutes of a computation nobody waits for


def _say(text: str) -> None:
    print(text, flush=True)
