"""Position, Heading, Prior and Between with offsets, and the camera of bundle adjustment."""

from __future__ import annotations

import gzip
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from factors import (
    Between,
    BetweenSensors,
    BundleProjection,
    Diagonal,
    Factor,
    Heading,
    Isotropic,
    Position,
    Prior,
    check_jacobians,
)
from factors.bundle import CAMERA, LENS
from models import SE2, SE3, SO3, R, euler
from models.errors import GraphError, NoiseModelError, SingularGeometryError
from models.sensors import project
from nls import FactorGraph, Values, kinds

Array = npt.NDArray[np.float64]
same = np.testing.assert_allclose
x, c, f, l, o = kinds("x", "c", "f", "l", "o")
UNIT = Isotropic()
PLANE = Values({x: (SE2, [[1.0, 2.0, pi / 2], [4.0, 6.0, 0.3]]), l: (R(2), [[0.0, 0.0]])})
SPACE = Values(
    {x: (SE3, euler.to_se3([[0.0, 0.0, pi / 2, 1, 2, 3], [0.1, 0.2, 0.3, 4, 5, 6]])), l: (R(3), [[0, 0, 0]])}
)


def error(factor: Factor, values: Values) -> Array:
    model, X = values.gather(factor)
    return model.error(*X)


def test_position_by_hand() -> None:
    same(error(Position(x[0], [0, 0], UNIT), PLANE), [[-1, -2]])
    same(error(Position(x[0], [0, 0], UNIT, offset=[3, 0]), PLANE), [[-1, -5]])
    same(error(Position(x[0:2], [10, 20], UNIT, ("y",)), PLANE), [[8], [14]])
    same(error(Position(x[0], [0, 0, 0], UNIT, offset=[3, 0, 1]), SPACE), [[-1, -5, -4]])
    same(error(Position(x[0:2], [10, 20], Diagonal(depth=0.5), ("depth",)), SPACE), [[14], [28]])
    same(error(Position(x[0], [0, 0], Diagonal(x=0.5, z=0.1), ("z", "x")), SPACE), [[-30, -2]])


def test_every_fix_may_have_its_own_lever_arm() -> None:
    both = error(Position(x[0:2], [0, 0], UNIT, offset=[[3, 0], [0, 2]]), PLANE)
    same(both, [[-1, -5], [-4 + 2 * sin(0.3), -6 - 2 * cos(0.3)]])


def test_the_noise_of_a_position_is_along_the_axes_of_the_world_that_of_a_prior_is_not() -> None:
    """The vehicle looks along +y: its own x is the y of the world."""
    model, X = PLANE.gather(Position(x[0], [1.0, 3.0], Diagonal(x=10.0, y=0.1)))
    same(model.error(*X), [[0.0, 10.0]], atol=1e-12)
    model, X = PLANE.gather(Prior(x[0], [1.0, 3.0, pi / 2], Diagonal(x=10.0, y=0.1, yaw=1.0)))
    same(model.error(*X), [[0.1, 0.0, 0.0]], atol=1e-12)


def test_heading_wraps_and_does_not_move_the_vehicle() -> None:
    values = Values({x: (SE2, [[1.0, 2.0, -3.1]])})
    model, X = values.gather(Heading(x[0], 3.1, Diagonal(heading=0.1)))
    (A,), b = model.linearize(*X)
    same(b, [[(6.2 - 2 * pi) / 0.1]])
    same(A, [[[0, 0, 10]]])
    model, X = SPACE.gather(Heading(x[1], 0.3, UNIT))
    (A,), b = model.linearize(*X)
    same(b, 0.0, atol=1e-14)
    same(A, [[[0, 0, 0, 0, sin(0.1) / cos(0.2), cos(0.1) / cos(0.2)]]])


def test_gimbal_lock_is_named() -> None:
    values = Values({x: (SE3, euler.to_se3([[0, 0.1, 0, 0, 0, 0], [0, pi / 2, 0, 0, 0, 0]]))})
    model, X = values.gather(Heading(x[0:2], [0.0, 0.0], UNIT))
    with pytest.raises(SingularGeometryError, match=r"Heading\(x1\): the pose is at gimbal lock") as caught:
        model.error(*X)
    assert (caught.value.factor, caught.value.keys) == ("Heading", (x[[1]],))


def test_a_prior_of_a_sensor_by_hand() -> None:
    """Half a meter ahead of (1, 2), looking to the left of +y."""
    model, X = PLANE.gather(Prior(x[0], [1.0, 2.5, -pi], UNIT, offset=[0.5, 0.0, pi / 2]))
    (A,), b = model.linearize(*X)
    same(b, 0.0, atol=1e-15)
    same(A, [[[0, 1, 0.5], [-1, 0, 0], [0, 0, 1]]], atol=1e-15)
    offsets = [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0]]
    found = error(Prior(x[0:2], [0, 0, 0], UNIT, ("yaw",), offset=offsets), PLANE)
    same(found, [[-pi / 2], [-0.3]])
    z = SE2.compose(PLANE[x], offsets)
    same(error(Prior(x[0:2], z, UNIT, offset=offsets), PLANE), 0.0, atol=1e-14)


