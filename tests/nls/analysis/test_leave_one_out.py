"""What `nls.explain` computes, against brute force: measurements really left out, dense inverses, dense ranks."""

from __future__ import annotations

import numpy as np
import pytest

import nls
import sim
from factors import XYH, Between, Cauchy, Diagonal, Factor, Information, Isotropic, Prior, Robust
from models import SE2, SE3, R
from models.chi_squared import chi2_interval, chi2_tail
from nls import FactorGraph, Marginals, Values
from nls.analysis import suspects
from nls.analysis.leave_one_out import checks
from nls.starts.chordal import chordal
from tests.combinations import for_all
from tests.nls.graphs import ODD, informations, pose_graph, x
from tests.nls.misreadings import checked

ELSEWHERE = 3.0  # where linear problems are linearized: nothing may depend on it


def network(seed: int = 0, kernel: bool = False) -> tuple[FactorGraph, Values]:
    """A linear problem: points of the plane, correlated differences, two priors."""
    rng = np.random.default_rng(seed)
    i, j = np.array([0, 1, 2, 3, 4, 0, 1, 5, 2]), np.array([1, 2, 3, 4, 0, 2, 3, 0, 5])
    P = rng.normal(size=(6, 2))
    z = P[j] - P[i] + 0.3 * rng.normal(size=(9, 2))
    noise = Information(informations(9, 2, rng))
    graph = FactorGraph([Between(x[i], x[j], z, Robust(noise, Cauchy(1.0)) if kernel else noise)])
    graph.add(Prior(x[[0, 3]], P[[0, 3]], Diagonal([0.1, 0.2])))
    return graph, Values({x: (R(2), P + ELSEWHERE)})


def left_out(graph: FactorGraph, values: Values, batch: int, index: int) -> float:
    """t of a measurement from the optimum of all others, of a linear problem."""
    rest = graph.only([np.arange(len(f)) != (index if k == batch else -1) for k, f in enumerate(graph.factors)])
    optimum = rest.optimize(values).values
    P = np.linalg.inv(rest.linearize(optimum).H.toarray())
    A_i, b_i = FactorGraph([graph.factors[batch][[index]]]).linearize(optimum)
    return float(b_i @ np.linalg.solve(np.eye(len(b_i)) + A_i @ P @ A_i.T, b_i))


def test_leaving_out_is_what_really_leaving_out_gives() -> None:
    graph, values = network()
    tests = checks(checked(graph, values), 2)
    for batch, factor in enumerate(graph.factors):
        for index in range(len(factor)):
            assert tests[batch].t[index] == pytest.approx(left_out(graph, values, batch, index), rel=1e-8)
    assert all((test.m == 2).all() for test in tests)


def test_weights_of_a_kernel_count() -> None:
    """With weights w the others are sqrt(w) A, sqrt(w) b; the one left out counts in full."""
    graph, values = network(2, kernel=True)
    values = graph.optimize(values, nls.GaussNewton(nls.Stop(update_tol=1e-12))).values
    found = checked(graph, values)
    t = checks(found, 2)[0].t
    w = found.linear.w[0]
    assert w.min() < 0.5 < w.max() < 1
    H = graph.linearize(values).H.toarray()
    for k in range(9):
        B = np.zeros((2, 12))
        for A_slot, keys in zip(found.linear.A[0], graph.factors[0].keys, strict=True):
            B[:, 2 * keys.numbers[k] : 2 * keys.numbers[k] + 2] = A_slot[k]
        P = np.linalg.inv(H - w[k] * B.T @ B)
        b = found.linear.b[0][k]
        e = b + w[k] * B @ P @ B.T @ b  # the optimum of the others, weights kept
        np.testing.assert_allclose(t[k], e @ np.linalg.solve(np.eye(2) + B @ P @ B.T, e), rtol=1e-6)


