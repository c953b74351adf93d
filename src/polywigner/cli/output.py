"""Where a command writes, and how: whole files or none."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from polywigner.errors import ArgumentError

__all__ = ["check_writable", "output_stem", "targets", "writing"]

_KNOWN_SUFFIXES = (".png", ".exr", ".json", ".npz")


def output_stem(out: str | None, name: str) -> Path:
    """The path, without suffix, of the files a command writes.

    Parameters
    ----------
    out : what ``--out`` said. An existing folder, or a text that ends with a slash, is a folder
        and the files in it are called ``name``; anything else is the stem itself, of which a
        suffix such as ``.png`` is taken off. None: ``name`` in the current folder.
    name : the files' name when ``out`` gives none.
    """
    if out is None:
        return Path(name)
    path = Path(out)
    if path.is_dir() or out.endswith(("/", os.sep)):
        return path / name
    return path.with_suffix("") if path.suffix.lower() in _KNOWN_SUFFIXES else path


def targets(stem: Path, suffixes: Sequence[str]) -> tuple[Path, ...]:
    """``stem`` with each of the suffixes (dots in the stem's own name are kept)."""
    return tuple(stem.with_name(stem.name + suffix) for suffix in suffixes)


def check_writable(paths: Sequence[Path]) -> None:
    """Fail before the long work rather than after it.

    Raises
    ------
    ArgumentError : a target is a folder, or its folder can neither be written to nor created.
    """
    for path in paths:
        if path.is_dir():
            raise ArgumentError(f"expected --out to name a file, got the folder {path}; rename it")
        folder = next(parent for parent in path.absolute().parents if parent.exists())
        if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
            raise ArgumentError(
                f"expected a folder that can be written to for {path}, got {folder}; "
                "choose another with --out"
            )


@contextmanager
def writing(paths: Sequence[Path]) -> Iterator[tuple[Path, ...]]:
    """Give a scratch path beside each target; put all of them in place once the block is done.

    Folders are created. A block that raises leaves neither targets nor scratch files; targets of
    an earlier run stay as they were.

    Raises
    ------
    ArgumentError : the operating system refused to write (no permission, disk full, ...).
    """
    # The process id keeps two runs with one target apart: the last to finish wins, whole.
    partials = tuple(p.with_name(f"{p.name}.{os.getpid()}.partial") for p in paths)
    try:
        for path in paths:
            path.parent.mkdir(parents=True, exist_ok=True)
        yield partials
        for partial in partials:
            partial.stat()  # all are there before the first takes its place
        for partial, path in zip(partials, paths, strict=True):
            partial.replace(path)
    except OSError as error:
        raise ArgumentError(
            f"expected to write {', '.join(map(str, paths))}, got {error}; "
            "choose another place with --out"
        ) from error
    finally:
        for partial in partials:
            partial.unlink(missing_ok=True)
