"""Batches joined: the same measurements in fewer batches, and never two kinds in one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

import factors as f
from factors import BearingRange, Between, Cauchy, Diagonal, Factor, Information, Isotropic, Prior, Robust, Wheels
from factors.base import Model
from factors.joined import joined
from models import SE2, R
from nls import FactorGraph, Values, kinds

close = np.testing.assert_allclose
x, l = kinds("x", "l")
RNG = np.random.default_rng(0)
VALUES = Values({x: (SE2, RNG.normal(0, 2, (6, 3))), l: (R(2), RNG.normal(0, 9, (4, 2)))})


def together(factors: Sequence[Factor]) -> list[Factor]:
    return joined([VALUES.gather(factor)[0] for factor in factors])


def rows(factors: Sequence[Factor]) -> npt.NDArray[np.float64]:
    """A'A, A'b and chi2 side by side: the whole problem, whatever the order of the rows."""
    system = FactorGraph(factors).linearize(VALUES)
    A = system.A.toarray()
    return np.column_stack([A.T @ A, A.T @ system.b, np.full(A.shape[1], system.chi2)])


def test_the_problem_stays_the_same_in_as_few_batches_as_kinds() -> None:
    step = [[1.0, 0.1, 0.2], [0.9, 0.0, 0.1]]
    full = RNG.normal(size=(2, 3, 3))
    factors = [
        Between(x[0], x[1], step[0], Isotropic(0.1)),
        BearingRange(x[[0, 1]], l[[2, 3]], [[0.1, 4.0], [0.2, 6.0]], Diagonal([0.1, 0.3])),
        Between(x[[1, 2]], x[[2, 3]], step, f.Covariance(full @ full.mT + np.eye(3))),
        Prior(x[0], [0, 0, 0], Information(np.diag([4.0, 0.0, 9.0]))),
        BearingRange(x[3], l[0], [3.1, 4.0], Diagonal([0.2, 0.1])),
    ]
    fewer = together(factors)
    assert [(f.name, len(f)) for f in fewer] == [("Between", 3), ("BearingRange", 3), ("Prior", 1)]
    assert fewer[0].keys == (x[[0, 1, 2]], x[[1, 2, 3]])
    matrices = [
        Between(x[k], x[k + 1], step[0], Information(M)) for k, M in enumerate((np.eye(3), full[0] @ full[0].T))
    ]
    assert [type(f.noise) for f in together(matrices)] == [Information]
    close(rows(fewer), rows(factors), rtol=1e-10, atol=1e-9)
    close(rows(together([*fewer, factors[0]])), rows([*factors, factors[0]]), rtol=1e-10, atol=1e-9)
    part = fewer[1][[0, 2]]
    close(rows([part, fewer[0], fewer[2]]), rows([factors[1][[0]], factors[4], *factors[:4:2], factors[3]]), atol=1e-9)


def test_what_differs_stays_apart() -> None:
    u, noise = [[1.0, 1.1]], Isotropic(0.1)
    z = [[0.1, 4.0]]
    factors = [
        Wheels(x[0], x[1], u, noise, base=0.5),
        Wheels(x[1], x[2], u, noise, base=0.6),
        Wheels(x[2], x[3], u, noise, base=0.5),
        BearingRange(x[0], l[0], z, noise),
        BearingRange(x[1], l[0], z, Robust(noise, Cauchy(1.0))),
        BearingRange(x[2], l[0], z, Robust(noise, f.Huber(1.0))),
        BearingRange(x[3], l[0], z, Robust(noise, Cauchy(1.0))),
        BearingRange(x[4], x[5], z, noise),
        Between(x[4], x[5], [1, 0, 0], noise),
        Between(x[4], x[5], [1, 0, 0], noise, convention="g2o"),
        Prior(x[3], [0, 0, 0], noise),
        Prior(l[0], [0, 0], noise),
    ]
    fewer = together(factors)
    assert [len(f) for f in fewer] == [2, 1, 1, 2, 1, 1, 1, 1, 1, 1]
    close(rows(fewer), rows(factors), rtol=1e-10, atol=1e-9)


class Tagged(BearingRange):
    """A factor with an attribute that all of its measurements share."""

    tag: object = None

    def tagged(self, tag: object) -> Model:
        self.tag = tag
        return self.bind(SE2, R(2))


def test_what_is_shared_is_equal_in_a_batch() -> None:
    tags = [np.array([1.0, 2.0]), np.array([1.0, 2.0]), np.array([1.0, 3.0]), 2.0, 2.0]
    models = [Tagged(x[0], l[0], [1.0, 0.1], Isotropic(0.1)).tagged(tag) for tag in tags]
    assert [len(f) for f in joined(models)] == [2, 1, 2]


def test_each_measurement_keeps_its_offset() -> None:
    z, noise = [[0.1, 4.0]], Isotropic(0.1)
    factors = [
        BearingRange(x[0], l[0], z, noise, offset=[0.5, 0.1, 0.3]),
        BearingRange(x[[1, 2]], l[1], z * 2, noise, offset=[[0.2, 0.1, -0.3], [0.4, 0.4, 0.0]]),
        BearingRange(x[[3, 4]], l[2], z * 2, noise, offset=[1.0, 0.0, 0.0]),
        BearingRange(x[3], l[2], z, noise),
        BearingRange(x[3], l[2], z, noise, offset=x[5]),
        BearingRange(x[4], l[2], z, noise, offset=x[0]),
    ]
    fewer = together(factors)
    assert [len(f) for f in fewer] == [5, 1, 2]
    close(rows(fewer), rows(factors), rtol=1e-10, atol=1e-9)
