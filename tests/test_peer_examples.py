"""The examples for Sionna RT and optiland, and what they say without them."""

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

# Sionna computes in single precision; 55 dB below the peak that is 1e-4 of the amplitude.
SINGLE = 1e-3
ANGLES = np.radians([-60, -20, -5, 0, 10, 20, 30, 70])


# Decibels between lobes of a body of 375 wavelengths, at directions in single precision.
LOBES = 0.02


# Of the amplitude of the direct way: Sionna's delays in single precision.
FRINGES = 5e-3


# Of the peak, in pixels of the picture, with half a million rays: 2 % is one standard error of the
# brightest, and of two thousand pixels one is four standard errors off.
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
    found = 10 * np.log10(example.gain_of_paths("polywigner", ANGLES))
    assert found == pytest.approx(expected, abs=SINGLE)


@pytest.mark.llvm
def test_sionna_finds_a_lossless_antenna_of_the_same_directivity(example: Any) -> None:
    scene = example.scene_with("polywigner")
    found, gain, efficiency = scene.tx_array.antenna_pattern.compute_gain(
        num_samples=800, verbose=False
    )
    angles = np.radians(np.linspace(-90, 90, 721))
    pattern = pw.radiation_pattern(example.antenna(), example.WAVELENGTH, angles, 0.0)
    largest = 10 ** (pattern.attrs["largest_directivity"] / 10)
    grid = 3e-3  # Sionna looks for the peak, and integrates, on a grid of 0.2 degrees
    assert efficiency[0] == pytest.approx(1.0, abs=grid)
    assert gain[0] == pytest.approx(largest, rel=grid)
    assert found[0] == pytest.approx(largest, rel=2 * grid)


@pytest.mark.llvm
def test_the_phase_is_that_of_sionnas_waves(example: Any) -> None:
    """exp(j omega t - j k r): what lies nearer by a quarter of a wave is ahead by 90 degrees."""
    import mitsuba as mi

    patch = pw.shapes.square(1e-3)
    side = np.array([2e-3, 0.0])  # along Sionna's y
    angle = 0.4
    fields = [
        example.vertical_pattern(source, example.WAVELENGTH)(mi.Float(np.pi / 2), mi.Float(angle))
        for source in (patch, patch.moved(side))
    ]
    here, there = (complex(f.real[0], f.imag[0]) for f in fields)
    ahead = 2 * np.pi * side[0] * np.sin(angle) / example.WAVELENGTH
    assert np.angle(there / here) == pytest.approx(ahead, abs=SINGLE)


@pytest.mark.llvm
def test_echoes_of_a_target_are_those_of_the_radar_equation() -> None:
    module = loaded("sionna_rcs")
    metal = module.body()
    scene = module.radar_scene()
    scene.add(module.target(metal, module.WAVELENGTH, (4.0, 1.8, 1.4)))
    yaws = np.radians(np.arange(0, 360, 15) + 0.3)
    found = module.echoes(scene, yaws, max_depth=1)
    ratio = found / module.radar_equation(metal, yaws)
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
        found = example.compared(across, surfaces, count=1 << 19)
        assert example.error(found["rays"], found["Huygens"]) < NOISE
        error = (found["rays"] - found["Huygens"]) / found["standard error"]
        assert np.sqrt((error**2).mean()) == pytest.approx(1.0, abs=0.2)


def test_the_example_without_optiland_says_one_sentence(tmp_path: Path) -> None:
    script = EXAMPLES / "signed_rays" / "signed_rays.py"
    hidden = "import sys; sys.modules['optiland'] = None; import runpy; "
    run = f"sys.argv = ['signed_rays.py']; runpy.run_path({str(script)!r}, run_name='__main__')"
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
