"""Every import in the package, read from the syntax tree."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import polywigner

PACKAGE = Path(polywigner.__file__).parent


def sources() -> list[Path]:
    return sorted(path for path in PACKAGE.rglob("*.py"))


def imports_of(tree: ast.AST, package: str) -> Iterator[str]:
    """Absolute dotted names of everything that a module imports, wherever it stands.

    ``package`` is the module's package, for relative imports.
    """
    aliases = {"polywigner"}
    for node in ast.walk(tree):
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
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in aliases
        ):
            yield f"polywigner.{node.attr}"


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
