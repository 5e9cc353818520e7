"""Starts of a camera and a sonar: exact for exact measurements, near enough for noisy ones, refused by name."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from factors import Diagonal, Factor, Information, Isotropic, Projection, RangeAzimuth
from factors.keys import Keys
from models import SE3, SO3, R
from models.algebra import Array
from models.sensors import Camera, range_azimuth
from nls import FactorGraph, GaussNewton, GraphError, SingularGeometryError, UnderconstrainedError, Values, kinds
from nls.starts.mounting import axes_from_azimuths
from nls.starts.rig import rig
from sim import Rig
from sim import rig as world

x, l, s, c, y, m = kinds("x", "l", "s", "c", "y", "m")
CAMERA = Camera(focal=(600.0, 600.0), center=(640.0, 480.0))
NOISE = Isotropic(1.0), Diagonal(range=0.01, azimuth=0.02)
LOOKING_AHEAD = [-0.5, -0.5, -0.5, 0.5]  # of a sonar on a camera
IDS = np.array([40, 7, 8, -3, 1000, 12, 9])  # of poses, the first of them at the start of the flight


def truth(seed: int = 0, points: int = 40) -> Values:
    """Poses around points, a sonar beside the camera, the camera somewhere on the vehicle."""
    rng, n = np.random.default_rng(seed), len(IDS)
    L = rng.uniform([-3, -2, 5], [3, 2, 9], (points, 3))
    X = SE3.exp(np.column_stack([rng.uniform(-1, 1, (n, 3)), rng.uniform(-0.2, 0.2, (n, 3))]))
    sonar = SE3.compose([0.1, 0.3, -0.1, *LOOKING_AHEAD], SE3.exp(0.2 * rng.normal(size=(1, 6))))
    camera = SE3.exp([[0.4, -0.2, 0.1, 0.3, -0.2, 1.0]])
    return Values({x: (SE3, X, IDS), l: (R(3), L, 3 * np.arange(points)), s: (SE3, sonar), c: (SE3, camera)})


def views(values: Values) -> tuple[Keys, Keys]:
    """Every point from every pose, by point."""
    X, L = values.stack("x").numbers, values.stack("l").numbers
    return Keys("x", np.tile(X, len(L))), Keys("l", np.repeat(L, len(X)))


def seen(values: Values, i: Keys, j: Keys, on: Array | None = None, off: Array | None = None) -> list[Factor]:
    """Exact pixels and contacts, camera at `on` and sonar at `off`; where None, no offset and the variable s0."""
    C = SE3.identity() if on is None else on
    O = values[s] if off is None else off
    p = SE3.act(SE3.inverse(SE3.compose(values[i], C)), values[j])
    q = SE3.act(SE3.inverse(SE3.compose(values[i], O)), values[j])
    pixels = Projection(i, j, CAMERA.project(p)[0], NOISE[0], CAMERA, on)
    return [pixels, RangeAzimuth(i, j, range_azimuth(q)[0], NOISE[1], s[0] if off is None else off)]


def forgotten(values: Values, *kept: int) -> Values:
    """Nothing known but some poses and where the sensors are."""
    known = np.isin(values.stack("x").numbers, kept)
    X = np.where(known[:, None], values.stack("x").X, [9.0, 9, 9, 0, 0, 0, 1])
    return values.replaced({x: X, l: np.full(values.stack("l").X.shape, 0.5)})


def off(found: Values, expected: Values, *names: str) -> float:
    """Largest difference, m and rad."""
    stacks = ((expected.stack(name), found.stack(name)) for name in names or expected.stacks)
    return max(float(np.abs(a.manifold.local(a.X, b.X)).max()) for a, b in stacks)


@pytest.mark.parametrize("three_points", [False, True])
@pytest.mark.parametrize("mounted", ["sonar variable", "both fixed"])
def test_exact_measurements_give_the_truth(three_points: bool, mounted: str) -> None:
    expected = truth()
    i, j = views(expected)
    on, sonar = (None, None) if mounted == "sonar variable" else (expected[c], SE3.compose(expected[c], expected[s]))
    graph = FactorGraph(seen(expected, i, j, on, sonar))
    graph.fix(x[40])
    found = rig(graph, forgotten(expected, 40), three_points=three_points)
    assert off(found, expected) < 1e-9


def test_a_camera_that_is_a_variable_is_taken_where_it_is() -> None:
    """Also when it is the sonar's place that is asked for: moved together with all poses nobody would notice."""
    expected = truth()
    expected[s[0]] = SE3.compose(expected[c[0]], expected[s[0]])
    i, j = views(expected)
    pixels, contacts = seen(expected, i, j, expected[c], expected[s])
    graph = FactorGraph([Projection(i, j, pixels.z, NOISE[0], CAMERA, c[0]), contacts])
    graph.fix(x[40])
    assert off(rig(graph, forgotten(expected, 40)), expected) < 1e-9
    graph = FactorGraph([graph.factors[0], RangeAzimuth(i, j, contacts.z, NOISE[1], s[0])])
    graph.fix(x[40])
    found = rig(graph, forgotten(expected, 40), calibrate=True)
    assert np.array_equal(found[c], expected[c])
    assert off(found, expected) < 1e-3


