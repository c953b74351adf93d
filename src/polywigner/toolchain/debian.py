"""Packages of Debian and Ubuntu, with root (apt-get install) or without (download and unpack).

Needs the standard library only and imports nothing of polywigner: ``tools/bootstrap`` loads this
file by its path before anything is installed.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Sequence
from pathlib import Path

_PATIENCE = 1800.0
"""Seconds that one apt command may take (a slow mirror, not a hanging one)."""


_MOST_BYTES = 2 << 30
"""Bytes of all files of one package; LLVM's has 130 MB."""


class PackageError(Exception):
    """A package could not be had; the message is one sentence."""


def is_debian() -> bool:
    """Whether apt-get, apt-cache and dpkg-deb are here."""
    return all(shutil.which(tool) for tool in ("apt-get", "apt-cache", "dpkg-deb"))


def is_root() -> bool:
    """Whether packages can be installed into the system."""
    return hasattr(os, "geteuid") and os.geteuid() == 0


def available(names: Sequence[str], options: Sequence[str] = ()) -> list[str]:
    """Return the packages of ``names`` that apt's present lists offer, in their order."""
    listing = _run("apt-cache", [*options, "madison", *names], check=False)
    offered = {line.split("|")[0].strip() for line in listing.splitlines() if "|" in line}
    return [name for name in names if name in offered]


def planned(wanted: Sequence[Sequence[str]]) -> list[str]:
    """Return the packages that :func:`install` would install, by apt's present lists."""
    try:
        return _plan(_choose(wanted, ()), ())
    except PackageError:
        return []


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

    def by_present_lists() -> list[str]:
        names = _choose(wanted, ())
        _run("apt-get", [*options, "install", "-y", "--no-install-recommends", *names])
        return names

    try:
        return by_present_lists()
    except PackageError:  # the lists are empty, or so old that their packages are gone
        _run("apt-get", [*options, "update"])
        return by_present_lists()


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
    PackageError when a thing cannot be had, is not what apt's lists say, or would be written, or
    lead, out of the folder.
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
        packages = sorted((Path(scratch) / "packages").glob("*.deb"))
        _check_sums(packages, names, options)
        for package in packages:
            files = Path(scratch) / "files.tar"
            _run("dpkg-deb", ["--fsys-tarfile", str(package)], output=files)
            _extract(files, folder, package.name)
    return names


def _private_options(scratch: Path) -> list[str]:
    """Options that keep apt from writing, or waiting for a lock, outside ``scratch``."""
    for name in ("lists/partial", "cache/archives/partial", "packages"):
        (scratch / name).mkdir(parents=True, exist_ok=True)
    settings = {"Dir::Cache": f"{scratch}/cache", "Debug::NoLocking": "1", "APT::Sandbox::User": ""}
    return [part for key, value in settings.items() for part in ("-o", f"{key}={value}")]


def _download(wanted: Sequence[Sequence[str]], options: Sequence[str], scratch: Path) -> list[str]:
    names = _plan(_choose(wanted, options), options)
    if names:
        _run("apt-get", [*options, "download", *names], folder=scratch / "packages")
    return names


def _plan(names: Sequence[str], options: Sequence[str]) -> list[str]:
    """These packages, and those they need, as far as the system lacks them."""
    plan = _run("apt-get", [*options, "-s", "install", "--no-install-recommends", *names])
    # "Inst name (version ..." is new; "Inst name [old] (version ..." would replace a library of
    # the running system, which must not be opened beside the one that is in use.
    return re.findall(r"^Inst (\S+) \(", plan, flags=re.MULTILINE)


def _check_sums(packages: Sequence[Path], names: Sequence[str], options: Sequence[str]) -> None:
    """Each file has a SHA-256 of apt's signed lists, where these have one for its package."""
    if not packages:
        return
    sums: dict[str, set[str]] = {}
    for entry in _run("apt-cache", [*options, "show", *names], check=False).split("\n\n"):
        fields = dict(re.findall(r"^(Package|SHA256): (\S+)", entry, flags=re.MULTILINE))
        if len(fields) == 2:
            sums.setdefault(fields["Package"], set()).add(fields["SHA256"])
    for package in packages:
        known = sums.get(package.name.split("_")[0])
        if known and hashlib.sha256(package.read_bytes()).hexdigest() not in known:
            raise PackageError(f"{package.name} is not what apt's lists say (its SHA-256 differs)")


def _extract(archive: Path, folder: Path, name: str) -> None:
    """The files and links of a package, and nothing that is written, or leads, out of the folder.

    Links that lead elsewhere are left out: packages have them, such as into /etc.
    """
    top, size = folder.resolve(), 0
    with tarfile.open(archive) as members:
        for member in members:
            target = top / member.name
            if target == top:
                continue
            size += member.size
            outside = member.name.startswith("/") or ".." in Path(member.name).parts
            if outside or size > _MOST_BYTES:
                raise PackageError(f"{name} has {member.name!r}, out of place or too large")
            if not target.parent.resolve().is_relative_to(top):
                raise PackageError(f"{name} has {member.name!r}, which leads elsewhere")
            if member.isdir():
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            target.unlink(missing_ok=True)
            if member.issym():
                if (target.parent / member.linkname).resolve().is_relative_to(top):
                    target.symlink_to(member.linkname)
            elif member.isreg() or member.islnk():
                content = members.extractfile(member)  # of a hard link: that of its target
                assert content is not None
                with content, target.open("wb") as file:
                    shutil.copyfileobj(content, file)
            else:
                raise PackageError(f"{name} has {member.name!r}, neither a file nor a link")


def _choose(wanted: Sequence[Sequence[str]], options: Sequence[str]) -> list[str]:
    chosen = []
    for alternatives in wanted:
        offered = available(alternatives, options)
        if not offered:
            raise PackageError(f"apt offers no {' or '.join(alternatives[:2])} (is it online?)")
        chosen.append(offered[0])
    return chosen


def _run(
    tool: str,
    arguments: Sequence[str],
    *,
    folder: Path | None = None,
    check: bool = True,
    output: Path | None = None,
) -> str:
    """Return the output of a command; PackageError with its last complaint when it fails.

    ``output`` : a file for what it prints, which then is not returned.
    """
    try:
        with contextlib.nullcontext(subprocess.PIPE) if output is None else output.open("wb") as to:
            done = subprocess.run(
                [tool, *(["-q"] if tool == "apt-get" else []), *arguments],
                # apt's messages are read here, so they must not be translated.
                env={**os.environ, "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"},
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=to,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                timeout=_PATIENCE,
            )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PackageError(f"`{tool}` could not be run ({error})") from None
    if check and done.returncode != 0:
        known = ("install", "update", "download", "--fsys-tarfile")
        words = [word for word in arguments if word in known]
        complaints = re.findall(r"^E: (.*)$", done.stderr, flags=re.MULTILINE)
        told = complaints[-1] if complaints else (done.stderr.strip().splitlines() or ["?"])[-1]
        raise PackageError(f"`{' '.join([tool, *words])}` failed: {told}")
    return done.stdout or ""
