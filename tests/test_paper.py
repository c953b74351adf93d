"""The paper has the format of the Journal of Open Source Software."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "paper" / "paper.md").read_text(encoding="utf-8")
BODY = TEXT.split("---\n", 2)[2]
ENTRY = re.compile(r"^@\w+\{([\w-]+),\n.*?^\}\n", re.MULTILINE | re.DOTALL)
SECTIONS = [
    "Summary",
    "Statement of need",
    "State of the field",
    "Software design",
    "Research impact statement",
    "AI usage disclosure",
    "Acknowledgements",
    "References",
]


def entries(path: str) -> dict[str, str]:
    text = (ROOT / path).read_text(encoding="utf-8")
    return {match[1]: match[0] for match in ENTRY.finditer(text)}


def test_the_paper_has_the_sections_and_the_length_that_the_journal_asks_for():
    assert re.findall(r"^# (.+)$", BODY, flags=re.MULTILINE) == SECTIONS
    assert 750 <= len(BODY.split()) <= 1750


def test_the_bibliography_has_what_is_cited_and_no_more():
    assert set(re.findall(r"@([\w-]+)", BODY)) == set(entries("paper/paper.bib"))


def test_entries_that_the_package_cites_too_are_the_same():
    ours, package = entries("paper/paper.bib"), entries("src/polywigner/references.bib")
    shared = set(ours) & set(package)
    assert len(shared) >= 5
    assert all(ours[key] == package[key] for key in shared)


def test_every_entry_leads_to_its_work():
    without = [
        k for k, text in entries("paper/paper.bib").items() if not re.search("doi|url", text)
    ]
    assert set(without) <= {"lee1983polygonal"}  # the submitting author adds its DOI


@pytest.mark.parametrize(
    "name",
    re.findall(
        r"^\| \[([\w-]+(?: RT)?)\]",
        (ROOT / "docs" / "comparison.md").read_text(encoding="utf-8"),
        flags=re.MULTILINE,
    ),
)
def test_every_program_of_the_comparison_is_named(name):
    assert name in BODY
