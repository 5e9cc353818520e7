"""Covariances by the factor R of A itself: where A'A loses a direction, and wherever it does not."""

from __future__ import annotations

import numpy as np
import pytest

import nls
from factors import Between, Isotropic, Prior, Range
from models import SE2, SE3, LieGroup, R
from nls import FactorGraph, Marginals, UnderconstrainedError, Values, kinds
from tests.nls.graphs import pose_graph, walk

pytestmark = pytest.mark.skipif(nls.QR.missing() is not None, reason=str(nls.QR.missing()))
x, l = kinds("x", "l")


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
@pytest.mark.parametrize("gauge", ["first", "free", "prior"])
def test_it_is_that_of_the_normal_equations_where_these_keep_all(group: LieGroup, gauge: str) -> None:
    sample = pose_graph(group, n=60, anchored=False)
    graph = FactorGraph([*sample.graph.factors])
    default, orthogonal = (Marginals(graph, sample.values, solver, gauge) for solver in (None, nls.QR()))
    scale = np.abs(default.all(x, "body")).max()
    np.testing.assert_allclose(orthogonal.all(x, "body"), default.all(x, "body"), atol=1e-9 * scale)
    np.testing.assert_allclose(orthogonal.covariance(x[7], "body"), default.covariance(x[7], "body"), atol=1e-9 * scale)
    joint, expected = (m.joint(x[[3, 50]], "body").matrix for m in (orthogonal, default))
    np.testing.assert_allclose(joint, expected, atol=1e-9 * scale)


@pytest.mark.parametrize(("n", "sigma"), [(20, 1000.0), (150, 300.0)])
def test_the_cure_of_a_direction_that_is_lost_works_to_the_letter(n: int, sigma: float) -> None:
    """A precise chain with a weak prior: its squares differ by 14 digits and more."""
    X = walk(SE2, n, np.random.default_rng(0))
    chain = Between(x[0 : n - 1], x[1:n], SE2.between(X[:-1], X[1:]), Isotropic(1e-4))
    graph, values = FactorGraph([chain, Prior(x[0], X[0], Isotropic(sigma))]), Values({x: (SE2, X)})
    with pytest.raises(UnderconstrainedError, match="linear_solver=") as caught:
        Marginals(graph, values)
    (cure,) = (line for line in str(caught.value).splitlines() if "linear_solver=" in line)
    call = f"Marginals(graph, values, {cure.rpartition(': ')[2]})"
    marginals = eval(call, {"Marginals": Marginals, "graph": graph, "values": values, "nls": nls})
    np.testing.assert_allclose(np.sqrt(np.diag(marginals.covariance(x[0], "body"))), sigma, rtol=1e-5)
    far = np.linalg.norm(X[-1, :2] - X[0, :2])  # a heading of so many rad moves the end by as much
    trace = np.trace(marginals.covariance(x[n - 1], view="position"))
    assert trace == pytest.approx(2 * sigma**2 + (far * sigma) ** 2, rel=1e-4)
    assert marginals.all(x, "body").shape == (n, 3, 3)
    assert graph.optimize(values, linear_solver=nls.QR()).converged


def test_what_is_free_is_refused_all_the_same_and_not_by_a_cure_in_use() -> None:
    X = walk(SE2, 5, np.random.default_rng(0))
    chain = Between(x[0:4], x[1:5], SE2.between(X[:-1], X[1:]), Isotropic(0.1))
    graph = FactorGraph([chain, Range(x[0], l[0], [3.0], Isotropic(0.1))])
    values = Values({x: (SE2, X), l: (R(2), [[9.0, 9.0]])})
    default, orthogonal = Marginals(graph, values), Marginals(graph, values, nls.QR())
    assert orthogonal.status(l) == default.status(l) == ["free"]
    np.testing.assert_allclose(orthogonal.all(x, "body"), default.all(x, "body"), atol=1e-9)
    with pytest.raises(UnderconstrainedError, match="fix a pose") as caught:
        Marginals(graph, values, nls.QR(), gauge="none")
    assert "nls.QR()" not in str(caught.value)
