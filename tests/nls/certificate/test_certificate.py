"""The certificate of a pose graph: its cost, its matrices, its eigenvalues against dense ones."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from factors import BearingRange, Between, Covariance, Diagonal, Huber, Information, Isotropic, Prior
from models import SE2, SE3, SO3, LieGroup, R
from models.algebra import Array
from nls import FactorGraph, Values
from nls.certificate.optimum import Optimum, _second_order, newton, rotations, spectrum, staircase
from nls.certificate.problem import Problem, certifiable
from nls.cli import main
from nls.linear import default
from nls.linear.factorization import SingularSystemError
from nls.linear.lu import SuperLU
from tests.nls.certificate.worlds import GROUPS, SEED, contradiction, dominated, noise_graph, problem_of, ring
from tests.nls.graphs import informations, l, pose_graph, x, y
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, SPACE, write


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


Captured = pytest.CaptureFixture[str]
CHAIN = Between(x[[0, 1]], x[[1, 2]], [1.0, 0.0, 0.1], Isotropic(0.1))


def blind(*information: float) -> Between:
    return Between(x[0], x[2], [2, 0, 0], Information(np.diag(information).astype(float)))


VALUES = Values({x: (SE2, SE2.identity(3)), l: (R(2), np.zeros((2, 2))), y: (SE3, SE3.identity(2))})


REFUSED = [
    ([CHAIN, BearingRange(x[0], l[1], [0.1, 3.0], Isotropic(0.1))], r"BearingRange\(x0, l1\) is no measured"),
    ([CHAIN.robust(Huber(1.0))], r"Between\(.*\) has the robust kernel Huber\(1\)"),
    ([CHAIN, Prior(x[[0, 2]], [0, 0, 0], Isotropic(1))], "x0 and x2 are both anchored"),
    ([CHAIN, Prior(x[[0, 0, 2]], [0, 0, 0], Isotropic(1))], "x0 and x2 are both anchored"),
    ([CHAIN, *(Prior(x[k], [0, 0, 0], Isotropic(1)) for k in (1, 2))], "x1 and x2 are both anchored"),
    ([CHAIN, Prior(l[1], [0, 0], Isotropic(1))], r"Prior\(l1\) is on no pose"),
    ([CHAIN[[0]]], "x2 and x0 are not connected"),
    ([CHAIN, Between(y[0], y[1], SE3.identity(1), Isotropic(1))], "Between factors of SE2, SE3; expected"),
    ([], "Between factors of nothing; expected"),
    ([CHAIN, blind(1, 1, 0)], r"Between\(x0, x2\) has no info.*rot"),
    ([CHAIN, blind(1, 0, 1)], r"Between\(x0, x2\) has no info.*posi"),
]


def test_what_cannot_be_certified_is_named() -> None:
    for factors, message in REFUSED:
        with pytest.raises(nls.GraphError, match=f"certify: {message}"):
            nls.certify(FactorGraph(factors), VALUES)


def test_fixed_poses_and_other_spaces_are_refused() -> None:
    graph = FactorGraph([CHAIN, Prior(x[1], [0, 0, 0], Diagonal([1, 1, 1]))])
    values = graph.optimize(Values({x: (SE2, VALUES[x[:3]])})).values
    assert nls.certify(graph, values).verdict == "certified"
    assert nls.certify(graph, VALUES).verdict == "refuted"  # and no warning of values that nothing measures
    graph.fix(x[1])
    assert nls.certify(graph, values).verdict == "certified"  # the pose of the prior
    graph.fix(x[0])
    with pytest.raises(nls.GraphError, match="x0 and x1 are both anchored"):
        nls.certify(graph, VALUES)
    turns = FactorGraph([Between(x[0], x[1], SO3.identity(1), Isotropic(1))])
    with pytest.raises(nls.GraphError, match="Between factors of SO3; expected"):
        nls.certify(turns, Values({x: (SO3, SO3.identity(2))}))


def test_what_was_handed_in_stays_as_it_was() -> None:
    sample = pose_graph(SE3, anchored=False)
    before = sample.values.copy()
    certificate = nls.certify(sample.graph, sample.values)
    assert np.array_equal(before[x], sample.values[x])
    assert not np.allclose(certificate.values[x], before[x], atol=1e-4)


@pytest.mark.parametrize("text", [PLANE, SPACE], ids=["plane", "space"])
def test_the_command_line_says_it(tmp_path: Path, capsys: Captured, text: str) -> None:
    file, where = str(write(tmp_path, text)), tmp_path / "r.json"
    assert main(["solve", file, "--certify", "--verbose", "--json", str(where)]) == 0
    shown = capsys.readouterr().out
    assert re.search("(?m)^certificate certified.*This does not validate the measurements$", shown)
    assert "SE-Sync cost: " in shown
    assert "\ncertify  " in shown
    report = json.loads(where.read_text())
    found, seconds = report["certificate"], report["timings"]
    graph, values, _ = nls.load(file)
    start, *_ = nls.initialize(graph, values)
    expected = nls.certify(graph, graph.optimize(start).values)
    assert (found["verdict"], found["proved"], found["lower_chi2"], found["refuted"]) == ("certified", True, None, [])
    assert found["chi2_given"] == report["chi2_final"] == pytest.approx(found["chi2_reached"], rel=1e-5)
    assert found["cost"] == pytest.approx(expected.cost, rel=1e-12)
    assert found["cost_given"] == pytest.approx(expected.cost_given, rel=1e-12)
    assert [found["moved"]["distance"], found["moved"]["angle"]] == pytest.approx(expected.moved, rel=1e-6)
    assert len(found["eigenvalues"]) == (3 if text is PLANE else 4)
    assert seconds["total"] == pytest.approx(sum(seconds[k] for k in ("solved", "check", "certify", "write")))
    assert main(["solve", file, "--json", "-"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert "certificate" not in plain
    assert "certify" not in plain["timings"]


def square(tmp_path: Path) -> str:
    """A square whose corners start on one spot."""
    lines = [f"VERTEX_SE2 {k} 0 0 {0.001 * (k == 1)}" for k in range(4)]
    lines += [f"EDGE_SE2 {k} {(k + 1) % 4} 1 0 {np.pi / 2 + 0.05 * (k == 0)} {INFORMATION_2}" for k in range(4)]
    return str(write(tmp_path, "\n".join(lines) + "\n"))


def test_the_command_line_refutes_and_the_way_on_that_it_prints_is_certified(tmp_path: Path, capsys: Captured) -> None:
    out, where = str(tmp_path / "out.g2o"), tmp_path / "r.json"
    command = ["solve", square(tmp_path), "--init", "file", "-o", out, "--json", str(where)]
    assert main([*command, "--certify"]) == 1
    captured = capsys.readouterr()
    assert "\ncertificate refuted: " in captured.out
    first = json.loads(where.read_text())
    lower = first["certificate"]["lower_chi2"]
    assert lower < 1e-3 * first["chi2_final"]
    (way_on,) = re.findall("-> continue from there: (.*)", captured.out)
    assert re.search(rf"nls: refuted: .*; continue from there: {re.escape(way_on)}\n$", captured.err)
    assert main([*command, *way_on.split()]) == 0
    captured = capsys.readouterr()
    assert f"\nimproved    from chi2 {first['chi2_final']:.9g}: continued from better poses\n" in captured.out
    assert "\ncertificate certified: " in captured.out
    assert captured.err == ""
    report = json.loads(where.read_text())
    assert report["certificate"]["refuted"] == [first["chi2_final"]]
    assert report["chi2_final"] == pytest.approx(lower, rel=1e-5)
    assert report["init"] == "better poses"
    graph, values, _ = nls.load(out)  # what is written is the better one
    assert graph.chi2(values) == pytest.approx(report["chi2_final"], rel=1e-4)


def test_the_command_line_goes_on_from_a_solution_that_stopped_too_early(tmp_path: Path, capsys: Captured) -> None:
    graph, start = dominated(SE2, 1e4, 1)
    file = str(tmp_path / "far.npz")
    nls.save(file, graph, start)
    command = ["solve", file, "--init", "file", "--json", str(tmp_path / "r.json"), "--allow-doubtful"]
    command += ["--chi2-rtol", "1e-6"]
    assert main([*command, "--certify"]) == 0
    shown = capsys.readouterr().out
    assert "\ncertificate undecided: this solution stopped too early: " in shown
    (way_on,) = re.findall("-> continue from there: (.*)", shown)
    stopped = json.loads((tmp_path / "r.json").read_text())["chi2_final"]
    assert main([*command, *way_on.split()]) == 0
    shown = capsys.readouterr().out
    assert f"\nimproved    from chi2 {stopped:.9g}: continued from better poses\n" in shown
    assert "\ncertificate certified: " in shown
    assert json.loads((tmp_path / "r.json").read_text())["chi2_final"] == pytest.approx(9999**2 / 0.02, abs=0.1)


def test_a_certified_solution_is_not_improved(tmp_path: Path, capsys: Captured) -> None:
    assert main(["solve", square(tmp_path), "--improve", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["certificate"]["verdict"], report["certificate"]["refuted"]) == ("certified", [])
    assert "better poses" not in report["starts"]


@pytest.mark.filterwarnings("ignore::models.errors.GraphWarning")
def test_a_solution_is_written_before_its_certificate_fails(tmp_path: Path, capsys: Captured) -> None:
    weights = ["1e10", "1e10", "1e-10", "1e10", "1e10"]
    lines = [f"EDGE_SE2 {k} {k + 1} 1 0 0.1 {w} 0 0 {w} 0 {w}" for k, w in enumerate(weights)]
    file, out = str(write(tmp_path, "\n".join(lines) + "\n")), tmp_path / "out.g2o"
    options = ["--certify", "--method", "levenberg-marquardt", "--json", "-", "-o", str(out)]
    assert main(["solve", file, *options]) == 2
    captured = capsys.readouterr()
    assert "nls: certify: the weights of positions differ by more than the digits" in captured.err
    assert "certificate" not in json.loads(captured.out)
    assert out.exists()
    out.unlink()
    assert main(["solve", file, "--improve", *options[1:]]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("nls: certify: the weights of positions differ by more than the digits") == 1
    assert out.exists()
