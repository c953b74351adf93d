"""constraints.txt has a tested version of every package that pyproject.toml asks for, within what
that allows; and what is missing is named."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

pytest.importorskip("packaging", reason="packaging is not installed")

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tools"))

from pin_versions import CONSTRAINTS, declared  # noqa: E402

# In no environment that the tests are run in: peers of benchmarks, and VTK's 600 MB.
_NOT_TESTED = {"coxeter", "finufft", "jax", "pyvista"}
TEXT = CONSTRAINTS.read_text()
LINES = [line for line in TEXT.splitlines() if not line.startswith("#")]
VERSIONS = dict(line.split("==") for line in LINES)


def test_every_line_is_one_version_of_a_package() -> None:
    assert all(re.fullmatch(r"[a-z0-9-]+==[\w.!]+", line) for line in LINES)
    assert list(VERSIONS) == sorted(VERSIONS) and "polywigner" not in VERSIONS


def test_every_requirement_has_a_version_within_its_range() -> None:
    for name, requirements in declared().items():
        if name in _NOT_TESTED:
            assert re.search(rf"^# Not tested .*\b{name}\b", TEXT, flags=re.MULTILINE)
            continue
        for requirement in requirements:
            assert requirement.specifier.contains(VERSIONS[name]), requirement
