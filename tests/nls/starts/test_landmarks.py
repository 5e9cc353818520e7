"""Points put where the poses saw them: exact for exact measurements, kept where nothing says where they are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import factors as f
from factors import Bearing, BearingRange, Between, Information, Isotropic, Landmark, Prior, Projection, Range, Sighting
from factors.keys import Keys
from models import SE2, SE3, LieGroup, Manifold, Measured, R
from models.algebra import Array
from models.errors import SingularGeometryError
from models.sensors import Camera, direction, distance
from nls import FactorGraph, Values, initialize, kinds
from nls.starts import STARTS, locate_points
from tests.nls.graphs import forgotten, moved, walk

x, l, m, o = kinds("x", "l", "m", "o")
ONE = Isotropic(1.0)


class TravelTime(Sighting):
    """A sensor from outside: seconds of sound on its way."""

    def measured(self, d: int) -> Manifold:
        return Measured("travel time")

    def sense(self, p: Array) -> tuple[Array, Array]:
        r, J = distance(p)
        return r / 1500, J / 1500

    def ranges(self, z: Array) -> Array:
        return 1500 * z[:, 0]


class Hydrophones(Sighting):
    """Another one: the cosine and the sine of a bearing in the plane."""

    def measured(self, d: int) -> Manifold:
        return Measured("cosine", "sine")

    def sense(self, p: Array) -> tuple[Array, Array]:
        bearing, J = direction(p)
        c, s = np.cos(bearing), np.sin(bearing)
        return np.hstack([c, s]), np.stack([-s, c], axis=1) * J

    def directions(self, z: Array) -> Array:
        return z


SENSORS: list[type[Sighting]] = [Landmark, BearingRange, Range, Bearing]


def exact(kind: Callable[..., Sighting], values: Values, pose: Keys, point: Keys, offset: object = None) -> Sighting:
    """A factor whose measurements are what the values predict."""
    empty = kind(pose, point, 0.0, ONE, offset=offset)
    space = empty.space(tuple(values.stack(k.kind).manifold for k in empty.keys))
    blank = kind(pose, point, np.zeros((len(pose), space.size)), ONE, offset=offset)
    model, X = values.gather(blank)
    return kind(pose, point, blank.predict(model.manifolds, *X)[0], ONE, offset=offset)


def scene(group: LieGroup, seed: int = 0, n: int = 30, k: int = 7) -> tuple[Values, Keys, Keys]:
    """Scattered poses and points under odd numbers, and who sees whom."""
    rng, d = np.random.default_rng(seed), group.point_dim
    X = group.exp(rng.normal(size=(n, group.dim)) * ([4.0] * d + [1.0] * (group.dim - d)))
    values = Values({l: (R(d), 10 * rng.normal(size=(k, d)), 100 - 3 * np.arange(k))})
    values.add(x, group, X, 7 * np.arange(n) - 50)
    values.add(o, group, group.exp(rng.normal(size=(1, group.dim))))
    i, j = rng.integers(0, n, 120), np.arange(120) % k
    return values, Keys("x", 7 * i - 50), Keys("l", 100 - 3 * j)


@pytest.mark.parametrize("kind", [*SENSORS, TravelTime, Hydrophones], ids=lambda kind: kind.__name__)
def test_exact_measurements_give_exact_points(kind: type[Sighting]) -> None:
    for group in (SE2,) if kind is Hydrophones else (SE2, SE3):
        truth, pose, point = scene(group)
        for offset in (None, truth[o[0]], o[np.zeros(120, dtype=int)]):
            found = locate_points(FactorGraph([exact(kind, truth, pose, point, offset)]), forgotten(truth))
            assert found[l] == pytest.approx(truth[l], abs=1e-9)
            assert np.array_equal(found[x], truth[x])
            assert np.array_equal(found[o], truth[o])


LENS = Camera(focal=(600.0, 500.0), center=(640.0, 480.0), distortion=(-0.3, 0.0, 0.0, 0.0))


def filmed(offset: str | None = None) -> tuple[Values, FactorGraph]:
    """Five points ahead of three cameras side by side, one point more seen by the first alone."""
    O = SE3.identity() if offset is None else SE3.exp([[0.2, 0.1, -0.3, 0.2, -0.1, 0.3]])
    C = SE3.exp(np.array([[k, 0.1 * k, 0, 0, -0.2 * k, 0.1] for k in range(3)], dtype=float))
    rng = np.random.default_rng(4)
    L = rng.uniform([-1, -1, 4], [2, 1, 8], size=(6, 3))
    values = Values({x: (SE3, SE3.compose(C, SE3.inverse(O))), l: (R(3), L), o: (SE3, O)})
    i, j = np.repeat(np.arange(3), 6), np.tile(np.arange(6), 3)
    i, j = i[(j < 5) | (i == 0)], j[(j < 5) | (i == 0)]
    pixels = LENS.project(SE3.act(SE3.inverse(C[i]), L[j]))[0]
    mounted = o[np.zeros(len(i), dtype=int)] if offset == "variable" else None if offset is None else O
    return values, FactorGraph([Projection(x[i], l[j], pixels, ONE, LENS, mounted)])


@pytest.mark.parametrize("offset", [None, "fixed", "variable"])
def test_pixels_of_two_or_more_poses_place_a_point(offset: str | None) -> None:
    truth, graph = filmed(offset)
    start = forgotten(truth).replaced({"l": np.full((6, 3), 30.0)})
    located = locate_points(graph, start)
    assert located[l[0:5]] == pytest.approx(truth[l[0:5]], abs=1e-9)
    assert located[l[5]].tolist() == [30.0] * 3  # on one ray
    assert graph.chi2(located) < graph.chi2(start)
    pair = graph.factors[0][np.isin(graph.factors[0].keys[0].numbers, [0, 2])]
    assert locate_points(FactorGraph([pair]), start)[l[0:5]] == pytest.approx(truth[l[0:5]], abs=1e-9)


def test_a_point_is_never_put_behind_a_camera_that_saw_it() -> None:
    """The rays of two pixels meet behind both: there is no image of it there, and the value given has one."""
    values = Values({x: (SE3, [[0, 0, 0, 0, 0, 0, 1], [1, 0, 0, 0, 0, 0, 1]]), l: (R(3), [[0.5, 0.0, 9.0]])})
    diverging = Projection(x[[0, 1]], l[0], [[-0.1, 0.0], [0.1, 0.0]], ONE)
    assert locate_points(FactorGraph([diverging]), values)[l[0]].tolist() == [0.5, 0.0, 9.0]
    behind = values.replaced({"l": np.array([[0.5, 0.0, -9.0]])})
    meeting = Projection(x[[0, 1]], l[0], [[0.1, 0.0], [-0.1, 0.0]], ONE)
    assert locate_points(FactorGraph([meeting]), behind)[l[0]] == pytest.approx([0.5, 0.0, 5.0])


def test_a_pixel_without_a_ray_is_named() -> None:
    values, _ = filmed()
    pixels = Projection(x[[0, 1]], l[2], [[640.0, 480.0], [1500.0, 480.0]], ONE, LENS)
    with pytest.raises(SingularGeometryError, match=r"^Projection\(x1, l2\): .*pixel .* has no ray"):
        locate_points(FactorGraph([pixels]), values)


def test_sightings_that_place_no_point_are_passed_over() -> None:
    truth, _ = filmed()
    n = np.arange(3)
    arcs = [exact(kind, truth, x[n], l[np.zeros(3, dtype=int)]) for kind in (f.RangeAzimuth, f.Elevation)]
    others = FactorGraph([*arcs, Range(x[0], x[1], 1.0, ONE), Prior(l[1], [1.0, 2.0, 3.0], ONE)])
    assert np.array_equal(locate_points(others, forgotten(truth))[l], forgotten(truth)[l])


@pytest.mark.parametrize("kind", [Landmark, BearingRange], ids=lambda kind: kind.__name__)
def test_the_first_pose_in_number_decides(kind: type[Sighting]) -> None:
    truth = Values({x: (SE2, [[0, 0, 0], [3, 0, 1], [5, 1, 2]], [9, -4, 2]), l: (R(2), [[4.0, 4.0]])})
    elsewhere = truth.replaced({"l": np.array([[7.0, 7.0]])})
    first, later = exact(kind, truth, x[-4], l[0]), exact(kind, elsewhere, x[[2, 9]], l[[0, 0]])
    for factors in ([first, later], [later, first]):
        assert locate_points(FactorGraph(factors), elsewhere)[l[0]] == pytest.approx([4, 4])


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_a_point_is_located_by_the_best_it_has(group: LieGroup) -> None:
    """One kind of points seen by every sensor; a direction with a distance beats sums of others."""
    truth, pose, point = scene(group)
    wrong = truth.replaced({"l": truth.stacks["l"].X + 3.0})
    factors = [exact(kind, wrong, pose, point) for kind in (Bearing, Range)]
    both = FactorGraph([*factors, exact(Landmark, truth, pose[range(21)], point[range(21)])])
    assert locate_points(both, forgotten(truth))[l] == pytest.approx(truth[l], abs=1e-10)
    assert locate_points(FactorGraph(factors), forgotten(truth))[l] == pytest.approx(wrong[l], abs=1e-10)


def test_what_nothing_locates_keeps_its_value() -> None:
    for kind, poses, kept in (
        (Range, [[0, 0, 0], [3, 1, 0]], True),  # two places
        (Range, [[0, 0, 0], [1, 1, 2], [2, 2, 0], [3, 3, 1]], True),  # in line
        (Range, [[0, 0, 0], [1, 1, 2], [2, 2, 0], [3, 2.5, 1]], False),
        (Range, [[1, 1, 0], [1, 1, 1]], True),  # one place
        (Bearing, [[0, 0, 0]], True),
        (Bearing, [[0, 0, 0], [2.5, 1.5, 1]], True),  # along the ray
        (Bearing, [[0, 0, 0], [2.5, 1.4, 1]], False),
        (Landmark, [[0, 0, 0]], False),
    ):
        n = len(poses)
        truth = Values({x: (SE2, np.array(poses, dtype=float)), l: (R(2), [[5.0, 3.0]])})
        factor = exact(kind, truth, x[0:n], l[np.zeros(n, dtype=int)])
        found = locate_points(FactorGraph([factor]), truth.replaced({"l": np.array([[6.0, 2.0]])}))[l[0]]
        assert found.tolist() == [6, 2] if kept else found == pytest.approx([5, 3]), (kind, poses)


def test_fixed_and_unseen_points_and_seen_poses_stay() -> None:
    truth, pose, point = scene(SE2)
    start = forgotten(truth)
    graph = FactorGraph([exact(kind, truth, pose[range(70)], point[range(70)]) for kind in SENSORS])
    graph.fix(l[[100, 94]])
    graph.add(exact(Range, truth, x[[-50, -43, -36]], x[[-29, -29, -29]]))
    found = locate_points(graph, start)
    assert found[l[[100, 94]]].tolist() == [[0.5, 0.5]] * 2
    assert found[l[[97, 91]]] == pytest.approx(truth[l[[97, 91]]])
    assert np.array_equal(found[x], truth[x])
    assert np.array_equal(start[l], forgotten(truth)[l])  # what was given is not changed


def test_noisy_ranges_never_fit_worse_than_what_was_given() -> None:
    rng = np.random.default_rng(8)
    for seed in range(20):
        truth, pose, point = scene(SE3, seed, n=6)
        clean = exact(Range, truth, pose, point)
        graph = FactorGraph([Range(pose, point, np.abs(clean.z[:, 0] + rng.normal(size=120)), ONE)])
        assert graph.chi2(locate_points(graph, truth)) <= graph.chi2(truth) * (1 + 1e-12)


def test_numbers_whose_squares_are_none_place_no_point() -> None:
    """A range or a place of 1e200 m: the points stay, the others are located, and NumPy says nothing."""
    truth, pose, point = scene(SE2, 4, n=6)
    ranges = exact(Range, truth, pose, point)
    z = ranges.z[:, 0].copy()
    z[ranges.keys[1].numbers == truth.stack("l").numbers[0]] = 1e200
    start = forgotten(truth)
    far = start[l].copy()
    far[1] = 1e200
    start[l] = far
    located = locate_points(FactorGraph([Range(pose, point, z, ONE)]), start)
    assert np.array_equal(located[l][0], start[l][0])
    assert located[l][2:] == pytest.approx(truth[l][2:], abs=1e-6)


def survey(group: LieGroup) -> tuple[Values, FactorGraph, Values]:
    rng, d, n, k = np.random.default_rng(5), group.point_dim, 20, 5
    X = walk(group, n, rng)
    truth = Values({x: (group, X), l: (R(d), group.position(X)[:k] + rng.normal(size=(k, d)))})
    odometry = Between(x[0 : n - 1], x[1:n], group.between(X[:-1], X[1:]), ONE)
    i, j = x[np.repeat(np.arange(n), k)], l[np.tile(np.arange(k), n)]
    graph = FactorGraph([odometry, exact(BearingRange, truth, i, j)])
    drifted = np.concatenate([X[:1], moved(group, X[1:], 0.5, rng)])
    return truth, graph, Values({x: (group, drifted), l: (R(d), np.zeros((k, d)) + 9.0)})


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_every_start_that_moves_poses_takes_the_points_along(group: LieGroup) -> None:
    truth, graph, start = survey(group)
    for name in {"auto", *STARTS} - {"file"}:
        found, chosen, chi2 = initialize(graph, start, name)
        assert chi2[chosen] < 1e-18
        assert np.abs(group.local(truth[x], found[x])).max() < 1e-10
        assert found[l] == pytest.approx(truth[l], abs=1e-9)
        assert name != "auto" or (chosen, set(chi2)) == ("chordal", {"file", "chordal"})
    assert initialize(graph, start, "file")[2]["file"] > 10
    assert initialize(graph, truth)[2]["file"] < 1e-18


def test_a_start_where_a_sensor_is_on_its_point_is_no_start() -> None:
    """All zeros: ranges have no value there, so the file's own start is left out."""
    truth, graph, _ = survey(SE2)
    ranges = exact(Range, truth, x[np.repeat(np.arange(20), 5)], l[np.tile(np.arange(5), 20)])
    zeros = Values({x: (SE2, np.zeros((20, 3))), l: (R(2), np.zeros((5, 2)))})
    zeros[x[0]] = truth[x[0]]
    zeros[l[0]] = zeros[x[3]][:2]
    _, name, chi2 = initialize(FactorGraph([*graph.factors, ranges]), zeros)
    assert "file" not in chi2
    assert chi2[name] < 1e-15


def test_a_sighting_that_says_nothing_is_passed_over() -> None:
    blind = Landmark(x[0], l[0], [500.0, 0.0], Information(np.diag([1e-12, 1e-12])))
    empty = Landmark(x[1], l[0], [7.0, 7.0], Information(np.zeros((2, 2))))
    seen = Landmark(x[2], l[0], [2.0, 0.0], Isotropic(0.1))
    values = Values({x: (SE2, [[0, 0, 0], [0, 0, 0], [1, 0, np.pi / 2]]), l: (R(2), [0.0, 0.0])})
    assert locate_points(FactorGraph([blind, empty, seen]), values)[l[0]] == pytest.approx([1.0, 2.0])
    assert np.array_equal(locate_points(FactorGraph([empty]), values)[l[0]], values[l[0]])
