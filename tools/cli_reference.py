#!/usr/bin/env python3
"""Write the page docs/cli.md: every command with its arguments and options, from the program.

python tools/cli_reference.py            write the page
python tools/cli_reference.py --check    exit code 1 if the page is out of date
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parents[1] / "docs" / "cli.md"

HEAD = """# Command line

Lengths, frequencies, angles and powers are texts with units, such as `"10 mm"`, `"94 GHz"`,
`"20 deg"`, `"10 dBm"`. If the input is invalid, a command prints one line and returns exit code 2.
A command writes its files completely or not at all, into the current folder unless `--out` names
another folder, or a path without suffix.

Long calls show a progress bar if stderr is a terminal. After Ctrl-C, a command prints one line and
returns exit code 130 when the current part of the work has finished: after about a second for
transforms, and after some seconds for fields near a source and for renders.
"""

OF_SOURCES = ("mtf", "pattern", "propagate", "psf", "transform", "volume")
GROUPS = {
    "Options of outlines": ("explore", "rcs", *OF_SOURCES),
    "Options of sources": OF_SOURCES,
    "Options of lenses": ("mtf", "psf"),
    "Options of fields": ("propagate", "volume"),
    "Options of scenes": ("receive", "render"),
}
"""Sections for the options that several commands share. The head describes ``--out``."""

TABLE = "| argument or option | meaning |", "|---|---|"


def page() -> str:
    """Return the text of the page."""
    import typer.main

    from polywigner.cli import app

    group: Any = typer.main.get_command(app)
    rows = {name: _rows(command) for name, command in sorted(group.commands.items())}
    shared: dict[str, list[str]] = {}
    for title, names in GROUPS.items():
        shared[title] = _shared([rows[name] for name in names])
        for name in names:
            rows[name] = [row for row in rows[name] if row not in shared[title]]
    parts = [HEAD]
    parts += ["\n".join(_section(name, group.commands[name], rows[name])) for name in rows]
    parts += ["\n".join(_group_section(title, shared[title])) for title in GROUPS]
    return "\n".join(parts)


def _shared(tables: list[list[str]]) -> list[str]:
    first, *others = tables
    return [row for row in first if all(row in other for other in others)]


def _section(name: str, command: Any, rows: list[str]) -> Iterator[str]:
    usage = " ".join(_shown(p) for p in command.params if p.param_type_name == "argument")
    yield f"## polywigner {name}\n"
    yield " ".join((command.help or "").split()) + "\n"
    yield f"```text\npolywigner {name} {usage} [OPTIONS]".replace("  ", " ") + "\n```\n"
    titles = [title for title, names in GROUPS.items() if name in names]
    if titles:
        links = ", ".join(f"[{title.lower()}]({_anchor(title)})" for title in titles)
        yield f"Shared options: {links}.\n"
    yield from (*TABLE, *rows, "")


def _group_section(title: str, rows: list[str]) -> Iterator[str]:
    names = ", ".join(f"`{name}`" for name in GROUPS[title])
    yield f"## {title}\n"
    yield f"Arguments and options of {names}:\n"
    yield from (*TABLE, *rows, "")


def _anchor(title: str) -> str:
    return "#" + title.lower().replace(" ", "-")


def _rows(command: Any) -> list[str]:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and not p.hidden]
    options = [p for p in options if p.name != "out"]
    names = [f"`{_shown(a)}`" for a in arguments]
    names += [", ".join(f"`{o}`" for o in (*p.opts, *p.secondary_opts)) for p in options]
    return [_row(name, p) for name, p in zip(names, arguments + options, strict=True)]


def _row(name: str, parameter: Any) -> str:
    text = " ".join((parameter.help or "").split()).replace("|", "\\|")
    default = _default(parameter)
    if default:
        text = f"{text.removesuffix('.')} (default: {default})."
    return f"| {name} | {text} |"


def _shown(argument: Any) -> str:
    name = str(argument.metavar or argument.name).upper()
    name = f"{name}..." if argument.nargs == -1 else name
    return name if argument.required else f"[{name}]"


def _default(parameter: Any) -> str:
    value = parameter.default
    if value is None or value == () or value is False or callable(value) or parameter.required:
        return ""
    return f"`{value}`"


def main() -> int:
    text = page()
    if "--check" in sys.argv[1:]:
        if PAGE.read_text(encoding="utf-8") != text:
            print(f"{PAGE.name} is out of date: run python tools/cli_reference.py")
            return 1
        return 0
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