@for_all(group=[R(2), SE2, SE3], held=[False, True])
def test_the_shares_are_the_degrees_of_freedom(group: object, held: bool) -> None:
    sample = pose_graph(group, anchored=not held, numbers=ODD)  # type: ignore[arg-type]
    if held:
        sample.graph.fix(x[[7, 12]])
    result = sample.graph.optimize(sample.values)
    explanation = nls.explain(sample.graph, result.values)
    assert sum(part.expected for part in explanation.parts) == pytest.approx(result.dof, abs=1e-5)
    assert sum(part.chi2 for part in explanation.parts) == pytest.approx(result.chi2_final, rel=1e-9)
    assert (explanation.chi2, explanation.dof) == (pytest.approx(result.chi2_final), result.dof)
    assert explanation.rank == explanation.unknowns == sample.graph.linearize(result.values).pattern.n
    assert {part.name for part in explanation.parts} >= {"Between, steps", "Between, closures"}


def test_limits_measure_nothing() -> None:
    """The hinges of a sonar are no degrees of freedom."""
    world = sim.hauv_floor(np.random.default_rng(0), legs=1, per_leg=10)
    result = world.graph.optimize(world.start)
    tests = checks(checked(world.graph, result.values), len(world.graph.factors))
    assert sum(test.dof.sum() for test in tests) == pytest.approx(result.dof, abs=1e-3)


def test_zero_rows_measure_nothing() -> None:
    """An information without one direction: a number less, for all that counts them. One of zeros is not unchecked."""
    omega = np.diag([100.0, 100.0, 0.0])
    k = np.arange(4)
    graph = FactorGraph([Between(x[k], x[(k + 1) % 4], [2.0, 0, np.pi / 2], Isotropic(0.1))])
    graph.add(Between(x[0], x[2], [2.1, 2, np.pi], Information(omega)))
    graph.add(Between(x[1], x[3], [9.0, 9, 1], Information(0 * omega)))
    values = Values({x: (SE2, [[0, 0, 0], [2, 0, np.pi / 2], [2, 2, np.pi], [0, 2, -np.pi / 2]])})
    result = graph.optimize(values)
    explanation = nls.explain(graph, result.values)
    assert {part.name: part.rows for part in explanation.parts}["Between, closures"] == 5
    assert sum(part.expected for part in explanation.parts) == pytest.approx(result.dof) == 5
    worst = next(w for w in explanation.worst if w.factor == "Between(x0, x2)")
    assert worst.normalized > worst.sigmas > 0
    test = checks(checked(graph, result.values), 3)
    assert [(each.m.tolist(), each.rows.tolist()) for each in test[1:]] == [([2], [2]), ([0], [0])]
    assert "unchecked" not in {finding.kind for finding in explanation.findings}
    assert test[1].dof == pytest.approx(2 - np.trace(checked(graph, result.values).C[1][0]))


def test_anchors_take_the_freedom_and_nothing_else() -> None:
    """C and e are those of the pseudo-inverse, A A^+ and b - A A^+ b, of a graph whose x, y and heading are free."""
    graph, values = chain_of_depths()
    found = checked(graph, values)
    A, b = graph.linearize(values)
    D = np.linalg.norm(A.toarray(), axis=0)
    S = A.toarray() / np.where(D == 0, 1, D)
    C, begin = S @ np.linalg.pinv(S, rcond=1e-9), 0
    np.testing.assert_allclose(np.concatenate([e.reshape(-1) for e in found.e[:2]]), b - C @ b, atol=1e-6)
    for own in (C_i for C_k in found.C[:2] for C_i in C_k):
        rows = slice(begin, begin := begin + len(own))
        np.testing.assert_allclose(own, C[rows, rows], atol=1e-7)


def chain_of_depths() -> tuple[FactorGraph, Values]:
    """Three poses in space, their heading and place free as a whole: XYH steps, and depth and tilt priors."""
    X = np.array([[0, 0, 0.1, 0, 0, 0, 1.0], [1, 0, 0.2, 0, 0, 0.2, 0.98], [2, 1, 0, 0, 0, 0.3, 0.95]])
    X[:, 3:] /= np.linalg.norm(X[:, 3:], axis=1)[:, None]
    steps: Factor = XYH(x[[0, 1, 0]], x[[1, 2, 2]], [[1, 0.1, 0.4], [1, 0.6, 0.2], [2, 1, 0.6]], Isotropic(0.1))
    prior = Prior(x[[0, 1, 2]], X, Diagonal(z=0.1, roll=0.02, pitch=0.02), components=("z", "roll", "pitch"))
    return FactorGraph([steps, prior]), Values({x: (SE3, X)})


