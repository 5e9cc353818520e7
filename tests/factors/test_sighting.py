"""Sightings: where targets are, which numbers are none, other mountings; what is done about a sonar's elevation."""

from __future__ import annotations

import re
from math import radians, sqrt

import numpy as np
import pytest

import factors as f
import models
from factors import Bearing, BearingRange, EpipolarArc, Huber, Isotropic, Range, RangeAzimuth, Sighting, sonar_factors
from factors.keys import Keys
from models import LINE, SE2, SE3, LieGroup, Manifold, R, euler
from models.errors import GraphError, OptionError
from models.sensors import DIDSON_HIGH, cartesian
from nls import FactorGraph, Kind, Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import error, linearized, refused, same

x, l, o = kinds("x", "l", "o")
UNIT = Isotropic()
NUMBERS = {f.Landmark: 3, Range: 1, Bearing: 2, BearingRange: 3, RangeAzimuth: 2}  # of a measurement in space


@for_all(case=[(f.Landmark, SE2), (f.Landmark, SE3), (BearingRange, SE2), (BearingRange, SE3), (f.Line, SE2)])
def test_locate_is_the_inverse_of_the_prediction(case: tuple[type[Sighting], LieGroup]) -> None:
    (kind, group), rng = case, np.random.default_rng(3)
    X, O = group.exp(rng.normal(size=(2, 6, group.dim)))
    points: Manifold = LINE if kind is f.Line else R(group.point_dim)
    for offset, more in ((None, ()), (O, ()), (O[0], ()), (o[0:6], (O,))):
        z = rng.uniform(0.3, 1.2, size=(6, group.point_dim))
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


@for_all(
    case=[
        (Range, x[[0, 1]], [1.0, -2.0], r"\(x1, l0\): its range is -2 m"),
        (Range, x[0], -1e-9, r"\(x0, l0\): its range is -1e-09 m"),
        (Range, x[[0, 1]], [[1.0], [-2.0]], r"\(x1, l0\)"),
        (BearingRange, x[[0, 1]], [[-1, 2], [-1, -3]], r"\(x1, l0\): its range is -3 m"),
        (BearingRange, x[[0, 1]], [[-1, -1, 2], [0, 0, -3]], r"\(x1, l0\)"),
        (RangeAzimuth, x[[0, 1]], [[5, -1], [-5, 1]], r"\(x1, l0\): its range is -5 m"),
        (RangeAzimuth, x[3], [-5, 0.1], r"\(x3, l0\)"),
    ]
)
def test_no_range_is_below_zero(case: tuple[type[Sighting], Keys, object, str]) -> None:
    kind, pose, z, named = case
    refused(lambda: kind(pose, l[0], z, UNIT), GraphError, f"^{kind.__name__}{named}")
    kind(pose, l[0], np.zeros_like(z), UNIT)  # 0 m is a range


@for_all(
    case=[
        (Bearing, x[0], 45.0, 0, r"\(x0, l0\): its bearing is 45 rad.* degrees"),
        (Bearing, x[[0, 1]], [0.5, -6.5], 0, r"\(x1, l0\): its bearing is -6.5 rad"),
        (Bearing, x[[0, 1]], [[0, 1], [0, 7]], 1, r"\(x1, l0\): its elevation is 7 rad"),
        (BearingRange, x[0], [90, 30], 0, r"\(x0, l0\): its bearing is 90 rad"),
        (BearingRange, x[[0, 1]], [[1, -80, 700], [1, 0, 2]], 1, r"\(x0, l0\): its elevation is -80 rad"),
        (RangeAzimuth, x[[0, 1]], [[9, 1], [90, 12]], 1, r"\(x1, l0\): its azimuth is 12"),
    ]
)
def test_an_angle_beyond_a_turn_has_two_cures_that_work_to_the_letter(
    case: tuple[type[Sighting], Keys, object, int, str],
) -> None:
    kind, pose, numbers, column, named = case
    caught = refused(lambda: kind(pose, l[0], numbers, UNIT), GraphError, f"^{kind.__name__}{named}")
    cures = re.findall(r"z[^ ]*(?: \d\])? = [a-z.]+\(z[^)]*\)", str(caught))
    assert ["radians" in cure for cure in cures] == [True, False]
    for cure in cures:
        scope = {"np": np, "models": models, "z": np.array(numbers, dtype=float)}
        exec(cure, scope)
        z = np.asarray(kind(pose, l[0], scope["z"], UNIT).z, dtype=float).reshape(len(pose), -1)
        assert set(np.nonzero(z != np.reshape(numbers, z.shape))[1]) == {column}


