"""Pairs of variables that nothing measures together."""

from __future__ import annotations

import numpy as np

from factors.keys import Keys
from nls import Marginals
from nls.covariance.selected import paired
from tests.nls.graphs import l, mixed, x


def test_a_pair_of_two_kinds_has_a_covariance_and_changes_none() -> None:
    sample = mixed(0)
    joint = Marginals(sample.graph, sample.values).joint([x[40], l[-1]], frame="body")
    marginals = Marginals(sample.graph, sample.values, pairs=[(x[[40]], l[[-1]])])
    np.testing.assert_allclose(
        marginals.cross(x[[40]], l[[-1]], frame="body")[0], joint.block(x[40], l[-1]), atol=1e-12
    )
    every = Marginals(sample.graph, sample.values).all(x, frame="body")
    np.testing.assert_allclose(marginals.all(x, frame="body"), every, rtol=1e-9)


def test_a_pair_counts_once_and_none_is_of_one_variable() -> None:
    assert paired([(x[[3, 5]], x[[3, 5]]), (x[[]], l[[]])]) == []
    (pair,) = paired([(x[[3, 1, 3, 4]], x[[5, 2, 5, 4]])])
    assert pair.keys == (Keys("x", np.array([1, 3])), Keys("x", np.array([2, 5])))
