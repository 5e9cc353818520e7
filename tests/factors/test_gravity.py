"""Gravity: roll and pitch of accelerometers at rest, the yaw free; what its direction cannot be."""

from __future__ import annotations

import numpy as np

from factors import ZPR, Gravity, Heading, Isotropic, Position
from models import SE3, SO3, R, euler
from models.errors import GraphError, SingularGeometryError, UnderconstrainedError
from nls import FactorGraph, Marginals, Values, kinds
from tests.factors.evaluated import error, refused, same

(x,) = kinds("x")
UNIT = Isotropic()
LEVEL = Values({x: (SE3, SE3.identity())})


def test_roll_and_pitch_are_those_of_a_tilt_sensor() -> None:
    roll, pitch = np.array([0.3, -2.8, 0.0, 1.5]), np.array([-0.2, 0.1, 1.4, -0.6])
    down = np.column_stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)])
    poses = Values({x: (SE3, SE3.from_rpy(0, 0, 5, roll, pitch, [0, 1, 2, 3]))})
    same(error(Gravity(x[:4], 9.81 * down, UNIT), poses), 0.0, atol=1e-14)
    same(error(ZPR(x[:4], np.column_stack([0 * roll + 5, pitch, roll]), UNIT), poses), 0.0, atol=1e-14)
    up = Gravity(x[0], [0.0, -np.sin(0.1), -np.cos(0.1)], UNIT, down=[0, 0, -1])
    same(error(up, LEVEL), [[0.1, 0.0]], atol=1e-14)  # the roll is about x of the body, whichever way z is
    same(error(Gravity(x[0], [-1.0, 0.0, 0.0], UNIT), LEVEL), [[0.0, np.pi / 2]], atol=1e-14)  # no gimbal lock


def test_the_yaw_stays_free_and_has_no_part_in_the_covariance() -> None:
    place, tilt = Position(x[0], [1, 2, 3], UNIT), Gravity(x[0], [0.1, -0.2, 1.0], Isotropic(0.01))
    named = "1 unknown is not measured: x0: yaw"
    refused(lambda: FactorGraph([place, tilt]).optimize(LEVEL), UnderconstrainedError, named)
    graph = FactorGraph([place, tilt, Heading(x[0], 0.7, Isotropic(0.5))])
    values = graph.optimize(LEVEL).values
    roll, pitch, yaw = euler.from_se3(values[x[0]])[:3]
    same([roll, pitch, yaw], [np.arctan2(-0.2, 1.0), np.arctan2(-0.1, np.hypot(0.2, 1.0)), 0.7], atol=1e-6)
    sigmas = np.sqrt(np.diag(Marginals(graph, values).covariance(x[0], frame="world")))
    same(sigmas[3:5], 0.01, rtol=1e-6)


def test_what_is_no_direction_of_gravity() -> None:
    attitude = Values({x: (SO3, SO3.identity())})
    accelerations = np.array([0.0, 0.0, -9.81])
    wrong = Gravity(x[0], accelerations, UNIT)
    named = r"Gravity\(x0\): its direction is opposite .* give -z"
    refused(lambda: FactorGraph([wrong]).chi2(attitude), SingularGeometryError, named)
    assert FactorGraph([Gravity(x[0], -accelerations, UNIT)]).chi2(attitude) == 0.0
    for z, down, named in (
        ([0, 0, 0], [0, 0, 1], "length 0"),
        ([0, 0, 1], [0, 0, 0], r"down is \[0.0, 0.0, 0.0\]"),
        ([0, 0, 1], [0, 1], r"down is \[0.0, 1.0\]"),
    ):
        refused(lambda z=z, down=down: attitude.gather(Gravity(x[0], z, UNIT, down)), GraphError, named)
    points = Values({x: (R(3), [0, 0, 0])})
    refused(lambda: points.gather(wrong), GraphError, r"x0 is in R\(3\), expected SE3 or SO3")
