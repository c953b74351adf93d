"""Bars on a terminal for work that takes long; nothing elsewhere."""

from __future__ import annotations

import io
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar

from polywigner.geometry.arguments import checked_flag

# Of a bar below a cell: characters, and seconds between two drawings.
_COLUMNS = 100
_INTERVAL = 0.1
# Seconds that a call may take without a word.
_PATIENCE = 5.0

Part = TypeVar("Part")


# Whether work without a bar writes the time that is left: see time_left_written.
_writes_time_left = False
# Parts that are computed at a time, each of them by one core or more.
_AT_ONCE = max(2, os.cpu_count() or 1)


@contextmanager
def time_left_written() -> Iterator[None]:
    """Within, work that shows no bar writes to stderr once how much time is left.

    It does so after some seconds, from the time that the first parts have taken.
    """
    global _writes_time_left
    before, _writes_time_left = _writes_time_left, True
    try:
        yield
    finally:
        _writes_time_left = before


def _time_left_writer(total: int, done: int) -> Callable[..., None]:
    begun, finished, is_written = time.monotonic(), 0, False

    def advance(parts: int = 1) -> None:
        nonlocal finished, is_written
        finished += parts
        left, elapsed = total - done - finished, time.monotonic() - begun
        if is_written or not left or elapsed < _PATIENCE or finished < min(_AT_ONCE, left):
            return
        is_written = True
        seconds = elapsed * left / finished
        text = f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
        sys.stderr.write(
            f"polywigner: about {text} left, {done + finished} of {total} parts are done\n"
        )
        sys.stderr.flush()

    return advance


# Bars that are drawn now: within them calls draw none.
_drawn_now: set[object] = set()


def _is_terminal() -> bool:
    """Whether stderr is a terminal: not where it is closed, or no file at all."""
    try:
        return sys.stderr.isatty()
    except (AttributeError, ValueError):
        return False


@contextmanager
def progress_bar(
    title: str, total: int, done: int = 0, show: bool | None = None
) -> Iterator[Callable[..., None]]:
    """A function to call after each of ``total`` parts, or with their number; ``done`` are done.

    ``show``: None draws the bar if stderr is a terminal. Nothing is left of it, in notebooks too.
    """
    if not (_is_terminal() if show is None else checked_flag(show, "progress")):
        yield _time_left_writer(total, done) if _writes_time_left else lambda parts=1: None
        return
    bar = object()
    _drawn_now.add(bar)
    try:
        with _drawn(title, total, done) as advance:
            yield advance
    finally:
        _drawn_now.discard(bar)


@contextmanager
def slow_bar(title: str, total: int) -> Iterator[Callable[..., None]]:
    """Draw a bar of :func:`progress_bar` once the work has taken five seconds, if none is drawn."""
    if _drawn_now or not _is_terminal():
        yield lambda parts=1: None
        return
    begun, done = time.monotonic(), 0
    draw: Callable[..., None] | None = None
    with ExitStack() as stack:

        def advance(parts: int = 1) -> None:
            nonlocal done, draw
            done += parts
            if draw is not None:
                draw(parts)
            elif time.monotonic() - begun > _PATIENCE and done < total:
                draw = stack.enter_context(progress_bar(title, total, done, True))

        yield advance


@contextmanager
def told(title: str, parts: Sequence[Part]) -> Iterator[Iterator[Part]]:
    """Iterate over the parts of a piece of work under a slow bar.

    A block rather than a generator: what ends it, Ctrl-C as well, ends the bar at once.
    """

    def each() -> Iterator[Part]:
        for part in parts:
            yield part
            advance()

    with slow_bar(title, len(parts)) as advance:
        yield each()


@contextmanager
def _drawn(title: str, total: int, done: int) -> Iterator[Callable[..., None]]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn(title),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
    )
    if _is_notebook():
        bar = Progress(*columns)
        task = bar.add_task("", total=total, completed=done)
        with _shown_as_text(bar) as refresh:

            def advance(parts: int = 1) -> None:
                bar.advance(task, parts)
                refresh()

            yield advance
        return
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=total, completed=done)
        yield lambda parts=1: bar.advance(task, parts)


def _is_notebook() -> bool:
    """Whether cells are run by a kernel; does not import IPython."""
    find_shell = getattr(sys.modules.get("IPython"), "get_ipython", None)
    return hasattr(find_shell() if find_shell else None, "kernel")


@contextmanager
def _shown_as_text(bar: Any) -> Iterator[Callable[[], None]]:
    """A function that draws the bar below a cell, some times a second.

    Rich draws in an output widget, whose empty area stays, and which takes ipywidgets. An output
    without any data has no area; and unlike ``clear_output`` it leaves the cell's others alone.
    """
    from IPython.display import display
    from rich.console import Console

    def data() -> dict[str, str]:
        console = Console(file=io.StringIO(), width=_COLUMNS, force_jupyter=False)
        with console.capture() as text:
            console.print(bar.get_renderable())
        return {"text/plain": text.get().rstrip()}

    handle, drawn = display(data(), raw=True, display_id=True), time.monotonic()

    def refresh() -> None:
        nonlocal drawn
        if time.monotonic() - drawn >= _INTERVAL:
            handle.update(data(), raw=True)
            drawn = time.monotonic()

    try:
        yield refresh
    finally:
        handle.update({}, raw=True)
