"""Parts of edges listed once for each position: their sums are W and its moments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import polywigner as pw
from polywigner import execution, kernels
from polywigner.execution import NumpyOperations
from polywigner.kernels import tables_of
from polywigner.kernels.cut.slice_parts import slice_parts
from polywigner.kernels.functions.part_kernels import PART_MOMENTS, PART_WIGNER

WAVES = pw.Illumination([1, 0.5j, 0.3], [(0.3, 0.1), (-0.2, 0.9), (1.3, -0.5)])
CHEVRON = pw.shapes.chevron(2.0, 1.2, 0.4)
SOURCES: dict[str, Any] = {
    "square": pw.shapes.square(1.0),
    "chevrons": pw.Aperture([*CHEVRON.rings, *CHEVRON.moved((2.3, 0.1)).rings]),
    "ring": pw.shapes.ring(1.0, 0.5, n=8),
    "needle": pw.Aperture([(0, 0), (1, 0.3), (0.99, 0.32)]).with_illumination(WAVES),
    "steered": CHEVRON.with_illumination(pw.Illumination([1j], [(0.7, 0.2)])),
    "complex weights": pw.phased_array(
        pw.shapes.square(0.8), [(k, 0.1 * k) for k in range(3)], [1, 0.5j, -0.3]
    ),
    "different waves": pw.Array(
        [pw.shapes.square(1.0).with_illumination(WAVES), pw.shapes.square(1.0).moved((1.2, 0.3))],
        [1, 0.7j],
    ),
}
# Of int |u|^2 and turns^3: some roundings of each part.
ROUNDED = 1e-13


def summed(kernel: Any, source: Any, x: Any, nu: Any, outputs: int) -> Any:
    host = NumpyOperations(double=True)
    tables = tables_of(source, True)
    owners, rows = slice_parts(host, tables, *tables.frame.position(host, *x.T))
    found = execution.evaluate(
        kernel,
        source,
        [*rows.T, *nu[owners].T],
        double=True,
        engine="numpy",
        outputs=outputs,
    )
    result = np.zeros((len(x), outputs))
    np.add.at(result, owners, np.stack(found, axis=-1))
    return result


def places(source: Any) -> tuple[Any, Any]:
    x, _ = pw.sample_automean(source, 50, seed=4)
    sizes = np.resize([0.0, 1e-9, 1e-3, 0.3, 1.0, 2.0], 50)
    return x, np.random.default_rng(2).normal(size=(50, 2)) * sizes[:, None]


@pytest.mark.parametrize("name", SOURCES)
def test_sums_over_parts_are_the_wigner_function(name: str) -> None:
    source = SOURCES[name]
    x, nu = places(source)
    energy = float(np.real(pw.lag_marginal(source, (0.0, 0.0))))
    found = summed(PART_WIGNER, source, x, nu, 1)[:, 0]
    assert abs(found - pw.wigner(source, x, nu)).max() < ROUNDED * 4 * energy


@pytest.mark.parametrize("name", SOURCES)
def test_sums_over_parts_are_the_moments(name: str) -> None:
    source = SOURCES[name]
    x, nu = places(source)
    energy = float(np.real(pw.lag_marginal(source, (0.0, 0.0))))
    kernel = kernels.kernel_for("lag moments", source)
    whole = execution.evaluate(
        kernel, source, [*x.T, *nu.T], double=True, engine="numpy", outputs=6
    )
    turns = 10 * (np.linalg.norm(nu, axis=1, keepdims=True) + 1)
    scale = energy * turns ** np.array([0, 1, 2, 2, 3, 3])
    errors = abs(summed(PART_MOMENTS, source, x, nu, 6) - np.stack(whole, axis=-1)) / scale
    assert errors.max() < ROUNDED
