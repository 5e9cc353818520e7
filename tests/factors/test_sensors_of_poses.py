"""Position, Heading, Prior and Between with offsets, and the camera of bundle adjustment."""

from __future__ import annotations

import gzip
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from factors import (
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
from models import SE2, SE3, R, euler
from models.errors import GraphError, NoiseModelError, SingularGeometryError
from models.sensors import project
from nls import FactorGraph, Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import error, linearized, refused, same

Array = npt.NDArray[np.float64]
x, c, f, l, o = kinds("x", "c", "f", "l", "o")
UNIT = Isotropic()
PLANE = Values({x: (SE2, [[1.0, 2.0, pi / 2], [4.0, 6.0, 0.3]]), l: (R(2), [[0.0, 0.0]])})
SPACE = Values(
    {x: (SE3, euler.to_se3([[0.0, 0.0, pi / 2, 1, 2, 3], [0.1, 0.2, 0.3, 4, 5, 6]])), l: (R(3), [[0, 0, 0]])}
)


def test_a_position_has_the_components_asked_for_in_their_order() -> None:
    same(error(Position(x[0:2], [10, 20], Diagonal(depth=0.5), ("depth",)), SPACE), [[14], [28]])
    same(error(Position(x[0], [0, 0], Diagonal(x=0.5, z=0.1), ("z", "x")), SPACE), [[-30, -2]])


def test_the_noise_of_a_position_is_along_the_axes_of_the_world_that_of_a_prior_is_not() -> None:
    """The vehicle looks along +y: its own x is the y of the world."""
    same(error(Position(x[0], [1.0, 3.0], Diagonal(x=10.0, y=0.1)), PLANE), [[0.0, 10.0]], atol=1e-12)
    prior = Prior(x[0], [1.0, 3.0, pi / 2], Diagonal(x=10.0, y=0.1, yaw=1.0))
    same(error(prior, PLANE), [[0.1, 0.0, 0.0]], atol=1e-12)


def test_heading_wraps_and_does_not_move_the_vehicle() -> None:
    (A,), b = linearized(Heading(x[0], 3.1, Diagonal(heading=0.1)), Values({x: (SE2, [[1.0, 2.0, -3.1]])}))
    same(b, [[(6.2 - 2 * pi) / 0.1]])
    same(A, [[[0, 0, 10]]])
    (A,), b = linearized(Heading(x[1], 0.3, UNIT), SPACE)
    same(b, 0.0, atol=1e-14)
    same(A, [[[0, 0, 0, 0, sin(0.1) / cos(0.2), cos(0.1) / cos(0.2)]]])
    locked = Values({x: (SE3, euler.to_se3([[0, 0.1, 0, 0, 0, 0], [0, pi / 2, 0, 0, 0, 0]]))})
    heading = Heading(x[0:2], [0.0, 0.0], UNIT)
    caught = refused(lambda: error(heading, locked), SingularGeometryError, r"Heading\(x1\): .* gimbal lock")
    assert (caught.factor, caught.keys) == ("Heading", (x[[1]],))


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


@for_all(
    case=[
        (Position(x[0], [1, 2, 3], UNIT), r"Position\(x0\): \(x, y\): .*\(3,\), expected \(n, 2"),
        (Position(x[0], [1, 2], UNIT, ("x", "z")), r"Position\(x0\): .*\('x', 'z'\) of \('x', 'y'\)"),
        (Position(x[0], [1, 2], UNIT, ()), r"components \(\) of"),
        (Position(x[0], [1, 2], UNIT, ("x", "x")), r"components \('x', 'x'\) of"),
        (Position(x[0], [1, 2], UNIT, ("yaw",)), r"components \('yaw',\) of"),
        (Position(x[0], [1, 2], UNIT, offset=[1, 2, 3]), r"Position\(x0\): offset: R\(2\)"),
        (Position(x[0:2], [1, 2], UNIT, offset=np.ones((3, 2))), "3 offsets for 2"),
        (Position(l[0], [1, 2], UNIT), r"Position\(l0\): l0 is in R\(2\), .* by a Prior"),
        (Heading(l[0], 1, UNIT), r"Heading\(l0\): l0 is in R\(2\), expected .*SE2 or SE3"),
        (Heading(x[0], [[1, 2]], UNIT), r"Heading\(x0\): \(yaw\): .*\(1, 2\), expected \(n, 1\)"),
        (Prior(x[0], [1, 2, 3], UNIT, offset=[1, 2]), r"Prior\(x0\): offset: SE2"),
        (Prior(x[0], [1, 2, 3], UNIT, offset=np.ones((2, 3))), r"Prior\(x0\): 2 offsets for 1"),
        (BetweenSensors(x[0], l[0], [1, 2], UNIT, ([0, 0], [0, 0])), r"joins SE2 and R\(2\)"),
        (BetweenSensors(x[0], x[1], [1, 2, 3], UNIT, ([0, 0], [0, 0])), "offset: SE2"),
        (BetweenSensors(x[0], x[1], [1, 2, 3], UNIT, l[0]), r"the offset l0 is in R\(2\), expected SE2"),
        (BundleProjection(l[0], f[0], c[0], [1, 2], UNIT), r"l0 is in R\(3\), this factor needs \(wx, wy"),
        (BundleProjection(c[0], f[0], l[0], 1, UNIT), r"\(u, v\): .*\(\), expected \(n, 2\)"),
    ]
)
def test_what_does_not_fit(case: tuple[Factor, str]) -> None:
    factor, named = case
    refused(lambda: (BUNDLE if factor.name == "BundleProjection" else PLANE).gather(factor), GraphError, named)


def test_offsets_that_are_none() -> None:
    for make, named in (
        (lambda: Prior(x[0], [1, 2, 3], UNIT, offset=o[0]), r"Prior\(x0\): .*not an array of numbers: a variable"),
        (lambda: Position(x[0], [1, 2], UNIT, offset="bow"), r"Position\(x0\): .*not an array of numbers"),
        (lambda: BetweenSensors(x[0], x[1], [1, 2, 3], UNIT, [0, 0, 0]), "expected a pair of offsets or one"),
        (lambda: BetweenSensors(x[0], x[1], [1, 2, 3], UNIT, np.zeros((2, 3))), "expected a pair of offsets or one"),
    ):
        refused(make, GraphError, named)


def test_noise_has_the_names_of_what_is_measured() -> None:
    depth = Position(x[0], 1, Diagonal(x=1.0), ("z",))
    refused(lambda: SPACE.gather(depth), NoiseModelError, r"Position\(x0\): .*\['z'\]")
    same(error(BundleProjection(c[0], f[0], l[0], [51.25, 1], Diagonal(v=0.5, u=2.0)), BUNDLE), [[0, 2]], atol=1e-12)


def test_a_point_in_the_plane_of_the_camera_is_named() -> None:
    factor = BundleProjection(c[[0, 1]], f[0], l[[0, 1]], [0, 0], UNIT)
    named = r"BundleProjection\(c1, f0, l1\): .* in the plane"
    caught = refused(lambda: linearized(factor, BUNDLE), SingularGeometryError, named)
    assert caught.keys == (c[[1]], f[[0]], l[[1]])


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
