"""Fill the parts of documents that are generated from other files; with --check, only compare.

    python tools/fill_documents.py
    python tools/fill_documents.py --check

A generated part lies between two comments, `<!-- filled: NAME -->` and `<!-- end -->`. NAME is
`references` or `FILE.md#2`. `references` is the bibliography as a list, for readers of the Markdown
files (the site contains the bibliography itself). `FILE.md#2` is the second table in the output of
a benchmark, which is stored in benchmarks/recorded: `python benchmarks/FILE.py >
benchmarks/recorded/FILE.md`.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTS = ROOT / "docs"
RESULTS = ROOT / "benchmarks" / "recorded"
BIBLIOGRAPHY = ROOT / "src" / "polywigner" / "references.bib"
PART = re.compile(r"(<!-- filled: (\S+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
TABLE = re.compile(r"(?:^\|.*\|\n)+", re.MULTILINE)
ENTRY = re.compile(r"^@\w+\{([\w-]+),\n(.*?)^\}", re.MULTILINE | re.DOTALL)
FIELD = re.compile(r"^\s*(\w+)\s*=\s*\{(.*)\},?$", re.MULTILINE)
ACCENTS = {
    r"{\'O}": "Ó",
    r"{\~n}": "ñ",
    r"{\'e}": "é",
    "---": ", ",
    "--": "–",
    "``": "“",
    "''": "”",
}


def references() -> str:
    """Return the bibliography as a list; each entry has its key as an anchor."""
    return "\n".join(entry(m[1], dict(FIELD.findall(plain(m[2])))) for m in entries()) + "\n"


def entries() -> Iterator[re.Match[str]]:
    return ENTRY.finditer(BIBLIOGRAPHY.read_text(encoding="utf-8"))


def plain(text: str) -> str:
    """Replace accents and dashes of TeX by characters; braces around capitals are dropped later."""
    for tex, character in ACCENTS.items():
        text = text.replace(tex, character)
    return text


def entry(key: str, fields: dict[str, str]) -> str:
    fields = {name: re.sub("[{}]", "", value) for name, value in fields.items()}
    authors = [name_of(author) for author in fields["author"].split(" and ")]
    where = fields.get("journal", "")
    if "volume" in fields:
        number = f"({fields['number']})" if "number" in fields else ""
        where += f" {fields['volume']}{number}"
    if "pages" in fields:
        where += f", {fields['pages']}"
    where = ", ".join(filter(None, [where.strip(), fields["year"]]))
    link = fields.get("url", "")
    if "doi" in fields:
        link = f"https://doi.org/{fields['doi']}"
    title = f"[{fields['title']}]({link})" if link else fields["title"]
    return f'- <a id="{key}"></a>{", ".join(authors)}: *{title}*, {where}.'


def name_of(author: str) -> str:
    """Return an author such as "Wolf, Emil" as "E. Wolf"."""
    last, _, first = author.partition(", ")
    initials = (re.sub(r"(\w)[^-\s]*", r"\1.", first) + " ").lstrip()
    return f"{initials}{last}"


def table(name: str) -> str:
    """Return a table of a Markdown file of results; tables are counted from 1."""
    file, _, number = name.partition("#")
    path = RESULTS / file
    if not path.is_file():
        raise SystemExit(
            f"{path.relative_to(ROOT)} does not exist, but a document is filled from it"
        )
    tables = TABLE.findall(path.read_text(encoding="utf-8"))
    if not (number.isdecimal() and 1 <= int(number) <= len(tables)):
        raise SystemExit(
            f"{file} has {len(tables)} tables, got the number {number} after #; use a number "
            f"from 1 to {len(tables)}"
        )
    return tables[int(number) - 1]


def filled(text: str) -> str:
    def part_of(part: re.Match[str]) -> str:
        name = part[2]
        return part[1] + (references() if name == "references" else table(name)) + part[4]

    return PART.sub(part_of, text)


def main() -> int:
    parser = argparse.ArgumentParser(description="Fill the generated parts of documents.")
    parser.add_argument("--check", action="store_true", help="compare without changing files")
    check = parser.parse_args().check
    faults = 0
    for path in sorted(DOCUMENTS.rglob("*.md")):
        text = path.read_text(encoding="utf-8")
        wanted = filled(text)
        if text == wanted:
            continue
        faults += 1
        if check:
            print(f"{path.relative_to(ROOT)} is out of date; run {Path(__file__).name}")
        else:
            path.write_text(wanted, encoding="utf-8")
            print(f"{path.relative_to(ROOT)}: filled")
    return 1 if check and faults else 0


if __name__ == "__main__":
    sys.exit(main())
