"""Atomic writing of files and folders: completely or not at all, even after Ctrl-C."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a scratch path next to ``path``, and rename it to ``path`` when the block ends.

    The scratch path has the same suffix as ``path``. If the block raises an exception, including
    KeyboardInterrupt, the new content is removed, and an earlier file or folder at ``path`` stays
    unchanged.
    """
    scratch = scratch_of(path)
    try:
        yield scratch
        if scratch.is_dir() and path.is_dir():
            _replace_folder(scratch, path)
        else:
            scratch.replace(path)
    finally:
        _remove(scratch)


def scratch_of(path: Path) -> Path:
    """Return the scratch path that :func:`atomic_path` uses in this process."""
    return path.with_name(f"{path.name}.{os.getpid()}.partial{path.suffix}")


def temporary_folder() -> TemporaryDirectory[str]:
    """Return a temporary folder that is removed at the end of a ``with`` block."""
    return TemporaryDirectory(prefix="polywigner-", ignore_cleanup_errors=True)


def _replace_folder(scratch: Path, path: Path) -> None:
    """Move the folder ``scratch`` to ``path``, and remove the earlier folder there.

    If an exception occurs, the earlier folder is restored.
    """
    old = scratch.with_name(f"{scratch.name}.old")
    path.rename(old)
    try:
        scratch.rename(path)
    # BaseException includes KeyboardInterrupt, so Ctrl-C also restores the old folder.
    except BaseException:
        if not path.exists():
            old.rename(path)
        raise
    _remove(old)


def _remove(path: Path) -> None:
    """Remove a file or a folder with its content, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()
