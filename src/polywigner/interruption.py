"""Ctrl-C on the command line ends the program within two seconds, and leaves nothing half written.

The first Ctrl-C raises KeyboardInterrupt in the main thread, as ever, so that blocks clean up after
themselves. Code in C may be long in noticing, or take the exception for a fault of its own: a
thread therefore ends the process after a while, as does the second Ctrl-C. Among imports nothing
is to be cleaned up, and modules that are loaded half way do harm: there the first one does so.
"""

from __future__ import annotations

import os
import signal
import sys
from _thread import RLock
from contextlib import contextmanager, suppress

# Until this module is imported, Ctrl-C shows a traceback: it imports what it needs later.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from types import FrameType
    from typing import NoReturn


INTERRUPTED = 130
"""The exit code of a program that SIGINT has ended, as shells give it."""

# Seconds for an orderly end: people press Ctrl-C again, or kill, after two.
_PATIENCE = 1.5

_SHOW_CURSOR = "\r\x1b[K\x1b[?25h"

_cleanups: dict[object, Callable[[], None]] = {}
# Of one thread again and again: a second Ctrl-C may come while the first is being answered.
_ending = RLock()
_interrupted = False


@contextmanager
def cleaned_up_by(remove: Callable[[], None]) -> Iterator[None]:
    """Within, an end by Ctrl-C calls this first, if need be from another thread."""
    key = object()
    _cleanups[key] = remove
    try:
        yield
    finally:
        del _cleanups[key]


@contextmanager
def unfinished(*paths: Path) -> Iterator[None]:
    """Files or folders that are gone when the block ends, in whatever way, Ctrl-C included.

    So are those beside them whose names begin with theirs.
    """

    def remove() -> None:
        for path in paths:
            _remove(path)

    with cleaned_up_by(remove):
        try:
            yield
        finally:
            remove()


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give a path beside a file or folder to write to; it takes its place when the block is done.

    Its suffix is the same. A block that raises, or Ctrl-C, leaves nothing half written, and what an
    earlier run wrote stays as it was. What a killed run left for the same path is removed first.
    """
    scratch = scratch_of(path)
    before, _, after = scratch.name.rpartition(f"{os.getpid()}.partial")
    with suppress(OSError):
        for left in path.parent.iterdir():
            owner = left.name.removeprefix(before).removesuffix(f".partial{after}")
            if left.name == f"{before}{owner}.partial{after}" and not is_running(owner):
                _remove(left)
    with unfinished(scratch):
        yield scratch
        if scratch.is_dir() and path.is_dir():
            _replace_folder(scratch, path)
        else:
            scratch.replace(path)


def scratch_of(path: Path) -> Path:
    """Return the path of :func:`atomic_path`, of this process alone: the last to finish wins.

    Its name tells the machine too: only there is it known whether the process runs.
    """
    import platform
    import zlib

    machine = zlib.crc32(platform.node().encode(errors="replace"))
    return path.with_name(f"{path.name}.{machine:08x}-{os.getpid()}.partial{path.suffix}")


def is_running(process: str) -> bool:
    """Whether this machine has a process of that number; in doubt, if it is a number at all."""
    try:
        if os.name == "posix":  # elsewhere the signal would end it
            os.kill(int(process), 0)
    except (ValueError, OverflowError, ProcessLookupError):
        return False
    except PermissionError:
        pass  # somebody else's
    return True


def _replace_folder(scratch: Path, path: Path) -> None:
    """Put a folder in another's place: not in one step, but back if that fails."""
    import shutil

    aside = path.with_name(f"{path.name}.{os.getpid()}.old.partial")
    path.rename(aside)
    try:
        scratch.rename(path)
    except BaseException:  # KeyboardInterrupt too
        if not path.exists():
            aside.rename(path)
        raise
    shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def temporary_folder(parent: Path | None = None, prefix: str = "polywigner-") -> Iterator[str]:
    """A folder that is gone when the block ends, in whatever way, Ctrl-C included."""
    import tempfile
    from pathlib import Path

    name = tempfile.mkdtemp(prefix=prefix, dir=parent)
    with unfinished(Path(name)):
        yield name


@contextmanager
def postponed_interrupts() -> Iterator[None]:
    """Within, Ctrl-C waits until the end of the block: an import that it would break for good.

    Only where Python's own handler would raise KeyboardInterrupt, in the main thread.
    """
    import threading

    before, pressed = signal.getsignal(signal.SIGINT), []
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or before is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, lambda *_: pressed.append(True))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        raise KeyboardInterrupt


def _remove(path: Path) -> None:
    import shutil

    with suppress(OSError):
        for found in [p for p in path.parent.iterdir() if p.name.startswith(path.name)]:
            if found.is_dir() and not found.is_symlink():
                shutil.rmtree(found, ignore_errors=True)
            else:
                found.unlink(missing_ok=True)


def answer_interrupts() -> None:
    """From now on, Ctrl-C ends this process as described above.

    Nothing changes where SIGINT is ignored, as in background jobs, or somebody else answers it.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return
    signal.signal(signal.SIGINT, _interrupt)
    if os.name == "posix":  # elsewhere only Python code notices Ctrl-C
        import threading

        receiving, sending = os.pipe()
        os.set_blocking(sending, False)
        # The signal is told to the thread by the system's own handler, whatever Python is at.
        signal.set_wakeup_fd(sending, warn_on_full_buffer=False)
        threading.Thread(target=_watch, args=(receiving,), name="Ctrl-C", daemon=True).start()


def is_interrupted() -> bool:
    """Whether Ctrl-C has been pressed: later failures come from it."""
    return _interrupted


def end_now() -> NoReturn:
    """Remove unfinished files, say so in one line, and end the process.

    Threads are not waited for: they may be long at work in C.
    """
    with _ending:
        for remove in list(_cleanups.values()):
            with suppress(Exception):
                remove()
        _kill_children()
        start = _SHOW_CURSOR if os.isatty(2) else ""
        with suppress(OSError):
            os.write(2, f"{start}polywigner: interrupted\n".encode())
        os._exit(INTERRUPTED)


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _interrupted
    if _interrupted or _is_importing(frame):
        end_now()
    import threading

    _interrupted = True
    sys.unraisablehook = lambda _: None
    threading.excepthook = lambda _: None
    raise KeyboardInterrupt


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _watch(receiving: int) -> None:
    from select import select

    while number := os.read(receiving, 1):
        if number[0] == signal.SIGINT and signal.getsignal(signal.SIGINT) is _interrupt:
            select([receiving], [], [], _PATIENCE)  # until the next one, at most
            end_now()


def _kill_children() -> None:
    """End the processes begun by this one, where the system tells of them (Linux).

    They may have been begun so that the terminal's Ctrl-C does not reach them.
    """
    with suppress(OSError, ValueError):
        for task in os.listdir("/proc/self/task"):  # noqa: PTH208 (pathlib is not imported yet)
            with open(f"/proc/self/task/{task}/children") as children:  # noqa: PTH123
                for child in children.read().split():
                    os.kill(int(child), signal.SIGTERM)
