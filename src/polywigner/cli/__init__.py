"""The command line ``polywigner``.

Commands check their options before they import large libraries, so that ``--help`` and errors
appear quickly.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from functools import partial
from typing import Annotated

import typer

from polywigner.cli import (
    doctor,
    lens_commands,
    propagate,
    radar_commands,
    scene_commands,
    source_commands,
)
from polywigner.cli.options import Text, with_options
from polywigner.cli.sources import ReadingOptions, WaveOptions
from polywigner.errors import PolywignerError

__all__ = ["main"]

_FAILED = 1
_BAD_INPUT = 2
_INTERRUPTED = 130  # Shells use this exit code for a program that SIGINT interrupted.
_DEBUG = "POLYWIGNER_DEBUG"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments : sequence of str or None
        Arguments after ``polywigner``. None selects the arguments of the process.

    Returns
    -------
    int
        0 after success, 2 for invalid input (a :class:`PolywignerError` or a wrong option), 130
        after Ctrl-C, 1 for any other error.
    """
    with warnings.catch_warnings():
        warnings.showwarning = partial(_show_warning, set())
        try:
            code = app(args=arguments, prog_name="polywigner", standalone_mode=False)
        except (KeyboardInterrupt, Exception) as error:
            code = _INTERRUPTED if _is_interruption(error) else _report_exception(error)
    # Typer returns the exit code of `typer.Exit`, and 130 after Ctrl-C.
    if code == _INTERRUPTED:
        _report("interrupted", _INTERRUPTED)
    return code if isinstance(code, int) else 0


def _is_interruption(error: BaseException | None) -> bool:
    """Return whether an error, or an earlier one in its chain, is or mentions KeyboardInterrupt.

    Mitsuba and Dr.Jit replace KeyboardInterrupt with other errors.
    """
    while error is not None:
        if isinstance(error, KeyboardInterrupt) or "KeyboardInterrupt" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def _report_exception(error: BaseException) -> int:
    """Write an error message on stderr for an exception, and return the exit code."""
    if isinstance(error, PolywignerError):
        return _report(f"error: {error}", _BAD_INPUT)
    if isinstance(error, MemoryError):
        return _report(f"error: out of memory ({error}); use fewer samples or pixels", _FAILED)
    if isinstance(error, BrokenPipeError):
        # At exit, Python flushes stdout, which would raise BrokenPipeError again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _FAILED
    # Typer contains a private copy of click, so errors of click are recognised by a method.
    if hasattr(error, "format_message"):
        if type(error).__name__ == "NoArgsIsHelpError":
            print(error.format_message().rstrip())
            return _BAD_INPUT
        text = error.format_message().rstrip(".")
        return _report(f"error: {text}; see `polywigner --help`", _BAD_INPUT)
    if os.environ.get(_DEBUG) == "1":
        import traceback

        traceback.print_exc()
    return _report(
        f"error: unexpected {type(error).__name__}: {error} (this is a bug in polywigner: please "
        f"report it with the traceback that {_DEBUG}=1 shows)",
        _FAILED,
    )


def _show_warning(shown: set[str], message: Warning | str, *_: object, **__: object) -> None:
    """Write a Python warning on stderr as a single line, unless its text is in ``shown``."""
    if str(message) not in shown:
        shown.add(str(message))
        _report(f"warning: {message}", 0)


def _report(message: str, code: int) -> int:
    """Write "polywigner: " and a message as one line on stderr, and return the exit code."""
    sys.stderr.write("polywigner: " + " ".join(message.split()) + "\n")
    return code


app = typer.Typer(
    help="Coherent radiation of polygonal apertures: transforms in closed form, and rendering.",
    add_completion=True,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Without rich, --help appears in half the time.
    rich_markup_mode=None,
)


def _show_version(is_requested: bool) -> None:
    """Print the version and exit if --version is specified."""
    if is_requested:
        from polywigner import __version__

        typer.echo(f"polywigner {__version__}")
        raise typer.Exit


@app.callback()
def _common_options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Define the options that precede the name of a command."""


def explore(
    aperture: Annotated[Text, typer.Argument(help="Aperture file (default: a chevron).")] = None,
    *,
    reading: ReadingOptions,
    wave: WaveOptions,
    port: Annotated[int, "Port of the server; 0: any free port."] = 5006,
    browser: Annotated[bool, "Open the page in a browser."] = True,
) -> None:
    """Serve a page to draw an aperture and see its transforms and fields (extra: explorer).

    Prints the address of the page, and serves it until Ctrl-C.
    """
    if aperture is not None:
        reading.check_file(aperture)
    wave.length()  # Raise errors in the options before the slow import.
    from polywigner.explorer import serve, start_state

    state = start_state(aperture, wave.frequency or wave.wavelength, **reading.reading_arguments())
    serve(state, port=port, browser=browser)
    os._exit(0)  # sys.exit would wait for the computing thread.


_COMMANDS = (
    *(scene_commands.render, scene_commands.receive, radar_commands.radar),
    *(source_commands.transform, source_commands.pattern, radar_commands.rcs),
    *(propagate.propagate, propagate.volume, lens_commands.psf, lens_commands.mtf),
    *(explore, doctor.doctor),
)
for command in _COMMANDS:
    app.command()(with_options(command))
