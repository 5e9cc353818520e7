"""Landmark, Range, Bearing and BearingRange: where the sensor sits, what is refused, what they are good for."""

from __future__ import annotations

import re
from math import pi

import numpy as np
import numpy.typing as npt
import pytest

import models
from factors import (
    Bearing,
    BearingRange,
    Between,
    Diagonal,
    ElevationHinge,
    Factor,
    Huber,
    Isotropic,
    Landmark,
    Range,
    RangeAzimuth,
    Sighting,
)
from factors.keys import Keys
from models import SE2, SE3, SO2, LieGroup, R
from models.errors import GraphError, SingularGeometryError
from nls import FactorGraph, Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import error, linearized, refused, same

Array = npt.NDArray[np.float64]
x, l, o = kinds("x", "l", "o")
UNIT = Isotropic()
QUARTER = [0.5, 0.0, pi / 2]  # half a meter ahead, looking to the vehicle's +y
KINDS = [Landmark, Range, Bearing, BearingRange]
NUMBERS = {Landmark: (2, 3), Range: (1, 1), Bearing: (1, 2), BearingRange: (2, 3)}


def plane(**more: object) -> Values:
    return Values({x: (SE2, [[1.0, 2.0, pi / 2], [0, 0, 0], [0, 0, 0]]), l: (R(2), [[1.0, 5.0], [4.0, 2.0]]), **more})


@for_all(group=[SE2, SE3], kind=[Landmark, BearingRange])
def test_locate_is_the_inverse_of_the_prediction(kind: type[Sighting], group: LieGroup) -> None:
    rng = np.random.default_rng(3)
    X, O = group.exp(rng.normal(size=(2, 6, group.dim)))
    points = R(group.point_dim)
    for offset, more in ((None, ()), (O, ()), (O[0], ()), (o[0:6], (O,))):
        z = points.exp(rng.uniform(0.3, 1.2, size=(6, group.point_dim)))
        factor = kind(x[0:6], l[0:6], z, UNIT, offset)
        assert factor.locates
        S = factor.sensor_pose(group, X, *more)
        L = factor.locate(group, S, z)
        assert L.shape == (6, group.point_dim)
        same(error(factor, Values({x: (group, X), l: (points, L), o: (group, O)})), 0.0, atol=1e-13)


def test_one_number_locates_nothing() -> None:
    for kind in (Range, Bearing):
        factor = kind(x[0], l[0], 1.0, UNIT)
        assert not factor.locates
        refused(lambda f=factor: f.locate(SE2, SE2.identity(), np.ones((1, 1))), NotImplementedError, kind.__name__)
    assert np.array_equal(Range(x[0], l[0], 1.0, UNIT).ranges(np.array([[2.5], [3.5]])), [2.5, 3.5])
    assert Bearing(x[0], l[0], 1.0, UNIT).ranges(np.ones((1, 1))) is None


ZERO = np.zeros((2, 3))
SPACE = Values({x: (SE3, SE3.identity(2)), l: (R(3), [[0, 0, 5.0], [1, 2, 3]]), o: (SE2, ZERO)})


@for_all(
    case=[
        (Landmark(x[0], l[0], [1, 2], UNIT), SPACE, r"Landmark\(x0, l0\): R\(3\): .*\(2,\)"),
        (Landmark(x[0], l[0], [1, 2, 3], UNIT), plane(), r"Landmark\(x0, l0\): R\(2\): .*\(3,\)"),
        (Range(x[0], l[0:2], [1, 2, 3], UNIT), plane(), "Range.* 3 measurements for 2"),
        (Range(x[0], l[0:2], [[1, 2]], UNIT), plane(), r"Range.*\(range\): .*\(1, 2\), exp.*n, 1"),
        (Bearing(x[0], l[0], [1, 2], UNIT), plane(), "2 measurements for 1"),
        (Bearing(x[0], l[0], 1, UNIT), SPACE, r"\(azimuth, elevation\): .*\(\), expected \(n, 2\)"),
        (BearingRange(x[0], l[0], 1, UNIT), plane(), r"\(bearing, range\): .*\(\), expected \(n, 2\)"),
        (Range(l[0], x[0], 1, UNIT), plane(), r"Range\(l0, x0\): l0 is in R\(2\), expected .*SE2 or SE3"),
        (
            Range(x[0], l[0], 1, UNIT),
            Values({x: (SE2, ZERO), l: (R(3), ZERO)}),
            r"Range\(x0, l0\): .* l0 is in R\(3\); .*R\(2\) or SE2",
        ),
        (
            Bearing(x[0], l[0], [1, 2], UNIT),
            Values({x: (SE3, SE3.identity(1)), l: (SE2, ZERO)}),
            r"l0 is in SE2; .*R\(3\) or SE3",
        ),
        (
            Range(x[0], l[0], 1, UNIT),
            Values({x: (SO2, [0.0]), l: (R(2), [[1, 1]])}),
            r"Range\(x0, l0\): x0 is in SO2, expected .*SE2 or SE3",
        ),
        (Range(x[0], l[0], 1, UNIT, o[0]), SPACE, r"Range\(x0, l0, o0\): the offset o0 is in SE2, expected SE3"),
        (Range(x[0], l[0], 1, UNIT, [1, 2]), plane(), r"Range\(x0, l0\): offset: SE2: .*\(1, 2\), exp"),
        (Range(x[0], l[0], 1, UNIT, [1, np.nan, 2]), plane(), "offset: SE2: element 0 .* not finite"),
        (Range(x[0], l[0], 1, UNIT, np.ones(7)), SPACE, "offset: SE3: .*length 2, expected 1"),
        (Range(x[0], l[0], 1, UNIT, ZERO), plane(), r"Range\(x0, l0\): 2 offsets for 1"),
        (Range(x[0:3], l[0], 1, UNIT, ZERO), plane(), "2 offsets for 3"),
    ]
)
def test_what_does_not_fit(case: tuple[Factor, Values, str]) -> None:
    factor, values, named = case
    refused(lambda: values.gather(factor), GraphError, named)


