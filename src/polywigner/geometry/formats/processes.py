"""Libraries that read files in processes of their own, within limits of time and memory."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from types import ModuleType
from typing import Any

from polywigner.errors import FileFormatError
from polywigner.geometry.formats import library_process

__all__ = ["in_process"]

_SECONDS = 10
"""Of the processor; a machine that does other work may take as many times as long."""
_PATIENCE = 60
_OUT_OF_TIME = getattr(signal, "SIGXCPU", signal.SIGTERM)
_MEMORY = 1 << 30


def in_process(
    program: ModuleType, asked: dict[str, Any], kind: str, library: str, remedies: tuple[str, str]
) -> dict[str, Any]:
    """What ``program.answer(asked)`` returns, called in a process of its own.

    `remedies` end the messages about a file that takes too long, and about one that `library` does
    not read. Raises FileFormatError for these, and with the text of a LookupError of ``answer``.
    """
    slow, damaged = remedies
    command = [sys.executable, "-P", library_process.__file__]
    text = json.dumps(
        {"program": program.__file__, "memory": _MEMORY, "seconds": _SECONDS, **asked}
    )
    try:
        done = subprocess.run(
            command, input=text.encode(), capture_output=True, timeout=_PATIENCE, check=False
        )
        if -done.returncode in (_OUT_OF_TIME, getattr(signal, "SIGKILL", signal.SIGTERM)):
            raise subprocess.TimeoutExpired(command, _SECONDS)
        found = json.loads(done.stdout) if done.returncode == 0 else None
    except subprocess.TimeoutExpired:
        raise FileFormatError(
            f"expected {kind} that {library} reads within {_SECONDS} s, got a larger layout; {slow}"
        ) from None
    except (ValueError, OSError):
        found = None
    if not isinstance(found, dict):
        raise FileFormatError(
            f"expected {kind}, got a file that {library} does not read; {damaged}"
        )
    if "error" in found:
        raise FileFormatError(str(found["error"]))
    return found
