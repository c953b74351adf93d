"""Packages of Debian and Ubuntu, with root (apt-get install) or without (download and unpack).

Needs the standard library only and imports nothing of polywigner: ``tools/bootstrap`` loads this
file by its path before anything is installed.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

__all__ = ["PackageError", "available", "install", "is_debian", "is_root", "unpack"]

_PATIENCE = 1800.0
"""Seconds that one apt command may take (a slow mirror, not a hanging one)."""


class PackageError(Exception):
    """A package could not be had; the message is one sentence."""


def is_debian() -> bool:
    """Whether apt-get, apt-cache and dpkg-deb are here."""
    return all(shutil.which(tool) for tool in ("apt-get", "apt-cache", "dpkg-deb"))


def is_root() -> bool:
    """Whether packages can be installed into the system."""
    return hasattr(os, "geteuid") and os.geteuid() == 0


def available(names: Sequence[str], options: Sequence[str] = ()) -> list[str]:
    """Those of ``names`` that apt's present lists offer, in the order given."""
    listing = _run("apt-cache", [*options, "madison", *names], check=False)
    offered = {line.split("|")[0].strip() for line in listing.splitlines() if "|" in line}
    return [name for name in names if name in offered]


def install(wanted: Sequence[Sequence[str]]) -> list[str]:
    """Install packages into the system, as root.

    Parameters
    ----------
    wanted : for each thing wanted, the packages that bring it, best first; the first that apt
        knows is taken.

    Returns
    -------
    The names of the packages asked for.

    Raises
    ------
    PackageError when a thing cannot be had.
    """
    options = ["-o", "DPkg::Lock::Timeout=300"]  # another apt-get may be at work
    try:
        names = _choose(wanted, ())
        _run("apt-get", [*options, "install", "-y", "--no-install-recommends", *names])
    except PackageError:  # the lists are empty, or so old that their packages are gone
        _run("apt-get", [*options, "update"])
        names = _choose(wanted, ())
        _run("apt-get", [*options, "install", "-y", "--no-install-recommends", *names])
    return names


def unpack(wanted: Sequence[Sequence[str]], folder: Path) -> list[str]:
    """Download packages, and those they need and the system lacks, and unpack them, without root.

    Nothing is installed: the files lie under ``folder`` as they would under ``/``.

    Parameters
    ----------
    wanted : as for :func:`install`.
    folder : an empty folder.

    Returns
    -------
    The names of the packages unpacked; empty when the system has all of them already.

    Raises
    ------
    PackageError when a thing cannot be had.
    """
    # apt's own helpers do not all cope with spaces in a path, so not below `folder`.
    with tempfile.TemporaryDirectory(prefix="polywigner-apt-") as scratch:
        options = _private_options(Path(scratch))
        try:
            names = _download(wanted, options, Path(scratch))
        except PackageError:  # the lists are empty or old: fetch them, for ourselves only
            options += ["-o", f"Dir::State::lists={scratch}/lists"]
            _run("apt-get", [*options, "update"])
            names = _download(wanted, options, Path(scratch))
        for package in sorted((Path(scratch) / "packages").glob("*.deb")):
            _run("dpkg-deb", ["-x", str(package), str(folder)])
    return names


def _private_options(scratch: Path) -> list[str]:
    """Options that keep apt from writing, or waiting for a lock, outside ``scratch``."""
    for name in ("lists/partial", "cache/archives/partial", "packages"):
        (scratch / name).mkdir(parents=True, exist_ok=True)
    settings = {"Dir::Cache": f"{scratch}/cache", "Debug::NoLocking": "1", "APT::Sandbox::User": ""}
    return [part for key, value in settings.items() for part in ("-o", f"{key}={value}")]


def _download(wanted: Sequence[Sequence[str]], options: Sequence[str], scratch: Path) -> list[str]:
    plan = _run(
        "apt-get", [*options, "-s", "install", "--no-install-recommends", *_choose(wanted, options)]
    )
    # "Inst name (version ..." is new; "Inst name [old] (version ..." would replace a library of
    # the running system, which must not be opened beside the one that is in use.
    names = re.findall(r"^Inst (\S+) \(", plan, flags=re.MULTILINE)
    if names:
        _run("apt-get", [*options, "download", *names], folder=scratch / "packages")
    return names


def _choose(wanted: Sequence[Sequence[str]], options: Sequence[str]) -> list[str]:
    chosen = []
    for alternatives in wanted:
        offered = available(alternatives, options)
        if not offered:
            raise PackageError(f"apt offers no {' or '.join(alternatives[:2])} (is it online?)")
        chosen.append(offered[0])
    return chosen


def _run(
    tool: str, arguments: Sequence[str], *, folder: Path | None = None, check: bool = True
) -> str:
    """What a command prints; PackageError with its last complaint when it fails."""
    try:
        done = subprocess.run(
            [tool, *(["-q"] if tool == "apt-get" else []), *arguments],
            # apt's messages are read here, so they must not be translated.
            env={**os.environ, "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"},
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PATIENCE,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PackageError(f"`{tool}` could not be run ({error})") from None
    if check and done.returncode != 0:
        words = [word for word in arguments if word in ("install", "update", "download", "-x")]
        complaints = re.findall(r"^E: (.*)$", done.stderr, flags=re.MULTILINE)
        told = complaints[-1] if complaints else (done.stderr.strip().splitlines() or ["?"])[-1]
        raise PackageError(f"`{' '.join([tool, *words])}` failed: {told}")
    return done.stdout
