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

Every command of `polywigner`, with its arguments and options. Lengths, frequencies, angles and
powers are texts with units, such as `"10 mm"`, `"94 GHz"`, `"20 deg"`, `"10 dBm"`. Bad input ends a
command with one line and exit code 2. A command writes its files completely or not at all.

Long work shows a progress bar if stderr is a terminal. Ctrl-C ends a command with exit code 130 and
one line, once the current part of the work has finished: about a second for transforms, some
seconds for fields near a source and for renders. In the first second, while libraries are loaded,
Python may print a message of its own, or need a second Ctrl-C.
"""


def page() -> str:
    """Return the text of the page."""
    import typer.main

    from polywigner.cli import app

    group: Any = typer.main.get_command(app)
    parts = [HEAD]
    for name, command in sorted(group.commands.items()):
        parts.append("\n".join(_section(name, command)))
    return "\n".join(parts)


def _section(name: str, command: Any) -> Iterator[str]:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and not p.hidden]
    usage = " ".join(_shown(a) for a in arguments)
    yield f"## polywigner {name}\n"
    yield " ".join((command.help or "").split()) + "\n"
    yield f"```text\npolywigner {name} {usage} [OPTIONS]".replace("  ", " ") + "\n```\n"
    rows = [(f"`{_shown(a)}`", a.help, a) for a in arguments]
    rows += [
        (", ".join(f"`{o}`" for o in (*p.opts, *p.secondary_opts)), p.help, p) for p in options
    ]
    if rows:
        yield "| argument or option | meaning | default |\n|---|---|---|"
    for shown, meaning, parameter in rows:
        text = " ".join((meaning or "").split()).replace("|", "\\|")
        yield f"| {shown} | {text} | {_default(parameter)} |"
    if rows:
        yield ""


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
