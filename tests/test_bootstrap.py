"""``tools/bootstrap``, with recorded instead of real downloads."""

import importlib.machinery
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parent.parent / "tools" / "bootstrap"

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="make and flock are Unix's")


def load_bootstrap():
    loader = importlib.machinery.SourceFileLoader("bootstrap", str(SCRIPT))
    specification = importlib.util.spec_from_loader("bootstrap", loader)
    assert specification is not None
    module = importlib.util.module_from_spec(specification)
    loader.exec_module(module)
    return module


class Project:
    """A project folder with the bootstrap script and a record of its steps."""

    def __init__(self, root):
        self.module = load_bootstrap()
        self.steps: list[str] = []
        self.move(root)

    def move(self, root):
        """Move the project to another folder."""
        self.root = root
        environment = root / ".venv"
        self.module.ROOT = root
        self.module.ENVIRONMENT = environment
        self.module.INTERPRETER = environment / "bin" / "python"
        self.module.STAMP = environment / "polywigner-setup.json"
        self.module.create = self.create
        self.module.install = self.install
        self.module.install_llvm = lambda: self.steps.append("llvm")
        self.module.say = lambda message: None

    def create(self, python):
        shutil.rmtree(self.root / ".venv", ignore_errors=True)
        version = f"python3.{sys.version_info.minor}"
        packages = self.root / ".venv" / "lib" / version / "site-packages"
        for name in ("numpy", "shapely", "drjit", "mitsuba", "matplotlib"):
            (packages / name).mkdir(parents=True)
        (self.root / ".venv" / "bin").mkdir()
        (self.root / ".venv" / "bin" / "python").symlink_to(sys.executable)
        self.steps.append("create")

    def install(self, group):
        self.steps.append(f"install {group}")

    def set_up(self, group="test", python=None):
        """Return the steps of one run of the bootstrap."""
        self.steps = []
        done = self.module.set_up(python, group)
        assert done == bool(self.steps)
        return self.steps


@pytest.fixture
def project(tmp_path):
    root = tmp_path / "a project"
    root.mkdir()
    (root / "pyproject.toml").write_text("[project]\n")
    return Project(root)


def test_a_second_run_does_nothing(project):
    assert project.set_up() == ["create", "install test", "llvm"]
    assert project.set_up() == []


def test_a_demo_after_the_tests_needs_nothing_and_tests_after_a_demo_only_their_tools(project):
    project.set_up("demo")
    assert project.set_up("test") == ["install test", "llvm"]
    assert project.set_up("demo") == []
    assert project.set_up("dev") == ["install dev", "llvm"]
    assert project.set_up("test") == []


def test_every_group_installs_what_the_groups_that_it_contains_do():
    extras = tomllib.loads((SCRIPT.parent.parent / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]

    def closure(names):
        result = set(names.split(","))
        inner = [need[11:-1] for name in result for need in extras[name] if "polywigner[" in need]
        return result.union(*map(closure, inner))

    module = load_bootstrap()
    contents = {name: closure(extras) for name, extras in module.EXTRAS.items()}
    for name, contained in module.CONTAINED.items():
        assert all(contents[part] <= contents[name] for part in contained)


def test_new_requirements_are_installed_into_the_same_environment(project):
    project.set_up("dev")
    (project.root / "pyproject.toml").write_text("[project]\nversion = '2'\n")
    assert project.set_up("demo") == ["install dev", "llvm"]


def interrupted(project):
    def killed(group):
        raise KeyboardInterrupt

    (project.root / "pyproject.toml").write_text("[project]\nversion = '2'\n")
    project.module.install = killed
    with pytest.raises(KeyboardInterrupt):
        project.module.set_up(None, "test")
    project.module.install = project.install


def without_its_interpreter(project):
    link = project.root / ".venv" / "bin" / "python"
    link.unlink()
    link.symlink_to("/gone/python3")


def without_a_library(project):
    (library,) = project.root.glob(".venv/lib/*/site-packages/mitsuba")
    library.rmdir()


def with_a_stamp(text):
    return lambda project: (project.root / ".venv" / "polywigner-setup.json").write_text(text)


def made_by_hand(project):
    (project.root / ".venv" / "polywigner-setup.json").unlink()


def moved(project):
    # The scripts in .venv/bin contain the old path in their first line.
    project.move(project.root.rename(project.root.with_name("elsewhere")))


@pytest.mark.parametrize(
    "damage",
    [
        interrupted,
        without_its_interpreter,
        without_a_library,
        with_a_stamp('{"project"'),
        made_by_hand,
        moved,
    ],
)
def test_a_damaged_environment_is_made_anew(damage, project):
    project.set_up()
    damage(project)
    assert project.set_up() == ["create", "install test", "llvm"]
    assert project.set_up() == []


def test_another_python_asks_for_another_environment_and_then_stays(project):
    project.set_up()
    other = {"path": "/opt/python3.99", "version": "3.99.0"}
    this = project.module.python_of(None)
    project.module.python_of = lambda named: other if named == "python3.99" else this
    assert project.set_up(python="python3.99")[0] == "create"
    assert project.set_up(python="python3.99") == []
    assert project.set_up() == []


@pytest.mark.parametrize(
    ("interpreter", "complaint"),
    [
        ("no-such-python", "there is no interpreter 'no-such-python'"),
        ("false", "is not a working Python"),
        ("python3.9", r"3\.11 or newer, but .* is Python 3\.9"),
    ],
)
def test_an_interpreter_that_cannot_be_used_is_one_sentence(
    interpreter, complaint, project, tmp_path, monkeypatch
):
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    (tmp_path / "python3.9").write_text(f"#!/bin/sh\necho {tmp_path}/python3.9\necho 3.9.2\n")
    (tmp_path / "python3.9").chmod(0o755)
    with pytest.raises(project.module.SetupError, match=complaint):
        project.set_up(python=interpreter)
    assert not (project.root / ".venv").exists()


def test_an_activated_environment_and_foreign_paths_do_not_reach_inside(project, monkeypatch):
    for variable in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PIP_TARGET"):
        monkeypatch.setenv(variable, "/somewhere/else")
    monkeypatch.setenv("PIP_INDEX_URL", "https://index.example")
    code = "import os, json; print(json.dumps(dict(os.environ)))"
    seen = json.loads(project.module.run([sys.executable, "-I", "-c", code]).stdout)
    assert not {"PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PIP_TARGET"} & set(seen)
    assert seen["PIP_INDEX_URL"] == "https://index.example"  # The user's settings of pip apply.


def test_two_runs_at_once_take_turns(project, monkeypatch):
    other = (
        "import fcntl, os, sys\n"
        f"handle = os.open({str(project.root)!r}, os.O_RDONLY)\n"
        "try: fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)\n"
        "except BlockingIOError: sys.exit(7)"
    )

    def set_up(named, group):
        assert subprocess.run([sys.executable, "-c", other]).returncode == 7

    monkeypatch.setattr(sys, "argv", ["bootstrap"])
    monkeypatch.setattr(project.module, "set_up", set_up)
    project.module.main()
