"""Covariances where something is free, or nearly: against dense projections, by the factor R of A; refused by name."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import nls
from factors import Between, Diagonal, Factor, Isotropic, Prior, Range
from models import SE2, SE3, LieGroup, R
from models.algebra import Array, Mask
from models.errors import UnderconstrainedError
from nls import FactorGraph, Keys, Marginals, Values
from tests.nls.graphs import Sample, l, pose_graph, two_components, walk, x
from tests.nls.solving import make


def projected(graph: FactorGraph, values: Values) -> tuple[Array, Mask]:
    """The pseudo-inverse of A'A from the singular values of A, and which rows its null space leaves alone."""
    A = graph.linearize(values).A.toarray()
    _, s, Vt = np.linalg.svd(A)
    rank = int((s > 1e-9 * s[0]).sum())
    V, N = Vt[:rank].T, Vt[rank:].T
    return (V / np.square(s[:rank])) @ V.T, np.abs(N).max(axis=1, initial=0.0) < 1e-9


def landmark_with_one_range() -> Sample:
    """An anchored trajectory; l0 with one range to it, l1 with three."""
    sample = pose_graph(SE2)
    L = np.array([[4.0, 3.0], [2.0, -5.0]])
    graph = FactorGraph(sample.graph.factors)
    for k, poses in ((0, [3]), (1, [0, 4, 7])):
        z = np.linalg.norm(L[k] - sample.truth[x[poses]][:, :2], axis=1)
        graph.add(Range(x[poses], l[k], z, Isotropic(0.1)))
    values = Values({x: (SE2, sample.values[x]), l: (R(2), L)})
    return Sample(graph, values, values)


def pose_with_free_yaw() -> Sample:
    """A pose in space known but for its yaw, x0, and one known in all, x1."""
    X = SE3.exp(np.array([[1.0, 2.0, 3.0, 0, 0, 0], [0.5, 0, 1, 0.2, -0.1, 0.7]]))
    names = tuple(name for name in SE3.components if name != "yaw")
    five = Prior(x[0], X[:1], Diagonal([0.1, 0.2, 0.3, 0.01, 0.02]), components=names)
    every = Prior(x[1], X[1:], Diagonal([0.1, 0.1, 0.2, 0.03, 0.02, 0.01]))
    values = Values({x: (SE3, X)})
    return Sample(FactorGraph([five, every]), values, values)


