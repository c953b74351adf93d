"""Messages of the server in the terminal: few, and no traceback that nobody asked for."""

from __future__ import annotations

import logging
import math
import os

__all__ = ["keep_short", "log_fault"]

_FAULTS = "polywigner.explorer"
# requests that are damaged, and faults of callbacks: a line each
_ONE_LINE = (_FAULTS, "tornado.application", "bokeh.server.protocol_handler", "asyncio")
_REPEATED_S = 60.0  # seconds in which a line is written once
_MOST_LINES = 100  # that are remembered
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


class _Rarely(logging.Filter):
    """Lets a line through once a minute, with the number of those that were left out."""

    def __init__(self, seconds: float = _REPEATED_S) -> None:
        super().__init__()
        self.seconds = seconds
        self.written: dict[str, tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether it is written."""
        since, left_out = self.written.get(str(record.msg), (-math.inf, 0))
        if record.created - since < self.seconds:
            self.written[str(record.msg)] = since, left_out + 1
            return False
        if len(self.written) >= _MOST_LINES:
            self.written.clear()
        self.written[str(record.msg)] = record.created, 0
        if left_out:
            record.msg = f"{record.msg} (and {left_out} more)"
        return True


_RARELY = _Rarely()


def keep_short() -> None:
    """Set up the loggers of the server."""
    logging.getLogger("bokeh").setLevel(logging.ERROR)
    for name in _SILENT:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    for name in _ONE_LINE:
        logger = logging.getLogger(name)
        if _shortened not in logger.filters:
            logger.addFilter(_shortened)
            logger.addFilter(_RARELY)
