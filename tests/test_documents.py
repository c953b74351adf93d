"""Pages agree with recorded benchmarks, the bibliography and the code."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import polywigner as pw
from polywigner.citations import METHODS
from polywigner.errors import ArgumentError

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts)
RECORDED = ROOT / "benchmarks" / "recorded"
LABEL = re.compile(r"\(([A-Z]{1,2}\d{1,2})\)")


@pytest.mark.parametrize(
    "tool",
    [
        "check_documents.py",  # links within the repository
        "fill_documents.py --check",  # tables of benchmarks
        "cli_reference.py --check",
        "public_names.py --check",
    ],
)
def test_documents_agree_with_files_benchmarks_and_the_package(tool, leave_out):
    name, *options = tool.split()
    if name == "check_documents.py" and not (ROOT / "docs" / "images").exists():
        leave_out("docs/images, which only a clone has")
    command = [sys.executable, ROOT / "tools" / name, *options]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def worst(file, number, row):
    """Return the largest error of a recorded table, without the classes listed under limits."""
    leave_out = "cavity" if number == 1 else "thin,"
    tables = re.findall(r"(?:^\|.*\|\n)+", (RECORDED / file).read_text(), re.MULTILINE)
    rows = [line.strip("|").split("|") for line in tables[number - 1].splitlines()[2:]]
    chosen = [cells for cells in rows if row in cells[0] and not re.search(leave_out, cells[0])]
    assert len(chosen) >= 8
    return max(float(value) for cells in chosen for value in cells[1:] if value.strip())


@pytest.mark.parametrize("row", ["double", "single"])
@pytest.mark.parametrize(
    ("file", "number"),
    [("fourier_accuracy.md", 1), ("fourier_accuracy_llvm.md", 1), ("fourier_accuracy.md", 2)],
)
def test_what_has_been_recorded_is_within_what_is_promised(file, number, row):
    text = (ROOT / "docs" / "accuracy.md").read_text(encoding="utf-8")
    line = re.search(rf"^\| {'F' if number == 1 else 'W and A'},.*$", text, re.MULTILINE)
    assert line is not None
    promised, measured = (
        [float(value) for value in re.findall(rf"{word} (\S+?e-\d+)", line[0])]
        for word in ("promised", "measured")
    )
    column = ["double", "single"].index(row)
    # "Measured" is the largest value of all engines, rounded to one digit.
    assert worst(file, number, row) <= 1.05 * measured[column] < promised[column]


def labels_of_formulas():
    """Return the labels of formulas, tables and sentences."""
    result = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        result += re.findall(r"\\tag\{([A-Z]+\d+)\}", text)
        result += re.findall(r"\| \(([A-Z]+\d+)\) \|$", text, re.MULTILINE)
        result += re.findall(r"  \(([A-Z]+\d+)\)$", text, re.MULTILINE)
    return result


def test_every_label_stands_at_one_formula():
    labels = labels_of_formulas()
    assert len(labels) > 40
    assert sorted(labels) == sorted(set(labels))


def test_every_label_that_code_and_documents_cite_stands_at_a_formula():
    labels = set(labels_of_formulas())
    sources = [*(ROOT / "src").rglob("*.py"), *PAGES]
    cited = {label: path for path in sources for label in LABEL.findall(path.read_text("utf-8"))}
    assert {label: path.name for label, path in cited.items() if label not in labels} == {}


def test_files_in_commands_of_the_readme_are_there():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = "render|transform|pattern|propagate"
    files = re.findall(rf"^polywigner (?:{commands}) (\S+)", text, re.MULTILINE)
    assert len(files) == 4
    assert [name for name in files if not (ROOT / name).is_file()] == []


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
def test_a_link_of_the_repository_becomes_one_of_the_site(written, read):
    assert FOR_SITE(written, DOCS) == read


def test_the_tour_links_each_public_function_that_it_names():
    """The text of a link is the name of the function."""
    tour = (DOCS / "tour.md").read_text(encoding="utf-8").split("```", 1)[0]
    unlinked = [name for name in pw.__all__ if f"`pw.{name}`" in tour.replace(f"[`pw.{name}`]", "")]
    assert unlinked == []


BIBLIOGRAPHY = Path(pw.__file__).parent / "references.bib"


def keys_of(text):
    return re.findall(r"^@\w+\{([\w-]+),", text, flags=re.MULTILINE)


def field_of(entry, name):
    match = re.search(rf"^  {name}\s*= \{{(.*)\}},?$", entry, flags=re.MULTILINE)
    assert match, f"{name} in {entry}"
    return match[1].replace("{", "").replace("}", "")


@pytest.mark.parametrize("method", METHODS)
def test_every_method_cites_the_paper_first_then_this_software_and_each_entry_once(method):
    keys = keys_of(pw.cite(method, method, "wigner"))
    assert keys[:2] == keys_of(pw.cite()) == ["mackay2022polygons", "polywigner"]
    assert set(METHODS[method]) <= set(keys) and len(keys) == len(set(keys))


def test_braces_of_every_entry_are_closed_and_no_entry_is_never_cited():
    text = pw.cite(*METHODS)
    for entry in text.strip().split("\n\n"):
        assert entry.count("{") == entry.count("}") > 0
        assert field_of(entry, "title") and field_of(entry, "author") and field_of(entry, "year")
    assert set(keys_of(text)) == set(keys_of(BIBLIOGRAPHY.read_text(encoding="utf-8")))


def test_the_version_cited_is_that_of_the_package():
    assert field_of(pw.cite().split("\n\n")[1], "version") == pw.__version__
    assert f"\nversion: {pw.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_an_unknown_method_is_refused_with_the_known_ones():
    with pytest.raises(ArgumentError, match="rendering"):
        pw.cite("raytracing")


def test_the_citation_file_has_the_paper_of_the_bibliography():
    yaml = pytest.importorskip("yaml")
    file = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    paper, software = pw.cite().split("\n\n")
    (preferred,) = file["references"]
    assert preferred["title"] == field_of(paper, "title")
    names = [f"{a['family-names']}, {a['given-names']}" for a in preferred["authors"]]
    assert " and ".join(names) == field_of(paper, "author")
    assert field_of(paper, "eprint") in preferred["url"]
    assert file["title"] == field_of(software, "title")
    assert file["authors"] == [{"name": field_of(software, "author")}]