def test_what_is_known_better_counts_more() -> None:
    """Every third range of the later views is 0.3 m too long, and its sigma is a meter."""
    expected = truth()
    i, j = views(expected)
    pixels, contacts = seen(expected, i, j)
    poor = (i.numbers != 40) & (j.numbers % 9 == 0)
    sigma = np.where(poor, 1.0, 0.01)
    z = contacts.z + np.column_stack([0.3 * poor, np.zeros(len(i))])
    graph = FactorGraph(
        [pixels, RangeAzimuth(i, j, z, Diagonal(np.column_stack([sigma, np.full(len(i), 0.02)])), s[0])]
    )
    graph.fix(x[40])
    found = rig(graph, forgotten(expected, 40))
    assert off(found, expected, "x") < 1e-3  # 0.1 with equal weights
    assert off(found, expected, "l") < 1e-9


def test_batches_orders_and_duplicates_do_not_matter() -> None:
    expected, rng = truth(), np.random.default_rng(1)
    i, j = views(expected)
    pixels, contacts = seen(expected, i, j)
    a, b = rng.permutation(len(i)), rng.permutation(len(i))
    graph = FactorGraph([contacts[b[:90]], pixels[a[100:]], pixels[a[:120]], contacts[b[80:]]])
    graph.fix(x[40])
    assert off(rig(graph, forgotten(expected, 40)), expected) < 1e-9


def test_who_comes_first() -> None:
    """Fixed poses, else fixed points, else the pose of lowest number; and what is fixed stays."""
    expected = truth()
    factors = seen(expected, *views(expected))
    graph = FactorGraph(factors)
    assert off(rig(graph, forgotten(expected, -3)), expected) < 1e-9
    graph.fix(x[12])
    assert off(rig(graph, forgotten(expected, 12)), expected) < 1e-9
    graph = FactorGraph(factors)
    graph.fix(l[[0, 3, 9, 12]])
    known = forgotten(expected)
    known[l[[0, 3, 9, 12]]] = expected[l[[0, 3, 9, 12]]]
    assert off(rig(graph, known), expected) < 1e-9
    graph.fix(x[[7, 9]])
    known[x[[7, 9]]] = expected[x[[9, 7]]]  # wrong, but fixed
    found = rig(graph, known)
    assert np.array_equal(found[x[[7, 9]]], expected[x[[9, 7]]])
    assert np.array_equal(found[l[[0, 3, 9, 12]]], expected[l[[0, 3, 9, 12]]])


def test_poses_are_placed_in_the_order_of_what_they_share() -> None:
    """A chain in which each pose shares five points with the next alone, under numbers that jump about."""
    expected = truth(points=40)
    order = IDS[[0, 4, 2, 6, 1, 5, 3]]
    i = np.concatenate([np.full(10, number) for number in order])
    j = np.concatenate([3 * np.arange(5 * k, 5 * k + 10) for k in range(7)])
    graph = FactorGraph(seen(expected, Keys("x", i), Keys("l", j)))
    graph.fix(x[40])
    assert off(rig(graph, forgotten(expected, 40)), expected) < 1e-8