def close(covariance: Array, expected: Array) -> None:
    np.testing.assert_allclose(covariance, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert np.array_equal(covariance, covariance.mT)


@pytest.mark.parametrize("solver", ["cholesky", "lu", "schur"])
def test_a_landmark_with_one_range(solver: str) -> None:
    sample = landmark_with_one_range()
    pinv, determined = projected(sample.graph, sample.values)
    assert determined.tolist() == [True] * 24 + [False] * 2 + [True] * 2
    marginals = Marginals(sample.graph, sample.values, make(solver))
    assert (marginals.status(x), marginals.status(l)) == (["estimated"] * 8, ["free", "estimated"])
    close(marginals.all(x, "body"), np.array([pinv[k : k + 3, k : k + 3] for k in range(0, 24, 3)]))
    close(marginals.covariance(x[3], "body"), pinv[9:12, 9:12])
    close(marginals.covariance(l[1]), pinv[26:, 26:])
    joint = marginals.joint([x[3], l[1]], frame="body")
    rows = [9, 10, 11, 26, 27]
    close(joint.matrix, pinv[np.ix_(rows, rows)])
    close(marginals.joint(x[0:8], frame="body").matrix, pinv[:24, :24])
    for ask in (
        lambda: marginals.covariance(l[0]),
        lambda: marginals.covariance(l[[1, 0]], view="position"),
        lambda: marginals.joint([x[3], l[0]], frame="body"),
        lambda: marginals.all(l),
    ):
        with pytest.raises(
            UnderconstrainedError, match=r"l0: x, y: not determined. 1 free direction moves it"
        ) as caught:
            ask()
        error = caught.value
        assert (error.keys, error.nullity, error.components) == ((l[0],), 1, ("l0: x, y",))
    assert marginals.underconstrained is not None
    assert marginals.underconstrained.keys == (l[0],)


def test_a_component_that_is_free() -> None:
    sample = two_components(anchored=True)
    pinv, determined = projected(sample.graph, sample.values)
    assert determined.tolist() == [True] * 24 + [False] * 24
    marginals = Marginals(sample.graph, sample.values, gauge="none")
    assert marginals.status(x) == ["estimated"] * 8 + ["free"] * 8
    close(marginals.joint(x[0:8], frame="body").matrix, pinv[:24, :24])
    close(marginals.covariance(x[[5, 2]], "body"), np.array([pinv[k : k + 3, k : k + 3] for k in (15, 6)]))
    match = "x50: x, y, yaw; x57: x, y, yaw: .* 3 free directions move them"
    with pytest.raises(UnderconstrainedError, match=match) as caught:
        marginals.covariance(x[[2, 50, 57]], "world")
    assert (caught.value.keys, caught.value.nullity) == ((x[50], x[57]), 3)
    held = Marginals(sample.graph, sample.values)  # one of its poses held: all is determined
    assert held.underconstrained is None
    close(held.covariance(x[5], "body"), pinv[15:18, 15:18])


def test_a_pose_whose_yaw_is_free_has_a_position() -> None:
    sample = pose_with_free_yaw()
    pinv, determined = projected(sample.graph, sample.values)
    assert determined.tolist() == [True] * 5 + [False] + [True] * 6
    marginals = Marginals(sample.graph, sample.values)
    assert marginals.status(x) == ["free", "estimated"]
    Rot = SE3.rotation(sample.values[x])
    close(marginals.covariance(x[0], view="position"), Rot[0] @ pinv[:3, :3] @ Rot[0].T)
    np.testing.assert_allclose(np.diag(marginals.covariance(x[0], view="position")), [0.01, 0.04, 0.09], rtol=1e-12)
    close(marginals.covariance(x[1], "body"), pinv[6:, 6:])
    G = np.zeros((6, 12))
    G[:3, :3], G[3:, 6:9] = Rot
    close(marginals.joint(x[[0, 1]], view="position").matrix, G @ pinv @ G.T)
    close(marginals.all(x, view="position")[0], Rot[0] @ pinv[:3, :3] @ Rot[0].T)
    for frame, view in (("body", None), ("world", None), (None, "euler")):
        with pytest.raises(UnderconstrainedError, match="x0: yaw: not determined"):
            marginals.covariance(x[0], frame, view)


def test_the_free_gauge_beside_something_free_is_the_pseudo_inverse() -> None:
    sample = landmark_with_one_range()
    graph = FactorGraph([f for f in sample.graph.factors if not isinstance(f, Prior)])
    pinv, _ = projected(graph, sample.values)
    marginals = Marginals(graph, sample.values, gauge="free")
    assert marginals.status(x) == ["estimated"] * 8
    close(marginals.joint(x[0:8], frame="body").matrix, pinv[:24, :24])
    close(marginals.all(x, "body"), np.array([pinv[k : k + 3, k : k + 3] for k in range(0, 24, 3)]))
    with pytest.raises(UnderconstrainedError, match="l0: x, y"):
        marginals.covariance(l[0])


def test_fixed_untouched_and_free_variables_side_by_side() -> None:
    sample = landmark_with_one_range()
    sample.graph.fix(x[0])
    values = Values({x: (SE2, sample.values[x]), l: (R(2), np.vstack([sample.values[l], [[1.0, 1.0]]]))})
    with pytest.warns(nls.GraphWarning, match="l2: no measurement touches it"):
        marginals = Marginals(sample.graph, values)
    assert marginals.status(l) == ["free", "estimated", "unmeasured"]
    assert not marginals.covariance(x[0], "body").any()
    pinv, _ = projected(sample.graph, values)
    close(marginals.covariance(x[3], "body"), pinv[6:9, 6:9])  # x0 has no columns
    with pytest.raises(UnderconstrainedError, match="l2: no measurement touches it"):
        marginals.covariance(l[2])
    alone = Marginals(sample.graph, values, gauge="none")  # nothing is held: a column of zeros
    assert alone.status(l) == ["free", "estimated", "free"]
    with pytest.raises(UnderconstrainedError, match=r"l2: x, y: .* 2 free directions"):
        alone.covariance(l[2])


def test_a_graph_without_a_determined_variable_is_refused() -> None:
    sample = pose_graph(SE2, anchored=False)
    with pytest.raises(UnderconstrainedError, match="3 directions free"):
        Marginals(sample.graph, sample.values, gauge="none")


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_graphs_of_points_against_the_projection(seed: int) -> None:
    """Priors, distances and differences: which variables are determined, and their covariances."""

    def distance(a: Array, b: Array) -> Array:
        return 3.0 - np.linalg.norm(b - a, axis=1, keepdims=True)

    rng = np.random.default_rng(seed)
    n, components = 5, [["x"], ["y"], ["x", "y"]]
    graph = FactorGraph()
    for _ in range(rng.integers(1, 4)):
        names = components[rng.integers(3)]
        graph.add(Prior(l[int(rng.integers(n))], rng.normal(size=2), Isotropic(rng.uniform(0.1, 2)), components=names))
    for _ in range(rng.integers(1, 6)):
        i, j = rng.choice(n, 2, replace=False)
        graph.add(Factor.from_function(distance, [l[int(i)], l[int(j)]], 1, Isotropic(rng.uniform(0.1, 2))))
        if rng.random() < 0.5:
            graph.add(Between(l[int(i)], l[int(j)], rng.normal(size=2), Isotropic(rng.uniform(0.1, 2))))
    values = Values({l: (R(2), 3 * rng.normal(size=(n, 2)))})
    pinv, rows = projected(graph, values)
    determined = rows.reshape(n, 2).all(axis=1)
    if not determined.any():
        with pytest.raises(UnderconstrainedError):
            Marginals(graph, values, gauge="none")
        return
    marginals = Marginals(graph, values, gauge="none")
    assert np.array_equal(np.array(marginals.status(l)) == "estimated", determined)
    keys = Keys("l", np.flatnonzero(determined))
    at = (2 * keys.numbers[:, None] + np.arange(2)).reshape(-1)
    np.testing.assert_allclose(marginals.joint(keys).matrix, pinv[np.ix_(at, at)], rtol=1e-6, atol=1e-9)
    for k in np.flatnonzero(~determined).tolist():
        with pytest.raises(UnderconstrainedError, match=f"^l{k}: "):
            marginals.covariance(l[k])


# ---- by the factor R of A itself: where A'A loses a direction, and wherever it does not


ORTHOGONAL = pytest.mark.skipif(nls.QR.missing() is not None, reason=str(nls.QR.missing()))


@ORTHOGONAL
@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
@pytest.mark.parametrize("gauge", ["first", "free", "prior"])
def test_it_is_that_of_the_normal_equations_where_these_keep_all(group: LieGroup, gauge: str) -> None:
    sample = pose_graph(group, n=60, anchored=False)
    graph = FactorGraph([*sample.graph.factors])
    default, orthogonal = (Marginals(graph, sample.values, solver, gauge) for solver in (None, nls.QR()))
    scale = np.abs(default.all(x, "body")).max()
    np.testing.assert_allclose(orthogonal.all(x, "body"), default.all(x, "body"), atol=1e-9 * scale)
    np.testing.assert_allclose(orthogonal.covariance(x[7], "body"), default.covariance(x[7], "body"), atol=1e-9 * scale)
    joint, expected = (m.joint(x[[3, 50]], frame="body").matrix for m in (orthogonal, default))
    np.testing.assert_allclose(joint, expected, atol=1e-9 * scale)


@ORTHOGONAL
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


@ORTHOGONAL
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
