"""The certificate of a pose graph: its cost, its matrices, its eigenvalues against dense ones."""

from __future__ import annotations

import numpy as np
import pytest

import nls
import sim
from factors import Between, Covariance, Diagonal, Isotropic
from models import SE2, SE3, LieGroup
from models.algebra import Array
from nls import FactorGraph, Values
from nls.certificate.optimum import Optimum, _second_order, newton, rotations, spectrum, staircase
from nls.certificate.problem import Problem, certifiable
from nls.linear import default
from nls.linear.factorization import SingularSystemError
from nls.linear.lu import SuperLU
from tests.nls.certificate.worlds import GROUPS, SEED, contradiction, dominated, noise_graph, problem_of, ring
from tests.nls.graphs import informations, x


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_the_cost_is_the_sum_over_the_edges(group: LieGroup) -> None:
    graph, M, factors, values = problem_of(group)
    d, expected = group.point_dim, 0.0
    Q = np.zeros((graph.n * (d + 1), graph.n * (d + 1)))
    for factor in factors.factors:
        model, (X_i, X_j) = values.gather(factor)
        places = [values.stack("x").index(keys) for keys in factor.keys]
        for k in range(len(factor)):
            W = model.W[k % len(model.W)]
            I = W.T @ W if W.ndim == 2 else np.diag(W**2)
            tau = d / np.trace(np.linalg.inv(I[:d, :d]))
            kappa = I[2, 2] if d == 2 else 3 / (2 * np.trace(np.linalg.inv(I[3:, 3:])))
            R_i, R_j, R_ij = (group.rotation(X[k]) for X in (X_i, X_j, model.z))
            t_i, t_j, t_ij = (group.position(X[k]) for X in (X_i, X_j, model.z))
            expected += kappa * np.sum((R_j - R_i @ R_ij) ** 2) + tau * np.sum((t_j - t_i - R_i @ t_ij) ** 2)
            T, w = np.eye(d + 1), np.diag([kappa] * d + [tau])
            T[:d, :d], T[:d, d] = R_ij, t_ij
            i, j = (slice(place[k] * (d + 1), (place[k] + 1) * (d + 1)) for place in places)
            Q[i, i] += T @ w @ T.T
            Q[j, j] += w
            Q[i, j] -= T @ w
            Q[j, i] -= w @ T.T
    assert graph.cost(M) == pytest.approx(expected, rel=1e-12)
    flat = M.reshape(-1, d)
    assert np.trace(flat.T @ Q @ flat) == pytest.approx(expected, rel=1e-9)
    assert np.allclose(graph.product(M).reshape(-1, d), Q @ flat, rtol=0, atol=1e-9 * np.abs(Q).max())
    back = graph.poses(M)
    assert np.allclose(group.local(graph.graph.stack(values), back), 0, atol=1e-12)


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_newton_converges_in_a_few_steps(group: LieGroup) -> None:
    graph, M, *_ = problem_of(group)
    far = newton(graph, M)
    assert far.converged
    assert far.cost < 0.05 * graph.cost(M)
    delta = np.random.default_rng(SEED).normal(size=(graph.n, group.dim))
    M = graph.matrices(group.retract(graph.poses(far.M), 1e-3 * delta))
    found = newton(graph, M)
    assert found.converged
    assert found.steps <= 2
    assert found.cost == pytest.approx(far.cost, rel=1e-12) != graph.cost(M)
    assert np.allclose(found.M[graph.held], M[graph.held], atol=1e-14)
    again = newton(graph, found.M)
    assert again.steps == 0
    assert again.cost == pytest.approx(found.cost, rel=1e-12)
    assert np.allclose(rotations(found.M), found.M, atol=1e-12)


