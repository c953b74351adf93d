"""What the site makes of a page of Markdown that is also read on a code host.

Folders, lessons, works and API entries are links to files there; here each becomes a link to the
page, or the place on it, that shows it. ``<!-- index: WORDS -->`` puts its words into the site's
index: a search for one of them finds the page first.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

# A link to a folder shows its files on a code host, and one to a lesson its code; here they show
# the folder's page, and the lesson with what it draws.
LINK = re.compile(r"\]\(([^):#]+)\)")
LESSON = re.compile(r"\]\([./]*examples/lessons/(lesson_\w+)\.py\)")
# A link to a work in docs/sources.md stays, and gets its number; the list there is the site's own.
WORK = re.compile(r"\[([^]\[]+)\]\([./]*sources\.md#(\w+)\)")
LIST = re.compile(r"<!-- filled: references -->.*?<!-- end -->", re.DOTALL)
BIBLIOGRAPHY = "```{bibliography}\n:all:\n:style: unsrt\n```"
# Entries of the API reference are made when the site is built; no heading of a file has their name.
ENTRY = re.compile(r"\[`([^`]+)`\]\([./\w]*api/\w+\.rst#([\w.]+)\)")
# Tables that benchmarks have printed are no pages of the site, but for the comparison.
RECORDED = re.compile(r"\]\([./]*benchmarks/recorded/(?!comparison)(\w+\.md)\)")
REPOSITORY = "https://github.com/polywigner/polywigner/blob/main"
INDEX = re.compile(r"^<!-- index: (.*) -->$", re.MULTILINE)


def for_site(text: str, folder: Path) -> str:
    """The text of a page in ``folder`` as the site's builder reads it."""

    def page_of(link: re.Match[str]) -> str:
        has_page = (folder / link[1] / "README.md").is_file()
        return f"]({link[1]}/README.md)" if has_page else link[0]

    def index_of(comment: re.Match[str]) -> str:
        words = ", ".join(f"! {word.strip()}" for word in comment[1].split(","))
        return f"```{{index}} {words}\n```"

    text = LIST.sub(BIBLIOGRAPHY, WORK.sub(r"\1 {cite:p}`\2`", text))
    text = INDEX.sub(index_of, ENTRY.sub(r"{py:obj}`\1 <\2>`", text))
    text = RECORDED.sub(rf"]({REPOSITORY}/benchmarks/recorded/\1)", text)
    return LINK.sub(page_of, LESSON.sub(r"](/docs/lessons/\1.rst)", text))


def rewrite(app: Any, page: str, text: list[str]) -> None:
    text[0] = for_site(text[0], Path(app.env.doc2path(page)).parent)


def setup(app: Any) -> dict[str, bool]:
    app.connect("source-read", rewrite)
    return {"parallel_read_safe": True}
