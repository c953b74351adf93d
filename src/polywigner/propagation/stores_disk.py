"""One run at a time for a store, and files that outlast a power cut."""

from __future__ import annotations

import errno
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from polywigner.errors import StoreError

try:
    import fcntl as _fcntl
except ImportError:  # Windows has no lock of this kind: its runs go on without
    _LOCKS: Any = None
else:
    _LOCKS = _fcntl

__all__ = ["one_run", "to_disk"]

# What file systems answer that cannot be asked to write something out.
_NOT_KNOWN = {errno.EINVAL, errno.ENOTSUP, errno.ENOSYS}


@contextmanager
def one_run(path: Path) -> Iterator[None]:
    """Hold the place of a store for this run. Raises StoreError while another run holds it.

    The system's lock on the file NAME.lock beside the store ends with its process, whatever ends
    that. The next run takes over the file that a killed run leaves, and removes it. Workers of a
    cluster take no lock: theirs is the run of the process that started it.

    Nothing is locked on Windows, on file systems without such locks, and in folders that cannot be
    written to.
    """
    file = path.with_name(f"{path.name}.lock")
    descriptor = None if _LOCKS is None else _locked(file, path)
    try:
        yield
    finally:
        if descriptor is not None:
            file.unlink(missing_ok=True)  # first: who opens it now waits for nobody
            os.close(descriptor)


def _locked(file: Path, path: Path) -> int | None:
    """The file, open and locked; None where that cannot be."""
    while True:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            return None  # if there is something to write, writing says why it cannot
        try:
            _LOCKS.flock(descriptor, _LOCKS.LOCK_EX | _LOCKS.LOCK_NB)
            if _is_at(descriptor, file):
                os.ftruncate(descriptor, 0)
                os.write(descriptor, f"{os.getpid()} on {platform.node()}".encode())
                return descriptor
            os.close(descriptor)  # of a run that has just ended, and removed it
        except BlockingIOError:
            holder = os.read(descriptor, 300).decode(errors="replace")
            os.close(descriptor)
            raise StoreError(
                f"expected no other run to write to {path}, got one that does (process {holder}); "
                "wait for its end, or choose another name"
            ) from None
        except OSError:
            os.close(descriptor)
            file.unlink(missing_ok=True)
            return None


def _is_at(descriptor: int, file: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), file.stat())
    except FileNotFoundError:
        return False


def to_disk(path: Path) -> None:
    """Wait until the content of a file, or the names in a folder, are on the disk."""
    is_folder = path.is_dir()
    if is_folder and os.name == "nt":  # keeps no folder open
        return
    descriptor = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NOT_KNOWN:
            raise
    finally:
        os.close(descriptor)
