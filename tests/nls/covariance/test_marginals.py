"""Marginals and joints against dense inverses, in the frame of the body and of the world; gauges; what is refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import nls
import sim
from factors import Factor, Huber, Information, Isotropic, Prior, Robust
from factors.keys import Keys
from models import SE2, SE3, SO2, SO3, LieGroup, R, euler
from models.algebra import Array
from models.errors import GraphError, OptionError, ResourceLimitError, SingularGeometryError, UnderconstrainedError
from nls import FactorGraph, Kind, Marginals, Values
from nls.covariance.inverse import paired
from tests.nls.graphs import ODD, SAMPLES, Sample, informations, l, mixed, pose_graph, two_components, x
from tests.nls.solving import make


def dense(sample: Sample) -> tuple[Array, list[str]]:
    """(A'A)^-1 with zeros for what is fixed, and the names of its rows, over all variables in order."""
    system = sample.graph.linearize(sample.values)
    every = FactorGraph(sample.graph.factors).linearize(sample.values)
    inverse = np.linalg.inv((system.A.T @ system.A).toarray())
    free = np.isin(every.cols, system.cols)
    Sigma = np.zeros((len(free), len(free)))
    Sigma[np.ix_(free, free)] = inverse
    return Sigma, every.cols


def close(found: Array, expected: Array, tolerance: float = 1e-10) -> None:
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max(initial=1e-300))
    assert np.array_equal(found, found.mT)
    assert np.linalg.eigvalsh(found).min(initial=0.0) >= -1e-13 * np.abs(found).max(initial=0.0)


@pytest.mark.parametrize("name", ["cholesky", "lu", "qr"])
def test_every_marginal_and_the_joint_of_all(name: str) -> None:
    for graph in ("R(1)", "SO3", "SE3", "SE2 odd ids", "mixed, some fixed") if name == "cholesky" else ("SE3", "mixed"):
        sample = SAMPLES[graph]()
        marginals = Marginals(sample.graph, sample.values, make(name))
        Sigma, names = dense(sample)
        joint = marginals.joint([nls.Keys(s.kind, s.numbers) for s in sample.values.stacks.values()], frame="body")
        close(joint.matrix, Sigma)
        assert list(joint.names) == names
        begin = 0
        for stack in sample.values.stacks.values():
            n, d = len(stack), stack.manifold.dim
            blocks = np.array([Sigma[k : k + d, k : k + d] for k in range(begin, begin + n * d, d)])
            begin += n * d
            close(marginals.all(Kind(stack.kind), frame="body"), blocks)
            for k in (0, n - 1):
                close(marginals.covariance(nls.Keys(stack.kind, int(stack.numbers[k])), frame="body"), blocks[k])
            close(marginals.covariance(nls.Keys(stack.kind, stack.numbers[::-1]), frame="body"), blocks[::-1])


def test_many_variables_come_out_of_the_pass_over_all(monkeypatch: pytest.MonkeyPatch) -> None:
    sample = pose_graph(SE2, numbers=ODD)
    some = x[[7, 1000, -3]]
    whole = Marginals(sample.graph, sample.values)
    solved, joint = whole.covariance(some, frame="world"), whole.joint(some, frame="body").matrix
    monkeypatch.setattr("nls.covariance.marginals.ONE_BLOCK", 4)
    monkeypatch.setattr("nls.covariance.inverse.ONE_BLOCK", 4)
    passed = Marginals(sample.graph, sample.values)
    np.testing.assert_allclose(passed.covariance(some, frame="world"), solved, rtol=1e-11)
    assert "_diagonal" in vars(passed)
    close(passed.joint(some, frame="body").matrix, joint)


