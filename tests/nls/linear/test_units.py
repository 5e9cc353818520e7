"""Units decide neither what is free nor where a solver arrives; what else is free is named."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Between, Diagonal, Factor, Isotropic, Landmark, Prior, Range
from models import SE2, R
from nls import (
    FactorGraph,
    Pinv,
    UnderconstrainedError,
    Values,
    kinds,
)
from nls.linear import SOLVERS

x, l, p = kinds("x", "l", "p")
SCALES = pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3, 1e6])
EVERY = pytest.mark.parametrize("name", [name for name, kind in SOLVERS.items() if kind.missing() is None])


def plane(scale: float, anchored: bool) -> tuple[FactorGraph, Values]:
    """Poses on a circle that see four points, lengths in units of so many meters."""
    rng, angle = np.random.default_rng(3), np.linspace(0, 5, 12)
    X = np.c_[4 * np.cos(angle), 4 * np.sin(angle), angle + np.pi / 2]
    L = np.array([[0.0, 1.0], [6.0, 1.0], [-6.0, 3.0], [1.0, -7.0]])
    meters = np.array([1 / scale, 1 / scale, 1.0])
    sigmas = np.array([0.05, 0.05, 0.01])
    i, j = np.repeat(np.arange(12), 4), np.tile(np.arange(4), 12)
    seen = SE2.act(SE2.inverse(X[i]), L[j]) + 0.05 * rng.normal(size=(48, 2))
    steps = SE2.between(X[:-1], X[1:]) + sigmas * rng.normal(size=(11, 3))
    factors: list[Factor] = [
        Between(x[0:11], x[1:12], steps * meters, Diagonal(sigmas * meters)),
        Landmark(x[i], l[j], seen / scale, Isotropic(0.05 / scale)),
    ]
    if anchored:
        factors.append(Prior(x[0], X[0] * meters, Diagonal(sigmas * meters)))
    start = SE2.retract(X, sigmas * rng.normal(size=X.shape))
    return FactorGraph(factors), Values({x: (SE2, start * meters), l: (R(2), L / scale)})


@EVERY
@SCALES
def test_units_of_length_change_nothing(name: str, scale: float) -> None:
    for anchored, gauge in ((True, "first"), (False, "first"), (False, "free")):
        graph, values = plane(scale, anchored)
        result = graph.optimize(values, linear_solver=SOLVERS[name](), gauge=gauge)
        reference = (lambda g, v: g.optimize(v))(*plane(1.0, anchored))
        assert result.converged
        assert (result.chi2_final, result.dof) == (pytest.approx(reference.chi2_final, rel=1e-6), reference.dof)
        assert result.underconstrained == ()
        if gauge == "first":
            found, expected = result.values[x][:, :2] * scale, reference.values[x][:, :2]
            np.testing.assert_allclose(found, expected, atol=1e-4)


def test_a_shortest_step_of_a_free_gauge_names_what_else_it_leaves() -> None:
    graph, values = plane(1.0, anchored=False)
    graph.add(Range(x[0], p[0], [3.0], Isotropic(0.1)))
    stacks = {kind: (stack.manifold, stack.X) for kind, stack in values.stacks.items()}
    result = graph.optimize(Values({**stacks, p: (R(2), [[9.0, 9.0]])}), None, Pinv(), gauge="free")
    assert (result.converged, result.underconstrained) == (True, ("p0: x, y",))
    assert result.dof == 11 * 3 + 96 + 1 - (36 - 3 + 8 + 1)


@SCALES
def test_a_heading_that_calls_itself_relative_is_refused(scale: float) -> None:
    graph, values = plane(scale, anchored=False)
    prior = Prior(x[3], values[x[3]], Isotropic(1.0), components=("yaw",))
    prior.relative = True  # type: ignore[misc]
    graph.add(prior)
    with pytest.raises(UnderconstrainedError):
        graph.optimize(values, gauge="free")
