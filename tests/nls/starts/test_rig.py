"""Starts of a camera and a sonar: exact for exact measurements, near enough for noisy ones, refused by name."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pytest

import sim
from factors import Diagonal, Factor, Information, Isotropic, Projection, RangeAzimuth, Sighting
from factors.keys import Keys
from models import SE3, SO3, Manifold, Measured, R
from models.algebra import Array
from models.sensors import Camera, range_azimuth
from nls import FactorGraph, GaussNewton, GraphError, SingularGeometryError, UnderconstrainedError, Values, kinds
from nls.starts.mounting import axes_from_azimuths
from nls.starts.rig import rig

x, l, s, c, y, m = kinds("x", "l", "s", "c", "y", "m")
CAMERA = Camera(focal=(600.0, 600.0), center=(640.0, 480.0))
NOISE = Isotropic(1.0), Diagonal(range=0.01, azimuth=0.02)
LOOKING_AHEAD = [-0.5, -0.5, -0.5, 0.5]  # of a sonar on a camera
IDS = np.array([40, 7, 8, -3, 1000, 12, 9])  # of poses, the first of them at the start of the flight


class Pinhole(Sighting):
    """A camera from outside: the tangents of two angles."""

    def measured(self, d: int) -> Manifold:
        return Measured("right", "down")

    def sense(self, p: Array) -> tuple[Array, Array]:
        return Camera().project(p)

    def rays(self, z: Array) -> tuple[Array, Array]:
        return Camera().ray(z)


class Scanner(Sighting):
    """A sonar from outside."""

    contact = True

    def measured(self, d: int) -> Manifold:
        return Measured("range", "azimuth")

    def sense(self, p: Array) -> tuple[Array, Array]:
        return range_azimuth(p)


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


I, J = views(truth())


def seen(
    values: Values, i: Keys = I, j: Keys = J, on: Array | None = None, off: Array | None = None
) -> tuple[Projection, RangeAzimuth]:
    """Exact pixels and contacts, camera at `on` and sonar at `off`; where None, no offset and the variable s0."""
    C = SE3.identity() if on is None else on
    O = values[s] if off is None else off
    p = SE3.act(SE3.inverse(SE3.compose(values[i], C)), values[j])
    q = SE3.act(SE3.inverse(SE3.compose(values[i], O)), values[j])
    pixels = Projection(i, j, CAMERA.project(p)[0], NOISE[0], CAMERA, on)
    return pixels, RangeAzimuth(i, j, range_azimuth(q)[0], NOISE[1], s[0] if off is None else off)


def forgotten(values: Values, *kept: int) -> Values:
    """Nothing known but some poses and where the sensors are."""
    known = np.isin(values.stack("x").numbers, kept)
    X = np.where(known[:, None], values.stack("x").X, [9.0, 9, 9, 0, 0, 0, 1])
    return values.replaced({x: X, l: np.full(values.stack("l").X.shape, 0.5)})


def held(*factors: Factor) -> FactorGraph:
    """A graph with the first pose fixed."""
    return FactorGraph(factors, [x[40]])


def placed(expected: Values, *factors: Factor, three_points: bool = False) -> Values:
    """The start from the first pose."""
    return rig(held(*factors), forgotten(expected, 40), three_points=three_points)


def off(found: Values, expected: Values, *names: str) -> float:
    """Largest difference, m and rad."""
    stacks = ((expected.stack(name), found.stack(name)) for name in names or expected.stacks)
    return max(float(np.abs(a.manifold.local(a.X, b.X)).max()) for a, b in stacks)


@pytest.mark.parametrize("three_points", [False, True])
def test_exact_measurements_give_the_truth(three_points: bool) -> None:
    """Sonar a variable, or both fixed; in any batches and order, with duplicates; sensors from outside."""
    expected, rng = truth(), np.random.default_rng(1)
    on, sonar = expected[c], SE3.compose(expected[c], expected[s])
    pixels, contacts = seen(expected)
    a, b = rng.permutation(len(I)), rng.permutation(len(I))
    tangents = Pinhole(I, J, (pixels.z - [640.0, 480.0]) / 600, Isotropic(1 / 600))
    for factors in (
        (pixels, contacts),
        seen(expected, on=on, off=sonar),
        (contacts[b[:90]], pixels[a[100:]], pixels[a[:120]], contacts[b[80:]]),
        (tangents, Scanner(I, J, contacts.z, NOISE[1], s[0])),
    ):
        assert off(placed(expected, *factors, three_points=three_points), expected) < 1e-9


def test_a_camera_that_is_a_variable_is_taken_where_it_is() -> None:
    """Also when it is the sonar's place that is asked for: moved together with all poses nobody would notice."""
    expected = truth()
    expected[s[0]] = SE3.compose(expected[c[0]], expected[s[0]])
    pixels, contacts = seen(expected, on=expected[c], off=expected[s])
    assert off(placed(expected, pixels.mounted(c[0]), contacts), expected) < 1e-9
    found = rig(held(pixels.mounted(c[0]), contacts.mounted(s[0])), forgotten(expected, 40), calibrate=True)
    assert np.array_equal(found[c], expected[c])
    assert off(found, expected) < 1e-3


