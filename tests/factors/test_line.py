"""Line: both normals of a wall, walls seen past their ends, where the sensor sits, starts, what is refused."""

from __future__ import annotations

from math import pi

import numpy as np
import numpy.typing as npt
import pytest

from factors import Between, Diagonal, Heading, Isotropic, Line, Prior, check_jacobians
from factors.keys import Keys
from models import LINE, SE2, R
from models.algebra import wrap
from models.errors import GraphError, UnderconstrainedError
from models.sensors import line_in_frame, normalized
from nls import FactorGraph, Marginals, Values, kinds
from nls.starts import incremental, locate_points
from tests.combinations import for_all
from tests.factors.evaluated import refused, same

Array = npt.NDArray[np.float64]
x, l, o = kinds("x", "l", "o")
NOISE = Diagonal(alpha=0.01, r=0.03)
WALLS = np.array([[0.0, 6.0], [pi / 2, 4.0], [-2.2, 3.0]])
MOUNT = np.array([0.4, -0.2, 2.5])


def drive(n: int = 25) -> Array:
    """Along y from (10, -3) to (10, 9): past the wall y = 4, whose extension is crossed, and outside of x = 6."""
    return np.column_stack([np.full(n, 10.0), np.linspace(-3, 9, n), np.linspace(1.4, 1.8, n)])


def sights(X: Array, O: Array | None = None) -> tuple[Keys, Keys, Array]:
    """Every wall from every pose, as a scanner reports it: r >= 0, whatever the normal of the wall."""
    i, k = (a.ravel() for a in np.indices((len(X), len(WALLS))))
    S = X[i] if O is None else SE2.compose(X[i], O)
    return x[i], l[k], normalized(line_in_frame(S, WALLS[k])[0])


def noisy(z: Array, seed: int) -> Array:
    return normalized(z + np.random.default_rng(seed).normal(0, [0.01, 0.03], z.shape))


def around(X: Array, seed: int, size: float = 0.1) -> Values:
    """Values near the truth, every second wall by its other normal."""
    rng = np.random.default_rng(seed)
    L = LINE.retract(WALLS, rng.normal(0, size, WALLS.shape))
    L[1::2] = np.column_stack([L[1::2, 0] + pi, -L[1::2, 1]])
    return Values({x: (SE2, SE2.retract(X, rng.normal(0, size, X.shape))), l: (LINE, L)})


def graph_of(X: Array, z: Array, pose: Keys, wall: Keys, walked: int | None = None) -> FactorGraph:
    """Odometry, exact unless seeded, and sightings."""
    step, sigmas, moved = np.arange(len(X) - 1), [0.02, 0.02, 0.01], SE2.between(X[:-1], X[1:])
    if walked is not None:
        moved = SE2.retract(moved, np.random.default_rng(walked).normal(0, sigmas, moved.shape))
    walk = Between(x[step], x[step + 1], moved, Diagonal(sigmas))
    return FactorGraph([Prior(x[0], X[0], Isotropic(1e-3)), walk, Line(pose, wall, z, NOISE)])


def test_the_sign_of_r_is_no_rule_where_an_extension_is_crossed() -> None:
    """The trap: near the crossing the sign of r' is that of the noise. By sign alone some sightings are 180 deg off."""
    X = drive(1001)
    pose, wall, exact = sights(X)
    h, _ = line_in_frame(X[pose.numbers], WALLS[wall.numbers])
    crossed = wall.numbers == 1
    assert h[crossed, 1].min() < -3 < 3 < h[crossed, 1].max()
    z = noisy(exact, 4)
    by_sign, by_angle = wrap(z[:, 0] - normalized(h)[:, 0]), LINE.local(h, z)
    assert (np.abs(by_sign) > 3).sum() >= 2
    assert (crossed & (np.abs(h[:, 1]) < 0.1))[np.abs(by_sign) > 3].all()
    assert np.abs(by_angle[:, 0]).max() < 0.05
    assert np.abs(by_angle[:, 1]).max() < 0.15


def test_the_residual_is_small_whichever_normal_was_measured() -> None:
    X = drive()
    pose, wall, z = sights(X)
    for seed, values in enumerate((Values({x: (SE2, X), l: (LINE, WALLS)}), around(X, 1, 0.0))):
        same(Line(pose, wall, z, NOISE).chi2(values), 0.0, atol=1e-20)
        flipped = z.copy()
        flipped[::3] = np.column_stack([z[::3, 0] + pi, -z[::3, 1]])
        same(Line(pose, wall, flipped, NOISE).chi2(values), 0.0, atol=1e-20)
        chi2 = [Line(pose, wall, noisy(z, 10 * s + seed), NOISE).chi2(values).sum() for s in range(20)]
        rows = 2 * len(z)
        assert abs(np.mean(chi2) - rows) < 4 * np.sqrt(2 * rows / 20)


def test_walls_seen_past_their_ends_are_solved() -> None:
    X = drive(1001)
    pose, wall, exact = sights(X)
    graph, start = graph_of(X, noisy(exact, 4), pose, wall, walked=1), around(X, 2)
    result = graph.optimize(start)
    assert result.converged
    assert result.chi2_final == pytest.approx(result.dof, abs=5 * np.sqrt(2 * result.dof))
    same(LINE.local(WALLS, result.values[l]), 0.0, atol=0.05)
    same(result.values[x][:, :2], X[:, :2], atol=0.1)
    assert check_jacobians(graph.factors[2], start) < 1e-6