def test_quantiles_and_tails() -> None:
    assert chi2_interval(10.0) == pytest.approx((3.247, 20.483), abs=1e-3)  # a table of chi-squared
    assert chi2_interval(0.0) == (0.0, 0.0)
    np.testing.assert_allclose(chi2_tail(np.array([11.345, 0.0, 5.0]), np.array([3, 3, 0])), [0.01, 1, 1], atol=1e-5)


def test_the_least_certain_are_those_of_the_marginals() -> None:
    sample = pose_graph(SE3, numbers=ODD)
    values = sample.graph.optimize(sample.values).values
    explanation = nls.explain(sample.graph, values)
    sigma = np.sqrt(np.diagonal(Marginals(sample.graph, values).all(x, frame="world"), axis1=1, axis2=2))
    assert [weak.component for weak in explanation.weakest] == list(SE3.components)
    for c, weak in enumerate(explanation.weakest):
        assert weak.key.numbers[0] == values.stack("x").numbers[sigma[:, c].argmax()]
        assert (weak.sigma, weak.typical) == pytest.approx((sigma[:, c].max(), np.median(sigma[:, c])), rel=1e-6)
        assert weak.unit == ("m" if c < 3 else "rad")


def test_where_wrong_closures_bent_the_map_too_far_the_rest_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """In as many iterations as the rest needs from a chordal start, which are too few from the bent map."""
    world = sim.manhattan(np.random.default_rng(0), 300)
    z = [[0.1, -0.2, 0.0], [2.1, 0.0, 0.1], [0.0, 0.9, 3.1]]
    wrong = Between(x[[291, 200, 160]], x[[9, 60, 30]], z, world.graph.factors[1].noise)
    spoiled, damped = FactorGraph([*world.graph.factors, wrong]), nls.LevenbergMarquardt()
    bent = spoiled.optimize(world.start, damped)
    anew = world.graph.optimize(chordal(world.graph, bent.values), damped)
    assert anew.iterations < world.graph.optimize(bent.values, damped).iterations
    monkeypatch.setattr(suspects, "ITERATIONS", anew.iterations)
    found = nls.explain(spoiled, bent.values)
    assert {suspect.factor for suspect in found.suspects} == {wrong.describe(k) for k in range(3)}
    assert found.chi2_without == pytest.approx((anew.chi2_final, anew.dof))
    assert sum(part.chi2 for part in found.parts) == pytest.approx(bent.chi2_final)


def test_where_all_closures_are_off_none_is_said_to_be_left_out() -> None:
    rng, n = np.random.default_rng(0), 40
    turn, i, sigmas = 2 * np.pi / n * np.arange(3 * n), np.arange(2 * n), np.array([0.05, 0.05, 0.01])
    truth = np.column_stack([np.cos(turn), np.sin(turn), turn + np.pi / 2]) * [n / 2 / np.pi, n / 2 / np.pi, 1]
    off = 8 * rng.normal(size=(2 * n, 3)) * sigmas  # stated eight times too small
    off[7] += [3.0, 2.0, 0.5]
    step = SE2.between(truth[:-1], truth[1:]) + rng.normal(size=(3 * n - 1, 3)) * sigmas
    closures = Between(x[i], x[i + n], SE2.between(truth[i], truth[i + n]) + off, Diagonal(sigmas))
    graph = FactorGraph([Between(x[: 3 * n - 1], x[1 : 3 * n], step, Diagonal(sigmas)), closures])
    found = nls.explain(graph, graph.optimize(Values({x: (SE2, truth)})).values)
    assert found.findings[0].kind == "systematic"
    assert found.suspects == ()
    assert found.chi2_without is None
    assert not any("without" in finding.says for finding in found.findings)
