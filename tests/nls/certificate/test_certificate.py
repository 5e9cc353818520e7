"""The certificate of a pose graph: its cost, its matrices, its eigenvalues against dense ones, and its verdicts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Between, Covariance, Diagonal, Isotropic
from models import SE2, SE3, LieGroup
from models.algebra import Array
from nls import FactorGraph, Values
from nls.certificate.newton import Optimum, _second_order, nearest, newton, rotations, tangent
from nls.certificate.problem import Problem, certifiable
from nls.certificate.spectrum import spectrum
from nls.certificate.staircase import _rounded, placed, staircase
from nls.linear import laplacian
from nls.linear.lu import SuperLU
from nls.linear.singular import SingularSystemError
from tests.nls.graphs import ODD, informations, pose_graph, walk, x

GROUPS = (SE2, SE3)
SEED = 3


def problem_of(group: LieGroup, seed: int = SEED, start: float = 0.3) -> tuple[Problem, Array, FactorGraph, Values]:
    sample = pose_graph(group, anchored=False, numbers=ODD, seed=seed, start=start)
    graph = certifiable(sample.graph, sample.values)
    return graph, graph.matrices(graph.graph.stack(sample.values)), sample.graph, sample.values


def ring(turns: int, n: int = 12, sigma: float = 0.1) -> tuple[FactorGraph, Values]:
    """A ring of exact steps, started with the headings going round so many times."""
    k = np.arange(n)
    graph = FactorGraph([Between(x[k], x[(k + 1) % n], [1.0, 0.0, 2 * np.pi / n], Isotropic(sigma))])
    heading = turns * 2 * np.pi / n * k
    steps = np.column_stack([np.cos(heading), np.sin(heading)])
    X = np.column_stack([np.cumsum(steps, axis=0) - steps[0], heading])
    return graph, Values({x: (SE2, X)})


def noise_graph(group: LieGroup, seed: int) -> tuple[FactorGraph, Values]:
    """Measurements between all pairs of five poses that have nothing to do with each other."""
    rng = np.random.default_rng(seed)
    i, j = np.triu_indices(5, 1)
    scale = np.repeat([1.0, 2.0], [group.point_dim, group.dim - group.point_dim])
    z = group.exp(rng.normal(size=(len(i), group.dim)) * scale)
    return FactorGraph([Between(x[i], x[j], z, Isotropic(0.5))]), Values({x: (group, group.identity(5))})


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


@pytest.mark.parametrize(("group", "rows"), [(SE2, 0), (SE3, 0), (SE2, 2), (SE3, 1)], ids=repr)
def test_newtons_model_is_right_to_second_order(group: LieGroup, rows: int) -> None:
    graph, M, *_ = problem_of(group)
    rng = np.random.default_rng(SEED)
    M = nearest(np.dstack([M, rng.normal(size=(*M.shape[:2], rows))]))
    E, g, H, off = _second_order(graph, M)
    i, j = graph.graph.i, graph.graph.j
    H[graph.held] = 0.0
    delta = rng.normal(size=g.shape)
    linear = 2 * np.sum(g * delta)
    square = np.einsum("nk,nkl,nl", delta, H, delta) + 2 * np.einsum("nk,nkl,nl", delta[i], off, delta[j])
    errors = []
    for step in (1e-2, 1e-3):
        moved = graph.cost(nearest(M + step * (E @ delta[:, None, :, None])[..., 0]))
        errors.append(abs(moved - graph.cost(M) - step * linear - step**2 * square))
    assert errors[1] < 3e-3 * errors[0]  # third order: 1e-3
    assert errors[0] < 0.3 * 1e-4 * abs(square)
    assert tangent(M).shape[3] == M.shape[2] + group.dim - group.point_dim + rows * group.point_dim


def test_the_nearest_matrix_of_the_plane_is_that_of_the_singular_vectors() -> None:
    """Also of mirrored ones, and of one that is nearly singular."""
    Y = np.random.default_rng(3).normal(size=(50, 2, 2))
    Y[0] = [[1.0, 2.0], [0.5, 1.0 + 1e-6]]
    U, _, Vt = np.linalg.svd(Y)
    M = nearest(np.concatenate([Y, np.ones((50, 1, 2))], axis=1))
    assert 10 < (np.linalg.det(Y) < 0).sum() < 40
    np.testing.assert_allclose(M[:, :2], U @ Vt, atol=1e-9)
    np.testing.assert_allclose(M[:, :2] @ M[:, :2].mT, np.broadcast_to(np.eye(2), (50, 2, 2)), atol=1e-14)
    assert (M[:, 2] == 1).all()


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
    monkeypatch.setattr(laplacian, "best_decomposition", lambda n: SuperLU)
    other, *_ = problem_of(group)
    found = spectrum(other, newton(other, M))
    assert found.certified
    assert expected.certified
    assert found.lowest == pytest.approx(expected.lowest, rel=1e-9)
    assert np.allclose(found.eigenvalues, expected.eigenvalues, rtol=1e-6, atol=1e-6)
    with pytest.raises(SingularSystemError):
        other.factorized(other.on_diagonal - 2 * np.eye(group.point_dim + 1) * other.on_diagonal.max(), other.off)


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_moving_and_renumbering_everything_changes_nothing(group: LieGroup) -> None:
    _, _, graph, values = problem_of(group, start=0.05)
    values = graph.optimize(values).values
    expected = nls.certify(graph, values)
    assert expected.verdict == "certified"
    assert expected.better is None
    assert expected.direction is None
    rng = np.random.default_rng(SEED)
    X, numbers = values.stacks["x"].X, values.stacks["x"].numbers
    moved = group.compose(group.exp(5 * rng.normal(size=(1, group.dim))), X)
    order = rng.permutation(len(numbers))
    renumbered = Values({x: (group, moved[order], numbers[order])})
    mixed = FactorGraph([f[rng.permutation(len(f))] for f in reversed(graph.factors)])
    found = nls.certify(mixed, renumbered)
    assert found.verdict == "certified"
    assert found.cost == pytest.approx(expected.cost, rel=1e-9)
    assert np.allclose(found.moved + found.moved_rms, expected.moved + expected.moved_rms, rtol=1e-4)
    least = x[int(numbers.min())]
    assert np.allclose(group.local(found.values[least], renumbered[least]), 0, atol=1e-12)
    assert graph.chi2(found.values) == pytest.approx(graph.chi2(expected.values), rel=1e-6)


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_how_far_the_two_optima_are_apart(group: LieGroup) -> None:
    _, _, graph, values = problem_of(group, start=0.05)
    found = nls.certify(graph, values)
    delta = group.local(values.stacks["x"].X, found.values.stacks["x"].X)
    distance = np.linalg.norm(group.position(values.stacks["x"].X) - group.position(found.values.stacks["x"].X), axis=1)
    angle = np.linalg.norm(delta[:, group.point_dim :], axis=1)
    assert found.moved == pytest.approx((distance.max(), angle.max()), rel=1e-9)
    assert found.moved_rms == pytest.approx((np.sqrt(np.mean(distance**2)), np.sqrt(np.mean(angle**2))), rel=1e-9)
    assert found.lower_chi2 is not None
    assert found.lower_chi2 < graph.chi2(values)


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_exact_measurements_are_certified(group: LieGroup) -> None:
    X = walk(group, 8, np.random.default_rng(SEED))
    i, j = np.array([0, 1, 2, 3, 4, 5, 6, 7, 2]), np.array([1, 2, 3, 4, 5, 6, 7, 0, 6])
    graph = FactorGraph([Between(x[i], x[j], group.between(X[i], X[j]), Isotropic(0.1))])
    found = nls.certify(graph, Values({x: (group, X)}))
    assert found.verdict == "certified"
    assert found.cost < 1e-20
    assert found.lowest == 0.0
    assert found.converged
    assert found.eigenvalue == pytest.approx(0, abs=1e-9)
    assert found.lower_chi2 is None
    assert found.report().startswith(
        "certified: globally optimal in the SE-Sync cost, which differs slightly from chi2"
    )
    assert found.report().count("\n") == 3


@pytest.mark.parametrize(("turns", "sigma"), [(-1, 0.1), (2, 1e5), (3, 0.1)])
def test_a_ring_wound_wrongly_is_refuted(turns: int, sigma: float) -> None:
    graph, values = ring(turns, sigma=sigma)
    values = graph.optimize(values, nls.LevenbergMarquardt()).values
    found = nls.certify(graph, values)
    assert found.verdict == "refuted"
    assert found.better is not None
    assert found.better_cost is not None
    assert found.cost == pytest.approx(found.cost_given, rel=1e-6)
    assert found.eigenvalue < -1e-3 * sigma**-2
    assert found.better_cost < 1e-20 * found.cost
    assert graph.chi2(found.better) < 1e-20 * graph.chi2(values)
    assert found.lower_chi2 == graph.chi2(found.better)
    assert np.allclose(found.better[x[0]], values[x[0]], atol=1e-12)
    assert "a lower one is" in found.report()
    assert [advice.action for advice in found.advice] == ["start at better"]
    # along the direction, as a row below every [R t], the cost falls
    problem, direction = certifiable(graph, values), found.direction
    assert direction is not None
    M = problem.matrices(found.values.stacks["x"].X)
    raised = nearest(np.dstack([M, 1e-2 * direction]))
    expected = found.eigenvalue * 1e-4 * np.sum(direction[:, :2] ** 2)
    assert problem.cost(raised) - found.cost == pytest.approx(expected, rel=1e-2)


def test_what_rounding_hides_is_not_certified() -> None:
    """One edge 1e14 times the information of the others: its rounding is larger than the whole cost of a wrong ring."""
    graph, values = ring(2, n=20, sigma=1.0)
    stiff = Between(x[0], x[20], [1.0, 0.0, 0.0], Isotropic(1e-7))
    X = np.concatenate([values[x[:20]], SE2.compose(values[x[:1]], stiff.z)])
    found = nls.certify(FactorGraph([*graph.factors, stiff]), Values({x: (SE2, X)}))
    assert found.verdict == "refuted"
    assert (found.better_cost or 0.0) < 1e-20 * found.cost


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


def test_the_staircase_is_taken_where_chordal_rotations_cancel(monkeypatch: pytest.MonkeyPatch) -> None:
    graph, values = ring(2)
    graph.add(Between(x[[0, 0]], x[[50, 50]], [[1.0, 0.0, 0.0], [1.0, 0.0, np.pi]], Isotropic(0.1)))
    X = np.concatenate([values[x], [[1.0, 0.0, 0.4]]])
    values = Values({x: (SE2, X, np.append(np.arange(12), 50))})
    with pytest.raises(nls.UnderconstrainedError, match="cancel"):
        nls.initialize(graph, values, "chordal")
    found = nls.certify(graph, values)
    assert found.verdict == "refuted"
    assert found.better_cost == pytest.approx(400.0 + 400.0)
    monkeypatch.setattr("nls.certificate.verdict.staircase", lambda *_: (None, 0.0))
    assert nls.certify(graph, values).verdict == "undecided"


def test_measurements_that_contradict_each_other_are_undecided() -> None:
    found = nls.certify(*noise_graph(SE3, seed=1))
    assert found.verdict == "undecided"
    assert found.better is None
    assert found.better_cost is None
    assert found.eigenvalue < -0.01
    assert found.direction is not None
    assert 0.9 * found.cost < found.lowest < 0.9999 * found.cost  # the bound of the poses with more rows
    assert "undecided" in found.report()
    assert f"{found.lowest:.6g}" in found.report()
    assert nls.certify(*noise_graph(SE2, seed=1)).verdict == "certified"


def test_a_pose_that_is_fixed_or_has_a_prior_keeps_its_place() -> None:
    sample = pose_graph(SE2, anchored=True, numbers=ODD)
    certificate = nls.certify(sample.graph, sample.values)
    assert np.allclose(certificate.values[x[8]], sample.values[x[8]], atol=1e-12)
    assert not np.allclose(certificate.values[x[-3]], sample.values[x[-3]], atol=1e-6)
    graph = FactorGraph(sample.graph.factors[:-1])
    graph.fix(x[40])
    fixed = nls.certify(graph, sample.values)
    assert np.allclose(fixed.values[x[40]], sample.values[x[40]], atol=1e-12)
    assert fixed.cost == pytest.approx(certificate.cost, rel=1e-9)


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


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_rounding_finds_the_rows_that_hold_the_poses(group: LieGroup) -> None:
    """Wherever the rows are, mirrored too, and however the whole is moved."""
    graph, M, *_ = problem_of(group)
    d, rng = group.point_dim, np.random.default_rng(SEED)
    T = group.exp(rng.normal(size=(1, group.dim)))
    assert np.allclose(placed(graph.matrices(group.compose(T, graph.poses(M))), M, graph.held), M, atol=1e-12)
    basis = np.linalg.qr(rng.normal(size=(d + 2, d + 2)))[0][:d]
    for mirror in (1, -1):
        basis[0] *= mirror
        hidden = M @ basis
        assert graph.cost(hidden) == pytest.approx(graph.cost(M), rel=1e-12)
        assert np.allclose(placed(_rounded(hidden), M, graph.held), M, atol=1e-9)


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
        assert found.cost <= costs[-1]


@pytest.mark.parametrize(
    ("name", "cost"),
    [("pose-graphs-2d/intel.g2o", 52.348227), ("pose-graphs-3d/parking-garage.g2o.gz", 1.262524)],
)
def test_published_optima_are_certified(data: Path, name: str, cost: float) -> None:
    """D. Rosen et al., "SE-Sync", IJRR 38(2-3), 2019, tables 1 and 2, print 52.35 and 1.263."""
    graph, values, _ = nls.load(data / name)
    start, *_ = nls.initialize(graph, values)
    found = nls.certify(graph, graph.optimize(start).values)
    assert found.verdict == "certified"
    assert found.converged
    assert found.steps <= 6
    assert found.cost == pytest.approx(cost, rel=1e-6)
    assert found.cost - found.lowest < 1e-6 * cost
    assert found.eigenvalues[-1] > 1e-4
    assert found.lower_chi2 is None
