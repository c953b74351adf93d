"""The architecture as a test: imports run only downwards through the rooms, and each of the two
heavy libraries has one home.

Every import is read from the syntax tree, so one inside a function counts like one at the top,
and so do ``from polywigner import name``, ``pw.name`` and ``importlib.import_module("...")``.
"""

import ast
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import polywigner

PACKAGE = Path(polywigner.__file__).parent
# The public names may name every room, lazily.
FILES = {
    file: path.read_text(encoding="utf-8")
    for path in sorted(PACKAGE.rglob("*.py"))
    if (file := path.relative_to(PACKAGE).as_posix()) != "__init__.py"
}

# A room may import from those above it in this list, never from those below or beside it.
ROOMS = [
    ("errors", "interruption"),
    ("quantities", "citations", "numerics"),
    ("geometry",),
    ("source", "optics"),
    ("llvm",),
    ("kernels",),
    ("execution",),
    ("transforms",),
    ("radiometry",),
    ("propagation",),
    ("reception",),
    ("scattering", "rays"),
    ("radar",),
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
        "llvm",
        "mitsuba",
    },  # the plugin's sampling code is Dr.Jit code by nature
    "mitsuba": {"mitsuba"},
}

# Files that run before anything is installed, or before Dr.Jit's library is chosen.
STANDARD_LIBRARY_ONLY = {
    # drjit: in require_drjit() only, after a library has been selected
    "llvm.py": ("polywigner.errors", "polywigner.interruption", "drjit"),
    "errors.py": (),
    "interruption.py": (),
}


def imports_of(text: str, package: str, at_run_time: bool = False) -> Iterator[str]:
    """Absolute dotted names of everything that a module imports, wherever it stands.

    ``package`` is the module's package, for relative imports. ``at_run_time``: without what only a
    type checker imports.
    """
    aliases = {"polywigner"}
    nodes = [node for node, runs in nodes_of(text) if runs or not at_run_time]
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
                if alias.name == "polywigner":
                    aliases.add(alias.asname or alias.name)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = package.split(".")
                base = ".".join([*parents[: len(parents) - node.level + 1], *filter(None, [base])])
            for alias in node.names:
                yield f"{base}.{alias.name}"
        elif isinstance(node, ast.Call):
            yield from dynamic_import(node)
    for node in nodes:
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in aliases
        ):
            yield f"polywigner.{node.attr}"


@cache
def nodes_of(text: str) -> list[tuple[ast.AST, bool]]:
    """The nodes of a module that imports are read from, and whether they run."""
    result: list[tuple[ast.AST, bool]] = []
    left: list[tuple[ast.AST, bool]] = [(ast.parse(text), True)]
    while left:
        node, runs = left.pop()
        if isinstance(node, ast.Import | ast.ImportFrom | ast.Call | ast.Attribute):
            result.append((node, runs))
        if isinstance(node, ast.If) and is_for_type_checkers(node):
            left += [(child, runs) for child in node.orelse]
            left += [(child, False) for child in node.body]
        else:
            left += [(child, runs) for child in ast.iter_child_nodes(node)]
    return result


def is_for_type_checkers(node: ast.If) -> bool:
    named = {getattr(part, "id", getattr(part, "attr", "")) for part in ast.walk(node.test)}
    return "TYPE_CHECKING" in named


def dynamic_import(call: ast.Call) -> Iterator[str]:
    """The module that ``import_module("...")`` or ``__import__("...")`` names, its literal part."""
    function = call.func
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    if name not in ("import_module", "__import__") or not call.args:
        return
    text = call.args[0]
    if isinstance(text, ast.JoinedStr) and text.values:
        text = text.values[0]
    if isinstance(text, ast.Constant) and isinstance(text.value, str):
        yield text.value.rstrip(".")


def room_of(file):
    return file.split("/")[0].removesuffix(".py")


def room_imported(name):
    """The room that a dotted name leads into; None for what lies outside the package."""
    parts = name.split(".")
    if parts[0] != "polywigner" or len(parts) < 2:
        return None
    public = polywigner._HOMES.get(parts[1])  # `from polywigner import wigner` is transforms'
    return public.split(".")[1] if public and "." in public else parts[1]


def breaches(text, file):
    """What a module imports against the rules."""
    room = room_of(file)
    package = ".".join(["polywigner", *file.split("/")[:-1]])
    result = []
    for name in imports_of(text, package):
        library = name.split(".")[0]
        if room not in HOMES.get(library, {room}):
            result.append(f"{file} imports {library}, whose home is {sorted(HOMES[library])}")
        other = room_imported(name)
        if other in LEVEL and other != room and LEVEL[other] >= LEVEL[room]:
            result.append(f"{file} ({room}) imports {name} ({other}): not a room above it")
    return result


def test_every_file_stands_in_a_known_room():
    strays = {room_of(file) for file in FILES} - set(LEVEL)
    assert not strays, f"give these a place in ROOMS: {sorted(strays)}"


def test_imports_run_only_downwards():
    assert [b for file, text in FILES.items() for b in breaches(text, file)] == []


@pytest.mark.parametrize("file", sorted(STANDARD_LIBRARY_ONLY))
def test_what_runs_before_the_set_up_needs_the_standard_library_only(file):
    allowed = STANDARD_LIBRARY_ONLY[file]
    package = ".".join(["polywigner", *file.split("/")[:-1]])
    foreign = [
        name
        for name in imports_of(FILES[file], package)
        if name.split(".")[0] not in sys.stdlib_module_names and not name.startswith(allowed)
    ]
    assert foreign == []


# --- The modules of the package import each other in no circle, inside functions neither


def module_imported(name, modules):
    """The module of the package in which a dotted name stands: a public name in its room."""
    parts = name.split(".")
    if parts[0] == "polywigner" and len(parts) > 1 and parts[1] in polywigner._HOMES:
        parts = [*polywigner._HOMES[parts[1]].split("."), *parts[1:]]
    while len(parts) > 1 and ".".join(parts) not in modules:
        parts.pop()
    return ".".join(parts) if len(parts) > 1 and parts[0] == "polywigner" else None


def graph_of(texts):
    """Module -> modules that it imports, from {path in the package: source text}.

    Importing ``a.b.c`` runs ``a/__init__.py`` and ``a/b/__init__.py`` as well, so these count too,
    but for the packages that the importing module stands in.
    """
    names = {
        path: ".".join(["polywigner", *path.removesuffix(".py").split("/")]).removesuffix(
            ".__init__"
        )
        for path in texts
    }
    modules = set(names.values())
    graph: dict[str, set[str]] = {}
    for path, text in texts.items():
        package = ".".join(["polywigner", *path.split("/")[:-1]])
        result = set()
        for name in imports_of(text, package, at_run_time=True):
            module = module_imported(name, modules)
            if module is not None:
                result.add(module)
                parts = module.split(".")
                facades = {".".join(parts[:count]) for count in range(2, len(parts))}
                result |= {
                    f for f in facades if f in modules and not f"{package}.".startswith(f"{f}.")
                }
        graph[names[path]] = result - {names[path]}
    return graph


def test_imports_run_in_no_circle():
    TopologicalSorter(graph_of(FILES)).prepare()  # raises CycleError with the modules of a circle