@pytest.mark.parametrize("gauge", ["first", "free"])
def test_pairs_that_share_a_factor_come_out_of_one_pass(gauge: str) -> None:
    """Poses far apart are given as pairs; a held one has no covariance with any."""
    world = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
    i, j = np.array([0, 3, 31, 7, 12]), np.array([25, 17, 2, 8, 12])
    marginals = Marginals(world.graph, world.truth, gauge=gauge, pairs=[(x[i], x[j])])
    for frame in ("body", "world"):
        blocks = marginals.cross(x[i], x[j], frame=frame)
        for k in range(4):
            pair = marginals.joint(x[[i[k], j[k]]], frame=frame)
            np.testing.assert_allclose(blocks[k], pair.matrix[:3, 3:], rtol=0, atol=1e-12)
        np.testing.assert_allclose(blocks[4], marginals.covariance(x[12], frame=frame), rtol=0, atol=1e-12)
    with pytest.raises(GraphError, match="x3 and x30 share no factor"):
        marginals.cross(x[[7, 3]], x[[8, 30]], frame="body")
    with pytest.raises(GraphError, match="2 and 1 variables"):
        marginals.cross(x[[7, 3]], x[8], frame="body")


def test_motions_of_pairs_against_the_dense_joint() -> None:
    """G = X_i^-1 X_j: J Sigma J' with J by differences, both ways round, and for poses of space and of the plane."""
    for space, far in ((SE2, [(0, 1), (3, 2), (7, 0)]), (SE3, [(1, 0), (2, 5), (6, 7)])):
        sample = pose_graph(space, seed=3)
        i, j = np.array(far).T
        marginals = Marginals(sample.graph, sample.values, pairs=[(x[i], x[j])])
        motions = marginals.relative(x[i], x[j])
        for k, (a, b) in enumerate(far):
            X = sample.values[x[[a, b]]]
            G, step = space.between(X[:1], X[1:]), 1e-6
            J = np.zeros((space.dim, 2 * space.dim))
            for column, E in enumerate(step * np.eye(2 * space.dim).reshape(-1, 2, space.dim)):
                moved = space.retract(X, E)
                J[:, column] = space.local(G, space.between(moved[:1], moved[1:]))[0] / step
            Sigma = marginals.joint(x[[a, b]], frame="body").matrix
            np.testing.assert_allclose(motions[k], J @ Sigma @ J.T, rtol=0, atol=1e-5 * Sigma.max())
        held = FactorGraph(sample.graph.factors)
        held.fix(x[0])
        assert not Marginals(held, sample.values).relative(x[0], x[0]).any()
    points = mixed(0)
    with pytest.raises(GraphError, match="no poses of one group"):
        Marginals(points.graph, points.values).relative(x[40], l[5])


@pytest.mark.parametrize("case", ["one", "two", "space", "points"])
def test_gauges(case: str) -> None:
    sample = {
        "one": lambda: pose_graph(SE2, anchored=False),
        "two": two_components,
        "space": lambda: pose_graph(SE3, anchored=False, numbers=ODD),
        "points": lambda: pose_graph(R(2), anchored=False),
    }[case]()
    A = FactorGraph(sample.graph.factors).linearize(sample.values).A.toarray()
    keys = nls.Keys("x", sample.values.stack("x").numbers)
    first = Marginals(sample.graph, sample.values)
    lowest = [repr(x[int(n)]) for n in ([0, 50] if case == "two" else [keys.numbers.min()])]
    assert first.gauge == ", ".join(lowest) + " fixed"
    status = first.status(x)
    assert [repr(x[int(n)]) for n, s in zip(keys.numbers, status, strict=True) if s == "gauge"] == lowest
    held = np.array([s == "gauge" for s in status])
    assert not first.all(x, "body")[held].any()
    assert first.all(x, "body")[~held].any(axis=(1, 2)).all()

    free = Marginals(sample.graph, sample.values, gauge="free")
    assert free.status(x) == ["estimated"] * len(keys)
    pinv = np.linalg.pinv(A.T @ A, rcond=1e-11, hermitian=True)
    close(free.joint(keys, frame="body").matrix, pinv, 1e-9)
    d = sample.values.stack("x").manifold.dim
    for k, block in enumerate(free.all(x, "body")):
        close(block, pinv[k * d : k * d + d, k * d : k * d + d], 1e-9)

    prior = Marginals(sample.graph, sample.values, gauge="prior")
    assert prior.gauge.startswith("a prior of unit information on")
    np.testing.assert_allclose(prior.all(x, "body")[held], np.broadcast_to(np.eye(d), (held.sum(), d, d)), atol=1e-8)

    with pytest.raises(UnderconstrainedError, match="directions free"):
        Marginals(sample.graph, sample.values, gauge="none")


