"""Ctrl-C ends a command with exit code 130 and one line, and leaves no incomplete files."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from polywigner.interruption import atomic_path, temporary_folder

_CHEVRONS = Path(__file__).parent.parent / "examples" / "two_chevrons" / "chevrons.geojson"
_LINE = "polywigner: interrupted\n"


def write_folder(path, text):
    path.mkdir()
    (path / "chunk").write_text(text)


def read_folder(path):
    return (path / "chunk").read_text()


@pytest.mark.parametrize(
    ("write", "read"),
    [(Path.write_text, Path.read_text), (write_folder, read_folder)],
    ids=["file", "folder"],
)
def test_a_result_appears_complete_or_not_at_all(write, read, tmp_path):
    target = tmp_path / "field.zarr"
    for text, error in (("first", None), ("second", None), ("third", KeyboardInterrupt)):
        try:
            with atomic_path(target) as scratch:
                assert scratch.suffix == ".zarr" and scratch.parent == tmp_path
                write(scratch, text)
                if error:
                    raise error
        except KeyboardInterrupt:
            pass
        assert read(target) == ("second" if error else text)
        assert list(tmp_path.iterdir()) == [target]


def test_a_folder_that_cannot_be_replaced_is_put_back(tmp_path, monkeypatch):
    target = tmp_path / "field.zarr"
    write_folder(target, "first")
    rename = Path.rename

    def fail(self, to):
        if ".partial" in self.name and to == target and not self.name.endswith(".old"):
            raise KeyboardInterrupt
        return rename(self, to)

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(KeyboardInterrupt), atomic_path(target) as scratch:
        write_folder(scratch, "second")
    assert read_folder(target) == "first" and list(tmp_path.iterdir()) == [target]


def test_an_old_folder_that_cannot_be_removed_is_no_error(tmp_path, monkeypatch):
    target = tmp_path / "field.zarr"
    write_folder(target, "first")

    def fail(*_, **__):
        raise PermissionError

    with atomic_path(target) as scratch:
        write_folder(scratch, "second")
        monkeypatch.setattr("os.rmdir", fail)
    assert read_folder(target) == "second"


def test_a_temporary_folder_is_removed_with_its_files():
    with pytest.raises(KeyboardInterrupt), temporary_folder() as folder:
        Path(folder, "scratch").touch()
        raise KeyboardInterrupt
    assert not Path(folder).exists()


_AT_AN_IMPORT = """
import os, signal, sys
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == "shapely.lib":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupts())
from polywigner.cli import main
sys.exit(main())
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
def test_ctrl_c_ends_a_command_with_130_and_one_line(tmp_path):
    words = ("transform", str(_CHEVRONS), "--frequency", "94 GHz")
    done = subprocess.run(
        [sys.executable, "-c", _AT_AN_IMPORT, *words], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (130, _LINE)
    assert not list(tmp_path.iterdir())
