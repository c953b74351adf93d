"""Examples for Sionna RT and optiland, and their messages without these packages."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parent.parent / "examples"

# Single precision at 55 dB below the peak is 1e-4 of the amplitude.
SINGLE = 1e-3
ANGLES = np.radians([-60, -20, -5, 0, 10, 20, 30, 70])


# Difference [dB] between lobes of a body of 375 wavelengths, because directions are in single
# precision.
LOBES = 0.02


# Relative error of the line-of-sight amplitude due to Sionna's delays in single precision.
FRINGES = 5e-3


# Noise with half a million rays, relative to the peak. One standard error of the brightest pixel is
# 2 %, and one of two thousand pixels deviates by four standard errors.
NOISE = 0.08


def loaded(name: str, needed: str = "sionna.rt") -> Any:
    pytest.importorskip(needed)
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / name / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def example() -> Any:
    module = loaded("sionna_pattern")
    module.register("polywigner", module.antenna(), module.WAVELENGTH)
    return module


@pytest.mark.llvm
def test_path_gains_in_free_space_are_the_directivity(example: Any) -> None:
    pattern = pw.radiation_pattern(example.antenna(), example.WAVELENGTH, ANGLES, 0.0)
    expected = pattern["directivity"].values[:, 0]
    result = 10 * np.log10(example.gain_of_paths("polywigner", ANGLES))
    assert result == pytest.approx(expected, abs=SINGLE)


@pytest.mark.llvm
def test_echoes_of_a_target_are_those_of_the_radar_equation() -> None:
    module = loaded("sionna_rcs")
    metal = module.body()
    scene = module.radar_scene()
    scene.add(module.target(metal, module.WAVELENGTH, (4.0, 1.8, 1.4)))
    yaws = np.radians(np.arange(0, 360, 15) + 0.3)
    result = module.echoes(scene, yaws, max_depth=1)
    ratio = result / module.radar_equation(metal, yaws)
    assert 10 * np.log10(ratio) == pytest.approx(0, abs=LOBES)


@pytest.mark.llvm
def test_two_rays_over_concrete_interfere_as_in_sionna() -> None:
    module = loaded("two_rays")
    module.mi.set_variant("llvm_ad_mono_polarized")
    distances = np.array([2.0, 3.7, 11.0, 40.0])
    theirs = module.sionna_channel_of(distances)
    ours = module.channel_of(module.DOT, distances, **module.ALL_SIDES) / 2
    direct = module.WAVELENGTH / (4 * np.pi * np.hypot(distances, 0.2))
    turned = 1j * ours * module.direct_phase(distances).conj()  # Sionna's first delay is zero
    assert turned / direct == pytest.approx(theirs.conj() / direct, abs=FRINGES)


@pytest.mark.filterwarnings("ignore")
def test_rays_through_real_lenses_reproduce_the_focal_spot_of_a_hexagon() -> None:
    example = loaded("signed_rays", "optiland")
    for across, surfaces in example.LENSES.values():
        result = example.compared(across, surfaces, count=1 << 19)
        assert example.error(result["rays"], result["Huygens"]) < NOISE
        error = (result["rays"] - result["Huygens"]) / result["standard error"]
        assert np.sqrt((error**2).mean()) == pytest.approx(1.0, abs=0.2)


def test_the_example_without_optiland_says_one_sentence(tmp_path: Path) -> None:
    script = EXAMPLES / "signed_rays" / "signed_rays.py"
    hidden = "import sys; sys.modules['optiland'] = None; import runpy; "
    run = f"sys.argv = ['signed_rays.py']; runpy.run_path({str(script)!r}, run_name='__main__')"
    result = subprocess.run(
        [sys.executable, "-c", hidden + run],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1
    assert result.stderr.splitlines() == [
        "expected optiland, got none; run `pip install optiland==0.6.3`"
    ]
    assert not list(tmp_path.iterdir())
