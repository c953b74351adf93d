"""Conversion of docstrings for the reference pages, and their examples."""

import doctest
import inspect
import re
import runpy
from pathlib import Path

import pytest

import polywigner as pw

EXTENSION = Path(__file__).parent.parent / "docs" / "extensions" / "docstrings.py"
CONVERTED = runpy.run_path(str(EXTENSION))["converted"]
FUNCTIONS = [name for name in pw.__all__ if inspect.isfunction(getattr(pw, name))]


BLOCK = "So::\n\n    a * b | c\n\n===  ===\na*b  c|d\n===  ==="


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (
            "Law.\n\nParameters\n----------\nx, y : float, shape (2,)\n    Both in m.\n",
            ":Parameters:\n    ``x, y``\n        float, shape (2,)\n\n        Both in m.\n",
        ),
        (
            "Parameters\n----------\nx : in m\n\nThere is one in\ncommon: the first.\n",
            "\n    There is one in\n    common: the first.",
        ),
        ("u* |u|^2 ``|u|*`` :func:`fourier`", r"u\* \|u\|^2 ``|u|*`` :func:`fourier`"),
        (BLOCK, BLOCK),
    ],
    ids=["types are paragraphs", "colons of prose", "formulas are no markup", "blocks and tables"],
)
def test_docstrings_are_converted(text, shown):
    assert shown in CONVERTED(text)


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
    takes_options = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
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
