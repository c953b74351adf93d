"""The modules of the package import each other in no circle, inside functions neither."""

from __future__ import annotations

import ast

import pytest

import polywigner
from package_imports import PACKAGE, imports_of, sources


class _AtRunTime(ast.NodeTransformer):
    """A module without what only a type checker imports."""

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.AST]:
        if "TYPE_CHECKING" in ast.unparse(node.test):
            return [self.visit(child) for child in node.orelse]
        return self.generic_visit(node)


def module_imported(name: str, modules: set[str]) -> str | None:
    """The module of the package in which a dotted name stands: a public name in its room."""
    parts = name.split(".")
    if parts[0] == "polywigner" and len(parts) > 1 and parts[1] in polywigner._HOMES:
        parts = [*polywigner._HOMES[parts[1]].split("."), *parts[1:]]
    while len(parts) > 1 and ".".join(parts) not in modules:
        parts.pop()
    return ".".join(parts) if len(parts) > 1 and parts[0] == "polywigner" else None


def graph_of(texts: dict[str, str]) -> dict[str, set[str]]:
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


def circles_in(graph: dict[str, set[str]]) -> list[str]:
    """A line for each circle that a walk through the graph closes."""
    circles: list[str] = []
    done: set[str] = set()

    def walk(module: str, path: list[str]) -> None:
        if module in path:
            circles.append(" -> ".join([*path[path.index(module) :], module]))
        elif module not in done:
            for other in sorted(graph[module]):
                walk(other, [*path, module])
            done.add(module)

    for module in sorted(graph):
        walk(module, [])
    return circles


def test_imports_run_in_no_circle() -> None:
    files = {p.relative_to(PACKAGE).as_posix(): p for p in sources()}
    del files["__init__.py"]  # the public names: it may name every room, lazily (checked below)
    assert circles_in(graph_of({f: p.read_text(encoding="utf-8") for f, p in files.items()})) == []


@pytest.mark.parametrize(
    "texts",
    [
        {"a/x.py": "from polywigner.a import y", "a/y.py": "from . import x"},
        {"a/x.py": "def f():\n    from polywigner.a import y", "a/y.py": "from .x import z"},
        {"a/x.py": "import polywigner.b.y", "b/__init__.py": "import polywigner.a.x", "b/y.py": ""},
        {"a/__init__.py": "from .x import f", "a/x.py": "from polywigner.a import f"},
        {
            "geometry/x.py": "import polywigner as pw\npw.Aperture",
            "geometry/__init__.py": "from . import x",
        },
    ],
)
def test_a_circle_is_seen(texts: dict[str, str]) -> None:
    assert circles_in(graph_of(texts))


@pytest.mark.parametrize(
    "texts",
    [
        {"a/x.py": "from polywigner.a import y", "a/y.py": "import numpy", "a/__init__.py": ""},
        {
            "a/x.py": "if TYPE_CHECKING:\n    from polywigner.a import y",
            "a/y.py": "from polywigner.a import x",
        },
    ],
)
def test_no_circle_is_seen_where_none_is(texts: dict[str, str]) -> None:
    assert circles_in(graph_of(texts)) == []
