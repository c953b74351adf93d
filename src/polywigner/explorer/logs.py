"""Messages of the server in the terminal: few, and no traceback that nobody asked for."""

from __future__ import annotations

import logging
import math
import os

_FAULTS = "polywigner.explorer"
# requests that are damaged, and faults of callbacks: a line each
_ONE_LINE = (_FAULTS, "tornado.application", "asyncio")
_LONGEST = 200  # characters of a line: messages of others are quoted in it
_REPEATED_S = 60.0  # seconds in which the same line of code writes once
# what strangers ask for and do not get
_SILENT = ("tornado.access", "tornado.general", "bokeh.server.views.ws")


def log_fault(what: str) -> None:
    """Log the exception that is being handled."""
    logging.getLogger(_FAULTS).exception(what)


def _shortened(record: logging.LogRecord) -> bool:
    error = record.exc_info[1] if record.exc_info else None
    if error is not None and not os.environ.get("POLYWIGNER_DEBUG"):
        what = str(record.msg).split("%", 1)[0].split("\n", 1)[0].strip()
        record.msg = f"{what}: {type(error).__name__} (POLYWIGNER_DEBUG=1 shows more)"
        record.args, record.exc_info, record.exc_text = (), None, None
    return True


class Rarely(logging.Filter):
    """Filter: each line of code logs once a minute, with the number of messages left out."""

    def __init__(self, seconds: float = _REPEATED_S) -> None:
        super().__init__()
        self.seconds = seconds
        self.written: dict[str, tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether it is written."""
        own = record.msg if record.name == _FAULTS else ""
        place = f"{record.pathname}:{record.lineno}:{own}"
        since, left_out = self.written.get(place, (-math.inf, 0))
        if record.created - since < self.seconds:
            self.written[place] = since, left_out + 1
            return False
        self.written[place] = record.created, 0
        text = record.getMessage()
        text = text if len(text) <= _LONGEST else f"{text[:_LONGEST]} …"
        record.msg = f"{text} (and {left_out} more)" if left_out else text
        record.args = ()
        return True


_RARELY = Rarely()


def keep_short() -> None:
    """Set up the loggers of the server."""
    logging.getLogger("bokeh").setLevel(logging.ERROR)
    for name in _SILENT:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    of_bokeh = [name for name in logging.root.manager.loggerDict if name.startswith("bokeh.")]
    for name in {*_ONE_LINE, *of_bokeh}.difference(_SILENT):
        logger = logging.getLogger(name)
        if _shortened not in logger.filters:
            logger.addFilter(_shortened)
            logger.addFilter(_RARELY)