def test_points_of_one_sensor_alone() -> None:
    """Rays of the camera meet; a contact of the sonar leaves its point where it was; so does a ray."""
    expected = truth()
    i, j = views(expected)
    pixels, contacts = seen(expected, i, j)
    unheard = np.isin(j.numbers, [0, 3, 6, 9])
    unseen, once = j.numbers == 12, (j.numbers == 15) & (i.numbers != 7)
    graph = FactorGraph([pixels[~unseen & ~once], contacts[~unheard & (j.numbers != 15)]])
    graph.fix(x[40])
    start = forgotten(expected, 40)
    found = rig(graph, start)
    kept = found[l[[12, 15]]]
    assert np.array_equal(kept, start[l[[12, 15]]])
    found[l[[12, 15]]] = expected[l[[12, 15]]]
    assert off(found, expected) < 1e-9


def test_azimuth_decides_between_two_points_on_a_ray() -> None:
    """A sonar 6 m ahead of the camera, turned: rays come into its spheres and go out."""
    expected = truth()
    expected[s[0]] = SE3.compose([0.2, 0.1, 6.5, *LOOKING_AHEAD], SE3.exp([0, 0, 0, 0, 0, 1.5]))
    graph = FactorGraph(seen(expected, *views(expected)))
    graph.fix(x[40])
    found = rig(graph, forgotten(expected, 40))
    assert off(found, expected) < 1e-8


def test_pairs_that_meet_nowhere_or_say_nothing_are_passed_over() -> None:
    expected = truth()
    expected[s[0]] = SE3.compose([0.2, 0.1, 2.5, *LOOKING_AHEAD], SE3.exp([0.0, 0, 0, 0, 0, 0.1]))
    i, j = views(expected)
    pixels, contacts = seen(expected, i, j)
    z, information = contacts.z.copy(), np.tile(np.diag([1e4, 2e3]), (len(i), 1, 1))
    z[::5, 0], z[1::5, 0] = 0.01, 3.0
    information[1::5, 0, 0] = 0.0
    graph = FactorGraph([pixels, RangeAzimuth(i, j, z, Information(information), s[0])])
    graph.fix(x[40])
    assert off(rig(graph, forgotten(expected, 40)), expected) < 1e-9


@cache
def simulated(seed: int) -> Rig:
    """20 poses of 200 points."""
    return world(np.random.default_rng(seed), points=200)


@pytest.mark.parametrize("seed", [1, 2])
def test_every_start_leads_to_the_same_optimum(seed: int) -> None:
    scene = simulated(seed)
    graph, given = scene.graph, scene.start
    wrong, unknown = given.copy(), given.copy()
    turn = np.random.default_rng(seed).normal(size=3)
    wrong[s[0]] = np.append(given[s[0]][:3], SO3.retract(given[s[0]][3:], np.pi / 2 * turn / np.linalg.norm(turn)))
    unknown[s[0]] = [50.0, 0, 0, 1, 0, 0, 0]
    starts = {
        "guess": rig(graph, given),
        "three points": rig(graph, given, three_points=True),
        "90 degrees": rig(graph, wrong),
        "nothing": rig(graph, unknown, calibrate=True),
    }
    before = scene.errors(starts["guess"])
    assert 0.015 < before.poses < 0.05
    assert 0.05 < before.points < 0.075
    assert before.poses < scene.errors(starts["three points"]).poses < 0.3
    blind = scene.errors(starts["nothing"])
    assert blind.extrinsic_m < 0.03
    assert blind.extrinsic_rad < np.radians(3)
    results = {name: graph.optimize(start, GaussNewton()) for name, start in starts.items()}
    for name, result in results.items():
        assert result.converged, name
        assert result.iterations <= 12, name
        assert result.chi2_final == pytest.approx(results["guess"].chi2_final, rel=1e-6), name
    assert results["nothing"].iterations <= results["guess"].iterations


def test_from_nothing_is_exact_without_noise() -> None:
    scene = world(np.random.default_rng(3), poses=8, points=60, noise_scale=0.0)
    start = scene.start.copy()
    start[s[0]] = [1.0, 2, 3, 0.5, 0.5, -0.5, 0.5]
    assert off(rig(scene.graph, start, calibrate=True), scene.truth) < 1e-3
    assert start[s[0]][0] == 1.0


