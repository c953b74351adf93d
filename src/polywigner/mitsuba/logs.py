"""Mitsuba's own log, which goes to stdout, kept away from there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mitsuba as mi

from polywigner.interruption import temporary_folder

__all__ = ["silent", "to_list"]

# A colour film in a variant of one channel: as intended, and so no news to anybody.
_EXPECTED = ("Monochrome mode enabled",)
_DATE = len("2000-01-01 00:00:00 ")


@contextmanager
def silent() -> Iterator[None]:
    """Nothing is logged within, and no progress bar drawn."""
    with _appending():
        yield


@contextmanager
def to_list() -> Iterator[list[str]]:
    """Give a list that holds, once the block is done, what Mitsuba had to say in it."""
    messages: list[str] = []
    # Through a file, which needs no Python: messages come from Mitsuba's threads. An appender
    # with a file also leaves out the progress bars.
    with temporary_folder() as folder:
        path = Path(folder) / "mitsuba.log"
        appender = mi.StreamAppender(str(path))
        try:
            with _appending(appender):
                yield messages
        finally:
            del appender  # closes the file
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
            texts = (line[_DATE:].strip() for line in lines)
            messages += [t for t in texts if t and not any(known in t for known in _EXPECTED)]


@contextmanager
def _appending(*appenders: mi.Appender) -> Iterator[None]:
    logger = mi.logger()
    before = [logger.appender(index) for index in range(logger.appender_count())]
    logger.clear_appenders()
    for appender in appenders:
        logger.add_appender(appender)
    try:
        yield
    finally:
        logger.clear_appenders()
        for appender in before:
            logger.add_appender(appender)
