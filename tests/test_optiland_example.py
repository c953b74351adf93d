"""The example for optiland: where that is installed, and what it says where it is not."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow

EXAMPLE = Path(__file__).parent.parent / "examples" / "signed_rays" / "signed_rays.py"

# Of the peak, in pixels of the picture, with half a million rays: 2 % is one standard error of the
# brightest, and of two thousand pixels one is four standard errors off.
NOISE = 0.08


@pytest.fixture(scope="module")
def example() -> Any:
    spec = importlib.util.spec_from_file_location("signed_rays", EXAMPLE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.filterwarnings("ignore")
def test_rays_through_real_lenses_reproduce_the_focal_spot_of_a_hexagon(example: Any) -> None:
    pytest.importorskip("optiland")
    for across, surfaces in example.LENSES.values():
        found = example.compared(across, surfaces, count=1 << 19)
        assert example.error(found["rays"], found["Huygens"]) < NOISE
        error = (found["rays"] - found["Huygens"]) / found["standard error"]
        assert np.sqrt((error**2).mean()) == pytest.approx(1.0, abs=0.2)


def test_the_example_without_optiland_says_one_sentence(tmp_path: Path) -> None:
    hidden = "import sys; sys.modules['optiland'] = None; import runpy; "
    run = f"sys.argv = ['signed_rays.py']; runpy.run_path({str(EXAMPLE)!r}, run_name='__main__')"
    found = subprocess.run(
        [sys.executable, "-c", hidden + run],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 1
    assert found.stderr.splitlines() == [
        "expected optiland, got none; run `pip install optiland==0.6.3`"
    ]
    assert not list(tmp_path.iterdir())
