"""The command line ``polywigner``, whose commands are listed in ``commands``.

``main`` turns every outcome into an exit code and, for a failure, one line on stderr. The heavy
libraries are imported by the command that needs them, so that ``--help`` answers at once.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence

from polywigner.errors import PolywignerError

__all__ = ["main"]

_FAILED = 1
_BAD_INPUT = 2
_INTERRUPTED = 130  # as shells report a program that SIGINT has ended
_DEBUG = "POLYWIGNER_DEBUG"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments : the words after ``polywigner``; those of the process when None.

    Returns
    -------
    0 when the work was done, 2 for input that cannot be used (a :class:`PolywignerError` or a
    wrong option), 130 after Ctrl-C, 1 for anything unforeseen.
    """
    with warnings.catch_warnings():
        warnings.showwarning = _show_warning
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    try:
        from polywigner.cli.commands import app

        returned = app(args=arguments, prog_name="polywigner", standalone_mode=False)
    except (KeyboardInterrupt, Exception) as error:
        if not _is_interruption(error):
            return _from_exception(error)
        returned = _INTERRUPTED
    # Typer returns the code of an `Exit` raised inside a command, of --help, and of Ctrl-C.
    if returned == _INTERRUPTED:
        return _say("interrupted", _INTERRUPTED)
    return returned if isinstance(returned, int) else 0


def _is_interruption(error: BaseException | None) -> bool:
    """Return whether Ctrl-C caused an error: Mitsuba and Dr.Jit replace KeyboardInterrupt."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt) or "KeyboardInterrupt" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def _from_exception(error: BaseException) -> int:
    if isinstance(error, PolywignerError):
        return _say(f"error: {error}", _BAD_INPUT)
    if isinstance(error, MemoryError):
        return _say(f"error: out of memory ({error}); ask for fewer samples or pixels", _FAILED)
    if isinstance(error, BrokenPipeError):  # `polywigner ... | head`: the reader has gone
        # The rest in stdout's buffer must not be flushed again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _FAILED
    # The module of typer's copy of click is private, so its usage errors are recognised by name.
    if hasattr(error, "format_message"):
        if type(error).__name__ == "NoArgsIsHelpError":  # `polywigner` alone shows the help
            print(error.format_message().rstrip())
            return _BAD_INPUT
        text = error.format_message().rstrip(".")
        return _say(f"error: {text}; see `polywigner --help`", _BAD_INPUT)
    if type(error).__name__ == "Abort":
        return _say("interrupted", _INTERRUPTED)
    if os.environ.get(_DEBUG) == "1":
        import traceback

        traceback.print_exc()
    return _say(
        f"error: unexpected {type(error).__name__}: {error} (this is a fault of polywigner: "
        f"please report it with the traceback that {_DEBUG}=1 shows)",
        _FAILED,
    )


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    _say(f"warning: {message}", 0)


def _say(message: str, code: int) -> int:
    """Write one line on stderr, without line breaks of the message."""
    sys.stderr.write("polywigner: " + " ".join(message.split()) + "\n")
    return code
