"""`Position` of some coordinates: their names are asked for, and no others are taken."""

from __future__ import annotations

import re

import numpy as np

from factors import Isotropic, Position
from models import SE2, SE3
from models.errors import GraphError
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import error, refused

(x,) = kinds("x")
SPACE, PLANE = Values({x: (SE3, SE3.identity(4))}), Values({x: (SE2, SE2.identity(4))})
ONE = Isotropic(1.0)


@for_all(
    case=[
        (SPACE, x[0], [1.0, 2.0], "components=('x', 'y')"),
        (SPACE, x[[0, 1]], [1.0, 2.0], "components=('x', 'y')"),
        (SPACE, x[0:4], np.ones((4, 2)), "components=('x', 'y')"),
        (SPACE, x[0], 5.0, "components=('z',)"),
        (SPACE, x[0], [5.0], "components=('z',)"),
        (SPACE, x[0:4], np.ones(4), "components=('z',)"),
        (SPACE, x[0:4], np.ones((4, 1)), "components=('z',)"),
        (PLANE, x[0:4], np.ones((4, 1)), "components=('y',)"),
    ]
)
def test_fewer_numbers_than_coordinates_want_names(case: tuple) -> None:
    values, pose, z, cure = case
    refused(lambda: values.gather(Position(pose, z, ONE)), GraphError, rf"^Position\(x.*\): z has .*{re.escape(cure)}$")


def test_as_many_numbers_as_coordinates_want_none() -> None:
    for values, z in ((SPACE, [1.0, 2.0, 3.0]), (PLANE, [1.0, 2.0]), (SPACE, np.ones((3, 3)))):
        assert error(Position(x[0 : max(1, np.ndim(z) * 3 - 3)], z, ONE), values).shape[1] == np.shape(z)[-1]
    assert error(Position(x[0], [1.0, 2.0], ONE, components=("x", "y")), SPACE).tolist() == [[1.0, 2.0]]
    for z in (np.ones(4), np.ones((1, 4))):
        refused(lambda z=z: SPACE.gather(Position(x[0], z, ONE)), GraphError, r"expected \(n, 3\)")
