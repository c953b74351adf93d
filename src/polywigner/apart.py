"""Run a function in a process of its own, with a limit of time and one of memory.

Damaged files, drivers and bad compilers can end a process, hang it or fill the memory. Here they
end a child. The child is a fresh interpreter: a fork of a process with the threads of Dr.Jit or
OpenBLAS can hang, and `multiprocessing` would run the user's unguarded script again.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, TypeVar, cast

from polywigner.errors import EngineError, PolywignerError

if TYPE_CHECKING:
    import subprocess

__all__ = ["ChildError", "run_apart"]

Result = TypeVar("Result")
Failure = Literal["time", "memory", "end", "error", "start"]

# Of the clock to those of the processor: what a machine that does other work may take.
_WAITING = 6.0
# OpenBLAS reserves some 30 MB for each thread that it starts, of which a machine may have many.
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
# Of the text that a child has written to stderr, from the end.
_KEPT = 1 << 14
_PROGRAM = """
import pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
from polywigner.apart import _answer
_answer()
"""


class ChildError(EngineError):
    """A function has not returned from its process."""

    def __init__(self, text: str, failure: Failure, status: int | None, stderr: str) -> None:
        super().__init__(text)
        self.failure = failure
        """Why: its time or memory was used up, the process ended by itself, the function raised
        an error that is none of this package, or no process could be started."""
        self.status = status
        """Exit status, the negative number of a signal that has ended it; None: was ended here."""
        self.stderr = stderr
        """The end of the text that it has written to stdout and stderr."""


def run_apart(
    function: Callable[[], Result],
    seconds: float,
    memory: int | None,
    environment: Mapping[str, str] | None = None,
) -> Result:
    """Return ``function()``, called in a process of its own.

    Starting the process takes 0.1 s, and the imports that the function needs. An array of 256 MB
    comes back in a second.

    Parameters
    ----------
    function : of a module of its own name, or a ``functools.partial`` of one; its arguments and
        its result are copied (pickled).
    seconds : of the processor that it may take, and six times as many of the clock.
    memory : bytes of address space that it may have, libraries included: NumPy and Shapely take
        0.15 GB, Dr.Jit with LLVM 0.4 GB on two cores and more on many. None: any number.
    environment : variables to set, as well as those of this process.

    Raises
    ------
    PolywignerError as the function raises it; ChildError (an EngineError) in all other cases.
    """
    import subprocess  # takes 15 ms, which a verdict that is remembered saves
    from tempfile import TemporaryFile

    task = pickle.dumps(sys.path) + pickle.dumps((seconds, memory)) + pickle.dumps(function)
    # files without names: pipes are four times slower, and could fill this process's memory
    with TemporaryFile() as asked, TemporaryFile() as answer, TemporaryFile() as complaints:
        asked.write(task)
        asked.seek(0)
        try:
            child = subprocess.Popen(
                [sys.executable, "-P", "-c", _PROGRAM],
                stdin=asked,
                stdout=answer,
                stderr=complaints,
                env={**os.environ, **_ONE_THREAD, **(environment or {})},
                start_new_session=True,  # ends with the children that it has started
            )
        except (OSError, ValueError) as error:
            raise _failed(f"one that could not be started ({error})", "start", None, "") from None
        try:
            status = child.wait(_WAITING * seconds)
        except subprocess.TimeoutExpired:
            status = None
        finally:
            _end(child)
        answer.seek(0)
        stderr = _end_of(cast(BinaryIO, complaints))
        return cast(Result, _value(cast(BinaryIO, answer), status, seconds, memory, stderr))


def _end(child: subprocess.Popen[bytes]) -> None:
    """End a process, and the processes that it has started; leave no zombie."""
    with suppress(ProcessLookupError, PermissionError):
        if hasattr(os, "killpg"):
            os.killpg(child.pid, signal.SIGKILL)
        else:
            child.kill()
    child.wait()


def _end_of(file: BinaryIO) -> str:
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _KEPT))
    return file.read().decode(errors="replace")


def _value(
    answer: BinaryIO, status: int | None, seconds: float, memory: int | None, stderr: str
) -> Any:
    """The value that a child has returned, or the error."""
    out_of_time = (-signal.SIGXCPU, -signal.SIGKILL) if hasattr(signal, "SIGXCPU") else ()
    if status is None or status in out_of_time:
        raise _failed(f"none within {seconds:g} s", "time", status, stderr)
    try:
        kind, value = pickle.load(answer) if status == 0 else ("end", None)
    except Exception as error:  # cut short, or an object that does not come back
        kind, value = "error", repr(error)
    if kind == "value":
        return value
    if isinstance(value, PolywignerError) and kind == "raised":
        raise value
    if kind == "memory":
        raise _failed(f"none within {memory} bytes of memory", "memory", status, stderr)
    if kind == "error":
        raise _failed(str(value), "error", status, stderr)
    last = (stderr.strip().splitlines() or ["no message"])[-1].strip()
    raise _failed(f"a process that ended with status {status} ({last})", "end", status, stderr)


def _failed(got: str, failure: Failure, status: int | None, stderr: str) -> ChildError:
    return ChildError(
        f"expected an answer from a process of its own, got {got}", failure, status, stderr
    )


def _answer() -> None:
    """Call the function on stdin and write its value, or its error, to stdout: in the child."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    seconds, memory = pickle.load(sys.stdin.buffer)
    _limit(seconds, memory)
    try:
        value = pickle.load(sys.stdin.buffer)()
        pickle.dump(("value", value), answers, protocol=5)
    except BaseException as error:
        answers.seek(0)
        answers.truncate()
        answers.write(_told(error))
    answers.close()
    sys.stdout.flush()
    os._exit(0)  # a library that ends badly after its work has still done it


def _told(error: BaseException) -> bytes:
    if isinstance(error, MemoryError):
        return pickle.dumps(("memory", None))
    if isinstance(error, PolywignerError):
        with suppress(Exception):
            return pickle.dumps(("raised", error))
    import traceback

    traceback.print_exception(error)
    sys.stderr.flush()
    return pickle.dumps(("error", f"{type(error).__name__}: {error}"))


def _limit(seconds: float, memory: int | None) -> None:
    try:
        import resource
    except ImportError:  # not on this system, where the clock alone counts
        return
    whole = max(1, round(seconds))
    wanted = [(resource.RLIMIT_CORE, 0, 0), (resource.RLIMIT_CPU, whole, whole + 1)]
    if memory is not None:
        wanted += [(kind, memory, memory) for kind in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE)]
    for kind, soft, hard in wanted:
        with suppress(ValueError, OSError):  # a lower limit holds already
            resource.setrlimit(kind, (soft, hard))
