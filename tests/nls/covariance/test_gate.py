"""The gate of measurements that are not in the graph: S = H Sigma H' + R of each, and which are refused."""

from __future__ import annotations

import numpy as np
import pytest

from factors import (
    Between,
    Diagonal,
    ElevationHinge,
    EpipolarArc,
    Information,
    Isotropic,
    Landmark,
    Range,
    Robust,
    Tukey,
)
from models import SE2, SE3, R
from models.chi_squared import chi2_gate
from models.errors import GraphError, OptionError, UnderconstrainedError
from nls import FactorGraph, Keys, Marginals, Values, kinds
from nls.covariance import gate
from tests.factors.evaluated import refused
from tests.nls.graphs import mixed

x, l = kinds("x", "l")


@pytest.mark.parametrize("held", ["first", "free"])
def test_distances_are_those_of_the_dense_formula(held: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "ONE_BLOCK", 13)  # two closures together
    sample, rng = mixed(0), np.random.default_rng(0)
    marginals = Marginals(sample.graph, sample.values, gauge=held)
    i, points = (Keys(kind, sample.values.stack(kind).numbers) for kind in "xl")
    X, sigmas, ends = sample.values[x], np.array([0.3, 0.2, 0.1]), i.numbers != i.numbers[::-1]
    z = SE2.retract(SE2.between(X, X[::-1]), rng.normal(0, 9 * sigmas, X.shape))
    closures = Between(i[ends], i[::-1][ends], z[ends], Robust(Diagonal(sigmas), Tukey(1.0)))
    seen = Landmark(i[[0] * len(points)], points, rng.normal(0, 3, (len(points), 2)), Isotropic(0.5))
    every = marginals.joint(i, points, frame="body")
    for factor, s in ((closures, sigmas), (seen, np.array([0.5, 0.5]))):
        d2, limit = marginals.gate(factor)
        assert limit == chi2_gate(len(s), 0.99)
        model, stacks = sample.values.gather(factor)
        A, b = model.linearize(*stacks)
        for k in range(len(factor)):
            H, nu = s[:, None] * np.concatenate([A_k[k] for A_k in A], axis=1), s * b[k]
            Sigma = np.block([[every.block(u, v) for v in factor[k].keys] for u in factor[k].keys])
            np.testing.assert_allclose(d2[k], nu @ np.linalg.solve(H @ Sigma @ H.T + np.diag(s**2), nu), rtol=1e-9)


def test_numbers_that_a_measurement_has_spent_are_no_degrees_of_freedom() -> None:
    poses = Values({x: (SE3, [[0, 0, 0, 0, 0, 0, 1], [0.3, 0, 0.5, 0, 0, 0, 1]])})
    arc = EpipolarArc(x[0], x[1], [4.0, -0.2, 3.676, -0.263], Isotropic(0.01), limit=0.12)
    known = FactorGraph([Between(x[0], x[1], poses[x[1]], Isotropic(0.1))])
    assert Marginals(known, poses).gate(arc, 0.5).limit == chi2_gate(1, 0.5)


def test_the_limit_counts_what_is_measured() -> None:
    poses = Values({x: (SE3, SE3.exp(np.zeros((2, 6)))), l: (R(3), [[1.0, 0.1, 0.0]])})
    known = [Between(x[0], x[1], SE3.identity(), Isotropic(0.1)), Landmark(x[0], l[0], [1, 0.1, 0], Isotropic(0.1))]
    marginals = Marginals(FactorGraph(known), poses)
    W = np.array([np.diag([1.0, 1, 1, 1, 0, 0]), np.eye(6)])
    both = Between(x[[0, 0]], x[[1, 1]], SE3.exp(np.zeros((2, 6))), Information(W))
    assert [marginals.gate(both[[k]], 0.5).limit for k in (0, 1)] == [chi2_gate(m, 0.5) for m in (4, 6)]
    refused(
        lambda: marginals.gate(both),
        GraphError,
        r"Between\(.*measures 4 or 6 numbers; .* ask for factor\[rows\] of one$",
    )
    assert marginals.distances(both).shape == (2,)
    refused(lambda: marginals.gate(ElevationHinge(x[0], l[0], 0.1)), GraphError, "ElevationHinge.* measures 0 numbers")


def test_what_has_no_gate_is_refused() -> None:
    values = Values({x: (SE2, np.zeros((2, 3))), l: (R(2), [[1.0, 1.0], [2.0, 2.0]])})
    step, again = (Between(x[0], x[1], [0, 0, 0], Isotropic(0.1)) for _ in range(2))
    ranges = Range(x[[1, 0, 1]], l[[1, 0, 0]], [2.8, 1.4, 1.5], Isotropic(0.1))
    marginals = Marginals(FactorGraph([step, Landmark(x[1], l[0], [1, 1], Isotropic(0.1)), ranges]), values)
    refused(
        lambda: marginals.gate(step), GraphError, r"Between\(x0, x1\) is in the graph, and the estimate has used it"
    )
    refused(lambda: marginals.gate(ranges[[0]]), UnderconstrainedError, "l1: x, y: not determined")
    refused(lambda: marginals.gate("x0"), GraphError, r"expected a factor such as Between\(...\), got 'x0'")  # type: ignore[arg-type]
    refused(lambda: marginals.gate(again, 1), OptionError, "probability: 1 ")
    assert marginals.gate(again[[]]).d2.shape == (0,)
