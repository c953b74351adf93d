"""Convert numpydoc docstrings to what Sphinx reads.

Each parameter becomes a definition: its type, and a paragraph with its description. Other sections
become fields. Symbols such as ``|u|`` and ``u*`` are escaped, which reStructuredText would read as
markup.
"""

from __future__ import annotations

import itertools
import re
from typing import Any

from polywigner import errors

SECTION = re.compile(
    r"^(Parameters|Attributes|Returns|Yields|Raises|Warns|See Also|Notes|References|Examples)"
    r"\n-{3,}\n",
    re.M,
)
ITEM = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*) ?: (.*)$")
TERM = re.compile(r"^\*{0,2}\w+(?:, \*{0,2}\w+)*\s*$")
# Literals, roles and links are left as they are: odd pieces of a split by this.
SINGLE = re.compile(r"(?<![`:\w])`([^`\n]+)`(?![`_])")
PAGE = re.compile(r"docs/(\w+)\.md")
MARKUP = re.compile(r"(``.+?``|:[\w:]+:`[^`]+`|`[^`]+`_)", re.DOTALL)
SPECIAL = re.compile(r"[*|`\\]|(?<=\w)_(?=\W|$)")
ERROR = re.compile(rf"\b({'|'.join(errors.__all__)})\b")


def escaped(prose: str) -> str:
    """Prose in which only the markup meant as such is left."""
    prose = PAGE.sub(r":doc:`docs/\1.md </docs/\1>`", SINGLE.sub(r"``\1``", prose))
    pieces = MARKUP.split(prose)
    pieces[::2] = [SPECIAL.sub(r"\\\g<0>", piece) for piece in pieces[::2]]
    return "".join(pieces)


def paragraphs(text: str) -> str:
    """Escape a text but for its literal blocks, tables, and prompts of examples."""
    written, literal = [], False
    for block in re.split(r"(\n\s*\n)", text):
        if not block.strip():
            written.append(block)
            continue
        indented = block.startswith(" ")
        literal = indented and literal
        plain = literal or re.match(r"\s*(>>>|\+-|={3,}|\.\. )", block)
        written.append(block if plain else escaped(block))
        literal = literal or block.rstrip().endswith("::")
    return "".join(written)


def definitions(text: str) -> str:
    """Parameters: one definition each, its type and its description."""
    written: list[str] = []
    lines = text.splitlines()
    for line, following in itertools.zip_longest(lines, lines[1:], fillvalue=""):
        in_prose = bool(written) and re.match(r"\S", written[-1])  # where a colon is a colon
        item = None if in_prose else ITEM.match(line)
        if item:
            written += [f"``{item[1]}``", f"    {item[2]}"]
            if following.startswith("    "):
                written.append("")
        elif TERM.match(line) and following.startswith("    "):
            written.append(f"``{line.rstrip()}``")
        else:
            written.append(line)
    return escaped("\n".join(written))


def with_links(text: str) -> str:
    """Exceptions by their names, as links."""
    return ERROR.sub(r":class:`~polywigner.errors.\1`", text)


def converted(docstring: str) -> str:
    """A docstring of this project as reStructuredText."""
    before, *sections = SECTION.split(docstring)
    written = [paragraphs(before).rstrip(), ""]
    for title, body in zip(sections[::2], sections[1::2], strict=True):
        if title in ("Parameters", "Attributes", "See Also"):
            body = definitions(body)
        else:
            body = (
                with_links(paragraphs(body)) if title in ("Raises", "Warns") else paragraphs(body)
            )
        indented = "\n".join(f"    {line}".rstrip() for line in body.strip("\n").splitlines())
        written += [f":{title}:", indented, ""]
    return "\n".join(written)


def convert(
    _app: Any, _what: str, _name: str, _value: Any, _options: Any, lines: list[str]
) -> None:
    lines[:] = converted("\n".join(lines)).splitlines()


def setup(app: Any) -> dict[str, bool]:
    app.connect("autodoc-process-docstring", convert)
    return {"parallel_read_safe": True}