def dense(graph: Problem, M: Array) -> Array:
    """S with the positions eliminated."""
    n, d, k = graph.n, graph.d, graph.d + 1
    S, QM = np.zeros((n, k, n, k)), graph.product(M)
    S[np.arange(n), :, np.arange(n)] = graph.on_diagonal
    for i, j, block in zip(graph.graph.i, graph.graph.j, graph.off, strict=True):
        S[i, :, j] += block
        S[j, :, i] += block.T
    for i in range(n):
        product = QM[i, :d] @ M[i, :d].T
        S[i, :d, i, :d] -= (product + product.T) / 2
    turn, move = S[:, :d].reshape(n * d, n, k), S[:, d].reshape(n, n, k)
    tt, tp, pp = turn[..., :d].reshape(n * d, n * d), turn[..., d], move[..., d]
    return np.asarray(tt - tp @ np.linalg.pinv(pp) @ tp.T)


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_the_eigenvalues_are_those_of_the_dense_matrix(group: LieGroup) -> None:
    graph, M, *_ = problem_of(group)
    for found in (newton(graph, M), Optimum(M, graph.cost(M), False, 0)):
        known = spectrum(graph, found)
        S = dense(graph, found.M)
        expected = np.linalg.eigvalsh(S)
        count = group.point_dim + 1
        assert np.allclose(known.eigenvalues, expected[:count], rtol=1e-4, atol=1e-8 * expected[-1])
        v = known.v[:, : group.point_dim].ravel()
        assert np.allclose(S @ v, known.eigenvalues[0] * v, atol=1e-4 * np.linalg.norm(v) * expected[-1])
        assert known.certified is (found.converged and bool(expected[0] > -1e-9 * expected[-1]))
    assert known.eigenvalues[0] < -1
    assert known.lowest < found.cost


def test_the_bound_holds_for_random_pose_graphs() -> None:
    k, rng = np.arange(12), np.random.default_rng(SEED)
    z = [1.0, 0.0, np.pi / 6] + 0.1 * rng.normal(size=(12, 3))
    edges = FactorGraph([Between(x[k], x[(k + 1) % 12], z, Isotropic(0.1))])
    graph = certifiable(edges, Values({x: (SE2, SE2.identity(12))}))
    found = [newton(graph, rotations(rng.normal(size=(12, 3, 2)))) for _ in range(30)]
    costs, lowest = [each.cost for each in found], [spectrum(graph, each).lowest for each in found]
    assert max(costs) > 1.1 * min(costs)  # there are local minima
    assert max(lowest) < min(costs) < (1 + 2e-6) * max(lowest)
    assert [spectrum(graph, each).certified for each in found] == [each.cost < 1.0001 * min(costs) for each in found]


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_without_cholmod_it_is_the_same(group: LieGroup, monkeypatch: pytest.MonkeyPatch) -> None:
    graph, M, *_ = problem_of(group)
    expected = spectrum(graph, newton(graph, M))
    monkeypatch.setattr(default, "best_decomposition", lambda n: SuperLU)
    other, *_ = problem_of(group)
    found = spectrum(other, newton(other, M))
    assert found.certified
    assert expected.certified
    assert found.lowest == pytest.approx(expected.lowest, rel=1e-9)
    assert np.allclose(found.eigenvalues, expected.eigenvalues, rtol=1e-6, atol=1e-6)
    with pytest.raises(SingularSystemError):
        other.factorized(other.on_diagonal - 2 * np.eye(group.point_dim + 1) * other.on_diagonal.max(), other.off)


@pytest.mark.parametrize("turns", [-1, 3])
def test_rows_are_added_until_the_ring_unwinds(turns: int) -> None:
    graph, values = ring(turns)
    problem = certifiable(graph, values)
    found = newton(problem, problem.matrices(values.stacks["x"].X))
    better, lowest = staircase(problem, found, spectrum(problem, found))
    assert better is not None
    assert better.cost < 1e-20 * found.cost
    assert lowest == 0.0
    assert np.allclose(better.M[0], found.M[0], atol=1e-12)
    assert np.allclose(np.linalg.det(better.M[:, :2]), 1)


