"""Position, Heading, Prior and Between with offsets, and the camera of bundle adjustment."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np

from factors import (
    BetweenSensors,
    BundleProjection,
    Diagonal,
    Factor,
    Heading,
    Isotropic,
    Position,
    Prior,
)
from factors.bundle import CAMERA, LENS
from models import SE2, SE3, R, euler
from models.errors import GraphError, NoiseModelError, SingularGeometryError
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import error, linearized, refused, same

x, c, f, l, o = kinds("x", "c", "f", "l", "o")
UNIT = Isotropic()
PLANE = Values({x: (SE2, [[1.0, 2.0, pi / 2], [4.0, 6.0, 0.3]]), l: (R(2), [[0.0, 0.0]])})
SPACE = Values(
    {x: (SE3, euler.to_se3([[0.0, 0.0, pi / 2, 1, 2, 3], [0.1, 0.2, 0.3, 4, 5, 6]])), l: (R(3), [[0, 0, 0]])}
)


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
