"""`check_jacobians` names the likely cause of a wrong derivative, the wrong entry, and the worst factor of a graph."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from factors import Diagonal, Factor, Isotropic, Noise, SqrtInformation, check_jacobians
from models import SE2, SE3, LieGroup, R
from models.algebra import Array
from models.errors import GraphError, JacobianError
from models.sensors import point_in_frame
from nls import FactorGraph, Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import refused

x, l = kinds("x", "l")
PLANE = Values({x: (SE2, [[0, 0, 0.3], [1, 2, -0.5], [2, 1, 0.1]]), l: (R(2), [[1.0, 2.0], [3.0, 4.0]])})


def scan(L: Array) -> Array:
    """A square, curved, not symmetric function of a point."""
    a, b = L[:, 0], L[:, 1]
    return np.stack([a * b, np.sin(a) + 3 * b], axis=1)


def scan_jacobian(L: Array) -> Array:
    a, b = L[:, 0], L[:, 1]
    return np.stack([np.stack([b, a], axis=-1), np.stack([np.cos(a), np.full_like(a, 3.0)], axis=-1)], axis=1)


@for_all(
    case=[
        (lambda J: -J, "; likely: the sign is flipped; the ratio is -1 for all entries$"),
        (lambda J: -2 * J, r"; likely: the sign .* and .* factor 2 too many .*; the ratio is -2 for all entries$"),
        (lambda J: 3.1 * J, "; likely: a constant factor; the ratio is 3.1 for all entries$"),
        (lambda J: J * [1.0, 0.0], r"; likely, in column\(s\) \[1\]: a derivative is left out; the ratio is 0 "),
        (lambda J: J.mT, "; likely: it is transposed"),
        (lambda J: np.deg2rad(J), "; likely: it is in degrees"),
        (lambda J: np.rad2deg(J), "; likely: degrees"),
        (lambda J: J / 2, r"; likely: a factor 2 is missing"),
        (lambda J: 2 * J, r"; likely: there is a factor 2"),
        (lambda J: J * [1.0, -1.0], r"; likely, in column\(s\) \[1\]: the sign"),
        (lambda J: J * [1.0, 2.0], r"; likely, in column\(s\) \[1\]: there is a factor 2"),
        (lambda J: J + 0.1, r"central difference [-0-9.e]+ \+- [0-9]e-[01][0-9]$"),
    ]
)
def test_check_jacobians_names_the_likely_cause(case: tuple[Callable[[Array], Array], str]) -> None:
    mistake, cause = case
    right = Factor.from_function(scan, l[0:2], 2, jacobians=lambda L: [scan_jacobian(L)])
    assert check_jacobians(right, PLANE) < 1e-8
    wrong = Factor.from_function(scan, l[0:2], 2, Isotropic(0.5), lambda L: [mistake(scan_jacobian(L))])
    caught = refused(lambda: check_jacobians(wrong, PLANE), JacobianError, cause)
    slot, n, row, column = caught.entry
    assert slot == 0
    assert caught.numeric == pytest.approx(2 * scan_jacobian(PLANE[l])[n, row, column], rel=1e-6)
    assert caught.analytic == pytest.approx(2 * mistake(scan_jacobian(PLANE[l]))[n, row, column], rel=1e-9)
    assert f"row {row}, component {'xy'[column]} of l{n}: analytic" in str(caught)


def test_check_jacobians_finds_one_wrong_entry_in_a_batch() -> None:
    def jacobians(L: Array) -> list[Array]:
        J = scan_jacobian(L)
        J[1, 0, 1] += 1e-4
        return [J]

    factor = Factor.from_function(scan, l[0:2], 2, jacobians=jacobians)
    with pytest.raises(JacobianError, match=r"row 0, component y of l1") as caught:
        check_jacobians(factor, PLANE)
    assert caught.value.entry == (0, 1, 0, 1)
    column = np.abs(scan_jacobian(PLANE[l])[1, :, 1]).max()
    assert check_jacobians(factor, PLANE, rtol=1e-3) == pytest.approx(1e-4 / column, rel=1e-4)


@for_all(group=[SE2, SE3])
def test_check_jacobians_names_the_order_of_columns(group: LieGroup) -> None:
    (p,), d = kinds("p"), group.point_dim
    values = Values({p: (group, group.exp(0.3 * np.random.default_rng(0).normal(size=(2, group.dim))))})

    def jacobians(X: Array, shift: int = 0) -> list[Array]:
        J = np.zeros((len(X), d, group.dim))
        J[:, :, :d] = group.world_axes(X)[:, :d, :d]
        return [np.roll(J, shift, axis=2)]

    assert check_jacobians(Factor.from_function(group.position, p[0:2], d, jacobians=jacobians), values) < 1e-8
    first = Factor.from_function(group.position, p[0:2], d, jacobians=lambda X: jacobians(X, group.dim - d))
    with pytest.raises(JacobianError, match=r"its columns are in another order \(translation comes first\)"):
        check_jacobians(first, values)


def in_body_jacobians(X: Array, L: Array, transposed: bool) -> list[Array]:
    H_x, R_T = point_in_frame(SE3, X, L)[1]
    return [H_x, R_T.mT if transposed else R_T]


@for_all(noise=[Isotropic(0.1), Diagonal([0.1, 0.2, 0.5]), SqrtInformation(np.tri(3) + np.eye(3))])
def test_check_jacobians_names_a_transposed_rotation(noise: Noise) -> None:
    """Whatever the noise: whitened, a transposed rotation is no transposed matrix."""
    X = SE3.exp([[0.3, -0.2, 0.5, 0.4, -0.6, 0.8], [1.0, 0.0, 0.2, -0.3, 0.2, 0.5]])
    values = Values({x: (SE3, X), l: (R(3), [[3.0, 1.0, 0.5], [2.0, -1.0, 0.7]])})
    seen = lambda X, L: point_in_frame(SE3, X, L)[0]  # noqa: E731
    right, wrong = (
        Factor.from_function(seen, [x[0:2], l[0:2]], 3, noise, partial(in_body_jacobians, transposed=transposed))
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
    two, graph = FactorGraph([right, slightly]), FactorGraph([slightly, badly, right])
    one = refused(lambda: check_jacobians(two, PLANE), JacobianError, "^array.* 1.01 for all entries$")
    caught = refused(lambda: check_jacobians(graph, PLANE), JacobianError, "; the worst of 2 factors .*, of 3$")
    alone = refused(lambda: check_jacobians(badly, PLANE), JacobianError, "analytic")
    assert str(caught).startswith(str(alone))
    assert (one.deviation, caught.deviation) == (pytest.approx(0.0099, abs=1e-4), pytest.approx(2 / 3, abs=1e-4))
    refused(lambda: check_jacobians(PLANE, PLANE), GraphError, "expected a factor or a graph, got Values")