def test_what_no_measurement_touches_has_no_covariance() -> None:
    sample = pose_graph(SE2)
    values = Values({x: (SE2, np.vstack([sample.values[x], np.zeros((2, 3))]), [*range(8), 90, 91])})
    with pytest.warns(nls.GraphWarning, match="x90, x91: no measurement touches them"):
        marginals = Marginals(sample.graph, values)
    assert marginals.status(x) == ["estimated"] * 8 + ["unmeasured"] * 2
    for ask in (
        lambda: marginals.covariance(x[90], "body"),
        lambda: marginals.joint([x[3], x[90]], frame="body"),
        lambda: marginals.all(x, "body"),
    ):
        with pytest.raises(UnderconstrainedError, match=r"no measurement touches") as caught:
            ask()
        assert x[90] in caught.value.keys
    expected = Marginals(sample.graph, sample.values).all(x, "body")
    np.testing.assert_allclose(marginals.covariance(x[0:8], "body"), expected, rtol=1e-11)
    sample.graph.fix(x[[90, 91]])
    fixed = Marginals(sample.graph, values)
    assert fixed.status(x)[8:] == ["fixed", "fixed"]
    assert not fixed.covariance(x[[90, 91]], "world").any()


def test_a_robust_kernel_counts_with_its_weight() -> None:
    """Residual 10 sigma, Huber at 1: the weight is 1/10, and the variance is that of ten such measurements."""
    noise = Robust(Isotropic(0.5), Huber(1.0))
    graph = FactorGraph([Prior(x[0], [5.0], noise)])
    assert Marginals(graph, Values({x: (R(1), [0.0])})).covariance(x[0])[0, 0] == pytest.approx(10 * 0.25)
    assert Marginals(graph, Values({x: (R(1), [4.9])})).covariance(x[0])[0, 0] == pytest.approx(0.25)


def test_memory_is_bounded() -> None:
    sample = pose_graph(SE2)
    marginals = Marginals(sample.graph, sample.values, memory_limit=8e3)
    with pytest.raises(ResourceLimitError, match="the joint covariance of 24 unknowns needs") as caught:
        marginals.joint(x[0:8], frame="body")
    assert caught.value.needed > caught.value.limit == 8e3
    with pytest.raises(ResourceLimitError, match="marginal covariances of 8 variables"):
        marginals.all(x, frame="body")
    assert marginals.covariance(x[3], frame="body").shape == (3, 3)
    loose = pose_graph(SE2, anchored=False)
    with pytest.raises(ResourceLimitError, match=r"gauge 'free': 3 free directions of 24 unknowns"):
        Marginals(loose.graph, loose.values, gauge="free", memory_limit=1e3)


def test_the_values_may_change_afterwards() -> None:
    for frame in ("body", "world"):
        sample = pose_graph(SE2)
        marginals = Marginals(sample.graph, sample.values)
        before = marginals.all(x, frame)
        sample.values[x[3]] = [9.0, 9.0, 2.0]
        before[0] = 7.0
        again = marginals.all(x, frame)
        np.testing.assert_array_equal(again[1:], before[1:])
        assert not (again[0] == 7.0).any()