def test_the_weights_are_those_of_the_chart() -> None:
    Sigma = np.linalg.inv(informations(1, 6, np.random.default_rng(SEED))[0])
    I = np.linalg.inv(Sigma)
    expected = [3 / (2 * np.trace(np.linalg.inv(I[3:, 3:]))), 3 / np.trace(np.linalg.inv(I[:3, :3]))]
    for convention in ("g2o", "graphslam", "gtsam", "log"):
        factor = Between(x[0], x[1], SE3.exp(np.arange(6) / 10), Covariance(Sigma), convention)
        graph = certifiable(FactorGraph([factor]), Values({x: (SE3, SE3.identity(2))}))
        assert graph.W[0, [0, 3]] == pytest.approx(expected, rel=1e-9)
    sigmas = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    edges = Between(x[[0, 1]], x[[1, 2]], np.zeros((2, 3)), Diagonal(sigmas))  # of each measurement
    graph = certifiable(FactorGraph([edges]), Values({x: (SE2, SE2.identity(3))}))
    assert graph.W[:, 0] == pytest.approx(sigmas[:, 2] ** -2.0)
    assert graph.W[:, 2] == pytest.approx(2 / (sigmas[:, :2] ** 2).sum(axis=1))


def test_newton_never_goes_up(monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(6):
        graph = certifiable(*noise_graph(SE3, seed))
        taken: list[Array] = []
        plain = graph.product
        monkeypatch.setattr(graph, "product", lambda M, plain=plain, taken=taken: taken.append(M) or plain(M))
        found = newton(graph, rotations(np.random.default_rng(seed).normal(size=(5, 4, 3))))
        costs = [graph.cost(M) for M in taken]
        assert len(costs) > 3
        assert (np.diff(costs) < 0).all()
        assert found.converged
        assert found.cost <= (1 + 1e-14) * costs[-1]  # two roundings of one cost


def test_every_optimum_on_the_way_up_is_rounded() -> None:
    """The last one needs all its rows and is rounded to dearer poses than the one before."""
    graph, values = contradiction(73)
    values = graph.optimize(values, nls.LevenbergMarquardt()).values
    problem = certifiable(graph, values)
    stuck = newton(problem, problem.matrices(values.stacks["x"].X))
    known = spectrum(problem, stuck)
    poses, lowest = staircase(problem, stuck, known)
    assert poses is not None
    assert lowest < poses.cost < 0.8 * stuck.cost
    found = nls.certify(graph, values)
    assert (found.verdict, found.proved) == ("refuted", False)
    assert found.lower_chi2 == pytest.approx(131.39649, rel=1e-5)


@pytest.mark.parametrize("seed", [2, 11])
def test_the_last_step_of_newton_is_taken_where_the_cost_is_rounding(seed: int) -> None:
    """The gradient that it leaves behind would widen the gap, by its product with the positions."""
    world = sim.torus(np.random.default_rng(seed), coils=6, per_coil=8, sigma_t=0.1, sigma_r=0.05)
    for start in (world.truth, nls.initialize(world.graph, world.start, "chordal")[0]):
        values = world.graph.optimize(start).values
        problem = certifiable(world.graph, values)
        optimum = newton(problem, problem.matrices(values.stacks["x"].X))
        assert np.abs(_second_order(problem, optimum.M)[1]).max() < 1e-9
        assert optimum.cost - spectrum(problem, optimum).lowest < 1e-6 * optimum.cost


@pytest.mark.parametrize("noise", [0.05, 0.1, 0.2])
def test_the_last_step_promises_little_however_high_the_cost(noise: float) -> None:
    """A part of 1e-13 of a cost of 5e9 leaves a gradient that widens the gap to 70 and more."""
    graph, values = dominated(SE2, 1e4, 1, noise)
    values = graph.optimize(values).values
    problem = certifiable(graph, values)
    optimum = newton(problem, problem.matrices(values.stacks["x"].X))
    assert optimum.converged
    assert 4e9 < optimum.cost < 6e9
    assert 0.4 < optimum.cost - spectrum(problem, optimum).lowest < 30
