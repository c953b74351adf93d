"""Laws at single places that one source and an array obey alike."""

from __future__ import annotations

from typing import Any

import numpy as np

from polywigner.testing.array_cases import ArrayCase
from polywigner.testing.cases import Case, require

__all__ = ["ambiguity_is_hermitian_and_bounded", "values_at_zero", "wigner_is_real_and_bounded"]


def wigner_is_real_and_bounded(case: Case | ArrayCase, allowed: float) -> Any:
    """Also returns W at the case's places."""
    value = case.evaluate("wigner", case.x, case.nu)
    if np.iscomplexobj(value):
        raise AssertionError(f"W is real: expected a real array, got {value.dtype}")
    bound = 2**case.dimension * case.energy
    law = f"|W| <= {2**case.dimension} times int |u|^2"
    here = {"x": case.x, "nu": case.nu}
    require(law, value, np.clip(value, -bound, bound), allowed, here)
    return value


def ambiguity_is_hermitian_and_bounded(case: Case | ArrayCase) -> None:
    here = {"upsilon": case.upsilon, "xi": case.xi}
    value = case.evaluate("ambiguity", case.upsilon, case.xi)
    mirrored = case.evaluate("ambiguity", -case.upsilon, -case.xi)
    require("A(-upsilon, -xi) = conj A(upsilon, xi)", mirrored, value.conj(), case.allowed, here)
    size = np.abs(value)
    require("|A| <= A(0, 0)", size, np.minimum(size, case.energy), case.allowed, here)


def values_at_zero(case: Case | ArrayCase, allowed: float) -> None:
    """Values at zero frequency: those of W, within ``allowed``, and of A are the marginals."""
    zero = np.zeros(case.dimension)
    by_position = case.evaluate("position_marginal", case.x)
    at_zero = case.evaluate("wigner", case.x, zero)
    require("W(x, 0) = R_x(x)", at_zero, by_position, allowed, {"x": case.x})
    by_lag = case.evaluate("lag_marginal", case.xi)
    at_zero = case.evaluate("ambiguity", zero, case.xi)
    require("A(0, xi) = R_xi(xi)", at_zero, by_lag, case.allowed, {"xi": case.xi})
