"""The reference's pages show docstrings as they are meant: sentences whole, formulas unharmed."""

import ast
import doctest
import inspect
import itertools
import re
import runpy
from pathlib import Path

import pytest

import polywigner as pw

EXTENSION = Path(__file__).parent.parent / "docs" / "extensions" / "docstrings.py"
CONVERTED = runpy.run_path(str(EXTENSION))["converted"]
FUNCTIONS = [name for name in pw.__all__ if inspect.isfunction(getattr(pw, name))]


def test_a_parameters_sentence_is_not_cut_where_its_line_ends():
    text = "Law.\n\nParameters\n----------\nx, y : (..., 2) in m, or\n    a pair: both.\n"
    body = ":Parameters:\n    ``x, y``\n        (..., 2) in m, or\n        a pair: both."
    assert CONVERTED(text) == f"Law.\n\n{body}\n"


def test_prose_after_the_parameters_keeps_its_colons():
    text = "Parameters\n----------\nx : in m\n\nThere is one in\ncommon: the first.\n"
    assert "\n    There is one in\n    common: the first." in CONVERTED(text)


def test_formulas_are_no_markup_but_literals_and_roles_are():
    assert CONVERTED("u* |u|^2 ``|u|*`` :func:`fourier`").splitlines() == [
        r"u\* \|u\|^2 ``|u|*`` :func:`fourier`"
    ]


def test_a_literal_block_and_a_table_stay_as_they_are():
    block = "So::\n\n    a * b | c\n\n===  ===\na*b  c|d\n===  ==="
    assert CONVERTED(block).rstrip() == block


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_shown_as_an_argument_of_a_public_function_is_one(name):
    function = getattr(pw, name)
    shown = CONVERTED(inspect.getdoc(function))
    section = re.search(r"^:Parameters:\n(.*?)(?=^:|\Z)", shown, re.MULTILINE | re.DOTALL)
    terms = re.findall(
        r"^    ``([\w, *]+)``\n        ", section[1] if section else "", re.MULTILINE
    )
    names = {part.strip(" *") for line in terms for part in line.split(",")}
    parameters = inspect.signature(function).parameters
    takes_options = any(p.kind is p.VAR_KEYWORD for p in parameters.values())  # named elsewhere
    assert takes_options or names <= set(parameters)
    assert bool(names) == bool(section)


CALLABLE = [name for name in pw.__all__ if callable(getattr(pw, name))]


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.llvm] * (n == "differentiable")) for n in CALLABLE]
)
def test_every_public_name_has_an_example_that_runs(name):
    examples = doctest.DocTestParser().get_doctest(
        inspect.getdoc(getattr(pw, name)) or "", {}, name, None, None
    )
    assert examples.examples, f"{name} has no example"
    shown: list[str] = []
    results = doctest.DocTestRunner(verbose=False).run(examples, out=shown.append)
    assert not results.failed, "".join(shown)


# A clause without a noun: the reader has to guess what is spoken of.
RIDDLE = re.compile(
    r"^(What|Of|That of|Those|The same|How|Whose|Which) |"
    r"\b(what|that of|those (that|of|which)|of which)\b"
)
CLEAR = ("Print BibTeX of what to cite", "Say what power", "does not hold what", "by default those")


def _docstrings(tree):
    """Docstrings of modules, functions, classes, and of the names that they assign."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef):
            yield ast.get_docstring(node) or ""
            for before, after in itertools.pairwise(node.body):
                match before, after:
                    case ast.Assign() | ast.AnnAssign(), ast.Expr(ast.Constant(str(text))):
                        yield text


def _first_lines():
    package = Path(pw.__file__).parent
    return [
        f"{path.relative_to(package)}: {text.strip().splitlines()[0]}"
        for path in sorted(package.rglob("*.py"))
        for text in _docstrings(ast.parse(path.read_text(encoding="utf-8")))
        if text
    ]


def test_docstrings_of_names_are_read():
    source = 'x = 1\n"""A."""\nclass C:\n    y: int\n    """B."""\n'
    assert list(filter(None, _docstrings(ast.parse(source)))) == ["A.", "B."]


def test_first_lines_of_docstrings_are_no_riddles():
    lines = [line for line in _first_lines() if not any(clear in line for clear in CLEAR)]
    assert [line for line in lines if RIDDLE.search(line.partition(": ")[2])] == []
