"""Dead reckoning from XYH and ZPR, landmarks on the arc of their first contact, the search along it."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest

import factors as f
from factors import XYH, ZPR, Between, Cauchy, Diagonal, Elevation, ElevationHinge, Factor, Isotropic, RangeAzimuth
from factors.base import Jacobians, Model
from factors.keys import Keys
from models import SE2, SE3, Manifold, Measured, R, euler
from models.algebra import Array, Index
from models.errors import GraphError, OptionError, SingularGeometryError
from models.sensors import DIDSON_HIGH, cartesian, levelled, spherical, zpr
from nls import FactorGraph, Values, initialize, kinds
from nls.starts import chain, dead_reckoning, first_sighting, incremental, search_elevation, spanning_tree
from tests.nls.graphs import forgotten

same = np.testing.assert_allclose
x, y, l, m = kinds("x", "y", "l", "m")
UNIT = Isotropic()
LEVEL = np.deg2rad([0.0, -35.0, 0.0])
MOUNT = euler.to_se3([*LEVEL, 0.3, 0.0, 0.1])  # ahead, below, looking 35 deg down
PLANE, DOWN = [3, 4, 2], [5, 1, 0]  # x, y, yaw and z, pitch, roll of an Euler vector


def path(n: int, seed: int = 0) -> Array:
    """Euler vectors of a tilted, turning vehicle whose heading passes +-180 deg."""
    rng = np.random.default_rng(seed)
    yaw = 0.6 * np.arange(n)
    heading = (yaw + np.pi) % (2 * np.pi) - np.pi
    return np.stack([*rng.normal(scale=0.2, size=(2, n)), heading, *np.cumsum(rng.normal(size=(3, n)), axis=1)], axis=1)


class Log(XYH):
    """A log from outside: centimeters to port and ahead, and the turn."""

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return Measured("port", "ahead", "turn")

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        h, (H_i, H_j) = levelled(*X)
        T = np.array([[0, -100.0, 0], [100.0, 0, 0], [0, 0, 1.0]])
        return h @ T.T, (T @ H_i, T @ H_j)

    def level_steps(self, model: Model) -> Array:
        return np.column_stack([model.z[:, 1] / 100, -model.z[:, 0] / 100, model.z[:, 2]])


class Gravity(ZPR):
    """Tilt and pressure, bar, from outside."""

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return Measured("pitch", "roll", "bar")

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        h, H = zpr(X[0])
        T = np.array([[0, 1.0, 0], [0, 0, 1.0], [0.1, 0, 0]])
        return h @ T.T, (T @ H,)

    def tilts(self, model: Model) -> Array:
        return model.z[:, [2, 0, 1]] * [10.0, 1, 1]


def navigation(e: Array, numbers: Index, kind: str = "x") -> list[Factor]:
    """Exact steps, the second half backwards, in no order; exact tilts."""
    n = len(e)
    i, j = np.arange(n - 1), np.arange(1, n)
    i[n // 2 :], j[n // 2 :] = j[n // 2 :].copy(), i[n // 2 :].copy()
    mixed = np.random.default_rng(7).permutation(n - 1)
    step = SE2.between(e[i][:, PLANE], e[j][:, PLANE])[mixed]
    odometry = XYH(Keys(kind, numbers[i[mixed]]), Keys(kind, numbers[j[mixed]]), step, UNIT)
    return [odometry, ZPR(Keys(kind, numbers), e[:, DOWN], UNIT)]


def lost(values: Values, *known: Keys) -> Values:
    """All poses at the identity but the known ones."""
    out = values.replaced({k: SE3.identity(len(s)) for k, s in values.stacks.items() if s.manifold is SE3})
    for key in known:
        out[key] = values[key]
    return out


def same_poses(found: Array, expected: Array) -> None:
    same(SE3.local(np.atleast_2d(expected), np.atleast_2d(found)), 0.0, atol=1e-11)


def test_exact_navigation_gives_the_path() -> None:
    """Of sensors from outside, too; an array of another shape is refused."""
    e, numbers = path(20), 3 * np.arange(20) - 5
    truth = Values({x: (SE3, euler.to_se3(e), numbers)})
    steps, tilts = navigation(e, numbers)
    log = Log(*steps.keys, np.column_stack([-100 * steps.z[:, 1], 100 * steps.z[:, 0], steps.z[:, 2]]), UNIT)
    gravity = Gravity(*tilts.keys, tilts.z[:, [1, 2, 0]] / [1, 1, 10.0], UNIT)
    for factors in ([steps, tilts], [log, gravity]):
        same_poses(dead_reckoning(FactorGraph(factors), lost(truth, x[-5]))[x], truth[x])
    grown = incremental(FactorGraph([log, gravity]), lost(truth, x[-5]), stage_size=10)
    same(SE3.local(truth[x], grown[x]), 0.0, atol=1e-6)
    gravity.tilts = lambda model: model.z[0]  # type: ignore[method-assign]
    with pytest.raises(GraphError, match=r"Gravity.*tilts returned an array of shape \(3,\), expected \(20, 3\)"):
        dead_reckoning(FactorGraph([log, gravity]), truth)


def test_fixed_poses_stay_and_parts_have_their_own_beginning() -> None:
    """x5 is fixed, wherever it is, and the path hangs on it; y has nothing fixed and begins at its first pose.

    Beside the steps of x, y may be chained by relative poses.
    """
    e, f, numbers = path(9), path(6, seed=1), np.arange(9)
    truth = Values({x: (SE3, euler.to_se3(e)), y: (SE3, euler.to_se3(f))})
    graph = FactorGraph([*navigation(e, numbers), *navigation(f, numbers[:6], "y")])
    graph.add(ZPR(x[5], [9.0, 0.5, 0.5], UNIT))  # wrong, and nothing to a pose that is fixed
    graph.fix(x[5])
    start = lost(truth, x[5], y[0])
    found = dead_reckoning(graph, start)
    same_poses(found[x], truth[x])
    same_poses(found[y], truth[y])
    assert np.array_equal(found[x[5]], start[x[5]])
    chained = Between(y[0:5], y[1:6], SE3.between(truth[y][:-1], truth[y][1:]), UNIT)
    values, _, _ = initialize(FactorGraph([*navigation(e, numbers), chained], [x[5]]), start, "odometry")
    same_poses(values[x], truth[x])
    same_poses(values[y], truth[y])


def test_what_is_not_measured_is_kept() -> None:
    """Without ZPR the depth and tilt given; without XYH everything, bit for bit; points anyway."""
    e = path(5)
    truth = Values({x: (SE3, euler.to_se3(e)), l: (R(3), [[1.0, 2.0, 3.0]])})
    odometry = XYH(x[[0, 1]], x[[1, 2]], SE2.between(e[:2][:, PLANE], e[1:3][:, PLANE]), UNIT)
    graph = FactorGraph([odometry, ZPR(x[[0, 2, 3]], e[[0, 2, 3]][:, DOWN], UNIT)])
    start = truth.copy()
    other = e.copy()
    other[1:, PLANE] = 0.0
    other[[0, 2], 5] = 99.0
    start[x[0:5]] = euler.to_se3(other)
    found = dead_reckoning(graph, start)
    same_poses(found[x[0:3]], truth[x[0:3]])
    assert np.array_equal(found[x[3:5]], start[x[3:5]])
    assert np.array_equal(found[l], truth[l])
    alone = FactorGraph([ZPR(x[0], [1, 0, 0], UNIT)])
    assert dead_reckoning(alone, start) is start


def test_empty_batches_are_no_steps() -> None:
    """Alone, and beside others: of XYH, Between, ZPR and contacts."""
    e = path(3)
    truth = Values({x: (SE3, euler.to_se3(e)), l: (R(3), [[1.0, 2.0, 3.0]])})
    none, nothing = x[[]], np.zeros((0, 3))
    empty = [XYH(none, none, nothing, UNIT), Between(none, none, np.zeros((0, 7)), UNIT)]
    empty += [ZPR(none, nothing, UNIT), RangeAzimuth(none, l[[]], np.zeros((0, 2)), UNIT)]
    for factor in empty:
        for start in (dead_reckoning, chain, spanning_tree, first_sighting, search_elevation):
            found = start(FactorGraph([factor]), truth)
            assert np.array_equal(found[x], truth[x])
    start = lost(truth, x[0])
    linked = Between(x[[0, 1]], x[[1, 2]], SE3.between(truth[x][:-1], truth[x][1:]), UNIT)
    for measured in (navigation(e, np.arange(3)), [linked]):
        graph = FactorGraph([*empty, *measured, *empty])
        same_poses(initialize(graph, start, "odometry")[0][x], truth[x])
        assert initialize(graph, start)[1] == initialize(FactorGraph(measured), start)[1]


def test_a_kept_pose_at_gimbal_lock_is_named() -> None:
    """But one that is measured may be anything before."""
    e = path(3)
    X = euler.to_se3(e)
    X[1] = euler.to_se3([0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0])
    values = Values({x: (SE3, X, [4, 5, 6])})
    measured = navigation(e, np.array([4, 5, 6]))
    same_poses(dead_reckoning(FactorGraph(measured), values)[x[6]], X[2])
    with pytest.raises(SingularGeometryError, match=r"dead reckoning from x5: the pose is at gimbal lock") as caught:
        dead_reckoning(FactorGraph(measured[:1]), values)
    assert caught.value.keys == (x[5],)
    fixed = FactorGraph(navigation(e, np.array([4, 5, 6])))
    fixed.fix(x[9])  # which no step touches
    beside = Values({x: (SE3, np.concatenate([euler.to_se3(e), X[[1]]]), [4, 5, 6, 9])})
    found = dead_reckoning(fixed, beside)
    same_poses(found[x[[4, 5, 6]]], euler.to_se3(e))
    assert np.array_equal(found[x[9]], X[1])


def dive(n: int = 12, k: int = 60, seed: int = 0) -> tuple[Values, Array, Array, Array]:
    """A vehicle that flies a curve over a floor and looks down at 35 deg: truth, contacts (i, k) and (r, az, el)."""
    rng = np.random.default_rng(seed)
    t = np.arange(n)
    tilt, way = [0.04 * np.sin(t), 0.03 * np.cos(t)], [0.15 * t, 0.1 * np.sin(t), 0.1 * np.sin(0.7 * t)]
    e = np.stack([*tilt, 0.05 * t, *way], axis=1)
    X, L = euler.to_se3(e), rng.uniform([1.5, -1.5, 2.0], [5.0, 2.0, 2.8], size=(k, 3))
    S = SE3.compose(X, MOUNT)
    z = np.array([spherical(SE3.act(SE3.inverse(s[None]), L))[0] for s in S])
    seen = np.array([DIDSON_HIGH.sees(cartesian(each)[0]) for each in z])
    often = seen.sum(axis=0) >= 3
    i, k_of = np.nonzero(seen[:, often])
    return Values({x: (SE3, X), l: (R(3), L[often])}), i, k_of, z[:, often][i, k_of]


def contacts(i: Array, k: Array, z: Array, **more: object) -> list[Factor]:
    return f.sonar_factors(x[i], l[k], z[:, :2], Diagonal(range=0.01, azimuth=0.005), DIDSON_HIGH, MOUNT, **more)  # type: ignore[arg-type]


def first_of(i: Array, k: Array) -> Array:
    """Place of the contact of the lowest pose number of each landmark, one by one."""
    return np.array([min(np.flatnonzero(k == each), key=lambda place: i[place]) for each in range(k.max() + 1)])


def test_landmarks_at_the_elevation_of_their_first_contact() -> None:
    truth, i, k, z = dive()
    mixed = np.random.default_rng(1).permutation(len(i))
    graph = FactorGraph([f for part in np.array_split(mixed, 3) for f in contacts(i[part], k[part], z[part])])
    found = first_sighting(graph, forgotten(truth))
    first = first_of(i, k)
    flat = cartesian(z[first] * [1, 1, 0])[0]
    same(found[l], SE3.act(SE3.compose(truth[x], MOUNT)[i[first]], flat), atol=1e-12)
    below = first_sighting(graph, forgotten(truth), elevation=0.1)
    height = SE3.act(SE3.inverse(SE3.compose(truth[x], MOUNT)[i[first]]), below[l])
    same(spherical(height)[0], np.column_stack([z[first, :2], np.full(len(first), 0.1)]), atol=1e-12)


def test_the_search_finds_exact_elevations() -> None:
    """To what a parabola over a step of half a degree leaves, and FLAT allows: mostly 0.1 deg of 7."""
    truth, i, k, z = dive()
    (given,) = contacts(i, k, z, elevation="free")
    values = forgotten(truth)
    found = search_elevation(FactorGraph([given]), values, limit=radians(7))
    with_place = values.copy()
    with_place.add(y, SE3, MOUNT)
    variable = RangeAzimuth(x[i], l[k], z[:, :2], given.noise, offset=y[0])
    same(search_elevation(FactorGraph([variable]), with_place, limit=radians(7))[l], found[l], atol=1e-12)
    first = first_of(i, k)
    S = SE3.compose(truth[x], MOUNT)[i[first]]
    h, _ = spherical(SE3.act(SE3.inverse(S), found[l]))
    same(h[:, :2], z[first, :2], atol=1e-12)
    off = np.rad2deg(np.abs(h[:, 2] - z[first, 2]))
    zero = np.rad2deg(np.abs(z[first, 2]))
    assert zero.mean() > 3.0
    assert np.median(off) < 0.1
    assert off.mean() < 0.15 * zero.mean()


def test_motion_in_the_plane_gives_one_of_the_two_and_not_their_mean() -> None:
    """A level sonar, surge, sway and yaw: +el and -el fit, 0 does not, and a solve from 0 stays there."""
    el = np.array([0.1, -0.1, 0.06, 0.0])
    e = np.array([[0, 0, 0.2 * t, 0.5 * t, 0.3 * t, 2.0] for t in range(4)])
    X = euler.to_se3(e)
    L = SE3.act(X[:1], cartesian(np.column_stack([[3.0, 4.0, 3.5, 3.0], [0.1, 0.0, -0.1, 0.0], el]))[0])
    z = np.array([spherical(SE3.act(SE3.inverse(s[None]), L))[0] for s in X])
    i, k = (a.ravel() for a in np.meshgrid(np.arange(4), np.arange(4), indexing="ij"))
    graph = FactorGraph([RangeAzimuth(x[i], l[k], z[i, k, :2], Diagonal(range=1e-3, azimuth=1e-3))])
    graph.fix(x[0:4])
    values = Values({x: (SE3, X), l: (R(3), L)})
    found = search_elevation(graph, forgotten(values), limit=0.12)
    h = spherical(SE3.act(SE3.inverse(X[:1]), found[l]))[0][:, 2]
    same(np.abs(h[:3]), np.abs(el[:3]), atol=2e-3)
    assert h[3] == 0.0
    graph.remove(graph.factors[0])
    graph.add(RangeAzimuth(x[i[k < 3]], l[k[k < 3]], z[i[k < 3], k[k < 3], :2], Isotropic(1e-3)))
    graph.fix(l[3])
    assert graph.optimize(found).chi2_final < 1e-9


def test_where_nothing_tells_the_elevation_is_zero() -> None:
    """One view; and turns on the spot, however many."""
    turning = euler.to_se3([[0, 0, 0.05 * t, 0, 0, 0] for t in range(5)])
    X = np.concatenate([turning, euler.to_se3([[0.1, 0.2, 0.3, 1.0, 2.0, 3.0]])])
    p = cartesian(np.array([[3.0, 0.0, 0.1]]))[0]
    z = np.array([spherical(SE3.act(SE3.inverse(s[None]), p))[0][0] for s in turning])
    graph = FactorGraph([RangeAzimuth(x[0:5], l[0], z[:, :2], Isotropic(1e-3)), RangeAzimuth(x[5], l[1], [2, 0], UNIT)])
    values = Values({x: (SE3, X), l: (R(3), np.ones((2, 3)))})
    found, flat = search_elevation(graph, values), first_sighting(graph, values)
    assert np.array_equal(found[l], flat[l])


def test_hinges_other_sightings_and_kernels_take_part() -> None:
    """The limit is that of the widest hinge; a known elevation decides; a wild contact under a kernel does not."""
    truth, i, k, z = dive()
    first = first_of(i, k)
    free = contacts(i, k, z, elevation="free")[0]

    def found(*factors: Factor, **more: float) -> Array:
        S = SE3.compose(truth[x], MOUNT)[i[first]]
        X = search_elevation(FactorGraph(factors), forgotten(truth), **more)[l]
        return spherical(SE3.act(SE3.inverse(S), X))[0][:, 2]

    narrow = ElevationHinge(x[i[first]], l[k[first]], radians(2), offset=MOUNT)
    assert np.abs(found(free, narrow)).max() <= radians(2) + 1e-12
    wide = ElevationHinge(x[i], l[k], radians(6), softness=9.0, offset=MOUNT)
    assert radians(5) < np.abs(found(free, wide)).max() <= radians(6) + 1e-12
    assert radians(4) < np.abs(found(free, narrow, wide, limit=radians(5))).max() <= radians(5) + 1e-12
    soft = ElevationHinge(x[i[first]], l[k[first]], radians(2), softness=9.0, offset=MOUNT)
    for hinges in ((soft, wide), (wide, soft)):
        assert np.abs(found(free, *hinges)).max() > radians(5)
    assert np.abs(found(free)).max() > radians(6)
    known = Elevation(x[i[first]], l[k[first]], 0.03, Isotropic(1e-5), MOUNT)
    same(found(free, known), 0.03, atol=1e-3)
    wild = z.copy()
    last = np.array([np.flatnonzero(k == each)[-1] for each in range(k.max() + 1)])
    wild[last, 0] += 0.4
    spoiled = RangeAzimuth(x[i], l[k], wild[:, :2], free.noise, MOUNT)
    off = [np.abs(found(f) - z[first, 2]).mean() for f in (free, spoiled, spoiled.robust(Cauchy(1.0)))]
    assert off[2] < 0.5 * off[1]
    assert off[0] < 0.5 * off[1]


def test_fixed_landmarks_and_other_variables_stay() -> None:
    truth, i, k, z = dive()
    graph = FactorGraph(contacts(i, k, z))
    graph.fix(l[3])
    values = forgotten(truth)
    values.add(m, R(3), [[7.0, 8.0, 9.0]])
    for found in (first_sighting(graph, values), search_elevation(graph, values)):
        assert np.array_equal(found[l[3]], values[l[3]])
        assert np.array_equal(found[m], values[m])
        assert (found[l[4]] != values[l[4]]).any()
    assert search_elevation(FactorGraph([graph.factors[1]]), values)[l].tolist() == values[l].tolist()


def test_bad_options_are_refused_by_name() -> None:
    empty = FactorGraph()
    for bad in (np.nan, 4.0, -np.pi / 2, "a", None, np.array([0.1, 0.2])):
        with pytest.raises(OptionError, match="first_sighting: elevation"):
            first_sighting(empty, Values(), elevation=bad)  # type: ignore[arg-type]
    assert search_elevation(empty, Values(), limit=1.57).stacks == {}
    for name, wrong in (("limit", (7.0, 1.58, "a")), ("steps", (0, 1.5, True))):
        for value in wrong:
            with pytest.raises(OptionError, match=f"search_elevation: {name}: {value!r}"):
                search_elevation(empty, Values(), **{name: value})  # type: ignore[arg-type]


def test_the_method_odometry_reckons_and_searches() -> None:
    """From nothing but the first pose; auto comes as near as that. The solve ends at the truth."""
    truth, i, k, z = dive()
    e = euler.from_se3(truth[x])
    here = f.Position(x[0], truth[x[0]][:2], Isotropic(1e-3), components=("x", "y"))
    north = f.Heading(x[0], e[0, 2], Isotropic(1e-4))
    graph = FactorGraph([*navigation(e, np.arange(len(e))), here, north, *contacts(i, k, z)])
    nothing = lost(forgotten(truth), x[0])
    expected = search_elevation(graph, dead_reckoning(graph, nothing))
    values, name, chi2 = initialize(graph, nothing, "odometry")
    assert (name, chi2) == ("odometry", {"odometry": graph.chi2(expected)})
    assert np.array_equal(values[x], expected[x])
    assert np.array_equal(values[l], expected[l])
    assert min(initialize(graph, nothing)[2].values()) < 1.0  # without noise, in 400 numbers
    same_poses(expected[x], truth[x])
    result = graph.optimize(values)
    assert result.converged
    same(result.values[l], truth[l], atol=1e-4)