def test_the_normal_of_the_start_does_not_matter() -> None:
    X = drive()
    pose, wall, z = sights(X)
    graph, start = graph_of(X, noisy(z, 4), pose, wall), around(X, 5)
    turned = start.replaced({l: np.column_stack([start[l][:, 0] + pi, -start[l][:, 1]])})
    one, two = graph.optimize(start), graph.optimize(turned)
    assert one.chi2_final == pytest.approx(two.chi2_final, rel=1e-9)
    same(LINE.local(one.values[l], two.values[l]), 0.0, atol=1e-7)
    assert np.abs(one.values[l][:, 1] + two.values[l][:, 1]).max() < 1e-6, "r has kept its sign in both"
    P, Q = (Marginals(graph, r.values).covariance(l[1]) for r in (one, two))
    same(np.abs(P), np.abs(Q), rtol=1e-6)
    assert P[0, 1] * Q[0, 1] < 0


@for_all(offset=["none", "fixed", "variable"])
def test_lines_start_where_they_were_seen_first(offset: str) -> None:
    X = drive()
    O = None if offset == "none" else MOUNT
    pose, wall, z = sights(X, O)
    values = Values({x: (SE2, X), l: (LINE, LINE.identity(3)), o: (SE2, MOUNT)})
    factor = Line(pose, wall, z, NOISE, o[0] if offset == "variable" else O)
    found = locate_points(FactorGraph([factor]), values)
    same(LINE.local(WALLS, found[l]), 0.0, atol=1e-12)
    assert (found[x] == X).all()


def test_the_incremental_start_places_lines() -> None:
    X = drive()
    pose, wall, z = sights(X)
    graph = graph_of(X, noisy(z, 6), pose, wall)
    start = Values({x: (SE2, np.tile(X[:1], (len(X), 1))), l: (LINE, LINE.identity(3))})
    found = incremental(graph, start, stage_size=5)
    same(LINE.local(WALLS, found[l]), 0.0, atol=0.1)
    same(found[x][:, :2], X[:, :2], atol=0.2)


def test_many_poses_for_one_measurement_as_particles_ask() -> None:
    """`predict` and the measurement space take any number of rows: h and H of 50 particles, one sighting."""
    X = drive(50)
    model, _ = Values({x: (SE2, X), l: (LINE, WALLS)}).gather(Line(x[0], l[1], [1.0, 2.0], NOISE))
    L = np.tile(WALLS[[1]], (50, 1))
    h, H = model.factor.predict(model.manifolds, X, L)
    z = normalized(line_in_frame(X, L)[0])
    assert H is not None
    assert [None if H_k is None else H_k.shape for H_k in H] == [(50, 2, 3), (50, 2, 2)]
    same(model.space.local(h, z), 0.0, atol=1e-13)
    assert (np.abs(h - z).max(axis=1) > 1).any(), "some were measured by the other normal"


def test_a_moved_world_changes_nothing_and_one_pose_is_held() -> None:
    X, G = drive(), np.array([3.0, -1.0, 2.4])
    pose, wall, z = sights(X)
    factor = Line(pose, wall, noisy(z, 7), NOISE)
    values = around(X, 8)
    # G l: alpha + theta, r + the way of G along the turned normal
    L = values[l] + [2.4, 0.0]
    L[:, 1] += 3.0 * np.cos(L[:, 0]) - np.sin(L[:, 0])
    moved = Values({x: (SE2, SE2.compose(G, values[x])), l: (LINE, L)})
    same(factor.chi2(moved), factor.chi2(values), rtol=1e-9)
    result = FactorGraph([factor, *graph_of(X, z, pose, wall).factors[1:2]]).optimize(values)
    assert result.converged
    assert "x0 held" in result.gauge


def test_parallel_walls_leave_the_way_along_them_free() -> None:
    graph = FactorGraph([Line(x[0], l[[0, 1]], [[0.0, 2.0], [0.0, -1.0]], NOISE), Heading(x[0], 0.0, Isotropic(0.1))])
    graph.add(Prior(l[[0, 1]], [[0.0, 2.0], [0.0, -1.0]], Isotropic(0.01)))
    values = Values({x: (SE2, [0.0, 0.0, 0.0]), l: (LINE, [[0.0, 2.0], [0.0, -1.0]])})
    with pytest.raises(UnderconstrainedError, match="x0"):
        graph.optimize(values, gauge="none")
    graph.add(Line(x[0], l[2], [pi / 2, 3.0], NOISE))
    graph.add(Prior(l[2], [-pi / 2, -3.0], Isotropic(0.01)))
    values = Values({x: (SE2, [0.0, 0.1, 0.0]), l: (LINE, [[0.0, 2.0], [0.0, -1.0], [1.5, 3.0]])})
    same(graph.optimize(values).values[x[0]], 0.0, atol=1e-6)


def test_what_does_not_fit() -> None:
    for pose, wall, z, offset, named in (
        (R(2), LINE, np.ones((2, 2)), None, r"Line: x0 is in R\(2\), .* SE2"),
        (SE2, R(2), np.ones((2, 2)), None, r"Line: l0 is in R\(2\), .* LINE"),
        (SE2, LINE, np.ones((2, 3)), None, r"LINE: .*\(2, 3\), expected \(n, 2\)"),
        (SE2, LINE, np.ones((2, 2)), [1.0, 2.0], "offset: SE2"),
    ):
        values = Values({x: (pose, pose.identity(2)), l: (wall, wall.identity())})
        factor = Line(x[[0, 1]], l[0], z, NOISE, offset)
        refused(lambda values=values, factor=factor: values.gather(factor), GraphError, named)
