"""Metadata, public names and make targets of the package."""

import importlib
import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import polywigner

ROOT = Path(__file__).resolve().parent.parent
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
IN_CLONE = (ROOT / ".github").exists()  # the sdist excludes the workflows


def test_the_installed_version_is_that_of_the_sources():
    """Archives without git have the version, too."""
    assert "version" in PYPROJECT["project"]["dynamic"]
    assert polywigner.__version__ == importlib.metadata.version("polywigner")


def test_the_changelog_has_an_entry_for_this_version():
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## [{polywigner.__version__}]" in changelog


def test_the_package_says_that_it_is_typed():
    assert (Path(polywigner.__file__).parent / "py.typed").is_file()


def test_every_public_name_is_what_its_home_has():
    for name, home in polywigner._HOMES.items():
        assert getattr(polywigner, name) is getattr(importlib.import_module(home), name), name


def test_an_unknown_public_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'wagner'"):
        _ = polywigner.wagner


def test_importing_the_package_loads_no_heavy_library():
    heavy = {"numpy", "scipy", "shapely", "xarray", "matplotlib", "drjit", "mitsuba"}
    code = f"import sys, polywigner; print(*{heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.split() == []


def test_the_sdist_takes_along_what_it_names():
    for name in PYPROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]:
        assert (ROOT / name).exists(), name


RECIPES = ROOT / "packaging"


def test_the_conda_recipe_asks_for_what_the_package_asks_for():
    project = PYPROJECT["project"]
    recipe = (RECIPES / "conda" / "meta.yaml").read_text("utf-8")
    run = recipe.split("  run:\n")[1].split("\ntest:")[0]
    named = {text.replace("matplotlib", "matplotlib-base") for text in project["dependencies"]}
    asked = {line.strip(" -").replace(" ", "") for line in run.splitlines() if "- " in line}
    assert asked == named | {"python" + project["requires-python"], "libllvm19"}
    assert f'version = "{polywigner.__version__}"' in recipe


def test_the_copies_of_the_version_are_those_of_the_package():
    """The release tool finds each copy of the version once."""
    for path, changes in release.copies(polywigner.__version__, "2026-01-31").items():
        text = path.read_text(encoding="utf-8")
        for pattern, line in changes:
            after, count = re.subn(pattern, line, text, flags=re.MULTILINE)
            assert count == 1, (path, pattern)
            assert "date" in line or "2026-01-31" in line or after == text, (path, line)


def test_the_address_is_the_same_everywhere():
    home = PYPROJECT["project"]["urls"]["Homepage"]
    names = ["README.md", "CITATION.cff", "packaging/conda/meta.yaml"]
    if IN_CLONE:
        names.append(".github/ISSUE_TEMPLATE/config.yml")
    for name in names:
        assert home in (ROOT / name).read_text(encoding="utf-8"), name


# The tool checks that constraints.txt contains a tested version of each package in pyproject.toml.

sys.path.insert(0, str(ROOT / "tools"))

import release  # noqa: E402
from pin_versions import CONSTRAINTS, declared  # noqa: E402

# Packages that only benchmarks use; no test environment contains them.
_NOT_TESTED = {"coxeter", "jax"}
TEXT = CONSTRAINTS.read_text()
LINES = [line for line in TEXT.splitlines() if not line.startswith("#")]
VERSIONS = dict(line.split("==") for line in LINES)


def test_every_line_is_one_version_of_a_package():
    assert all(re.fullmatch(r"[a-z0-9-]+==[\w.!]+", line) for line in LINES)
    assert list(VERSIONS) == sorted(VERSIONS) and "polywigner" not in VERSIONS


def test_every_requirement_has_a_version_within_its_range():
    for name, requirements in declared().items():
        if name in _NOT_TESTED:
            assert re.search(rf"^# Not installed .*\b{name}\b", TEXT, flags=re.MULTILINE)
            continue
        for requirement in requirements:
            assert requirement.specifier.contains(VERSIONS[name]), requirement