def test_two_sonars_from_nothing_with_the_camera_on_a_vehicle() -> None:
    expected = truth(points=60)
    second = SE3.compose([0.0, -0.4, 0.2, *LOOKING_AHEAD], SE3.exp([0, 0, 0, 0.3, 0.2, -0.4]))
    sonars = SE3.compose(expected[c], np.stack([expected[s[0]], second]))
    i, j = views(expected)
    k = np.arange(len(i)) % 2
    q = SE3.act(SE3.inverse(SE3.compose(expected[i], sonars[k])), expected[j])
    contacts = RangeAzimuth(i, j, range_azimuth(q)[0], NOISE[1], Keys("s", k))
    graph = FactorGraph([seen(expected, i, j, expected[c])[0], contacts])
    graph.fix(x[40])
    X, L = (expected.stack(kind) for kind in "xl")
    whole = Values({x: (SE3, X.X, IDS), l: (R(3), L.X, L.numbers), s: (SE3, sonars)})
    start = forgotten(whole, 40)
    start[s] = SE3.identity(2)
    assert off(rig(graph, start, calibrate=True), whole) < 1e-3


def test_camera_and_sonar_mounted_by_variables_of_one_kind() -> None:
    """The camera is held where it is meanwhile, and not the sonar with it."""
    expected = truth(points=60)
    camera, sonar = expected[c], SE3.compose(expected[c], expected[s])
    i, j = views(expected)
    pixels, contacts = seen(expected, i, j, camera, sonar)
    graph = FactorGraph([pixels.mounted(s[1]), contacts.mounted(s[0])])  # type: ignore[attr-defined]
    graph.fix(x[40])
    X, L = (expected.stack(kind) for kind in "xl")
    both = np.concatenate([sonar, camera])
    whole = Values({x: (SE3, X.X, IDS), l: (R(3), L.X, L.numbers), s: (SE3, both)})
    start = forgotten(whole, 40)
    start[s[0]] = SE3.identity()[0]
    found = rig(graph, start, calibrate=True)
    assert np.array_equal(found[s[1]], whole[s[1]])
    assert off(found, whole) < 1e-3


def test_axes_from_azimuths() -> None:
    rng = np.random.default_rng(4)
    R_os, p = SO3.rotation(SO3.exp([0.4, 2.0, -1.0])), rng.normal(size=(500, 3))
    azimuth = np.arctan2(p[:, 1], p[:, 0])
    assert axes_from_azimuths(np.matvec(R_os, p), azimuth) == pytest.approx(R_os, abs=1e-12)
    assert axes_from_azimuths(np.matvec(R_os, p[:5]), azimuth[:5]) == pytest.approx(R_os, abs=1e-9)
    noisy = axes_from_azimuths(np.matvec(R_os, p), azimuth + rng.uniform(-0.08, 0.08, 500))
    assert 1e-4 < np.abs(noisy - R_os).max() < 0.03
    level, line = p * [1.0, 1, 0], np.outer(np.linspace(1, 2, 9), [1.0, 2, 3])
    for free, az in ((level, azimuth), (p[:4], azimuth[:4]), (line, np.full(9, np.arctan2(2, 1)))):
        with pytest.raises(SingularGeometryError, match=f"azimuths of {len(free)} contacts leave its rotation free"):
            axes_from_azimuths(np.matvec(R_os, free), az)
    for turn in SO3.rotation(SO3.exp(rng.normal(size=(40, 3)))):  # which of many solutions comes out is chance
        with pytest.raises(SingularGeometryError, match="500 contacts leave its rotation free"):
            axes_from_azimuths(np.matvec(turn, level), azimuth)
    flat = p * [1.0, 1, 0.01]
    with pytest.raises(SingularGeometryError, match="above and below its plane"):
        axes_from_azimuths(flat, np.arctan2(flat[:, 1], flat[:, 0]) + rng.uniform(-0.08, 0.08, 500))


