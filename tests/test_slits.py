"""Transforms of slits against closed forms, quadrature and identities."""

import pickle

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError

ROUNDING = 4e-15  # relative to the total width


PAIR = pw.Slits([[-1.0, -0.4], [0.1, 0.9]])


def test_slits_are_sorted_merged_where_they_touch_and_compared_by_content():
    touching = pw.Slits([[0.2, 0.1], [0.3, 0.2], [0.9, 0.5]])
    assert touching == pw.Slits([[0.5, 0.9], [0.1, 0.3]])
    assert hash(touching) == hash(pw.Slits([[0.1, 0.3], [0.5, 0.9]]))
    assert touching.length == pytest.approx(0.6)
    assert pickle.loads(pickle.dumps(touching)) == touching
    with pytest.raises(ValueError, match="read-only"):
        touching.intervals[0, 0] = 1.0
    with pytest.raises(AttributeError, match="cannot be changed"):
        touching.intervals = None


def test_points_of_slits_have_one_component():
    for bad in (0.5, [0.1, 0.2], np.zeros((3, 2))):
        with pytest.raises(ArgumentError, match=r"expected nu of shape \(\.\.\., 1\)"):
            pw.fourier(PAIR, bad)


@pytest.mark.llvm
def test_a_grating_of_many_slits_is_summed_in_parts():
    """The grating has more pairs of slits than one kernel sums."""
    grating = pw.Slits(np.arange(50)[:, None] + np.array([0.0, 0.3]))
    rng = np.random.default_rng(6)
    x, nu = rng.uniform(0, 50, (200, 1)), rng.uniform(-3, 3, (200, 1))
    for transform, arguments in ((pw.wigner, (x, nu)), (pw.ambiguity, (nu, x - 25))):
        compiled = transform(grating, *arguments, engine="llvm")
        assert np.abs(compiled).max() > 1
        difference = np.abs(compiled - transform(grating, *arguments, engine="numpy")).max()
        assert difference < 10 * ROUNDING * grating.length