def test_between_sensors_by_hand() -> None:
    """From (1, 2) + 1 ahead, looking along +y, to (4, 6) seen from the frame turned by 0.3."""
    factor = BetweenSensors(x[0], x[1], [3.0, -3.0, 0.3 - pi / 2], UNIT, ([1, 0, 0], [0, 0, 0]))
    same(error(factor, PLANE), 0.0, atol=1e-14)


@pytest.mark.parametrize("convention", ["log", "g2o", "graphslam", "gtsam"])
def test_between_sensors_at_the_origin_is_between(convention: str) -> None:
    rng = np.random.default_rng(1)
    for group in (SE2, SE3, SO3):
        values = Values({x: (group, group.exp(rng.normal(size=(4, group.dim))))})
        z, e = group.exp(rng.normal(size=(2, group.dim))), group.identity()[0]
        found = []
        for factor in (
            BetweenSensors(x[0:2], x[2:4], z, UNIT, (e, e), convention),
            Between(x[0:2], x[2:4], z, UNIT, convention),
        ):
            model, X = values.gather(factor)
            found.append(model.linearize(*X))
        same(found[0][1], found[1][1], atol=1e-14)
        for A, B in zip(found[0][0], found[1][0], strict=True):
            same(A, B, atol=1e-13)


def test_every_pair_may_have_its_own_offsets() -> None:
    rng = np.random.default_rng(2)
    X, O_i, O_j = (SE3.exp(rng.normal(size=(n, 6))) for n in (6, 3, 3))
    values = Values({x: (SE3, X)})
    z = SE3.between(SE3.compose(X[:3], O_i), SE3.compose(X[3:], O_j))
    same(error(BetweenSensors(x[0:3], x[3:6], z, UNIT, (O_i, O_j)), values), 0.0, atol=1e-13)
    for k in range(3):
        same(error(BetweenSensors(x[k], x[k + 3], z[k], UNIT, (O_i[k], O_j[k])), values), 0.0, atol=1e-13)


def test_hand_and_eye() -> None:
    """Two turns about different axes tell how the camera is mounted."""
    rng = np.random.default_rng(3)
    X = SE3.exp(rng.uniform(-1, 1, size=(6, 6)))
    mount = SE3.exp([0.3, -0.2, 0.1, 0.2, -0.3, 0.4])
    z = SE3.between(SE3.compose(X[:-1], mount), SE3.compose(X[1:], mount))
    graph = FactorGraph(
        [BetweenSensors(x[0:5], x[1:6], z, Isotropic(0.01), o[0]), Prior(x[0:6], X, Isotropic(1e-3))],
    )
    result = graph.optimize(Values({x: (SE3, X), o: (SE3, SE3.identity())}))
    assert result.converged
    same(SE3.local(mount, result.values[o[0]]), 0.0, atol=1e-6)


BUNDLE = Values(
    {c: (CAMERA, [[0, 0, 0, 0, 0, -2.0]] * 2), f: (LENS, [[100.0, 0.1, 0.0]]), l: (R(3), [[1.0, 0, 0], [1.0, 0, 2.0]])}
)


@pytest.mark.parametrize(
    ("factor", "values", "message"),
    [
        (
            Position(x[0], [1, 2, 3], UNIT),
            PLANE,
            r"Position\(x0\): \(x, y\): elements have shape \(3,\), expected \(n, 2",
        ),
        (Position(x[0], [1, 2], UNIT, ("x", "z")), PLANE, r"Position\(x0\): components \('x', 'z'\) of \('x', 'y'\)"),
        (Position(x[0], [1, 2], UNIT, ()), PLANE, r"components \(\) of"),
        (Position(x[0], [1, 2], UNIT, ("x", "x")), PLANE, r"components \('x', 'x'\) of"),
        (Position(x[0], [1, 2], UNIT, ("yaw",)), PLANE, r"components \('yaw',\) of"),
        (Position(x[0], [1, 2], UNIT, offset=[1, 2, 3]), PLANE, r"Position\(x0\): offset: R\(2\): elements have shape"),
        (Position(x[0:2], [1, 2], UNIT, offset=np.ones((3, 2))), PLANE, r"3 offsets for 2 measurements"),
        (Position(l[0], [1, 2], UNIT), PLANE, r"Position\(l0\): l0 is in R\(2\), expected a pose, .* by a Prior"),
        (Heading(l[0], 1, UNIT), PLANE, r"Heading\(l0\): l0 is in R\(2\), expected a pose, SE2 or SE3"),
        (
            Heading(x[0], [[1, 2]], UNIT),
            PLANE,
            r"Heading\(x0\): \(yaw\): elements have shape \(1, 2\), expected \(n, 1\)",
        ),
        (Prior(x[0], [1, 2, 3], UNIT, offset=[1, 2]), PLANE, r"Prior\(x0\): offset: SE2: elements have shape"),
        (Prior(x[0], [1, 2, 3], UNIT, offset=np.ones((2, 3))), PLANE, r"Prior\(x0\): 2 offsets for 1 measurements"),
        (
            BetweenSensors(x[0], l[0], [1, 2], UNIT, ([0, 0], [0, 0])),
            PLANE,
            r"joins SE2 and R\(2\); both must be in the",
        ),
        (BetweenSensors(x[0], x[1], [1, 2, 3], UNIT, ([0, 0], [0, 0])), PLANE, r"offset: SE2: elements have shape"),
        (BetweenSensors(x[0], x[1], [1, 2, 3], UNIT, l[0]), PLANE, r"the offset l0 is in R\(2\), expected SE2"),
        (BundleProjection(l[0], f[0], c[0], [1, 2], UNIT), BUNDLE, r"l0 is in R\(3\), this factor needs \(wx, wy"),
        (BundleProjection(c[0], f[0], l[0], 1, UNIT), BUNDLE, r"\(u, v\): elements have shape \(\), expected \(n, 2\)"),
    ],
)
def test_what_does_not_fit(factor: Factor, values: Values, message: str) -> None:
    with pytest.raises(GraphError, match=message):
        values.gather(factor)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Prior(x[0], [1, 2, 3], UNIT, offset=o[0]),
            r"Prior\(x0\): its offset is not an array of numbers: a variable",
        ),
        (lambda: Position(x[0], [1, 2], UNIT, offset="bow"), r"Position\(x0\): its offset is not an array of numbers"),
        (lambda: BetweenSensors(x[0], x[1], [1, 2, 3], UNIT, [0, 0, 0]), r"expected a pair of offsets or one variable"),
        (lambda: BetweenSensors(x[0], x[1], [1, 2, 3], UNIT, np.zeros((2, 3))), r"expected a pair of offsets or one"),
    ],
)
def test_offsets_that_are_none(make: object, message: str) -> None:
    with pytest.raises(GraphError, match=message):
        make()  # type: ignore[operator]


