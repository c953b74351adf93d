"""Run as a program of its own by ``readings``: a visitor's file is read, JSON goes to stdout.

A damaged file can end a library's process (segmentation faults, loops, memory without bound),
which must not be the server's. Limits are set before the program imports this package.
"""

from __future__ import annotations

import json
import runpy
import sys


def main() -> None:
    """Write the answer of the program named in the JSON text on stdin, or its error."""
    asked = json.load(sys.stdin)
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (asked["memory"],) * 2)
        seconds = int(asked["seconds"])  # also of orphans
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, ValueError, OSError):
        pass  # not on this system
    try:
        found = runpy.run_path(asked["program"])["answer"](asked)
    except LookupError as error:
        found = {"error": error.args[0]}
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
