"""In which axes a covariance is: body, world, position, Euler angles."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Information, Prior
from models import SE2, SE3, SO2, SO3, LieGroup, R, euler
from models.algebra import Array
from models.errors import OptionError, SingularGeometryError
from nls import FactorGraph, Marginals, Values
from tests.nls.graphs import informations, l, mixed, pose_graph, x


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
    raw = marginals.joint(x[[1, 5]], "body").block(x[1], x[5])
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
    body, world = (marginals.joint([x[7], l[77]], frame).matrix for frame in ("body", "world"))
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