def test_wrong_uses() -> None:
    sample = pose_graph(SE2)
    marginals = Marginals(sample.graph, sample.values)
    wrong: list[tuple[type[Exception], str, Callable[[], object]]] = [
        (GraphError, "the graph has no factors", lambda: Marginals(FactorGraph(), sample.values)),
        (OptionError, "linear_solver: 'lu'", lambda: Marginals(sample.graph, sample.values, "lu")),  # type: ignore[arg-type]
        (OptionError, "memory_limit: 0", lambda: Marginals(sample.graph, sample.values, memory_limit=0)),
        (OptionError, "gauge: 'last'", lambda: Marginals(sample.graph, sample.values, gauge="last")),
        (GraphError, "names no variable", lambda: marginals.covariance(3)),  # type: ignore[arg-type]
        (GraphError, "expected a kind such as x", lambda: marginals.all(x[[1, 2]], "body")),  # type: ignore[arg-type]
        (GraphError, "x77 has no value", lambda: marginals.covariance(x[77], "body")),
        (GraphError, "no variable is given", lambda: marginals.joint([], frame="body")),
        (GraphError, "'body' is no variable; expected frame='body', by name", lambda: marginals.joint(x[7], "body")),
        (GraphError, "x7 is given twice", lambda: marginals.joint([x[[6, 7]], x[7]], frame="body")),
        (GraphError, "x6 is not in this joint", lambda: marginals.joint(x[[1, 7]], frame="body").block(x[7], x[6])),
    ]
    for error, words, use in wrong:
        with pytest.raises(error, match=words):
            use()
    assert marginals.covariance(x[[]], "body").shape == (0, 3, 3)
    lying = FactorGraph([Factor.from_function(lambda X: X - 1.0, x[0], 2, relative=True)])
    with pytest.raises(GraphError, match="declares relative=True, but is not relative"):
        Marginals(lying, Values({x: (R(2), [0.0, 0.0])}), gauge="free")


def test_a_pair_of_two_kinds_has_a_covariance_and_changes_none() -> None:
    sample = mixed(0)
    joint = Marginals(sample.graph, sample.values).joint([x[40], l[-1]], frame="body")
    marginals = Marginals(sample.graph, sample.values, pairs=[(x[[40]], l[[-1]])])
    cross = marginals.cross(x[[40]], l[[-1]], frame="body")[0]
    np.testing.assert_allclose(cross, joint.block(x[40], l[-1]), atol=1e-12)
    every = Marginals(sample.graph, sample.values).all(x, frame="body")
    np.testing.assert_allclose(marginals.all(x, frame="body"), every, rtol=1e-9)


def test_a_pair_counts_once_and_none_is_of_one_variable() -> None:
    assert paired([(x[[3, 5]], x[[3, 5]]), (x[[]], l[[]])]) == []
    (pair,) = paired([(x[[3, 1, 3, 4]], x[[5, 2, 5, 4]])])
    assert pair.keys == (Keys("x", np.array([1, 3])), Keys("x", np.array([2, 5])))


def anchored(group: LieGroup, T: Array) -> Marginals:
    """Of a graph whose world has been moved by T: relative measurements as they are, priors and values moved."""
    sample = pose_graph(group, seed=4, anchored=False)
    X = group.compose(T, sample.values[x])
    Omega = informations(1, group.dim, np.random.default_rng(1))
    graph = FactorGraph([*sample.graph.factors, Prior(x[2], X[2], Information(Omega))])
    return Marginals(graph, Values({x: (group, X)}))


@pytest.mark.parametrize("group", [SE2, SE3, SO3], ids=str)
def test_a_moved_world(group: LieGroup) -> None:
    """Body covariances do not see it; world covariances turn with it, whatever the translation."""
    T = group.exp(np.linspace(0.7, -1.1, group.dim) * 2)
    here = anchored(group, group.identity()[0])
    there = anchored(group, T)
    np.testing.assert_allclose(there.all(x, "body"), here.all(x, "body"), rtol=0, atol=1e-12)
    G = group.world_axes(T)
    world = here.all(x, "world")
    np.testing.assert_allclose(there.all(x, "world"), G @ world @ G.T, rtol=0, atol=1e-12)
    assert np.abs(there.all(x, "world") - world).max() > 1e-3
    kept = [np.trace(m.all(x, "world"), axis1=1, axis2=2) for m in (here, there)]
    np.testing.assert_allclose(*kept, rtol=1e-9)  # lengths of the errors have no axes


