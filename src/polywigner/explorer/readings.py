"""Files that visitors send, read in processes of their own within limits of time and memory.

A small file can take minutes and gigabytes, and can end the process of the library that reads it.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Callable, Hashable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import polywigner
from polywigner.errors import FileFormatError, PolywignerError
from polywigner.explorer import library_process
from polywigner.explorer.outlines import Rings, check_upload, rings_of_aperture, without_advice
from polywigner.explorer.state import UNITS, State, Unit

_SECONDS = 10
_MEMORY = 1 << 30
_AT_ONCE = 2
_TOO_MUCH = (
    f"expected a file that is read within {_SECONDS} s and {_MEMORY >> 30} GiB, got one that needs "
    "more; simplify it"
)


class Readings:
    """Reads two files at once; others wait for their turn. The newest of each visitor wins."""

    def __init__(self, seconds: float = _SECONDS, memory: int = _MEMORY) -> None:
        self._seconds, self._memory = seconds, memory
        self._turns = asyncio.Semaphore(_AT_ONCE)
        self._tasks: dict[Hashable, asyncio.Task[None]] = {}
        self.processes: set[Process] = set()
        """Processes that read now."""

    def submit(
        self,
        visitor: Hashable,
        name: str,
        content: bytes,
        unit: Unit,
        then: Callable[[Rings | PolywignerError], None],
    ) -> None:
        """Read a file for a visitor in place of the last one, and call `then` with the result.

        Raises FileFormatError at once for a file that is too large, or of no known format.
        """
        check_upload(name, len(content))
        self.forget(visitor)

        async def work() -> None:
            try:
                then(await self.rings(name, content, unit))
            except PolywignerError as error:
                then(error)

        self._tasks[visitor] = asyncio.get_running_loop().create_task(work())

    def forget(self, visitor: Hashable) -> None:
        """End the reading for a visitor who has left."""
        task = self._tasks.pop(visitor, None)
        if task is not None:
            task.cancel()

    def stop(self) -> None:
        """End all processes, of a loop that does not run any more."""
        for process in self.processes:
            _kill(process)

    async def rings(self, name: str, content: bytes, unit: Unit) -> Rings:
        """Outlines of a file in units, which are its own where it states none.

        The name is used for its suffix and in messages only.

        Raises FileFormatError for what cannot be read, takes too long, or has too many vertices.
        """
        shown, suffix = check_upload(name, len(content))
        async with self._turns:
            with TemporaryDirectory(prefix="polywigner-") as folder:
                path = Path(folder) / f"upload{suffix}"
                path.write_bytes(content)
                found = await self._answer(str(path), unit)
        if "error" in found:
            text = without_advice(found["error"].replace(str(path), shown))
            raise FileFormatError(text if shown in text else f"{shown}: {text}")
        return tuple(tuple((x, y) for x, y in ring) for ring in found["rings"])

    async def _answer(self, path: str, unit: Unit) -> dict[str, Any]:
        limits = {"memory": self._memory, "seconds": self._seconds}
        asked = {"program": __file__, "path": path, "unit": unit, **limits}
        package = str(Path(polywigner.__file__).parent.parent)  # where the server found it
        folders = os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH"), package]))
        variables = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONPATH": folders}
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-P", library_process.__file__, env={**os.environ, **variables},
            stdin=PIPE, stdout=PIPE, stderr=DEVNULL, start_new_session=True,
        )  # fmt: skip
        self.processes.add(process)
        try:
            told = process.communicate(json.dumps(asked).encode())
            text, _ = await asyncio.wait_for(told, self._seconds)
            found = json.loads(text) if process.returncode == 0 else {"error": _TOO_MUCH}
        except TimeoutError:
            found = {"error": _TOO_MUCH}
        finally:
            _kill(process)
            await process.wait()
            self.processes.discard(process)
        return dict(found)


def _kill(process: Process) -> None:
    """End a process, with the processes that it has started."""
    if process.returncode is None:
        with suppress(ProcessLookupError):
            if hasattr(os, "killpg"):
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()


def answer(asked: dict[str, Any]) -> dict[str, Any]:
    """Return outlines in units, or the error of the file: called in the other process."""
    try:
        aperture = polywigner.read_aperture(asked["path"], unit=asked["unit"])
        rings = rings_of_aperture(aperture, UNITS[asked["unit"]])
        return {"rings": State(rings=rings).rings}  # its limits
    except PolywignerError as error:
        return {"error": str(error)}
