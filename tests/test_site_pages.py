"""The site reads the pages of the repository with links of its own."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

import polywigner as pw

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
FOR_SITE = runpy.run_path(str(DOCS / "extensions" / "pages.py"))["for_site"]


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("[`pw.otf`](api/transforms.rst#polywigner.otf)", "{py:obj}`pw.otf <polywigner.otf>`"),
        ("<!-- index: gain, EIRP -->", "```{index} ! gain, ! EIRP\n```"),
        ("[near](../examples/near_field)", "[near](../examples/near_field/README.md)"),
        ("[101](../examples/lessons/lesson_101_x.py)", "[101](/docs/lessons/lesson_101_x.rst)"),
        ("[Taylor](sources.md#taylor1955line)", "Taylor {cite:p}`taylor1955line`"),
        ("[files](files.md#units), `pw.otf`", "[files](files.md#units), `pw.otf`"),
    ],
)
def test_a_link_of_the_repository_becomes_one_of_the_site(written: str, read: str) -> None:
    assert FOR_SITE(written, DOCS) == read


def test_the_tour_links_each_public_function_that_it_names() -> None:
    """A link shows the name by which it is called; the checker knows that the entry is there."""
    tour = (DOCS / "tour.md").read_text(encoding="utf-8").split("```", 1)[0]
    unlinked = [name for name in pw.__all__ if f"`pw.{name}`" in tour.replace(f"[`pw.{name}`]", "")]
    assert unlinked == []


def test_a_search_for_directivity_finds_the_page_on_patterns() -> None:
    text = (DOCS / "patterns.md").read_text(encoding="utf-8")
    assert "! directivity" in FOR_SITE(text, DOCS)
    others = [path for path in DOCS.glob("*.md") if path.name != "patterns.md"]
    assert not any("<!-- index: directivity" in path.read_text("utf-8") for path in others)