@for_all(
    case=[
        (Range, x[[0, 1]], [1.0, -2.0], r"\(x1, l0\): its range is -2 m"),
        (Range, x[0], -1e-9, r"\(x0, l0\): its range is -1e-09 m"),
        (Range, x[[0, 1]], [[1.0], [-2.0]], r"\(x1, l0\)"),
        (BearingRange, x[[0, 1]], [[-1, 2], [-1, -3]], r"\(x1, l0\): its range is -3 m"),
        (BearingRange, x[[0, 1]], [[-1, -1, 2], [0, 0, -3]], r"\(x1, l0\)"),
        (RangeAzimuth, x[[0, 1]], [[5, -1], [-5, 1]], r"\(x1, l0\): its range is -5 m"),
        (RangeAzimuth, x[3], [-5, 0.1], r"\(x3, l0\)"),
        (Bearing, x[0], 45.0, r"\(x0, l0\): its bearing is 45 rad.* degrees"),
        (Bearing, x[[0, 1]], [0.5, -6.3], r"\(x1, l0\): its bearing is -6.3 rad"),
        (Bearing, x[[0, 1]], [[0, 1], [0, 7]], r"\(x1, l0\): its elevation is 7 rad"),
        (BearingRange, x[0], [90, 3], r"\(x0, l0\): its bearing is 90 rad"),
        (RangeAzimuth, x[[0, 1]], [[9, 1], [9, 12]], r"\(x1, l0\): its azimuth is 12"),
    ]
)
def test_no_range_is_below_zero_and_no_direction_beyond_a_turn(case: tuple[type[Sighting], Keys, object, str]) -> None:
    kind, pose, z, named = case
    refused(lambda: kind(pose, l[0], z, UNIT), GraphError, f"^{kind.__name__}{named}")


@for_all(
    case=[
        (Bearing, x[0], -6.5, 0),
        (Bearing, x[[0, 1]], [0.5, 45.0], 0),
        (Bearing, x[[0, 1]], [[0, 1], [0, 7]], 1),
        (BearingRange, x[0], [90, 30], 0),
        (BearingRange, x[[0, 1]], [[1, -80, 700], [1, 0, 2]], 1),
        (RangeAzimuth, x[[0, 1]], [[9, 1], [90, 12]], 1),
    ]
)
def test_both_cures_of_an_angle_beyond_a_turn_work_to_the_letter(
    case: tuple[type[Sighting], Keys, object, int],
) -> None:
    kind, pose, numbers, column = case
    with pytest.raises(GraphError) as caught:
        kind(pose, l[0], numbers, UNIT)
    cures = re.findall(r"z[^ ]*(?: \d\])? = [a-z.]+\(z[^)]*\)", str(caught.value))
    assert ["radians" in cure for cure in cures] == [True, False]
    for cure in cures:
        scope = {"np": np, "models": models, "z": np.array(numbers, dtype=float)}
        exec(cure, scope)
        z = np.asarray(kind(pose, l[0], scope["z"], UNIT).z, dtype=float).reshape(len(pose), -1)
        assert set(np.nonzero(z != np.reshape(numbers, z.shape))[1]) == {column}


def test_the_offset_given_stays_the_offset() -> None:
    bow = r"Range\(x0, l0\): its offset is not an array of numbers"
    refused(lambda: Range(x[0], l[0], 1, UNIT, offset=["bow", 0, 0]), GraphError, bow)
    given = np.array(QUARTER)
    factor = Range(x[0], l[0], 2.5, UNIT, given)
    given[:] = 9.0
    same(error(factor, plane()), 0.0, atol=1e-15)
    assert isinstance(factor.offset, np.ndarray)
    with pytest.raises(ValueError, match="read-only"):
        factor.offset[0, 0] = 1.0
    assert Range(x[0], l[0], 1, UNIT).offset is None
    assert Range(x[0:2], l[0], 1, UNIT, o[0]).offset == Keys("o", [0, 0])


