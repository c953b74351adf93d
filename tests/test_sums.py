"""Weighted sums over places, for many points, without storing their terms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner import execution, kernels
from polywigner.execution import evaluation

L_SHAPE = pw.Aperture([(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)])
SOURCES: dict[str, Any] = {
    "uniform": L_SHAPE,
    "cosine": pw.shapes.square(2.0).with_illumination(pw.cosine_taper(2.0, 2.0)),
    "many edges": pw.shapes.disc(1.0, n=40),
    "lattice": pw.phased_array(pw.shapes.square(0.8), [(k, j) for k in range(3) for j in range(2)]),
}
# Sums of some hundred terms in another order; in float32 terms err by 3e-6 of the largest.
DOUBLE, SINGLE = 1e-13, 1e-5


def setting(name: str, points: int) -> tuple[Any, Any, Any, Any]:
    """The Wigner function at places x, summed for frequencies, which are the points here."""
    source = SOURCES[name]
    rng = np.random.default_rng(7)
    places, _ = pw.sample_automean(source, 150, seed=1)
    return source, places, rng.normal(size=150), rng.normal(size=(points, 2))


@pytest.mark.parametrize("name", SOURCES)
def test_numpy_sums_block_by_block(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    source, places, weights, points = setting(name, 40)
    expected = pw.wigner(source, places, points[:, None]) @ weights
    kernel = kernels.kernel_for("wigner", source)
    for block in (1 << 22, 700, 64):
        monkeypatch.setattr(evaluation, "_BLOCK", block)
        found = execution.evaluate_sums(
            kernel, source, places, weights, points, (), double=True, engine="numpy"
        )
        assert abs(found - expected).max() < DOUBLE * abs(weights).sum() * 4 * 9


@pytest.mark.llvm
@pytest.mark.parametrize("name", SOURCES)
def test_compiled_kernels_give_the_same_sums(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    source, places, weights, points = setting(name, 40)
    expected = pw.wigner(source, places, points[:, None]) @ weights
    kernel = kernels.kernel_for("wigner", source)
    scale = abs(weights).sum() * 4 * 9
    monkeypatch.setattr(evaluation, "_BLOCK", 700)
    for double, allowed in ((True, DOUBLE), (False, SINGLE)):
        found = execution.evaluate_sums(
            kernel, source, places, weights, points, (), double=double, engine="llvm"
        )
        assert abs(found - expected).max() < allowed * scale


def test_no_points_have_no_sums() -> None:
    source, places, weights, _ = setting("uniform", 1)
    kernel = kernels.kernel_for("wigner", source)
    found = execution.evaluate_sums(
        kernel, source, places, weights, np.empty((0, 2)), (), double=True, engine="numpy"
    )
    assert found.shape == (0,)
