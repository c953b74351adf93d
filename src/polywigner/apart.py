"""Run a function in a process of its own, with a limit of time and one of memory.

Damaged files, drivers and bad compilers can end a process, hang it or fill the memory. Here they
end a child. The child is a fresh interpreter, or the fork of one that keeps its imports for the
next call: a fork of a process with the threads of Dr.Jit or OpenBLAS can hang, and
`multiprocessing` would run the user's unguarded script again.
"""

from __future__ import annotations

import atexit
import importlib
import os
import pickle
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, TypeVar, cast

from polywigner.errors import EngineError, PolywignerError

if TYPE_CHECKING:
    import subprocess

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
_answer(sys.stdin.buffer)
"""
_SERVER = """
import sys
sys.path[:] = {path!r}
from polywigner.apart import _serve
_serve()
"""
# Seconds of the clock until a server has imported its modules.
_STARTING = 120.0


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
    modules: Sequence[str] = (),
) -> Result:
    """Return ``function()``, called in a process of its own.

    Starting the process takes 0.1 s, and the imports that the function needs. An array of 256 MB
    comes back in a second. With `modules`, where the system can fork, the process is a fork of a
    server that is started once and imports them once: later calls take some 10 ms.

    Parameters
    ----------
    function : of a module of its own name, or a ``functools.partial`` of one; its arguments and
        its result are copied (pickled).
    seconds : of the processor that it may take, and six times as many of the clock.
    memory : bytes of address space that it may have, libraries included: NumPy and Shapely take
        0.15 GB, Dr.Jit with LLVM 0.4 GB on two cores and more on many. None: any number.
    environment : variables to set, as well as those of this process; not with `modules`.
    modules : names of modules to import before the fork. In a process that has such limits, or
        lower ones, the function is called where it is.

    Raises
    ------
    PolywignerError as the function raises it; ChildError (an EngineError) in all other cases.
    """
    if modules and _is_limited(seconds, memory):
        return function()
    from tempfile import TemporaryFile

    forks = bool(modules) and hasattr(os, "fork")
    # files without names: pipes are four times slower, and could fill this process's memory
    with TemporaryFile() as asked, TemporaryFile() as answer, TemporaryFile() as complaints:
        for part in ((sys.path, modules) if forks else sys.path, (seconds, memory), function):
            pickle.dump(part, asked)
        asked.seek(0)
        files = [cast(BinaryIO, file) for file in (asked, answer, complaints)]
        run = _forked if forks else _started
        try:
            status = run(files, _WAITING * seconds, environment)
        except (OSError, ValueError) as error:
            raise _failed(f"one that could not be started ({error})", "start", None, "") from None
        answer.seek(0)
        return cast(Result, _value(files[1], status, seconds, memory, _end_of(files[2])))


def _started(
    files: Sequence[BinaryIO], most: float, environment: Mapping[str, str] | None
) -> int | None:
    """Exit status of a fresh interpreter that answers; None where it was ended after `most` s."""
    import subprocess  # takes 15 ms, which a verdict that is remembered saves

    child = _interpreter(_PROGRAM, files, environment)
    try:
        return child.wait(most)
    except subprocess.TimeoutExpired:
        return None
    finally:
        _end(child)


def _interpreter(
    program: str, files: Sequence[Any], environment: Mapping[str, str] | None = None
) -> subprocess.Popen[bytes]:
    import subprocess

    return subprocess.Popen(
        [sys.executable, "-P", "-c", program],
        stdin=files[0],
        stdout=files[1],
        stderr=files[2],
        env={**os.environ, **_ONE_THREAD, **(environment or {})},
        start_new_session=True,  # ends with the children that it has started
    )


def _forked(
    files: Sequence[BinaryIO], most: float, environment: Mapping[str, str] | None
) -> int | None:
    """Exit status of a child of a server, which is kept for the next call if all went well."""
    server = _Server.idle.pop() if _Server.idle else _Server()
    if not server.is_alive():
        server.end()
        server = _Server()
    status = None
    try:
        status = server.status(files, most)
    finally:  # also when a user interrupts
        if status == 0:
            _Server.idle.append(server)
        else:
            server.end()
    return status


class _Server:
    """A process with one thread that forks a child for each call."""

    idle: list[_Server] = []  # noqa: RUF012

    def __init__(self) -> None:
        import socket
        from subprocess import DEVNULL

        self._channel, theirs = socket.socketpair()
        with theirs:
            files = [theirs, DEVNULL, DEVNULL]
            self._process = _interpreter(_SERVER.format(path=sys.path), files)

    def is_alive(self) -> bool:
        return self._process.poll() is None

    def status(self, files: Sequence[BinaryIO], most: float) -> int | None:
        """Exit status of a child; None where it has taken more seconds than `most`."""
        import socket

        try:
            self._channel.settimeout(_STARTING)
            socket.send_fds(self._channel, [b"-"], [file.fileno() for file in files])
            self._channel.recv(1)  # it has forked
            self._channel.settimeout(most)
            return int(self._channel.recv(8) or 1)  # nothing of a server that has ended
        except TimeoutError:
            return None

    def end(self) -> None:
        self._channel.close()
        _end(self._process)


def end_servers() -> None:
    """End the processes that wait for calls; the next call starts one."""
    while _Server.idle:
        _Server.idle.pop().end()


atexit.register(end_servers)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_Server.idle.clear)  # they answer the parent


def _serve() -> None:
    """Fork a child for each task, until the caller's process ends: in the server."""
    import socket

    channel = socket.socket(fileno=os.dup(0))
    os.dup2(1, 0)
    while (message := socket.recv_fds(channel, 1, 3))[0]:
        asked, answer, complaints = message[1]
        with os.fdopen(asked, "rb") as task:
            sys.path[:], modules = pickle.load(task)
            for name in modules:
                with suppress(Exception):  # the function meets it again
                    importlib.import_module(name)
            child = os.fork()
            if child == 0:
                channel.close()
                os.dup2(answer, 1)
                os.dup2(complaints, 2)
                _answer(task)
        os.close(answer)
        os.close(complaints)
        channel.send(b"-")
        status = os.waitpid(child, 0)[1]
        channel.send(str(os.waitstatus_to_exitcode(status)).encode())


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


def _answer(task: BinaryIO) -> None:
    """Call the function of a task and write its value, or its error, to stdout: in the child."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    seconds, memory = pickle.load(task)
    _limit(seconds, memory)
    try:
        value = pickle.load(task)()
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


def _is_limited(seconds: float, memory: int | None) -> bool:
    if os.name != "posix":
        return False
    import resource

    wanted = {resource.RLIMIT_CPU: max(1, round(seconds)), resource.RLIMIT_AS: memory or 0}
    found = {kind: resource.getrlimit(kind)[0] for kind in wanted}
    return all(0 <= found[kind] <= most for kind, most in wanted.items())


def _limit(seconds: float, memory: int | None) -> None:
    if os.name != "posix":  # where the clock alone counts
        return
    import resource

    whole = max(1, round(seconds))
    wanted = [(resource.RLIMIT_CORE, 0, 0), (resource.RLIMIT_CPU, whole, whole + 1)]
    if memory is not None:
        wanted += [(kind, memory, memory) for kind in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE)]
    for kind, soft, hard in wanted:
        with suppress(ValueError, OSError):  # a lower limit holds already
            resource.setrlimit(kind, (soft, hard))
