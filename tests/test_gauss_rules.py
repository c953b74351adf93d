"""Gauss rules, how many nodes an integrand needs, and what is estimated to be missing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from polywigner.execution import NumpyOperations, ScalarOperations
from polywigner.numerics.nodes import SUMS, gauss_rules, missed, node_sums, nodes_needed, rule_of

OPS = NumpyOperations(double=True)


@pytest.mark.parametrize("number", [0, 1, 10, 18])
def test_rules_are_gauss_legendres(number: int) -> None:
    table = gauss_rules()[number]
    node, weight = np.polynomial.legendre.leggauss(len(table))
    np.testing.assert_allclose(table[:, 0], node, rtol=0, atol=1e-15)
    np.testing.assert_allclose(table[:, 1], weight, rtol=0, atol=5e-15)


def test_the_largest_rule_integrates_what_oscillates_as_fast_as_it_can_follow() -> None:
    x, weight, *_ = gauss_rules()[-1].T
    for wave in (0.0, 300.0, 600.0):
        exact = 2 * np.sinc(wave / np.pi)
        assert weight @ np.exp(1j * wave * x) == pytest.approx(exact, abs=1e-13)


def test_the_last_weights_give_legendre_coefficients() -> None:
    for table in gauss_rules()[2:12]:
        n = len(table)
        coefficients = np.random.default_rng(n).normal(size=n)
        values = np.polynomial.legendre.legval(table[:, 0], coefficients)
        assert values @ table[:, 2] == pytest.approx(coefficients[-1], abs=1e-12)
        assert values @ table[:, 3] == pytest.approx(coefficients[-2], abs=1e-12)


MANY_NODES = np.polynomial.legendre.leggauss(300)


@pytest.mark.parametrize("ops", [OPS, ScalarOperations()])
@pytest.mark.parametrize("digits", [5.0, 12.0, 24.0])
def test_nodes_suffice_for_a_wave_next_to_a_pole_and_the_estimate_says_so(
    ops: Any, digits: float
) -> None:
    """exp(i w x)/(x^2 + a^2) has its poles at ia."""
    for pole in (0.3, 1.0, 4.0):
        for wave in (0.0, 4.0, 20.0):

            def integrand(at: Any, pole: float = pole, wave: float = wave) -> tuple[Any, Any]:
                envelope = pole * pole / (at * at + pole * pole)
                return np.cos(wave * at) * envelope, np.sin(wave * at) * envelope

            def node(at: Any, *weights: Any, integrand: Any = integrand) -> Any:
                return node_sums(*integrand(at), *weights)

            needed, expected = nodes_needed(ops, digits, 0.95 * pole, wave)
            rule = rule_of(ops, needed)
            assert len(gauss_rules()[int(rule)]) >= needed
            sums = ops.sum_over_rule(rule, gauss_rules(), node, SUMS)
            x, weight = MANY_NODES
            real, _ = integrand(x)
            true = abs(float(sums[0]) - weight @ real)
            estimate = float(missed(ops, tuple(sums), expected, 1.0))
            assert true <= estimate
            # the size of the integrand is that of the envelope, 1 at most
            assert true <= 10 * np.exp(-digits) + 1e-14


def test_too_few_nodes_are_noticed() -> None:
    """An integrand that oscillates four times faster than was said."""
    needed, expected = nodes_needed(OPS, 20.0, 100.0, 5.0)
    rule = rule_of(OPS, np.asarray(needed))

    def node(at: Any, *weights: Any) -> Any:
        return node_sums(np.cos(20.0 * at), np.sin(20.0 * at), *weights)

    sums = OPS.sum_over_rule(rule, gauss_rules(), node, SUMS)
    assert float(missed(OPS, tuple(sums), expected, 1.0)) > 1e-3


def test_samples_with_different_rules_are_summed_each_by_its_own() -> None:
    rules = gauss_rules()
    rule = np.array([[0.0, -1.0, 3.0], [3.0, 0.0, 5.0]])
    power = np.arange(6.0).reshape(2, 3) * 2

    def term(at: Any, weight: Any, _v1: Any, _v2: Any, power: Any) -> tuple[Any, ...]:
        return weight * at**power, weight

    sums = OPS.sum_over_rule(rule, rules, term, 2, power)
    expected = np.where(rule < 0, 0.0, 2 / (power + 1))
    # 4 nodes are exact up to power 7
    exact = power < 2 * np.array([[4, 9, 7], [7, 4, 9]])
    np.testing.assert_allclose(sums[0][exact], expected[exact], atol=1e-14)
    np.testing.assert_allclose(sums[1], np.where(rule < 0, 0.0, 2.0), atol=1e-14)