@for_all(kind=NUMBERS)
def test_mounted_elsewhere(kind: type[Sighting]) -> None:
    """A sensor moved is one made there; a variable at the place of the fixed offset measures the same."""
    rng = np.random.default_rng(5)
    X, O = SE3.exp(rng.normal(size=(2, 3, 6)))
    values = Values({x: (SE3, X), l: (R(3), rng.normal(size=(3, 3)) + 9), o: (SE3, O[:1])})
    z = np.full((3, NUMBERS[kind]), 0.1)
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
    hinge = f.ElevationHinge(x[0], l[[0, 1]], 0.1, 0.02).mounted(o[0])
    assert (hinge.limit, hinge.noise.sigma, hinge.slots[0]) == (0.1, 0.02, SE3)
    robust = Range(x[0], l[0], 1.0, UNIT).robust(Huber(2.0)).mounted([1.0, 0.0, 0.0])
    assert robust.kernel == Huber(2.0)
    with pytest.raises(GraphError, match="connects l0 to itself"):
        Range(x[0], l[0], 1.0, UNIT).mounted(l[0])


LIMIT = DIDSON_HIGH.aperture / 2
MOUNTED = euler.to_se3(np.array([0.0, -0.6, 0.0, 0.3, 0.0, 0.1]))


def test_treatments_of_the_elevation() -> None:
    pose, target, z = x[[3, 1, 2]], l[[8, 8, 5]], [[5.0, 0.1], [4.0, 0.2], [3.0, -0.1]]

    def made(**more: object) -> list[f.Factor]:
        return sonar_factors(pose, target, z, None, DIDSON_HIGH, offset=SE3.identity()[0], **more)

    (contacts,) = made(elevation="free")
    same(contacts.noise.sqrt_information(3, ("range", "azimuth")), 1 / DIDSON_HIGH.noise_sigmas[None])
    hinge = made(softness=0.05)[1]
    assert isinstance(hinge, f.ElevationHinge)
    assert (hinge.limit, hinge.keys, hinge.noise.sigma) == (LIMIT, contacts.keys, 0.05)
    prior = made(elevation="prior")[1]
    assert type(prior) is f.Elevation
    assert prior.keys == (x[[2, 1]], l[[5, 8]]), "of the first contact of each landmark"
    same(prior.noise.sigma, radians(14) / sqrt(12))
    for factor in (contacts, hinge, prior):
        assert np.array_equal(factor.offset, SE3.identity())
    with pytest.raises(OptionError, match=r"elevation: 'bounded' .* free, hinge, prior or search"):
        made(elevation="bounded")


def test_the_search_pairs_the_first_contact_of_every_target_with_its_later_ones() -> None:
    """Targets 8, 5 and 6 from poses in any order; 6 is seen once."""
    pose, target = x[[3, 1, 2, 4, 7, 2]], l[[8, 8, 5, 6, 8, 8]]
    z = np.array([[5.0, 0.1], [4.0, 0.2], [3.0, -0.1], [6.0, 0.0], [5.5, 0.05], [4.5, 0.15]])
    sigmas = np.arange(1.0, 13.0).reshape(6, 2) / 100

    def made(noise: f.Noise | None = None, offset: object = None) -> EpipolarArc:
        (factor,) = sonar_factors(pose, target, z, noise, DIDSON_HIGH, offset, elevation="search")
        assert isinstance(factor, EpipolarArc)
        return factor

    arcs = made(f.Diagonal(sigmas), MOUNTED)
    assert arcs.keys == (x[[1, 1, 1]], x[[3, 7, 2]])
    same(arcs.z, np.hstack([z[[1, 1, 1]], z[[0, 4, 5]]]))
    W = arcs.noise.sqrt_information(3, EpipolarArc.measures)
    same(W, np.eye(4) / np.hstack([np.sqrt(3) * sigmas[[1, 1, 1]], sigmas[[0, 4, 5]]])[:, None])  # divided by 3 pairs
    assert arcs.limit == LIMIT
    same(arcs.offset, MOUNTED[None])
    same(
        made().noise.sqrt_information(3, EpipolarArc.measures)[-1],
        np.diag(1 / np.tile(DIDSON_HIGH.noise_sigmas, 2) / np.sqrt([3, 3, 1, 1])),
    )
    assert made(f.Robust(Isotropic(0.1), Huber(2.0))).kernel == Huber(2.0)
    each = np.tile(MOUNTED, (6, 1))
    same(made(offset=each).offset, each[:3])
    each[4] = SE3.identity()[0]
    two, three = [[4, 0.1], [4, 0.2]], [1, 2, 3]
    for make, named in (
        (lambda: made(offset=each), r"RangeAzimuth\(x\[1, 7\], l\[8, 8\]\): two offsets"),
        (lambda: made(offset=o[0]), "the offset o0 is a variable"),
        (lambda: sonar_factors(x[[0, 1]], l[0], three, None, DIDSON_HIGH, elevation="search"), r"RangeAz.* \(3,\)"),
        (lambda: sonar_factors(x[[2, 2]], l[0], two, None, DIDSON_HIGH, elevation="search"), "x2 to itself"),
    ):
        refused(make, GraphError, named)
    (none,) = sonar_factors(x[0:3], l[0:3], z[:3], None, DIDSON_HIGH, elevation="search")
    assert len(none) == 0
    graph = FactorGraph([none, f.Prior(x[0], SE3.identity()[0], UNIT)])
    assert graph.optimize(Values({x: (SE3, SE3.identity())})).dof == 0