@for_all(
    case=[
        (Range(x[0:2], l[0:2], 1, UNIT), r"Range\(x1, l1\): .* at the sensor"),
        (Bearing(x[0:2], l[0:2], 1, UNIT), r"Bearing\(x1, l1\): .* at the sensor"),
        (BearingRange(x[0:2], l[0:2], [1, 1], UNIT), r"BearingRange\(x1, l1\): .*zero range"),
        (Bearing(x[0:2], l[[1, 0]], [1, 1], UNIT), r"Bearing\(x1, l0\): .* z axis"),
        (BearingRange(x[0:2], l[[1, 0]], [1, 1, 1], UNIT), r"BearingRange\(x1, l0\): .* z axis"),
    ]
)
def test_singular_geometry_names_the_measurement(case: tuple[Factor, str]) -> None:
    factor, named = case
    here = SPACE if "z axis" in named else Values({x: (SE2, ZERO), l: (R(2), [[1.0, 0.0], [0.0, 0.0]])})
    for evaluate in (error, linearized):
        caught = refused(lambda evaluate=evaluate: evaluate(factor, here), SingularGeometryError, named)
        assert caught.factor == type(factor).__name__
        assert caught.keys == tuple(k[[1]] for k in factor.keys)
    at_sensor = Values({x: (SE2, [[1.0, 2.0, 0.3]]), l: (R(2), [[1.0, 2.0]])})
    same(error(Landmark(x[0], l[0], [0, 0], UNIT), at_sensor), 0.0, atol=1e-15)


def surveyed(turns: Array) -> tuple[FactorGraph, Values, Array, Array]:
    """A vehicle that steps 1 m and turns, and a sensor, mounted nobody knows how, that sees six points."""
    rng, mount = np.random.default_rng(4), np.array([0.6, -0.2, 0.35])
    steps = np.stack([np.ones(len(turns)), np.zeros(len(turns)), turns], axis=1)
    path = [np.zeros(3)]
    for step in steps:
        path.append(SE2.compose(path[-1], step))
    n, X, L = len(path), np.array(path), rng.uniform(-4, 8, size=(6, 2))
    i, k = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(6)))
    S = SE2.compose(X, mount)[i]
    d = L[k] - S[:, :2]
    z = np.stack([np.arctan2(d[:, 1], d[:, 0]) - S[:, 2], np.linalg.norm(d, axis=1)], axis=1)
    odometry = Between(x[0 : n - 1], x[1:n], steps, Diagonal(x=0.01, y=0.01, yaw=0.01))
    sightings = BearingRange(x[i], l[k], z, Diagonal(bearing=0.01, range=0.05), offset=o[0])
    start = Values({x: (SE2, X), l: (R(2), L + rng.normal(scale=0.1, size=L.shape)), o: (SE2, [0.5, 0.0, 0.2])})
    return FactorGraph([odometry, sightings]), start, L, mount


def test_the_mounting_of_a_sensor_is_found() -> None:
    graph, start, L, mount = surveyed(np.repeat([0.4, -0.6], 7))
    graph.fix(x[0])
    result = graph.optimize(start)
    assert result.converged
    same(result.values[o[0]], mount, atol=1e-6)
    same(result.values[l], L, atol=1e-6)


@for_all(kind=[*KINDS, RangeAzimuth])
def test_mounted_elsewhere(kind: type[Sighting]) -> None:
    """The same as a factor made there; a variable at the place of the fixed offset measures the same."""
    rng = np.random.default_rng(5)
    X, O = SE3.exp(rng.normal(size=(2, 3, 6)))
    values = Values({x: (SE3, X), l: (R(3), rng.normal(size=(3, 3)) + 9), o: (SE3, O[:1])})
    z = np.full((3, 2 if kind is RangeAzimuth else NUMBERS[kind][1]), 0.1)
    bare = kind(x[0:3], l[0:3], z, Isotropic(0.5))
    fixed, free = bare.mounted(O[0]), bare.mounted(o[0])
    assert type(fixed) is type(free) is kind
    assert bare.offset is None
    assert (len(bare.keys), len(fixed.keys), len(free.keys)) == (2, 2, 3)
    assert free.unmoved == (2,)
    same(error(fixed, values), error(kind(x[0:3], l[0:3], z, Isotropic(0.5), O[0]), values), atol=0)
    same(error(free, values), error(fixed, values), atol=1e-13)
    same(error(free.mounted(None), values), error(bare, values), atol=0)
    same(error(free[1], values), error(fixed[1], values), atol=1e-13)
    assert np.abs(error(bare, values) - error(fixed, values)).max() > 0.1
    assert free.slots[0] is bare.slots[0]


def test_mounted_keeps_what_else_a_factor_holds() -> None:
    hinge = ElevationHinge(x[0], l[[0, 1]], 0.1, 0.02).mounted(o[0])
    assert (hinge.limit, hinge.noise.sigma, hinge.slots[0]) == (0.1, 0.02, SE3)
    robust = Range(x[0], l[0], 1.0, UNIT).robust(Huber(2.0)).mounted([1.0, 0.0, 0.0])
    assert robust.kernel == Huber(2.0)
    with pytest.raises(GraphError, match="joins l0 to itself"):
        Range(x[0], l[0], 1.0, UNIT).mounted(l[0])
