"""Check the documents for broken links and code blocks that do not parse.

    python tools/check_documents.py
    python tools/check_documents.py --site docs/_build/html

Checks every Markdown file of the project. Links to other sites are not followed. With --site,
checks the links and images of the built site instead, and that every public name has an entry in
the API reference.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
import urllib.parse
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def documents() -> list[Path]:
    folders = [ROOT, *(ROOT / name for name in ("docs", "examples", "benchmarks"))]
    result = [path for folder in folders[1:] for path in folder.rglob("*.md")]
    return sorted([*ROOT.glob("*.md"), *result])


def anchors(text: str) -> set[str]:
    """Return the anchors of a page's headings, as code hosts generate them."""
    headings = re.findall(r"^#+\s+(.*?)\s*$", without_code(text), flags=re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.replace(" ", "-") for heading in plain} | set(
        re.findall(r'<a id="([^"]+)"', text)
    )


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
            yield f"link to {target}, but the page has no such heading"
        elif there.suffix == ".rst" and anchor and not has_entry(there, anchor):
            yield f"link to {target}, but the API reference has no such entry"


def has_entry(page: Path, name: str) -> bool:
    """Return whether a page of the API reference has an entry for a name, or for its class."""
    entries = re.findall(r"^\.\. auto(?:function|class):: (\w+)$", page.read_text("utf-8"), re.M)
    return any(f"{name}.".startswith(f"polywigner.{entry}.") for entry in entries)


def broken_code(path: Path) -> Iterator[str]:
    blocks = re.findall(r"^```python\n(.*?)^```", path.read_text(), flags=re.DOTALL | re.MULTILINE)
    for block in blocks:
        try:
            ast.parse(block)
        except SyntaxError as error:
            yield f"a Python block does not parse: {error.msg}: {(error.text or '').strip()}"


def faults_of_documents() -> Iterator[str]:
    for path in documents():
        for check in (dead_links, broken_code):
            yield from (f"{path.relative_to(ROOT)}: {fault}" for fault in check(path))


def pages_of(site: Path) -> list[Path]:
    """Return all pages of the site except templates that the theme copies next to its files."""
    return sorted(set(site.rglob("*.html")) - set((site / "_static").rglob("*.html")))


def dead_links_of_site(site: Path) -> Iterator[str]:
    texts = {path: path.read_text(encoding="utf-8") for path in pages_of(site)}
    identities = {
        path: set(re.findall(r"""\bid="([^"]+)\"""", text)) for path, text in texts.items()
    }
    for path, text in texts.items():
        for target in sorted(set(re.findall(r'\b(?:href|src)="([^"]+)"', text))):
            if re.match(r"[a-z]+:|//", target):
                continue
            file, _, anchor = urllib.parse.unquote(target).partition("#")
            there = (path.parent / file.partition("?")[0]).resolve() if file else path
            if not there.exists():
                yield f"{path.relative_to(site)}: link to {target}, which does not exist"
            elif anchor and there in identities and anchor not in identities[there]:
                yield f"{path.relative_to(site)}: link to {target}, but the page has no such anchor"


def names_without_an_entry(site: Path) -> Iterator[str]:
    """Yield public names of the package, and of its public modules, without a reference entry."""
    import polywigner
    from polywigner import errors, figures, testing

    pages = "".join(path.read_text(encoding="utf-8") for path in (site / "docs/api").glob("*.html"))
    entries = set(re.findall(r'<dt class="sig[^>]*id="([^"]+)"', pages))
    modules = {"polywigner.geometry.shapes": polywigner.shapes}
    modules |= {module.__name__: module for module in (polywigner, errors, figures, testing)}
    modules["polywigner.source.arrays"] = polywigner.arrays
    for module, names in modules.items():
        for name in names.__all__:
            thing = getattr(names, name)
            if callable(thing) and f"{module}.{name}" not in entries:
                yield f"the API reference has no entry for {module}.{name}"


def main() -> int:
    parser = argparse.ArgumentParser(description="Check the documents, or the built site.")
    parser.add_argument("--site", type=Path, help="folder of the built site")
    site = parser.parse_args().site
    if site is None:
        what, faults = f"{len(documents())} documents", list(faults_of_documents())
    else:
        site = site.resolve()
        what = f"{len(pages_of(site))} pages of the site"
        faults = [*dead_links_of_site(site), *names_without_an_entry(site)]
    for fault in faults:
        print(fault)
    print(f"{what}, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
