"""Imports between subpackages, and the subpackages that import Dr.Jit and Mitsuba.

Imports inside functions count, and so do ``from polywigner import name``, ``pw.name`` and
``importlib.import_module("...")``.
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
# ``__init__.py`` imports all subpackages lazily.
FILES = {
    file: path.read_text(encoding="utf-8")
    for path in sorted(PACKAGE.rglob("*.py"))
    if (file := path.relative_to(PACKAGE).as_posix()) != "__init__.py"
}

# Subpackages in rows. A subpackage may import only from rows above its own row.
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
    ("mitsuba", "testing"),  # ``testing`` checks the public transforms
    ("figures",),
    ("explorer",),
    ("cli",),
    ("__main__",),
]
LEVEL = {name: level for level, names in enumerate(ROOMS) for name in names}

# Libraries, and the subpackages that may import each of them.
HOMES = {
    "drjit": {
        "execution",
        "llvm",
        "mitsuba",
    },  # the plugins compute with Dr.Jit
    "mitsuba": {"mitsuba"},
}

# Files that run before libraries are installed, or before LLVM is selected, and their permitted
# imports.
STANDARD_LIBRARY_ONLY = {
    # The function require_drjit() imports drjit after LLVM is selected.
    "llvm.py": ("polywigner.errors", "polywigner.interruption", "drjit"),
    "errors.py": (),
    "interruption.py": (),
}


def imports_of(text: str, package: str, at_run_time: bool = False) -> Iterator[str]:
    """Yield the absolute dotted names of all imports of a module.

    ``package`` is the module's package, for relative imports. ``at_run_time`` excludes imports for
    type checkers.
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
    """Return the syntax nodes that may contain imports, and whether they run."""
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
    """Yield the literal name in ``import_module("...")`` or ``__import__("...")``."""
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
    """Return the subpackage of a dotted name, or None outside of the package."""
    parts = name.split(".")
    if parts[0] != "polywigner" or len(parts) < 2:
        return None
    public = polywigner._HOMES.get(parts[1])  # `from polywigner import wigner`
    return public.split(".")[1] if public and "." in public else parts[1]


def breaches(text, file):
    """Return the forbidden imports of a module."""
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


def module_imported(name, modules):
    """Return the module that defines a dotted name."""
    parts = name.split(".")
    if parts[0] == "polywigner" and len(parts) > 1 and parts[1] in polywigner._HOMES:
        parts = [*polywigner._HOMES[parts[1]].split("."), *parts[1:]]
    while len(parts) > 1 and ".".join(parts) not in modules:
        parts.pop()
    return ".".join(parts) if len(parts) > 1 and parts[0] == "polywigner" else None


def graph_of(texts):
    """Return the imported modules of each module, from {path in the package: source text}.

    Importing ``a.b.c`` also runs ``a/__init__.py`` and ``a/b/__init__.py``, unless they contain the
    importing module.
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
    TopologicalSorter(graph_of(FILES)).prepare()  # raises CycleError for cyclic imports
