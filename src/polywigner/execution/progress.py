"""Progress bars on a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TypeVar

from polywigner.geometry.arguments import checked_callable, checked_flag

Part = TypeVar("Part")
# Function to call after each part. Its argument is the number of parts finished since the last
# call, by default 1.
Advance = Callable[..., None]
# Function of the number of finished parts and the number of all parts.
Report = Callable[[int, int], None]

# Time [s] after which a call draws a progress bar.
_PATIENCE = 5.0

# Number of visible progress bars. While a bar is visible, other calls draw no bar.
_bars = 0


def _is_terminal() -> bool:
    """Return whether stderr is a terminal. A closed or missing stderr is not a terminal."""
    try:
        return sys.stderr.isatty()
    except (AttributeError, ValueError):
        return False


@contextmanager
def progress_bar(
    title: str, total: int, done: int = 0, show: bool | None = None
) -> Iterator[Advance]:
    """Draw a progress bar on stderr, and erase it at the end of the block.

    Yields a function to call after each part. Its argument is the number of parts finished since
    the last call, by default 1.

    Parameters
    ----------
    title : str
        Text in front of the bar.
    total : int
        Number of parts.
    done : int, default 0
        Number of parts that are finished at the start.
    show : bool, optional
        Whether to draw the bar. By default the bar is drawn if stderr is a terminal.
    """
    global _bars
    if not (_is_terminal() if show is None else checked_flag(show, "progress")):
        yield lambda parts=1: None
        return
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

    columns = (*Progress.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn())
    _bars += 1
    try:
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(title, total=total, completed=done)
            yield lambda parts=1: bar.advance(task, parts)
    finally:
        _bars -= 1


@contextmanager
def slow_bar(title: str, total: int, report: Report | None = None) -> Iterator[Advance]:
    """Draw a progress bar after five seconds, unless another bar is visible.

    Yields a function to call after each part, like :func:`progress_bar`. Without a terminal, no bar
    is drawn. If ``report`` is specified, it is called after each part, and no bar is drawn.
    """
    start, done = time.monotonic(), 0
    checked_callable(report, "progress")
    draw: Advance | None = None
    with ExitStack() as stack:

        def advance(parts: int = 1) -> None:
            """Count finished parts, and draw the bar if the task is slow."""
            nonlocal done, draw
            done += parts
            is_slow = done < total and time.monotonic() - start > _PATIENCE
            if report is not None:
                report(done, total)
            elif draw is not None:
                draw(parts)
            elif is_slow and _bars == 0 and _is_terminal():
                draw = stack.enter_context(progress_bar(title, total, done, True))

        yield advance


@contextmanager
def with_progress(
    title: str, parts: Sequence[Part], report: Report | None = None
) -> Iterator[Iterator[Part]]:
    """Yield an iterator over the parts of a task; it draws a progress bar after five seconds.

    Unlike a generator, the context manager erases the bar immediately after an exception. If
    ``report`` is specified, it is called after each part, and no bar is drawn.
    """

    def iterate() -> Iterator[Part]:
        """Yield the parts, and count each part when the next one is requested."""
        for part in parts:
            yield part
            advance()

    with slow_bar(title, len(parts), report) as advance:
        yield iterate()