def test_what_is_known_better_counts_more() -> None:
    """Every third range of the later views is 0.3 m too long, and its sigma is a meter."""
    expected = truth()
    pixels, contacts = seen(expected)
    poor = (I.numbers != 40) & (J.numbers % 9 == 0)
    noise = Diagonal(np.column_stack([np.where(poor, 1.0, 0.01), np.full(len(I), 0.02)]))
    z = contacts.z + np.column_stack([0.3 * poor, np.zeros(len(I))])
    found = placed(expected, pixels, RangeAzimuth(I, J, z, noise, s[0]))
    assert off(found, expected, "x") < 1e-3  # 0.1 with equal weights
    assert off(found, expected, "l") < 1e-9


def test_who_comes_first() -> None:
    """Fixed poses, else fixed points, else the pose of lowest number; and what is fixed stays."""
    expected = truth()
    factors, four = seen(expected), l[[0, 3, 9, 12]]
    assert off(rig(FactorGraph(factors), forgotten(expected, -3)), expected) < 1e-9
    assert off(rig(FactorGraph(factors, [x[12]]), forgotten(expected, 12)), expected) < 1e-9
    graph, known = FactorGraph(factors, [four]), forgotten(expected)
    known[four] = expected[four]
    assert off(rig(graph, known), expected) < 1e-9
    graph.fix(x[[7, 9]])
    known[x[[7, 9]]] = expected[x[[9, 7]]]  # wrong, but fixed
    found = rig(graph, known)
    assert np.array_equal(found[x[[7, 9]]], expected[x[[9, 7]]])
    assert np.array_equal(found[four], expected[four])