def test_euler_view_against_differences() -> None:
    marginals = anchored(SE3, SE3.exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
    X, body = marginals.values[x], marginals.all(x, "body")
    step = 1e-6
    J = np.empty((len(X), 6, 6))
    for c, e in enumerate(np.eye(6) * step):
        there, back = (euler.from_se3(SE3.retract(X, np.tile(s * e, (len(X), 1)))) for s in (1, -1))
        J[:, :, c] = (there - back) / (2 * step)
    found = marginals.all(x, view="euler")
    np.testing.assert_allclose(found, J @ body @ J.mT, rtol=0, atol=1e-8 * np.abs(found).max())
    assert np.array_equal(found, found.mT)
    joint = marginals.joint(x[[1, 5]], view="euler")
    assert joint.names[:6] == ("x1: roll", "x1: pitch", "x1: yaw", "x1: x", "x1: y", "x1: z")
    np.testing.assert_allclose(joint.block(x[5], x[5]), found[5], rtol=1e-9, atol=1e-14)
    raw = marginals.joint(x[[1, 5]], frame="body").block(x[1], x[5])
    np.testing.assert_allclose(joint.block(x[1], x[5]), J[1] @ raw @ J[5].T, rtol=0, atol=1e-8)


def test_gimbal_lock_names_the_pose() -> None:
    X = euler.to_se3([[0.1, 0.2, 0.3, 0, 0, 0], [0.1, np.pi / 2, 0.3, 1, 0, 0]])
    graph = FactorGraph([Prior(x[[4, 9]], X, Information(np.eye(6)))])
    marginals = Marginals(graph, Values({x: (SE3, X, [4, 9])}))
    for ask in (lambda: marginals.all(x, view="euler"), lambda: marginals.joint(x[[4, 9]], view="euler")):
        with pytest.raises(SingularGeometryError, match=r"x9 is at gimbal lock") as caught:
            ask()
        assert caught.value.keys == (x[[9]],)
    assert marginals.covariance(x[4], view="euler").shape == (6, 6)
    assert marginals.all(x, "world").shape == (2, 6, 6)


def test_joint_of_poses_and_points_in_the_world() -> None:
    sample = mixed(1)
    marginals = Marginals(sample.graph, sample.values)
    body, world = (marginals.joint([x[7], l[77]], frame=frame).matrix for frame in ("body", "world"))
    np.testing.assert_array_equal(marginals.joint(x[7], l[77], frame="world").matrix, world)
    G = np.eye(5)
    G[:3, :3] = SE2.world_axes(sample.values[x[7]])
    np.testing.assert_allclose(world, G @ body @ G.T, rtol=0, atol=1e-14)
    places = marginals.joint([x[7], l[77]], view="position")
    assert places.names == ("x7: x", "x7: y", "l77: x", "l77: y")
    np.testing.assert_allclose(places.matrix, world[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])], rtol=0, atol=1e-14)


def test_a_frame_is_asked_for_where_it_matters() -> None:
    sample = mixed(0)
    marginals = Marginals(sample.graph, sample.values)
    missing = 'frame="body" or frame="world": say along which axes the covariance of x in SE2 is'
    for ask in (lambda: marginals.covariance(x[40]), lambda: marginals.all(x), lambda: marginals.joint([l[5], x[40]])):
        with pytest.raises(OptionError, match=missing):
            ask()
    for frame in (None, "body", "world"):
        np.testing.assert_array_equal(marginals.covariance(l[5], frame), marginals.covariance(l[5]))
    for frame, view, words in (
        ("map", None, "frame: 'map' is not possible; expected 'body' or 'world'"),
        ("body", "position", "the view 'position' has the axes of the world"),
        (None, "quaternion", "view: 'quaternion' is not possible"),
        (None, "euler", r"view: 'euler' is not possible.*SE2 has no roll"),
    ):
        with pytest.raises(OptionError, match=words):
            marginals.covariance(x[40], frame, **({} if view is None else {"view": view}))
    circle = pose_graph(SO2)
    assert Marginals(circle.graph, circle.values).covariance(x[3]).shape == (1, 1)
    with pytest.raises(OptionError, match="kind 'x', in SO2, has no position"):
        Marginals(circle.graph, circle.values).covariance(x[3], view="position")
    vectors = pose_graph(R(3))
    found = Marginals(vectors.graph, vectors.values)
    np.testing.assert_array_equal(found.all(x, view="position"), found.all(x))
