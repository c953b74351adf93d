"""The architecture as a test: imports run only downwards through the rooms, and each of the two
heavy libraries has one home.

Every import is read from the syntax tree, so one inside a function counts like one at the top,
and so do ``from polywigner import name``, ``pw.name`` and ``importlib.import_module("...")``.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

import polywigner
from package_imports import PACKAGE, imports_of, sources

# A room may import from those above it in this list, never from those below or beside it.
ROOMS = [
    ("errors", "interruption"),
    ("quantities", "citations", "apart"),
    ("geometry",),
    ("illumination", "optics"),
    ("toolchain", "numerics", "plans"),
    ("kernels",),
    ("execution",),
    ("transforms",),
    ("radiometry",),
    ("propagation",),
    ("reception",),
    ("scattering", "rays"),
    ("mitsuba", "testing"),  # `testing` is for users: it checks the public transforms
    ("figures",),
    ("explorer",),
    ("cli",),
    ("__main__",),
]
LEVEL = {name: level for level, names in enumerate(ROOMS) for name in names}

# Library -> rooms that may import it.
HOMES = {
    "drjit": {
        "execution",
        "toolchain",
        "mitsuba",
    },  # the plugin's sampling code is Dr.Jit code by nature
    "mitsuba": {"mitsuba"},
}

# (file, what it imports) -> why that is right although the rules say no.
EXCEPTIONS: dict[tuple[str, str], str] = {}

# Files that run before anything is installed, or before Dr.Jit's library is chosen.
STANDARD_LIBRARY_ONLY = {
    "toolchain/debian.py": (),
    "toolchain/llvm_discovery.py": (),
    "toolchain/trials.py": (
        "polywigner.toolchain",
        "polywigner.interruption",
        "polywigner.apart",
    ),
    # drjit: by require_drjit() only, when the library has been chosen
    "toolchain/llvm.py": ("polywigner.toolchain", "polywigner.errors", "drjit"),
    "toolchain/llvm_install.py": (
        "polywigner.toolchain",
        "polywigner.errors",
        "polywigner.interruption",
    ),
    "toolchain/native_hook.py": ("polywigner.toolchain",),
    "errors.py": (),
    "apart.py": ("polywigner.errors",),
    "interruption.py": (),
}


def room_of(path: Path) -> str:
    first = path.relative_to(PACKAGE).parts[0]
    return first.removesuffix(".py")


def room_imported(name: str) -> str | None:
    """The room that a dotted name leads into; None for what lies outside the package."""
    parts = name.split(".")
    if parts[0] != "polywigner" or len(parts) < 2:
        return None
    public = polywigner._HOMES.get(parts[1])  # `from polywigner import wigner` is transforms'
    return public.split(".")[1] if public and "." in public else parts[1]


def breaches(tree: ast.AST, file: str) -> list[str]:
    """What a module imports against the rules."""
    room = file.split("/")[0].removesuffix(".py")
    package = ".".join(["polywigner", *file.split("/")[:-1]])
    found = []
    for name in imports_of(tree, package):
        if (file, name) in EXCEPTIONS:
            continue
        library = name.split(".")[0]
        if room not in HOMES.get(library, {room}):
            found.append(f"{file} imports {library}, whose home is {sorted(HOMES[library])}")
        other = room_imported(name)
        if other in LEVEL and other != room and LEVEL[other] >= LEVEL[room]:
            found.append(f"{file} ({room}) imports {name} ({other}): not a room above it")
    return found


def test_every_file_stands_in_a_known_room() -> None:
    strays = {room_of(path) for path in sources()} - set(LEVEL) - {"__init__"}
    assert not strays, f"give these a place in ROOMS: {sorted(strays)}"


def test_imports_run_only_downwards() -> None:
    files = {path.relative_to(PACKAGE).as_posix(): path for path in sources()}
    del files["__init__.py"]  # the public names: it may name every room, lazily (checked below)
    found = [
        breach
        for file, path in files.items()
        for breach in breaches(ast.parse(path.read_text(encoding="utf-8")), file)
    ]
    assert found == []


def test_the_public_names_are_loaded_lazily() -> None:
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    eager = [n for n in tree.body if isinstance(n, ast.Import | ast.ImportFrom)]
    names = {a.name for n in eager if isinstance(n, ast.Import) for a in n.names}
    names |= {n.module or "" for n in eager if isinstance(n, ast.ImportFrom)}
    foreign = {name.split(".")[0] for name in names} - set(sys.stdlib_module_names)
    assert not foreign


@pytest.mark.parametrize("file", sorted(STANDARD_LIBRARY_ONLY))
def test_what_runs_before_the_set_up_needs_the_standard_library_only(file: str) -> None:
    allowed = STANDARD_LIBRARY_ONLY[file]
    tree = ast.parse((PACKAGE / file).read_text(encoding="utf-8"))
    package = ".".join(["polywigner", *file.split("/")[:-1]])
    foreign = [
        name
        for name in imports_of(tree, package)
        if name.split(".")[0] not in sys.stdlib_module_names and not name.startswith(allowed)
    ]
    assert foreign == []


def test_every_exception_is_still_needed() -> None:
    for file, name in EXCEPTIONS:
        tree = ast.parse((PACKAGE / file).read_text(encoding="utf-8"))
        package = ".".join(["polywigner", *file.split("/")[:-1]])
        assert name in set(imports_of(tree, package)), f"{file} no longer imports {name}"


@pytest.mark.parametrize(
    ("file", "source"),
    [
        ("geometry/x.py", "import drjit"),
        ("transforms.py", "import drjit.llvm as l"),
        ("kernels/x.py", "def f():\n    from drjit import cuda"),
        ("execution/x.py", "import mitsuba as mi"),
        ("figures/x.py", "from mitsuba import load_dict"),
        ("cli/x.py", "import importlib\nimportlib.import_module('mitsuba')"),
        ("cli/x.py", "import importlib\nimportlib.import_module(f'drjit.{kind}')"),
        ("geometry/x.py", "from polywigner.kernels import y"),
        ("geometry/x.py", "from ..execution import sums"),
        ("geometry/x.py", "from .. import transforms"),
        ("kernels/x.py", "def f():\n    import polywigner.transforms"),
        ("kernels/x.py", "from polywigner import wigner"),
        ("kernels/x.py", "import polywigner as pw\npw.fourier(1, 2)"),
        ("execution/x.py", "from polywigner import mitsuba"),
        ("errors.py", "from polywigner.quantities import parse_length"),
        ("mitsuba/x.py", "from polywigner.testing import y"),
        ("explorer/x.py", "import polywigner.cli"),
    ],
)
def test_the_rules_see_a_breach(file: str, source: str) -> None:
    assert breaches(ast.parse(source), file)


@pytest.mark.parametrize(
    ("file", "source"),
    [
        ("execution/x.py", "import drjit as dr"),
        ("mitsuba/x.py", "import mitsuba as mi\nimport drjit as dr"),
        ("execution/x.py", "from polywigner.geometry import Aperture"),
        ("cli/x.py", "import polywigner as pw\npw.wigner(1, 2, 3)"),
        ("geometry/x.py", "from .rings import y\nfrom polywigner import __version__"),
        ("mitsuba/x.py", "from polywigner.mitsuba.plugins import register"),
    ],
)
def test_the_rules_let_right_imports_pass(file: str, source: str) -> None:
    assert breaches(ast.parse(source), file) == []
