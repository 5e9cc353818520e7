"""`check_jacobians` and rotations that are transposed; its other causes are in `tests/factors/test_errors.py`."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from factors import Diagonal, Factor, Isotropic, Noise, SqrtInformation, check_jacobians
from models import SE2, SE3, R
from models.algebra import Array, skew
from models.errors import GraphError, JacobianError
from nls import FactorGraph, Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import refused

x, l = kinds("x", "l")
PLANE = Values({x: (SE2, [[0, 0, 0.3], [1, 2, -0.5], [2, 1, 0.1]])})


def in_body(X: Array, L: Array) -> Array:
    """A point in the frame of a pose in space."""
    return SE3.act(SE3.inverse(X), L)


def in_body_jacobians(X: Array, L: Array, transposed: bool = False) -> list[Array]:
    p, R_T = in_body(X, L), SE3.rotation(X).mT
    H_x = np.concatenate([np.broadcast_to(-np.eye(3), (len(p), 3, 3)), skew(p)], axis=2)
    return [H_x, R_T.mT if transposed else R_T]


@for_all(noise=[Isotropic(0.1), Diagonal([0.1, 0.2, 0.5]), SqrtInformation(np.tri(3) + np.eye(3))])
def test_check_jacobians_names_a_transposed_rotation(noise: Noise) -> None:
    """Whatever the noise: whitened, a transposed rotation is no transposed matrix."""
    X = SE3.exp([[0.3, -0.2, 0.5, 0.4, -0.6, 0.8], [1.0, 0.0, 0.2, -0.3, 0.2, 0.5]])
    values = Values({x: (SE3, X), l: (R(3), [[3.0, 1.0, 0.5], [2.0, -1.0, 0.7]])})
    right, wrong = (
        Factor.from_function(in_body, [x[0:2], l[0:2]], 3, noise, partial(in_body_jacobians, transposed=transposed))
        for transposed in (False, True)
    )
    assert check_jacobians(right, values) < 1e-6
    cause = "it is transposed" if isinstance(noise, Isotropic) else "a rotation in it is transposed"
    refused(lambda: check_jacobians(wrong, values), JacobianError, f"of l[01]: analytic .*; likely: {cause}$")


def test_check_jacobians_of_a_graph_names_the_worst_factor() -> None:
    def scaled(by: float) -> Factor:
        def jacobians(X: Array) -> list[Array]:
            return [by * SE2.world_axes(X)]

        return Factor.from_function(np.array, x[0:3], 3, Isotropic(0.1), jacobians)

    right, slightly, badly = scaled(1.0), scaled(1.01), scaled(3.0)
    assert check_jacobians(FactorGraph([right, right]), PLANE) == max(check_jacobians(right, PLANE), 0.0) < 1e-6
    assert check_jacobians(FactorGraph([right, slightly]), PLANE, rtol=0.1) == check_jacobians(slightly, PLANE, 0.1) > 0
    assert check_jacobians(FactorGraph(), PLANE) == 0.0
    one = refused(
        lambda: check_jacobians(FactorGraph([right, slightly]), PLANE), JacobianError, "^array.* 1.01 for all entries$"
    )
    graph = FactorGraph([slightly, badly, right])
    caught = refused(lambda: check_jacobians(graph, PLANE), JacobianError, "; the worst of 2 factors .*, of 3$")
    alone = refused(lambda: check_jacobians(badly, PLANE), JacobianError, "analytic")
    assert str(caught).startswith(str(alone))
    assert (one.deviation, caught.deviation) == (pytest.approx(0.0099, abs=1e-4), pytest.approx(2 / 3, abs=1e-4))
    refused(lambda: check_jacobians(PLANE, PLANE), GraphError, "expected a factor or a graph, got Values")
