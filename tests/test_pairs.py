"""Every position with every frequency: the short way of Dr.Jit gives what the long way gives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import polywigner as pw


@pytest.mark.parametrize("columns", [64, 82, 115, 4097, 349525])
def test_samples_are_dealt_to_rows_and_columns_without_a_slip(llvm: Any, columns: int) -> None:
    rows = max(2, (1 << 20) // columns)
    x = np.arange(rows)[:, None, None] / rows
    nu = np.arange(columns)[:, None] / columns
    slits = pw.Slits([(-2.0, 3.0)])  # W is different for all of these
    found = pw.wigner(slits, x, nu, engine="llvm", precision="single")
    for column in (0, columns - 1):  # where a sample would slip into another row
        at_once = pw.wigner(slits, x[:, 0], nu[column], engine="llvm", precision="single")
        np.testing.assert_allclose(found[:, column], at_once, rtol=0, atol=1e-5)
    at_once = pw.wigner(slits, x[rows // 2], nu, engine="llvm", precision="single")
    np.testing.assert_allclose(found[rows // 2], at_once, rtol=0, atol=1e-5)
