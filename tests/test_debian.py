"""Packages that are unpacked without root stay in their folder, and are what apt's lists say; and
nothing is installed into the system unasked."""

import hashlib
import io
import os
import tarfile

import pytest

from polywigner.cli import doctor
from polywigner.errors import EngineError
from polywigner.toolchain import debian, llvm_install

_BYTES = b"a library"


def _archive(path, *members):
    """A tar file of (name, type, target of a link)."""
    with tarfile.open(path, "w") as archive:
        for name, kind, target in members:
            member = tarfile.TarInfo(name)
            member.type, member.linkname = kind, target
            member.size = len(_BYTES) if kind == tarfile.REGTYPE else 0
            archive.addfile(member, io.BytesIO(_BYTES))
    return path


@pytest.mark.parametrize(
    "members",
    [
        [("/etc/evil", tarfile.REGTYPE, "")],
        [("../evil", tarfile.REGTYPE, "")],
        [("usr/../../evil", tarfile.REGTYPE, "")],
        [("usr/device", tarfile.CHRTYPE, "")],
    ],
    ids=["absolute", "above", "above from within", "device"],
)
def test_members_out_of_place_are_refused(members, tmp_path):
    folder = tmp_path / "tree"
    folder.mkdir()
    with pytest.raises(debian.PackageError, match=r"evil|device"):
        debian._extract(_archive(tmp_path / "a.tar", *members), folder, "a.deb")
    assert not list(folder.rglob("evil")) and not (tmp_path / "evil").exists()


def test_links_within_are_kept_and_links_that_lead_out_are_left_out(tmp_path):
    folder = tmp_path / "tree"
    folder.mkdir()
    members = [
        (".", tarfile.DIRTYPE, ""),
        ("lib/libx.so.1", tarfile.REGTYPE, ""),
        ("lib/libx.so", tarfile.SYMTYPE, "libx.so.1"),
        ("lib/hard.so", tarfile.LNKTYPE, "lib/libx.so.1"),
        ("lib/out", tarfile.SYMTYPE, "../../.."),
        ("etc", tarfile.SYMTYPE, str(tmp_path)),
        ("etc/file", tarfile.REGTYPE, ""),
    ]
    debian._extract(_archive(tmp_path / "a.tar", *members), folder, "a.deb")
    assert (folder / "lib" / "libx.so").read_bytes() == _BYTES
    assert (folder / "lib" / "hard.so").read_bytes() == _BYTES
    assert not (folder / "lib" / "out").is_symlink() and not (tmp_path / "file").exists()


def test_a_package_with_another_sum_than_apts_is_refused(tmp_path, monkeypatch):
    package, tool = tmp_path / "libx_1%3a2_amd64.deb", tmp_path / "apt-cache"
    package.write_bytes(_BYTES)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    digest = hashlib.sha256(_BYTES).hexdigest()
    for listed, is_refused in ((digest, False), (digest[::-1], True)):
        tool.write_text(f"#!/bin/sh\nprintf 'Package: libx\\nSHA256: {listed}\\n\\n'\n")
        tool.chmod(0o755)
        if not is_refused:
            debian._check_sums([package], ["libx"], ())
            continue
        with pytest.raises(debian.PackageError, match="SHA-256 differs"):
            debian._check_sums([package], ["libx"], ())


def test_folders_of_killed_runs_are_swept_and_those_of_running_ones_kept(tmp_path):
    names = [".partial-abc", ".partial-999999999-x", f".partial-{os.getpid()}-x", "native"]
    for name in names:
        (tmp_path / name).mkdir()
    llvm_install._sweep(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == set(names[2:])


def test_without_a_terminal_nothing_is_installed_into_the_system_unless_told(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    with pytest.raises(EngineError, match="--yes"):
        doctor._ask("an LLVM library")


@pytest.mark.parametrize("answer", ["n\n", "\n", "", "y\n", "Yes\n"])
def test_on_a_terminal_only_yes_is_consent(answer, monkeypatch):
    terminal = io.StringIO(answer)
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr("sys.stdin", terminal)
    if answer.lower().startswith("y"):
        doctor._ask("an LLVM library")
        return
    with pytest.raises(EngineError, match="nothing has been installed"):
        doctor._ask("an LLVM library")