def test_noise_has_the_names_of_what_is_measured() -> None:
    with pytest.raises(NoiseModelError, match=r"Position\(x0\): .*measurement's components are \['z'\]"):
        SPACE.gather(Position(x[0], 1, Diagonal(x=1.0), ("z",)))
    same(error(BundleProjection(c[0], f[0], l[0], [51.25, 1], Diagonal(v=0.5, u=2.0)), BUNDLE), [[0, 2]], atol=1e-12)


def test_a_point_in_the_plane_of_the_camera_is_named() -> None:
    model, X = BUNDLE.gather(BundleProjection(c[[0, 1]], f[0], l[[0, 1]], [0, 0], UNIT))
    with pytest.raises(
        SingularGeometryError, match=r"BundleProjection\(c1, f0, l1\): the point is in the plane"
    ) as caught:
        model.linearize(*X)
    assert caught.value.keys == (c[[1]], f[[0]], l[[1]])


def test_a_small_bundle() -> None:
    """Images without noise: Levenberg-Marquardt, which the factor asks for, brings chi2 to 0."""
    rng = np.random.default_rng(4)
    C = np.concatenate([rng.normal(scale=0.1, size=(4, 3)), rng.normal([0, 0, -8], 0.5, size=(4, 3))], axis=1)
    F, L = np.array([[500.0, -0.1, 0.05]]), rng.normal(size=(25, 3))
    i, k = (a.ravel() for a in np.meshgrid(np.arange(4), np.arange(25)))
    z, _ = project(C[i], F[np.zeros_like(i)], L[k])
    factor = BundleProjection(c[i], f[0], l[k], z, Isotropic(0.5))
    start = Values(
        {
            c: (CAMERA, C + rng.normal(scale=0.01, size=C.shape)),
            f: (LENS, F + np.array([5.0, 0.01, 0.0])),
            l: (R(3), L + rng.normal(scale=0.02, size=L.shape)),
        }
    )
    assert factor.relative
    assert factor.damped
    assert check_jacobians(factor, start) < 1e-6
    result = FactorGraph([factor]).optimize(start)
    assert result.chi2_initial > 1e3
    assert result.chi2_final < 1e-6


def test_a_public_bundle_problem(data: Path) -> None:
    """Half chi2 and |A'b| at the start of problem-49-7776, as the tests of BundleAdjustmentModels.jl have them."""
    with gzip.open(data / "bal" / "problem-49-7776-pre.txt.gz", "rt") as file:
        cameras, points, n = (int(word) for word in file.readline().split())
        numbers = np.array(file.read().split(), dtype=float)
    seen, C, L = np.split(numbers, [4 * n, 4 * n + 9 * cameras])
    i, k, *z = seen.reshape(n, 4).T
    C = C.reshape(cameras, 9)
    factor = BundleProjection(c[i.astype(int)], f[i.astype(int)], l[k.astype(int)], np.stack(z, axis=1), UNIT)
    values = Values({c: (CAMERA, C[:, :6]), f: (LENS, C[:, 6:]), l: (R(3), L.reshape(points, 3))})
    system = FactorGraph([factor]).linearize(values)
    assert system.b @ system.b / 2 == pytest.approx(850912.460680839605629, rel=1e-12)
    assert np.linalg.norm(system.A.T @ system.b) == pytest.approx(2.39615629098822921515e7, rel=1e-12)
