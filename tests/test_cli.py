"""Exit codes, error messages and start-up time of the command line."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from polywigner.cli import main
from polywigner.cli.options import check_writable, output_stem, targets, write
from polywigner.cli.sources import frequency_text
from polywigner.errors import ArgumentError

HEAVY = ("numpy", "shapely", "matplotlib", "drjit", "mitsuba", "rich")


def test_help_imports_no_heavy_library():
    code = (
        "import sys; from polywigner.cli import main; main(['--help']); main(['render', '--help']);"
        f"print('HEAVY', [m for m in {HEAVY} if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "HEAVY []" in run.stdout and not run.stderr
    assert all(command in run.stdout for command in ("render", "transform", "doctor"))


# Limits of the processor time for importing the package and for printing the help [s], ten times
# the usual time.
IMPORT, HELP = 0.3, 0.5


@pytest.mark.skipif(sys.platform == "win32", reason="no times of children there")
@pytest.mark.parametrize(
    ("command", "seconds"),
    [(("-c", "import polywigner"), IMPORT), (("-m", "polywigner", "--help"), HELP)],
    ids=["import", "help"],
)
def test_a_cold_start_takes_no_time_to_speak_of(command, seconds):
    subprocess.run([sys.executable, *command], capture_output=True, check=True)  # compiles bytecode
    before = os.times()
    subprocess.run([sys.executable, *command], capture_output=True, check=True)
    after = os.times()
    spent = after.children_user + after.children_system
    assert spent - before.children_user - before.children_system < seconds


def test_no_command_shows_the_help_and_fails(capsys):
    assert main([]) == 2
    assert "Usage: polywigner" in capsys.readouterr().out


def _raising(monkeypatch, error):
    def check(_):
        raise error

    monkeypatch.setattr("polywigner.cli.sources.SourceOptions.check", check)


@pytest.mark.parametrize(
    "error",
    [KeyboardInterrupt(), RuntimeError("failed to instantiate a plugin: KeyboardInterrupt:")],
    ids=["Python", "Mitsuba"],
)
def test_an_interruption_ends_with_130_and_one_line(error, monkeypatch, capsys):
    _raising(monkeypatch, error)
    assert main(["transform", "a.wkt"]) == 130
    assert capsys.readouterr().err == "polywigner: interrupted\n"


def test_too_little_memory_ends_with_1_and_one_line(monkeypatch, capsys):
    _raising(monkeypatch, MemoryError("8 GiB"))
    assert main(["transform", "a.wkt"]) == 1
    assert "out of memory (8 GiB); use fewer samples" in capsys.readouterr().err


def test_an_unforeseen_error_says_how_to_report_it_and_shows_its_traceback_only_on_request(
    monkeypatch, capsys
):
    _raising(monkeypatch, RuntimeError("the sky\nfell"))
    monkeypatch.delenv("POLYWIGNER_DEBUG", raising=False)
    assert main(["transform", "a.wkt"]) == 1
    quiet = capsys.readouterr().err
    assert quiet.count("\n") == 1
    assert "unexpected RuntimeError: the sky fell" in quiet
    assert "POLYWIGNER_DEBUG=1" in quiet
    monkeypatch.setenv("POLYWIGNER_DEBUG", "1")
    assert main(["transform", "a.wkt"]) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(("out", "stem"), [("a/b.NC", "a/b"), ("a/at_2.5", "a/at_2.5")])
def test_only_suffixes_of_results_are_removed_from_names(out, stem):
    assert output_stem(out, "field") == Path(stem)


def test_files_appear_together_and_only_once_they_are_whole(tmp_path):
    paths = targets(tmp_path / "new" / "at_2.5", (".x", ".y"))

    def write_last(scratch):
        assert ".partial." in scratch.name
        assert not any(path.exists() for path in paths)
        scratch.write_text("whole")

    write(paths, [{}, write_last])
    assert [path.name for path in sorted((tmp_path / "new").iterdir())] == ["at_2.5.x", "at_2.5.y"]


def test_a_failure_keeps_the_old_files_and_leaves_no_scratch(tmp_path):
    paths = targets(tmp_path / "a", (".x", ".y"))
    paths[0].write_text("old")
    with pytest.raises(ZeroDivisionError):
        write(paths, [{}, lambda scratch: 1 / 0])
    assert [p.name for p in tmp_path.iterdir()] == ["a.x"]
    assert paths[0].read_text() == "old"


def test_a_place_that_cannot_be_written_to_is_found_before_the_work(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match=r"cannot write .* to the folder"):
        check_writable([tmp_path / "file" / "deeper" / "a.png"])
    check_writable([tmp_path / "new" / "a.png"])
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("wavelength", "text"),
    [(299792458 / 94e9, "94 GHz"), (1e-6, "299.8 THz"), (3e9, "0.09993 Hz")],
)
def test_titles_state_the_frequency_of_a_wavelength(wavelength, text):
    assert frequency_text(wavelength) == text


def test_a_range_profile_may_have_65536_bins(capsys):
    for bins, words in (("65536", "none.xml"), ("65537", "--bins")):
        assert main(["receive", "none.xml", "--range", "9 m", "--bins", bins]) == 2
        assert words in capsys.readouterr().err