def test_poses_are_placed_in_the_order_of_what_they_share() -> None:
    """A chain in which each pose shares five points with the next alone, under numbers that jump about."""
    expected = truth()
    i, k = np.repeat(IDS[[0, 4, 2, 6, 1, 5, 3]], 10), np.arange(70)
    assert off(placed(expected, *seen(expected, Keys("x", i), Keys("l", 3 * (k - k // 10 * 5)))), expected) < 1e-8


def test_points_of_one_sensor_alone() -> None:
    """Rays of the camera meet; a contact of the sonar leaves its point where it was; so does a ray."""
    expected = truth()
    pixels, contacts = seen(expected)
    unheard = np.isin(J.numbers, [0, 3, 6, 9])
    unseen, once = J.numbers == 12, (J.numbers == 15) & (I.numbers != 7)
    found = placed(expected, pixels[~unseen & ~once], contacts[~unheard & (J.numbers != 15)])
    assert (found[l[[12, 15]]] == 0.5).all()
    found[l[[12, 15]]] = expected[l[[12, 15]]]
    assert off(found, expected) < 1e-9


def test_azimuth_decides_between_two_points_on_a_ray() -> None:
    """A sonar 6 m ahead of the camera, turned: rays come into its spheres and go out."""
    expected = truth()
    expected[s[0]] = SE3.compose([0.2, 0.1, 6.5, *LOOKING_AHEAD], SE3.exp([0, 0, 0, 0, 0, 1.5]))
    assert off(placed(expected, *seen(expected)), expected) < 1e-8


def test_pairs_that_meet_nowhere_or_say_nothing_are_passed_over() -> None:
    expected = truth()
    expected[s[0]] = SE3.compose([0.2, 0.1, 2.5, *LOOKING_AHEAD], SE3.exp([0.0, 0, 0, 0, 0, 0.1]))
    pixels, contacts = seen(expected)
    z, information = contacts.z.copy(), np.tile(np.diag([1e4, 2e3]), (len(I), 1, 1))
    z[::5, 0], z[1::5, 0] = 0.01, 3.0
    information[1::5, 0, 0] = 0.0
    assert off(placed(expected, pixels, RangeAzimuth(I, J, z, Information(information), s[0])), expected) < 1e-9


def test_every_start_leads_to_the_same_optimum() -> None:
    scene = sim.rig(np.random.default_rng(1), points=200)
    graph, given = scene.graph, scene.start
    wrong, unknown = given.copy(), given.copy()
    turn = np.random.default_rng(1).normal(size=3)
    wrong[s[0]] = np.append(given[s[0]][:3], SO3.retract(given[s[0]][3:], np.pi / 2 * turn / np.linalg.norm(turn)))
    unknown[s[0]] = [50.0, 0, 0, 1, 0, 0, 0]
    starts = {
        "guess": rig(graph, given),
        "three points": rig(graph, given, three_points=True),
        "90 degrees": rig(graph, wrong),
        "nothing": rig(graph, unknown, calibrate=True),
    }
    before, blind = scene.errors(starts["guess"]), scene.errors(starts["nothing"])
    assert 0.015 < before.poses < 0.05
    assert 0.05 < before.points < 0.075
    assert before.poses < scene.errors(starts["three points"]).poses < 0.3
    assert blind.extrinsic_m < 0.03
    assert blind.extrinsic_rad < np.radians(3)
    results = {name: graph.optimize(start, GaussNewton()) for name, start in starts.items()}
    for name, result in results.items():
        assert result.converged, name
        assert result.iterations <= 12, name
        assert result.chi2_final == pytest.approx(results["guess"].chi2_final, rel=1e-6), name
    assert results["nothing"].iterations <= results["guess"].iterations


def test_from_nothing_is_exact_without_noise() -> None:
    """One sonar; two of them, the camera on a vehicle; camera and sonar mounted by variables of one kind."""
    scene = sim.rig(np.random.default_rng(3), poses=8, points=60, noise_scale=0.0)
    start = scene.start.copy()
    start[s[0]] = [1.0, 2, 3, 0.5, 0.5, -0.5, 0.5]
    assert off(rig(scene.graph, start, calibrate=True), scene.truth) < 1e-3
    assert start[s[0]][0] == 1.0

    expected = truth(points=60)
    second = SE3.compose([0.0, -0.4, 0.2, *LOOKING_AHEAD], SE3.exp([0, 0, 0, 0.3, 0.2, -0.4]))
    sonars = SE3.compose(expected[c], np.stack([expected[s[0]], second]))
    i, j = views(expected)
    k = np.arange(len(i)) % 2
    pixels, contacts = seen(expected, i, j, expected[c], sonars[:1])
    q = SE3.act(SE3.inverse(SE3.compose(expected[i], sonars[k])), expected[j])
    both = RangeAzimuth(i, j, range_azimuth(q)[0], NOISE[1], Keys("s", k))
    for factors, sensors, known in (
        ((pixels, both), sonars, []),
        ((pixels.mounted(s[1]), contacts.mounted(s[0])), np.concatenate([sonars[:1], expected[c]]), [1]),
    ):
        X, L = (expected.stack(kind) for kind in "xl")
        whole = Values({x: (SE3, X.X, IDS), l: (R(3), L.X, L.numbers), s: (SE3, sensors)})
        start = forgotten(whole, 40)
        start[s] = SE3.identity(2)
        start[s[known]] = whole[s[known]]
        found = rig(held(*factors), start, calibrate=True)
        assert np.array_equal(found[s[known]], whole[s[known]])  # the camera is held meanwhile, not the sonar with it
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
    flat = p * [1.0, 1, 0.01]
    with pytest.raises(SingularGeometryError, match="above and below its plane"):
        axes_from_azimuths(flat, np.arctan2(flat[:, 1], flat[:, 0]) + rng.uniform(-0.08, 0.08, 500))


def test_poses_that_cannot_be_placed_are_named() -> None:
    expected = truth()

    def refused(values: Values, mask: Array, message: str, three_points: bool = False) -> Sequence[Keys]:
        with pytest.raises(SingularGeometryError, match=message) as raised:
            placed(values, *(f[mask] for f in seen(values)), three_points=three_points)
        return raised.value.keys

    few = (I.numbers != 8) | (J.numbers < 5)
    assert refused(expected, few, r"rig: x8 shares 2 points .*at least 3 are needed; fix x8") == (x[8],)
    line, ten = expected.copy(), l[3 * np.arange(10)]
    line[ten] = np.outer(np.linspace(-2, 2, 10), [1.0, 0.2, 0.1]) + np.array([0.0, 0.3, 6.0])
    first = (I.numbers != 12) | (J.numbers < 30)
    for three_points in (False, True):
        refused(line, first, r"rig: x12 sees the points known so far in one line: 10 points", three_points)
    line[ten] += 0.01 * np.random.default_rng(5).normal(size=(10, 3))  # less than the noise
    refused(line, first, r"rig: x12 .*10 points spread 0.0\d+ m across their line")


def test_what_does_not_tell_where_the_sonar_is() -> None:
    expected = truth()
    graph = held(*(f[I.numbers == 40] for f in seen(expected)))
    start = Values({x: (SE3, expected[x[40]], [40]), l: (R(3), expected[l], 3 * np.arange(40)), s: (SE3, expected[s])})
    with pytest.raises(UnderconstrainedError, match="rig: pixels and ranges do not determine s0") as caught:
        rig(graph, start, calibrate=True)
    assert [advice.action for advice in caught.value.advice] == ["move rig", "guess"]
    assert off(rig(graph, start), start) < 1e-9
    for factors in (seen(expected), seen(expected, off=expected[s])):
        with pytest.raises(GraphError, match="no RangeAzimuth has a free variable as its offset"):
            rig(FactorGraph(factors, [s[0]]), expected, calibrate=True)


def test_graphs_that_are_no_rig() -> None:
    expected = truth()
    (pixels, contacts), left = seen(expected), I.numbers > 8
    both = expected.copy()
    both.add(y, SE3, expected[x], IDS)
    both.add(m, R(3), expected[l], expected.stack("l").numbers)
    less = Values({x: (SE3, expected[x], IDS), l: (R(3), expected[l][1:], 3 * np.arange(1, 40)), s: (SE3, expected[s])})
    twice = [RangeAzimuth(*keys, contacts.z, NOISE[1], s[0]) for keys in ((Keys("y", I.numbers), J), (I, m[J.numbers]))]
    for factors, values, message in (
        ([pixels], expected, "rig: the graph has no RangeAzimuth of points in R3"),
        ([contacts], expected, "rig: the graph has no Projection of points in R3"),
        ([pixels[left], contacts[~left]], expected, "no point was seen by .* from one pose (160 pixels, 120 contacts)"),
        ([pixels, twice[0]], both, "rig: poses of several kinds, x, y.*expected one"),
        ([pixels, twice[1]], both, "rig: points of.*expected one"),
        ([pixels, contacts], less, "l0 has no value"),
    ):
        with pytest.raises(GraphError, match=re.sub(r"([()])", r"\\\1", message)):
            rig(FactorGraph(factors), values)
    fish = Projection(I, J, pixels.z + np.array([3000.0, 0]), NOISE[0], Camera((600.0, 600.0), (640.0, 480.0), (-0.3,)))
    with pytest.raises(SingularGeometryError, match=r"Projection\(x40, l0\): pixel .* has no ray"):
        rig(FactorGraph([fish, contacts]), expected)