def test_poses_that_cannot_be_placed_are_named() -> None:
    expected = truth()
    i, j = views(expected)
    few = (i.numbers != 8) | (j.numbers < 5)
    graph = FactorGraph([f[few] for f in seen(expected, i, j)])
    graph.fix(x[40])
    with pytest.raises(
        SingularGeometryError, match=r"rig: x8 shares 2 points .*at least 3 are needed; fix x8"
    ) as raised:
        rig(graph, forgotten(expected, 40))
    assert repr(raised.value.keys[0]) == "x8"

    first = j.numbers < 30
    line = expected.copy()
    line[l[3 * np.arange(10)]] = np.outer(np.linspace(-2, 2, 10), [1.0, 0.2, 0.1]) + np.array([0.0, 0.3, 6.0])
    for three_points in (False, True):
        graph = FactorGraph([f[(i.numbers != 12) | first] for f in seen(line, i, j)])
        graph.fix(x[40])
        with pytest.raises(
            SingularGeometryError, match=r"rig: x12 sees the points known so far in one line: 10 points"
        ):
            rig(graph, forgotten(line, 40), three_points=three_points)
    line[l[3 * np.arange(10)]] += 0.01 * np.random.default_rng(5).normal(size=(10, 3))  # less than the noise
    graph = FactorGraph([f[(i.numbers != 12) | first] for f in seen(line, i, j)])
    graph.fix(x[40])
    with pytest.raises(SingularGeometryError, match=r"rig: x12 .*10 points spread 0.0\d+ m across their line"):
        rig(graph, forgotten(line, 40))


def test_what_does_not_tell_where_the_sonar_is() -> None:
    expected = truth()
    i, j = views(expected)
    graph = FactorGraph([f[i.numbers == 40] for f in seen(expected, i, j)])
    graph.fix(x[40])
    start = Values({x: (SE3, expected[x[40]], [40]), l: (R(3), expected[l], 3 * np.arange(40)), s: (SE3, expected[s])})
    with pytest.raises(UnderconstrainedError, match="rig: pixels and ranges do not tell where s0 is") as caught:
        rig(graph, start, calibrate=True)
    assert [advice.action for advice in caught.value.advice] == ["move rig", "guess"]
    assert off(rig(graph, start), start) < 1e-9

    for factors in (seen(expected, i, j), seen(expected, i, j, off=expected[s])):
        graph = FactorGraph(factors)
        graph.fix(s[0])
        with pytest.raises(GraphError, match="no RangeAzimuth has a free variable as its offset"):
            rig(graph, expected, calibrate=True)


def test_graphs_that_are_no_rig() -> None:
    expected = truth()
    i, j = views(expected)
    pixels, contacts = seen(expected, i, j)
    for name, factor in (("RangeAzimuth", pixels), ("Projection", contacts)):
        with pytest.raises(GraphError, match=f"rig: the graph has no {name} of points in R3"):
            rig(FactorGraph([factor]), expected)
    left = i.numbers > 8
    with pytest.raises(
        GraphError, match=r"no point was seen by camera and sonar from one pose \(160 pixels, 120 contacts\)"
    ):
        rig(FactorGraph([pixels[left], contacts[~left]]), expected)
    both = Values(
        {
            **{k: (stack.manifold, stack.X, stack.numbers) for k, stack in expected.stacks.items()},
            y: (SE3, expected[x], IDS),
            m: (R(3), expected[l], expected.stack("l").numbers),
        }
    )
    for what, keys in (
        ("poses of several kinds, x, y", (Keys("y", i.numbers), j)),
        ("points of", (i, Keys("m", j.numbers))),
    ):
        with pytest.raises(GraphError, match=f"rig: {what}.*this start takes one"):
            rig(FactorGraph([pixels, RangeAzimuth(*keys, contacts.z, NOISE[1], s[0])]), both)
    less = Values({x: (SE3, expected[x], IDS), l: (R(3), expected[l][1:], 3 * np.arange(1, 40)), s: (SE3, expected[s])})
    with pytest.raises(GraphError, match="l0 has no value"):
        rig(FactorGraph([pixels, contacts]), less)


def test_a_pixel_without_a_ray_is_named() -> None:
    expected = truth()
    i, j = views(expected)
    pixels, contacts = seen(expected, i, j)
    fish = Projection(i, j, pixels.z + np.array([3000.0, 0]), NOISE[0], Camera((600.0, 600.0), (640.0, 480.0), (-0.3,)))
    with pytest.raises(SingularGeometryError, match=r"Projection\(x40, l0\): pixel .* has no ray"):
        rig(FactorGraph([fish, contacts]), expected)
