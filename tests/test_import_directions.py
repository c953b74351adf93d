"""The architecture as a test: imports run only downwards through the rooms, and each of the two
heavy libraries has one home.

Every import is read from the syntax tree, so one inside a function counts like one at the top,
and so do ``from polywigner import name``, ``pw.name`` and ``importlib.import_module("...")``.
"""

import ast
import sys

import pytest

import polywigner
from package_imports import PACKAGE, imports_of, sources

# A room may import from those above it in this list, never from those below or beside it.
ROOMS = [
    ("errors", "interruption"),
    ("quantities", "citations"),
    ("geometry",),
    ("source", "optics"),
    ("toolchain", "numerics"),
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
    # drjit: in require_drjit() only, after a library has been selected
    "toolchain/llvm.py": ("polywigner.errors", "polywigner.interruption", "drjit"),
    "toolchain/install.py": ("polywigner.toolchain", "polywigner.errors"),
    "errors.py": (),
    "interruption.py": (),
}


def room_of(path):
    first = path.relative_to(PACKAGE).parts[0]
    return first.removesuffix(".py")


def room_imported(name):
    """The room that a dotted name leads into; None for what lies outside the package."""
    parts = name.split(".")
    if parts[0] != "polywigner" or len(parts) < 2:
        return None
    public = polywigner._HOMES.get(parts[1])  # `from polywigner import wigner` is transforms'
    return public.split(".")[1] if public and "." in public else parts[1]


def breaches(tree, file):
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


def test_every_file_stands_in_a_known_room():
    strays = {room_of(path) for path in sources()} - set(LEVEL) - {"__init__"}
    assert not strays, f"give these a place in ROOMS: {sorted(strays)}"


def test_imports_run_only_downwards():
    files = {path.relative_to(PACKAGE).as_posix(): path for path in sources()}
    del files["__init__.py"]  # the public names: it may name every room, lazily (checked below)
    found = [
        breach
        for file, path in files.items()
        for breach in breaches(ast.parse(path.read_text(encoding="utf-8")), file)
    ]
    assert found == []


def test_the_public_names_are_loaded_lazily():
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    eager = [n for n in tree.body if isinstance(n, ast.Import | ast.ImportFrom)]
    names = {a.name for n in eager if isinstance(n, ast.Import) for a in n.names}
    names |= {n.module or "" for n in eager if isinstance(n, ast.ImportFrom)}
    foreign = {name.split(".")[0] for name in names} - set(sys.stdlib_module_names)
    assert not foreign


@pytest.mark.parametrize("file", sorted(STANDARD_LIBRARY_ONLY))
def test_what_runs_before_the_set_up_needs_the_standard_library_only(file):
    allowed = STANDARD_LIBRARY_ONLY[file]
    tree = ast.parse((PACKAGE / file).read_text(encoding="utf-8"))
    package = ".".join(["polywigner", *file.split("/")[:-1]])
    foreign = [
        name
        for name in imports_of(tree, package)
        if name.split(".")[0] not in sys.stdlib_module_names and not name.startswith(allowed)
    ]
    assert foreign == []


def test_every_exception_is_still_needed():
    for file, name in EXCEPTIONS:
        tree = ast.parse((PACKAGE / file).read_text(encoding="utf-8"))
        package = ".".join(["polywigner", *file.split("/")[:-1]])
        assert name in set(imports_of(tree, package)), f"{file} no longer imports {name}"


# --- The modules of the package import each other in no circle, inside functions neither


class _AtRunTime(ast.NodeTransformer):
    """A module without what only a type checker imports."""

    def visit_If(self, node):
        named = {getattr(part, "id", getattr(part, "attr", "")) for part in ast.walk(node.test)}
        if "TYPE_CHECKING" in named:
            return [self.visit(child) for child in node.orelse]
        return self.generic_visit(node)


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
        found = set()
        for name in imports_of(_AtRunTime().visit(ast.parse(text)), package):
            module = module_imported(name, modules)
            if module is not None:
                found.add(module)
                parts = module.split(".")
                facades = {".".join(parts[:count]) for count in range(2, len(parts))}
                found |= {
                    f for f in facades if f in modules and not f"{package}.".startswith(f"{f}.")
                }
        graph[names[path]] = found - {names[path]}
    return graph


def circles_in(graph):
    """A line for each circle that a walk through the graph closes."""
    circles: list[str] = []
    done: set[str] = set()

    def walk(module, path):
        if module in path:
            circles.append(" -> ".join([*path[path.index(module) :], module]))
        elif module not in done:
            for other in sorted(graph[module]):
                walk(other, [*path, module])
            done.add(module)

    for module in sorted(graph):
        walk(module, [])
    return circles


def test_imports_run_in_no_circle():
    files = {p.relative_to(PACKAGE).as_posix(): p for p in sources()}
    del files["__init__.py"]  # the public names: it may name every room, lazily (checked below)
    assert circles_in(graph_of({f: p.read_text(encoding="utf-8") for f, p in files.items()})) == []
