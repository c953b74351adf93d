#!/usr/bin/env python3
"""Write all public names with their signatures: python tools/public_names.py [--check].

The diff of the file tests/data/public_names.txt shows how a change affects users.
"""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FILE = Path(__file__).parents[1] / "tests" / "data" / "public_names.txt"
MODULES = (
    "polywigner",
    "polywigner.shapes",
    "polywigner.arrays",
    "polywigner.rays",
    "polywigner.propagation.horns",
    "polywigner.mitsuba",
    "polywigner.figures",
    "polywigner.testing",
    "polywigner.errors",
)
OPERATORS = {"__init__", "__call__", "__add__", "__sub__", "__and__", "__or__", "__getitem__"}


def lines() -> Iterator[str]:
    """Yield a line for each public function, class, method and attribute of a class."""
    for path in MODULES:
        module = module_of(path)
        for name in sorted(module.__all__):
            value = getattr(module, name)
            if not inspect.ismodule(value):
                yield from described(f"{path}.{name}", value)


def module_of(path: str) -> Any:
    """Return the module at a public path, which may be an attribute of its parent."""
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError:
        parent, _, name = path.rpartition(".")
        return getattr(importlib.import_module(parent), name)


def described(name: str, value: Any) -> Iterator[str]:
    """Yield the lines for a public value."""
    if inspect.isclass(value):
        bases = ", ".join(base.__name__ for base in value.__bases__ if base is not object)
        yield f"class {name}({bases})"
        for member in sorted(set(dir(value)) | set(getattr(value, "__annotations__", ()))):
            if member.startswith("_") and member not in OPERATORS:
                continue
            result = inspect.getattr_static(value, member, None)
            inherited = member not in {
                key
                for owner in value.__mro__
                if owner.__module__.startswith("polywigner")
                for key in (*vars(owner), *vars(owner).get("__annotations__", ()))
            }
            if not inherited:
                yield f"  {name}.{member}{signature(getattr(result, '__func__', result))}"
    else:
        yield name + signature(value)


def signature(value: Any) -> str:
    """Return parameters, defaults and types as text; an empty string if it is not callable."""
    if not callable(value) or inspect.isclass(value):
        return ""
    try:
        return re.sub(r" at 0x[0-9a-f]+", "", str(inspect.signature(value)))
    except ValueError:
        return "(...)"


def main() -> int:
    text = "\n".join(lines()) + "\n"
    if "--check" in sys.argv[1:]:
        if FILE.read_text(encoding="utf-8") != text:
            print(f"{FILE.name} is out of date: run python tools/public_names.py")
            return 1
        return 0
    FILE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
