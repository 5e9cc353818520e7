"""DriftingStep: the drift of a stretch that its steps share, whole, in parts, joined and step by step."""

from __future__ import annotations

import numpy as np

from factors import Diagonal, DriftingStep, Isotropic, Prior
from factors.joined import joined
from models import SE2, SE3, R
from models.errors import GraphError
from nls import FactorGraph, Values, kinds
from tests.factors.evaluated import Array, refused, same

x, d = kinds("x", "d")
NOISE = Diagonal(x=0.05, y=0.05, yaw=0.01)
DRIFT = np.array([[0.1, -0.05], [-0.2, 0.15]])
STRETCH = np.arange(10) // 5  # of a step


def way() -> tuple[Array, Array, Array]:
    """True poses (11, 3), steps (10, 3) as reckoned with the drift of two stretches, and their lengths."""
    rng = np.random.default_rng(0)
    steps = np.column_stack([rng.uniform(0.5, 2.0, 10), rng.normal(0, 0.2, 10), rng.normal(0, 0.8, 10)])
    X = [np.array([[3.0, -1.0, 2.5]])]
    for step in steps:
        X.append(SE2.compose(X[-1], step[None]))
    length = np.hypot(*steps[:, :2].T)
    return np.concatenate(X), steps + np.column_stack([length[:, None] * DRIFT[STRETCH], np.zeros(10)]), length


def start() -> Values:
    X = SE2.retract(way()[0], np.random.default_rng(1).normal(0, 0.2, (11, 3)))
    return Values({x: (SE2, X), d: (R(2), np.zeros((2, 2)))})


def steps(rows: list[int]) -> DriftingStep:
    _, z, length = way()
    k = np.array(rows)
    return DriftingStep(x[k], x[k + 1], d[STRETCH[k]], z[k], NOISE, length[k])


def test_two_ends_of_a_stretch_determine_its_drift() -> None:
    """Five steps each: fixes of x5 and x10 leave nothing but the drift to explain the steps."""
    truth = way()[0]
    fixes = Prior(x[[0, 5, 10]], truth[[0, 5, 10]], Isotropic(1e-3))
    result = FactorGraph([steps(list(range(10))), fixes]).optimize(start())
    same(result.values[d], DRIFT, atol=1e-6)
    same(SE2.local(truth, result.values[x]), 0.0, atol=1e-6)


def test_the_length_of_the_reckoned_way_unless_given() -> None:
    z = [[3.0, 4.0, 0.1], [0.0, 0.0, 0.3]]
    same(DriftingStep(x[[0, 1]], x[[1, 2]], d[0], z, NOISE).length, [5.0, 0.0])
    same(DriftingStep(x[[0, 1]], x[[1, 2]], d[0], z, NOISE, [4.0, 1.0]).length, [4.0, 1.0])
    same(DriftingStep(x[[0, 1]], x[[1, 2]], d[0], z[0], NOISE).length, [5.0, 5.0])  # one step for all


def test_joined_steps_are_the_batch() -> None:
    values = start()
    pieces = [steps([0, 1, 2]), steps([3]), steps([4, 5]), steps([6, 7, 8, 9])]
    (batch,) = joined([values.gather(piece)[0] for piece in pieces])
    whole, again = (FactorGraph([factor]).linearize(values) for factor in (steps(list(range(10))), batch))
    same(again.A.toarray(), whole.A.toarray(), atol=1e-12)
    same(again.b, whole.b, atol=1e-12)


def test_what_does_not_fit() -> None:
    z = [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    for length in ([1.0], [1.0, -1.0], [1.0, np.nan], [[1.0], [1.0]], 1.0):
        named = r"DriftingStep\(x\[0, 1\], .*\): lengths of shape .*, expected \(2,\), numbers from 0"
        refused(lambda length=length: DriftingStep(x[[0, 1]], x[[1, 2]], d[0], z, NOISE, length), GraphError, named)
    other = Values({x: (SE3, SE3.identity(2)), d: (R(2), np.zeros((1, 2)))})
    refused(lambda: DriftingStep(x[0], x[1], d[0], z[0], NOISE).chi2(other), GraphError, "DriftingStep: x0 is in SE3")
    for wrong in ([1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [], np.ones((2, 2, 3))):
        named = r"DriftingStep\(x0, x1, d0\): z has shape .*, expected \(n, 3\)"
        refused(lambda wrong=wrong: DriftingStep(x[0], x[1], d[0], wrong, NOISE), GraphError, named)
    refused(lambda: DriftingStep(x[0], x[1], d[0], z[0], NOISE, "long"), GraphError, "length is not an array.*'long'")
    refused(lambda: DriftingStep(x[0:3], x[3:6], d[0], z, NOISE), GraphError, r"lengths.*\(2,\).*\(3,\)")
