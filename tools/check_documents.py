"""Check the documents: links that lead nowhere, and code blocks that do not parse.

    python tools/check_documents.py

Looks at every Markdown file of the project. Links to other sites are not followed.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def documents() -> list[Path]:
    folders = [ROOT, *(ROOT / name for name in ("docs", "examples", "benchmarks"))]
    found = [path for folder in folders[1:] for path in folder.rglob("*.md")]
    return sorted([*ROOT.glob("*.md"), *found])


def anchors(text: str) -> set[str]:
    """The anchors that the headings of a page get, as code hosts make them."""
    headings = re.findall(r"^#+\s+(.*?)\s*$", without_code(text), flags=re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.replace(" ", "-") for heading in plain}


def without_code(text: str) -> str:
    return re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)


def dead_links(path: Path) -> Iterator[str]:
    text = path.read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)\s]+)\)", without_code(text))
    targets += re.findall(r"""<(?:img|a)\b[^>]*?(?:src|href)=["']([^"']+)["']""", text)
    for target in targets:
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        there = (path.parent / file) if file else path
        if not there.exists():
            yield f"link to {target}, which does not exist"
        elif there.suffix == ".md" and anchor and anchor not in anchors(there.read_text("utf-8")):
            yield f"link to {target}: no such heading"


def broken_code(path: Path) -> Iterator[str]:
    blocks = re.findall(r"^```python\n(.*?)^```", path.read_text(), flags=re.DOTALL | re.MULTILINE)
    for block in blocks:
        try:
            ast.parse(block)
        except SyntaxError as error:
            yield f"a python block does not parse: {error.msg}: {(error.text or '').strip()}"


def main() -> int:
    faults = [
        f"{path.relative_to(ROOT)}: {fault}"
        for path in documents()
        for check in (dead_links, broken_code)
        for fault in check(path)
    ]
    for fault in faults:
        print(fault)
    print(f"{len(documents())} documents, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
