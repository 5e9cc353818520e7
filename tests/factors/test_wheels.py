"""Wheels: the graph and the motion agree, the slip, parts of a batch, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Diagonal, Information, Isotropic, Prior, Wheels
from models import SE2, SE3, Measured
from models.errors import GraphError, NoiseModelError, OptionError, UnderconstrainedError
from models.vehicles import differential_drive, travel_sigmas
from nls import FactorGraph, Values, kinds
from tests.factors.evaluated import refused, same

(x,) = kinds("x")
NOISE = Diagonal(right=0.01, left=0.01, lateral=0.001)
BASE = 0.5


def test_a_graph_of_wheels_is_the_motion() -> None:
    """Round and round with up to 1.2 rad a step, forwards and backwards, from a start at one place."""
    rng = np.random.default_rng(0)
    u = rng.uniform(0.1, 0.7, (30, 2)) * np.where(np.arange(30) % 4 > 0, 1, -1)[:, None]
    X = [np.array([[1.0, -2.0, 3.0]])]
    for step in u:
        X.append(differential_drive(X[-1], step[None], BASE)[0])
    truth = np.concatenate(X)
    assert np.abs(np.diff(truth[:, 2])).max() > 5.0, "the heading passes pi"
    k = np.arange(30)
    graph = FactorGraph([Prior(x[0], truth[0], Isotropic(0.1)), Wheels(x[k], x[k + 1], u, NOISE, BASE)])
    start = SE2.retract(truth, 0.3 * rng.standard_normal(truth.shape))
    result = graph.optimize(Values({x: (SE2, start)}))
    assert result.converged
    assert result.chi2_final < 1e-12
    same(SE2.local(truth, result.values[x]), 0.0, atol=1e-6)


def test_slip_across_is_measured_as_zero_unless_given() -> None:
    slid = Values({x: (SE2, [[0.0, 0.0, 0.0], [1.0, 0.02, 0.0]])})
    for z, e in (([1.0, 1.0], -0.02), ([1.0, 1.0, 0.02], 0.0), ([[1.0, 1.0, 0.05]], 0.03)):
        factor = Wheels(x[0], x[1], z, Isotropic(1.0), BASE)
        model, X = slid.gather(factor)
        assert model.space is Measured("right", "left", "lateral")
        same(model.error(*X), [[0.0, 0.0, e]], atol=1e-14)
        same(Wheels(x[0], x[1], factor.z, Isotropic(1.0), BASE).chi2(slid), e * e, atol=1e-14)


def test_without_a_slip_that_is_measured_the_heading_does_not_hold_the_way() -> None:
    values = Values({x: (SE2, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])})
    graph = FactorGraph([Wheels(x[0], x[1], [1.0, 1.0], Information(np.diag([1.0, 1.0, 0.0])), BASE)])
    with pytest.raises(UnderconstrainedError, match="x1"):
        graph.optimize(values)


def test_what_does_not_fit() -> None:
    for base in (0.0, -0.5, float("nan"), float("inf"), "wide", None, True, [0.5]):
        refused(lambda base=base: Wheels(x[0], x[1], [1.0, 1.0], NOISE, base), OptionError, "Wheels: base")
    for z in (1.0, [1.0], [1.0, 1.0, 0.0, 0.0], np.ones((2, 2, 2)), []):
        named = r"Wheels\(x0, x1\): z has shape .*, expected \(n, 2\)"
        refused(lambda z=z: Wheels(x[0], x[1], z, NOISE, BASE), GraphError, named)
    space = Values({x: (SE3, SE3.identity(3))})
    refused(lambda: Wheels(x[0], x[1], [1.0, 1.0], NOISE, BASE).chi2(space), GraphError, "Wheels: x0 is in SE3, .*SE2")
    still = np.array([[1.0, 1.0], [0.0, 0.1]])
    named = "sigma of component 0, measurement 1, is 0"
    refused(lambda: Diagonal(travel_sigmas(still, 0.01, 0.01, 0.001)), NoiseModelError, named)