def test_a_hinge_pushes_until_the_target_is_inside_again() -> None:
    """Beyond by d, one measurement of sigma s: chi2 is (d / s)^2, and its derivative is that of the elevation."""
    factor = f.ElevationHinge(x[[0, 0, 0, 0]], l[0:4], LIMIT, softness=radians(1))
    el = np.array([LIMIT + radians(2), -LIMIT - radians(3), LIMIT - 1e-9, -LIMIT / 2])
    values = Values({x: (SE3, SE3.identity()), l: (R(3), cartesian(np.stack([[4.0] * 4, [0.1] * 4, el], axis=1))[0])})
    same(factor.chi2(values), [4.0, 9.0, 0.0, 0.0], atol=1e-12)
    A, b = linearized(factor, values)
    assert (b[0] < 0).all()  # back, towards 0
    assert (b[1] > 0).all()
    known = f.Elevation(x[[0, 0, 0, 0]], l[0:4], 0.0, Isotropic(radians(1)))
    for A_k, of_elevation in zip(A, linearized(known, values)[0], strict=True):
        same(A_k[:2], of_elevation[:2], atol=1e-12)
        same(A_k[2:], 0.0)
    assert factor.damped


def test_points_have_the_axes_of_the_world_and_no_offset() -> None:
    values = Values({o: (R(2), [[0.0, 0.0], [2.0, 0.0]]), l: (R(2), [1.0, 0.5])})
    seen = FactorGraph([Bearing(o[[0, 1]], l[0], [np.pi / 4, 3 * np.pi / 4], UNIT)], [o[[0, 1]]])
    same(seen.optimize(values).values[l[0]], [1.0, 1.0], atol=1e-6)
    values.add(Kind("x"), SE2, [0.0, 0.0, 0.3])
    for factor, named in (
        (Range(o[0], l[0], 1.0, UNIT, offset=[0, 0]), r"o0 is a point in R\(2\), which has no axes for an offset"),
        (Range(o[0], x[0], 1.0, UNIT), r"o0 is in R\(2\), expected a pose, SE2 or SE3, or a point like its target"),
        (f.Landmark(o[0], l[0], [1, 1], UNIT), r"o0 is in R\(2\), expected a pose, SE2 or SE3$"),
    ):
        refused(lambda factor=factor: values.gather(factor), GraphError, named)


def test_a_bearing_from_a_point_keeps_a_pose_from_being_held() -> None:
    """A landmark's bearing to another one says where north is, so no pose may be held with its heading."""
    values = Values({x: (SE2, [[0, 0, 0.3], [2, 0, 0.3]]), l: (R(2), [[2.0, 2.0], [4.0, 4.0]])})
    seen = f.Landmark(x[[0, 0, 1, 1]], l[[0, 1, 0, 1]], [[2, 2], [4, 4], [0, 2], [2, 4]], UNIT)
    for sort, held in ((Range(l[0], l[1], sqrt(8), UNIT), x[0]), (Bearing(l[0], l[1], np.pi / 2, UNIT), l[0])):
        result = FactorGraph([f.Between(x[0], x[1], [2, 0, 0], UNIT), seen, sort]).optimize(values)
        assert (result.gauge, result.chi2_final < 1e-12) == (f"{held} fixed", True)
