"""Assertions of tests: do the transforms of a source obey the laws that they must obey?

===============================  ==================================================================
assertion                        what it checks
===============================  ==================================================================
``assert_wigner_identities``     W, A, F and the marginals of an aperture or slits: all of the below
``assert_array_identities``      the same for an array: sums over its elements and pairs of them
``assert_marginals``             only that W and A integrate, and reduce at zero, to the marginals
``assert_otf_properties``        the OTF of a pupil, defocused or not
===============================  ==================================================================

Each evaluates the public transforms at random places and compares them with each other, with the
same source moved, turned, scaled and cut into pieces, and with values found another way. Each
raises an :class:`AssertionError` that names the law, the place and the two values, and returns
nothing. They take about a second, and more for many edges.
"""

from identities.wigner import (
    assert_array_identities,
    assert_marginals,
    assert_otf_properties,
    assert_wigner_identities,
)

__all__ = [
    "assert_array_identities",
    "assert_marginals",
    "assert_otf_properties",
    "assert_wigner_identities",
]
