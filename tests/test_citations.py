"""What is cited is one set of facts: in the package, in the docs and in CITATION.cff."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import polywigner as pw
from polywigner.citations import METHODS
from polywigner.cli import main
from polywigner.errors import ArgumentError

ROOT = Path(__file__).resolve().parent.parent
BIBLIOGRAPHY = Path(pw.__file__).parent / "references.bib"


def keys_of(text: str) -> list[str]:
    return re.findall(r"^@\w+\{([\w-]+),", text, flags=re.MULTILINE)


def field_of(entry: str, name: str) -> str:
    match = re.search(rf"^  {name}\s*= \{{(.*)\}},?$", entry, flags=re.MULTILINE)
    assert match, f"{name} in {entry}"
    return match[1].replace("{", "").replace("}", "")


@pytest.mark.parametrize("method", METHODS)
def test_every_method_cites_the_paper_first_then_this_software_and_each_entry_once(
    method: str,
) -> None:
    keys = keys_of(pw.cite(method, method, "wigner"))
    assert keys[:2] == keys_of(pw.cite()) == ["mackay2022polygons", "polywigner"]
    assert set(METHODS[method]) <= set(keys) and len(keys) == len(set(keys))


def test_braces_of_every_entry_are_closed_and_no_entry_is_never_cited() -> None:
    text = pw.cite(*METHODS)
    for entry in text.strip().split("\n\n"):
        assert entry.count("{") == entry.count("}") > 0
        assert field_of(entry, "title") and field_of(entry, "author") and field_of(entry, "year")
    assert set(keys_of(text)) == set(keys_of(BIBLIOGRAPHY.read_text(encoding="utf-8")))


def test_the_version_cited_is_that_of_the_package() -> None:
    assert field_of(pw.cite().split("\n\n")[1], "version") == pw.__version__
    assert f"\nversion: {pw.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_command_prints_the_same_and_tells_the_known_methods_where_one_is_unknown(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(ArgumentError, match="rendering"):
        pw.cite("raytracing")
    assert main(["cite", "raytracing"]) == 2
    assert "rendering" in capfd.readouterr().err
    assert main(["cite", "otf"]) == 0
    assert capfd.readouterr().out == pw.cite("otf")


def test_the_citation_file_has_the_paper_of_the_bibliography() -> None:
    yaml = pytest.importorskip("yaml")
    file = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    paper, software = pw.cite().split("\n\n")
    preferred = file["preferred-citation"]
    assert preferred["title"] == field_of(paper, "title")
    names = [f"{a['family-names']}, {a['given-names']}" for a in preferred["authors"]]
    assert " and ".join(names) == field_of(paper, "author")
    assert field_of(paper, "eprint") in preferred["url"]
    assert file["title"] == field_of(software, "title")
    assert file["authors"] == [{"name": field_of(software, "author")}]
