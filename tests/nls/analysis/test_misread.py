"""Kinds and single measurements read otherwise, clock offsets and numbers beyond all others; clean graphs: no alarm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import factors as f
from factors import XYH, ZPR, Between, Diagonal, Factor, Heading, Information, Isotropic, Position, Prior, Wheels
from factors.keys import Keys
from factors.replaced import replaced
from models import SE2, SE3, Manifold, Measured, R
from models.algebra import Array, wrap
from models.errors import GraphError
from models.manifolds.so3 import rotation3
from models.sensors import direction, distance
from nls import FactorGraph, Values, kinds
from nls.analysis.calibrations import calibrations
from nls.analysis.clock import ClockOffset, clock_offsets
from nls.analysis.leave_one_out import checks
from nls.analysis.misread import READINGS, MisreadMeasurement, misread_kinds, misread_measurements
from nls.analysis.scales import outsized
from nls.analysis.swapped_landmarks import swapped_landmarks
from tests.combinations import for_all
from tests.nls import misreadings
from tests.nls.graphs import walk
from tests.nls.misreadings import PUBLIC, WORLDS, checked, clean, doubted, misread, misread_one, optimum, public
from tests.nls.misreadings import read as reread

x, l = kinds("x", "l")
ONE = Isotropic(0.1)
PLANE = Values({x: (SE2, SE2.identity(2)), l: (R(2), [[1.0, 0.5]])})
POSE = SE3.exp([0.3, -0.2, 0.5, 0.4, -0.6, 0.8])
SPACE = Values({x: (SE3, np.stack([SE3.identity()[0], POSE])), l: (R(3), [[1.0, 0.5, 0.2]])})


class SatelliteCompass(Factor):
    """A sensor from outside: position and heading in the world; as a log the same of a step."""

    def __init__(self, keys: Sequence[Keys], z: npt.ArrayLike, frame: str) -> None:
        super().__init__(keys, z, ONE)
        self.slots, self.frame = (SE2,) * len(keys), frame  # type: ignore[misc]

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return Measured("yaw", "x", "y")

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, None]:
        return (X[0] if len(X) == 1 else SE2.between(*X))[:, [2, 0, 1]], None


def meanings(factor: Factor, values: Values) -> dict[str, Factor]:
    """The factor under every reading that makes sense for it."""
    read = {name: reading(values.gather(factor)[0]) for name, reading in READINGS.items()}
    return {name: meant for name, meant in read.items() if meant is not None}


@for_all(
    case=[
        (Between(x[0], x[1], [1, 2, 0.5], ONE), "transposed", [1, 2, -0.5]),
        (Between(x[0], x[1], [1, 2, 0.5], ONE), "y flipped", [1, -2, -0.5]),
        (Prior(x[0], [1, 2, 0.5], ONE), "x, y exchanged", [2, 1, np.pi / 2 - 0.5]),
        (f.Bearing(x[0], l[0], 0.4, ONE), "mirrored", [-0.4]),
        (Heading(x[0], 0.4, ONE), "transposed", [-0.4]),
        (Heading(x[0], 0.4, ONE), "x, y exchanged", [np.pi / 2 - 0.4]),
        (Position(x[0], [1, 2], ONE), "y flipped", [1, -2]),
        (Position(x[0], [1, 2], ONE), "x, y exchanged", [2, 1]),
        (f.Landmark(x[0], l[0], [1, 2], ONE), "y flipped", [1, -2]),
        (Wheels(x[0], x[1], [1.1, 0.9], ONE, base=0.5), "y flipped", [0.9, 1.1, 0]),
    ]
)
def test_in_the_plane(case: tuple[Factor, str, list[float]]) -> None:
    """As by hand; read twice, a measurement is what it was."""
    factor, name, z = case
    meant = reread(factor, name, PLANE)
    assert np.allclose(meant.z.reshape(-1), z)
    assert np.allclose(reread(meant, name, PLANE).z.reshape(-1), PLANE.gather(factor)[0].z.reshape(-1))


@for_all(case=[("y flipped", [1, -1, 1]), ("z flipped", [1, 1, -1]), ("transposed", [1, 1, 1])])
def test_reflections_and_a_transposed_rotation_in_space(case: tuple[str, list[float]]) -> None:
    name, M = case[0], np.diag(case[1])
    meant, rotation = reread(Between(x[0], x[1], POSE, ONE), name, SPACE), rotation3(POSE[3:])
    assert np.allclose(meant.z[0, :3], M @ POSE[:3])
    assert np.allclose(rotation3(meant.z[0, 3:]), rotation.T if name == "transposed" else M @ rotation @ M)


def test_variables_exchanged() -> None:
    meant = reread(f.BetweenSensors(x[0], x[1], [1, 2, 0.5], ONE, ([0.1, 0, 0], [0.2, 0, 0])), "exchanged", PLANE)
    assert meant.keys == (x[[1]], x[[0]])
    assert vars(meant)["offset"][0].tolist() == [[0.2, 0, 0]]


@for_all(
    case=[
        (SPACE, Between(x[0], x[1], POSE, ONE), {"exchanged", "transposed", "y flipped", "z flipped"}),
        (SPACE, XYH(x[0], x[1], [1, 0, 0.1], ONE), {"exchanged", "transposed", "y flipped"}),
        (SPACE, ZPR(x[0], [1, 0, 0.1], ONE), {"z flipped"}),
        (SPACE, f.RangeAzimuth(x[0], l[0], [1, 0.1], Diagonal(range=0.1, azimuth=0.1)), {"mirrored"}),
        (SPACE, Position(x[0], 3.0, ONE, components=("z",)), {"z flipped"}),
        (SPACE, Prior(l[0], [1, 2, 3], ONE), {"y flipped", "z flipped", "x, y exchanged"}),
        (PLANE, Prior(x[0], [1, 2, 0.5], ONE, components=("x", "y")), {"transposed", "y flipped"}),
    ]
)
def test_readings_that_make_sense(case: tuple[Values, Factor, set[str]]) -> None:
    values, factor, names = case
    assert meanings(factor, values).keys() == names


@pytest.mark.parametrize(
    ("frame", "expected"),
    [
        ("world", {"transposed": [-0.5, 1, 2], "y flipped": [-0.5, 1, -2], "x, y exchanged": [np.pi / 2 - 0.5, 2, 1]}),
        ("first", {"exchanged": [0.5, 1, 2], "transposed": [-0.5, 1, 2], "y flipped": [-0.5, 1, -2]}),
        ("", {}),
    ],
)
def test_a_sensor_that_states_its_frame_is_read_as_ours_are(frame: str, expected: dict[str, list[float]]) -> None:
    factor = SatelliteCompass([x[0], x[1]] if frame == "first" else [x[0]], [0.5, 1, 2], frame)
    meant = meanings(factor, PLANE)
    assert meant.keys() == expected.keys()
    for name, z in expected.items():
        assert np.allclose(meant[name].z, z)
        assert (meant[name].keys == factor.keys[::-1]) == (frame == "world" or name == "exchanged")
    k = np.arange(5)
    z = np.tile([0.1, 3.0, 4.0], (5, 1)) * np.array([1, 1, 1e8, 1, 1])[:, None] ** [0, 1, 1]
    far = SatelliteCompass([x[k], x[k + 1]] if frame == "first" else [x[k]], z, frame)
    found = outsized(FactorGraph([far]).pattern(Values({x: (SE2, np.zeros((6, 3)))})))
    assert [(f.place, f.value, f.reference) for f in found] == [((0, 2), 5e8, 5.0)] * (frame == "first")


def test_what_cannot_be_replaced() -> None:
    step = Between(x[0], x[1], [1, 2, 0.5], ONE)
    with pytest.raises(GraphError, match="2 measured values, expected 1"):
        replaced(step, z=np.zeros((2, 3)))
    with pytest.raises(GraphError, match=r"\[1\] variables; expected 1 for each of its 2 slots"):
        replaced(step, keys=[x[0]])


# a vehicle that only goes ahead has no y to flip
FORWARD = {("Between, steps", "transposed"), ("Between, steps", "y flipped"), ("Between, closures", "y flipped")}


def named(graph: FactorGraph, values: Values) -> set[tuple[str, str]]:
    return {(kind.kind, kind.reading) for kind in misread_kinds(graph, values)}


@pytest.mark.parametrize(
    ("name", "k", "reading", "expected"),
    [
        ("sphere", 1, "exchanged", {("Between, closures", "exchanged")}),
        ("manhattan", 0, "y flipped", FORWARD),
        ("subsea", 2, "mirrored", {("BearingRange", "mirrored"), ("Between", "y flipped")}),
        ("headings", 2, "mirrored", {("BearingRange", "mirrored")}),
        ("headings", 3, "transposed", {("Heading", "transposed")}),
        ("lines", 1, "y flipped", {("Wheels", "y flipped"), ("Line", "mirrored")}),
    ],
)
def test_a_kind_is_named(name: str, k: int, reading: str, expected: set[tuple[str, str]]) -> None:
    graph, start, right = clean(name, 0)
    wrong = misread(graph, start, k, reading)
    meant = misread_kinds(wrong, optimum(wrong, start))
    assert {(kind.kind, kind.reading) for kind in meant} <= expected
    (kind,) = (kind for kind in meant if (kind.reading, kind.places[0][0]) == (reading, k))
    assert kind.chi2 == pytest.approx(graph.chi2(right), rel=1e-3)
    assert kind.standing > 2 * kind.chi2


def test_fixes_in_another_frame_than_the_odometry() -> None:
    """North and east for east and north: with no heading that is the same as a mirrored odometry."""
    rng, sigmas = np.random.default_rng(0), np.array([0.05, 0.05, 0.02])
    X = walk(SE2, 40, rng)
    z = SE2.retract(SE2.between(X[:-1], X[1:]), sigmas * rng.normal(size=(39, 3)))
    fixes = Position(x[0:40], X[:, 1::-1] + 0.1 * rng.normal(size=(40, 2)), Isotropic(0.1))
    graph = FactorGraph([Between(x[0:39], x[1:40], z, Diagonal(sigmas)), fixes])
    meant = named(graph, optimum(graph, Values({x: (SE2, X)})))
    assert meant >= {("Between", "y flipped"), ("Position", "y flipped"), ("Position", "x, y exchanged")}


def test_other_mistakes_are_not_named() -> None:
    """Wrong sigmas, wrong closures."""
    graph, start, _ = clean("manhattan", 0)
    odometry, closures = graph.factors
    sharp, wrong = Between(*odometry.keys, odometry.z, Isotropic(0.004)), closures[:20]
    shuffled = Between(*wrong.keys, wrong.z[::-1] + np.array([3.0, 1.0, 1.0]), wrong.noise)
    for factors in ([sharp, closures], [odometry, closures[20:], shuffled]):
        wrong_graph = FactorGraph(factors)
        assert named(wrong_graph, optimum(wrong_graph, start)) == set()


def fitting(graph: FactorGraph, start: Values) -> tuple[list[tuple[int, int]], tuple[MisreadMeasurement, ...]]:
    """Places of the suspects, and which of these fit under another reading."""
    pattern, doubts = doubted(graph, optimum(graph, start))
    return doubts.places, misread_measurements(pattern, doubts.values, doubts.places)


@pytest.mark.parametrize(
    ("name", "k", "reading"),
    [
        ("sphere", 0, "exchanged"),
        ("sphere", 1, "transposed"),
        ("sphere", 1, "z flipped"),
        ("subsea", 1, "exchanged"),
        ("subsea", 2, "mirrored"),
        ("lines", 2, "mirrored"),
    ],
)
def test_a_measurement_is_named(name: str, k: int, reading: str) -> None:
    """Wherever it is a suspect: where the reading changes next to nothing it is none."""
    suspected = 0
    for seed in range(2):
        graph, start, _ = clean(name, seed)
        i = int(np.random.default_rng(seed).integers(2, len(graph.factors[k]) - 2))
        wrong = misread_one(graph, start, k, i, reading)
        place = (len(wrong.factors) - 1, 0)
        places, meant = fitting(wrong, start)
        assert all(one.place == place and one.t < 30 < 100 <= one.standing for one in meant)
        assert (reading in {one.reading for one in meant}) == (place in places)
        suspected += place in places
    assert suspected


@for_all(name=["ring", "manhattan", "sphere"], seed=range(3))
def test_a_wrong_closure_fits_under_no_reading(name: str, seed: int) -> None:
    graph, start, _ = clean(name, seed)
    assert fitting(misreadings.wrong_closure(graph, np.random.default_rng(seed)), start)[1] == ()


def alarms(graph: FactorGraph, values: Values) -> tuple[object, ...]:
    """All that the analyses say of a graph at its optimum."""
    pattern, doubts = doubted(graph, values)
    found, count = checked(graph, values), len(graph.factors)
    out = [*swapped_landmarks(graph, values, checks(found, count)), *clock_offsets(found, values, count)]
    out += [*misread_kinds(graph, values), *misread_measurements(pattern, doubts.values, doubts.places)]
    return *out, *calibrations(graph, values), *outsized(pattern)


@pytest.mark.parametrize("name", WORLDS)
def test_worlds(name: str) -> None:
    for seed in range(2):
        graph, _, values = clean(name, seed)
        assert alarms(graph, values) == (), seed


@pytest.mark.parametrize("name", PUBLIC)
def test_public_graphs(name: str, data: Path) -> None:
    assert alarms(*public(data / name)) == ()


POSES = 80


def weaving(t: Array) -> Array:
    """Poses (n, 3) of a vehicle at times t in steps: faster and slower, to the left and to the right."""
    s = t + 0.6 * np.sin(0.9 * t)
    return np.column_stack([s, 3 * np.sin(0.4 * s), np.arctan(1.2 * np.cos(0.4 * s))])


def survey(seed: int, dt: float, sensor: str) -> tuple[FactorGraph, Values]:
    """Odometry, fixes, headings and sightings, those of one sensor dt steps late."""
    rng, k = np.random.default_rng(seed), np.arange(POSES)
    X = {name: weaving(k + (dt if name == sensor else 0.0)) for name in ("odometry", "fix", "heading", "sight")}
    L = np.column_stack([np.linspace(0, POSES, 8), np.tile([5.0, -5.0], 4)])
    sigmas = np.array([0.05, 0.05, 0.01])
    odometry = SE2.retract(SE2.between(X["odometry"][:-1], X["odometry"][1:]), sigmas * rng.normal(size=(POSES - 1, 3)))
    i = np.repeat(k, 2)
    j = np.clip(np.column_stack([k // 12, k // 12 + 1]), 0, 7).reshape(-1)
    p = SE2.act(SE2.inverse(X["sight"][i]), L[j])
    z = np.hstack([direction(p)[0], distance(p)[0]]) + [0.01, 0.1] * rng.normal(size=(len(i), 2))
    z[:, 0] = wrap(z[:, 0])
    factors: list[Factor] = [
        Between(x[k[:-1]], x[k[1:]], odometry, Diagonal(sigmas)),
        Position(x[k], X["fix"][:, :2] + 0.1 * rng.normal(size=(POSES, 2)), Isotropic(0.1)),
        Heading(x[k], X["heading"][:, 2] + 0.02 * rng.normal(size=POSES), Isotropic(0.02)),
        f.BearingRange(x[i], l[j], z, Diagonal(bearing=0.01, range=0.1)),
    ]
    return FactorGraph(factors), Values({x: (SE2, weaving(k)), l: (R(2), L)})


def offsets(graph: FactorGraph, values: Values) -> tuple[ClockOffset, ...]:
    return clock_offsets(checked(graph, values), values, len(graph.factors))


@for_all(sensor=["fix", "heading", "sight"], dt=[0.3, -0.3])
def test_an_offset_is_estimated(sensor: str, dt: float) -> None:
    """Whatever the order of the poses in the stack."""
    graph, start = survey(int(dt < 0), dt, sensor)
    values = optimum(graph, start)
    (first,) = offsets(graph, values)
    assert first.kind == {"fix": "Position", "heading": "Heading", "sight": "BearingRange"}[sensor]
    assert first.dt == pytest.approx(dt, rel=0.25, abs=4 * first.sigma)
    assert first.chance < 1e-6
    order = np.random.default_rng(0).permutation(POSES)
    shuffled = Values({x: (SE2, values[x][order], order), l: (R(2), values[l])})
    (again,) = offsets(graph, shuffled)
    assert (again.dt, again.sigma, again.fall) == pytest.approx((first.dt, first.sigma, first.fall), rel=1e-4)


def test_other_mistakes_and_none_are_no_offset() -> None:
    """Nothing wrong; wrong sigmas, an outlier, a heading offset, a kernel, fixes in another frame."""
    for seed in range(1, 6):
        graph, start = survey(seed, 0.0, "")
        assert offsets(graph, optimum(graph, start)) == (), seed
    odometry, fixes, headings, sights = graph.factors
    far = np.array(fixes.z)
    far[20] += 3.0
    for wrong in (
        FactorGraph([odometry, Position(fixes.keys[0], fixes.z, Isotropic(0.02)), headings, sights]),
        FactorGraph([odometry, replaced(fixes, z=far), headings, sights]),
        FactorGraph([odometry, fixes, replaced(headings, z=headings.z + 0.2), sights]),
        FactorGraph([odometry, fixes.robust(f.Cauchy(1)), headings, sights]),
        misread(graph, start, 3, "mirrored"),
    ):
        assert offsets(wrong, optimum(wrong, start)) == ()


N = 12


@for_all(group=[SE2, SE3], seed=range(2))
def test_one_edge_is_too_long(group: type[SE2], seed: int) -> None:
    rng = np.random.default_rng(seed)
    X, k, i = walk(group, N, rng), np.arange(N - 1), int(rng.integers(N - 1))
    z = np.array(group.between(X[:-1], X[1:]))
    for times, expected in ((1e8, [(0, i)]), (1e4, [])):
        far = z.copy()
        far[i, : group.point_dim] *= times
        steps = Between(x[k], x[k + 1], far, Diagonal(np.full(group.dim, 0.1)))
        found = outsized(FactorGraph([steps]).pattern(Values({x: (group, X)})))
        assert [(one.place, one.quantity) for one in found] == [(place, "length") for place in expected]
        assert all(one.value > 1e6 * one.reference for one in found)


@for_all(seed=range(2))
def test_one_information_is_too_large(seed: int) -> None:
    """Of one component: also in a batch of its own, and not where it is a thousand times as large or where half are."""
    rng = np.random.default_rng(seed)
    X, k, i = walk(SE2, N, rng), np.arange(N - 1), int(rng.integers(N - 1))
    z, values = SE2.between(X[:-1], X[1:]), Values({x: (SE2, X)})
    for times, count, expected in ((1e7, 1, 1), (1e7, 2, 2), (1e3, 1, 0), (1e7, 6, 0)):
        Omega = np.tile(np.diag([100.0, 100.0, 2500.0]), (N - 1, 1, 1))
        wrong = np.sort(rng.permutation(N - 1)[:count])
        Omega[wrong, 2, 2] *= times
        steps = Between(x[k], x[k + 1], z, Information(Omega))
        apart, whole = (outsized(FactorGraph(f).pattern(values)) for f in ([steps[k != i], steps[[i]]], [steps]))
        assert len(apart) == expected
        assert {one.component for one in (*apart, *whole)} == ({"yaw"} if expected else set())
        assert sorted(one.place[1] for one in whole) == (wrong.tolist() if expected else [])


def test_components_are_compared_with_their_like() -> None:
    """A depth is sharper than a fix, and nothing is wrong with it; an information of 0 is none."""
    X, k = SE3.exp(0.1 * np.arange(48.0).reshape(8, 6)), np.arange(8)
    fix = Position(x[k], SE3.position(X)[:, :2], Diagonal([100.0, 100.0]), components=("x", "y"))
    depth = Position(x[k], SE3.position(X)[:, 2], Diagonal([1e-4]), components=("z",))
    blind = np.zeros((7, 6, 6))
    blind[:3] = np.eye(6)
    steps = Between(x[k[:-1]], x[k[1:]], SE3.between(X[:-1], X[1:]), Information(blind))
    assert outsized(FactorGraph([fix, depth, steps]).pattern(Values({x: (SE3, X)}))) == ()
