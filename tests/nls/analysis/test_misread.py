"""Readings undo themselves and say by hand what they say; kinds and single measurements read otherwise are named."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest

from factors import (
    XYH,
    ZPR,
    Bearing,
    Between,
    BetweenSensors,
    Diagonal,
    Factor,
    Heading,
    Isotropic,
    Landmark,
    Position,
    Prior,
    RangeAzimuth,
    Wheels,
)
from factors.keys import Keys
from factors.replaced import replaced
from models import SE2, SE3, Manifold, Measured, R
from models.algebra import Array
from models.errors import GraphError
from models.manifolds.so3 import rotation3
from nls import FactorGraph, Values, kinds
from nls.analysis.misread import READINGS, MisreadMeasurement, misread_kinds, misread_measurements
from nls.analysis.scales import outsized
from tests.combinations import for_all
from tests.nls.graphs import walk
from tests.nls.misreadings import clean, doubted, misread_one, optimum, wrong_closure
from tests.nls.misreadings import misread as misread_kind
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
        (Bearing(x[0], l[0], 0.4, ONE), "mirrored", [-0.4]),
        (Heading(x[0], 0.4, ONE), "transposed", [-0.4]),
        (Heading(x[0], 0.4, ONE), "x, y exchanged", [np.pi / 2 - 0.4]),
        (Position(x[0], [1, 2], ONE), "y flipped", [1, -2]),
        (Position(x[0], [1, 2], ONE), "x, y exchanged", [2, 1]),
        (Landmark(x[0], l[0], [1, 2], ONE), "y flipped", [1, -2]),
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
    meant = reread(BetweenSensors(x[0], x[1], [1, 2, 0.5], ONE, ([0.1, 0, 0], [0.2, 0, 0])), "exchanged", PLANE)
    assert meant.keys == (x[[1]], x[[0]])
    assert vars(meant)["offset"][0].tolist() == [[0.2, 0, 0]]


@for_all(
    case=[
        (SPACE, Between(x[0], x[1], POSE, ONE), {"exchanged", "transposed", "y flipped", "z flipped"}),
        (SPACE, XYH(x[0], x[1], [1, 0, 0.1], ONE), {"exchanged", "transposed", "y flipped"}),
        (SPACE, ZPR(x[0], [1, 0, 0.1], ONE), {"z flipped"}),
        (SPACE, RangeAzimuth(x[0], l[0], [1, 0.1], Diagonal(range=0.1, azimuth=0.1)), {"mirrored"}),
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
    wrong = misread_kind(graph, start, k, reading)
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


def misread(graph: FactorGraph, start: Values) -> tuple[list[tuple[int, int]], tuple[MisreadMeasurement, ...]]:
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
        places, meant = misread(wrong, start)
        assert all(one.place == place and one.t < 30 < 100 <= one.standing for one in meant)
        assert (reading in {one.reading for one in meant}) == (place in places)
        suspected += place in places
    assert suspected


@for_all(name=["ring", "manhattan", "sphere"], seed=range(3))
def test_a_wrong_closure_fits_under_no_reading(name: str, seed: int) -> None:
    graph, start, _ = clean(name, seed)
    assert misread(wrong_closure(graph, np.random.default_rng(seed)), start)[1] == ()
