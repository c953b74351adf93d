"""Libraries that read files in processes of their own, within limits of time and memory."""

from __future__ import annotations

import json
import subprocess
import sys
from types import ModuleType
from typing import Any

from polywigner.errors import FileFormatError
from polywigner.geometry.formats import library_process

__all__ = ["in_process"]

_SECONDS = 60
_MEMORY = 4 << 30


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
            command, input=text.encode(), capture_output=True, timeout=_SECONDS, check=False
        )
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
