"""Robust kernels: closed formulas, weights as derivatives, and what they do to a graph with outliers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import factors as f
from factors import Cauchy, Covariance, Diagonal, Huber, Isotropic, Prior, Robust, Tukey, check_jacobians
from factors.robust import KERNELS, kernel_from_text
from models import SE2, R
from models.algebra import Array
from models.errors import GraphError, NoiseModelError, OptionError, UnderconstrainedError
from nls import Dogleg, FactorGraph, GaussNewton, LevenbergMarquardt, Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import refused
from tests.nls.graphs import pose_graph, walk, x

(q,) = kinds("q")

FORMULAS: dict[str, Callable[[float, float], float]] = {  # rho(s) of one number, as printed in the sources
    "huber": lambda s, c: s if s <= c**2 else 2 * c * s**0.5 - c**2,
    "cauchy": lambda s, c: c**2 * np.log(1 + s / c**2),
    "tukey": lambda s, c: c**2 / 3 * (1 - (1 - s / c**2) ** 3) if s <= c**2 else c**2 / 3,
    "geman-mcclure": lambda s, c: c**2 * s / (c**2 + s),
    "welsch": lambda s, c: c**2 * (1 - np.exp(-s / c**2)),
    "dcs": lambda s, c: s if s <= c else c * (3 * s - c) / (s + c),
}


@for_all(name=KERNELS, c=[0.1, 1.0, 1.345, 30.0])
def test_rho_is_the_formula_and_weight_its_derivative(name: str, c: float) -> None:
    kernel = KERNELS[name](c)
    s = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 61)]) * c**2
    assert kernel.rho(s) == pytest.approx([FORMULAS[name](v, c) for v in s], rel=1e-12, abs=1e-15 * c**2)
    edges = np.array([c**2, c])  # a kink of the weight: its derivative is looked at on either side
    s = s[(np.abs(s[:, None] - edges) > 1e-3 * edges).all(axis=1) & (s > 0)]
    h = 1e-5 * s
    numeric = (kernel.rho(s + h) - kernel.rho(s - h)) / (2 * h)
    assert kernel.weight(s) == pytest.approx(numeric, rel=1e-6, abs=1e-7)


@for_all(name=KERNELS, c=[1e-3, 1.0, 1e3])
def test_limits(name: str, c: float) -> None:
    """1 at zero, falling, never negative; rho below the parabola and growing; all finite, continuous at an edge."""
    kernel = KERNELS[name](c)
    s = np.array([0.0, 1e-300, 1e-20, 1e-3, 1.0, 1e3, 1e20, 1e300])
    rho, weight = kernel.rho(s), kernel.weight(s)
    assert (rho[0], weight[0]) == (0.0, 1.0)
    assert np.isfinite(rho).all()
    assert ((weight >= 0) & (weight <= 1)).all()
    assert (np.diff(weight) <= 0).all()
    assert (np.diff(rho) >= -1e-12 * rho[1:]).all()
    assert (rho <= s * (1 + 1e-12)).all()
    assert weight[-1] < 1e-100
    for edge in (c, c**2):
        s = edge * np.array([1 - 1e-9, 1 + 1e-9])
        assert np.diff(kernel.rho(s))[0] == pytest.approx(0, abs=1e-7 * edge)
        assert np.diff(kernel.weight(s))[0] == pytest.approx(0, abs=1e-7)


@for_all(name=KERNELS)
def test_constants_and_text(name: str) -> None:
    for c in (0, -1.0, np.nan, np.inf, 1e200, 1e-200, True, "1", None, 1j):
        refused(lambda c=c: KERNELS[name](c), OptionError, "a number above 0")
    kernel = kernel_from_text(f"{name}:2.5")
    assert (type(kernel), kernel.c) == (KERNELS[name], 2.5)
    for c in ("-1", "0", "nan", "inf"):
        refused(lambda c=c: kernel_from_text(f"{name}:{c}"), OptionError, "a number above 0")
    for text in ("", "dcs", "huber:", "huber:x", "hubert:1", "Huber:1", ":1", "huber:1:2", "1"):
        refused(lambda text=text: kernel_from_text(text), OptionError, "robust: .* expected .*(dcs|huber):NUMBER")


def test_kernels_compare_by_value() -> None:
    assert Huber(1) == Huber(1.0)
    assert Huber(1) != Huber(2)
    assert Huber(1) != Cauchy(1)
    assert len({Huber(1), Huber(1.0), Cauchy(1)}) == 2
    assert repr(f.DCS(0.5)) == "DCS(0.5)"


NOISES = [
    Isotropic(0.3),
    Diagonal([0.1, 0.2, 0.3]),
    Diagonal(yaw=0.3, x=0.1, y=0.2),
    Covariance(np.diag([0.01, 0.04, 0.09]) + 0.001),
    f.Information(np.diag([100.0, 25.0, 0.0])),
    f.SqrtInformation([[10.0, 1.0, 0.0], [0.0, 5.0, 1.0], [0.0, 0.0, 3.0]]),
    Covariance(np.array([np.diag([0.01, 0.04, 0.09]) * k for k in (1, 2, 3)])),
]


@for_all(noise=NOISES)
def test_every_noise_may_be_robust(noise: f.Noise) -> None:
    """A robust noise whitens as before; chi2 of the factor is before the kernel, chi2 of the graph after it."""
    rng, kernel = np.random.default_rng(0), Cauchy(1.5)
    X, z = walk(SE2, 3, rng), walk(SE2, 3, rng)
    plain, robust = Prior(x[0:3], z, noise), Prior(x[0:3], z, Robust(noise, kernel))
    values = Values({x: (SE2, X)})
    assert np.array_equal(robust.chi2(values), plain.chi2(values))
    assert robust.weights(values) == pytest.approx(kernel.weight(plain.chi2(values)))
    assert np.array_equal(plain.weights(values), np.ones(3))
    assert FactorGraph([robust]).chi2(values) == pytest.approx(kernel.rho(plain.chi2(values)).sum(), rel=1e-14)
    A, b = FactorGraph([robust]).linearize(values)
    A0, b0 = FactorGraph([plain]).linearize(values)
    root = np.sqrt(np.repeat(robust.weights(values), 3))
    assert b == pytest.approx(root * b0, rel=1e-14)
    assert A.toarray() == pytest.approx(root[:, None] * A0.toarray(), rel=1e-14)


def test_what_cannot_be_robust() -> None:
    for noise, kernel, named in (
        (Robust(Isotropic(1), Huber(1)), Huber(1), "not robust already"),
        (0.1, Huber(1), "expected a noise"),
        (None, Huber(1), "expected a noise"),
        (Isotropic(1), "huber", "expected a kernel"),
        (Isotropic(1), Huber, "expected a kernel"),
        (Isotropic(1), None, "expected a kernel"),
    ):
        refused(lambda noise=noise, kernel=kernel: Robust(noise, kernel), NoiseModelError, named)


# ---- in a graph


def test_the_graph_is_left_alone() -> None:
    sample = pose_graph(SE2, seed=1)
    before = sample.graph.chi2(sample.values)
    sample.graph.fix(x[0])
    robust = sample.graph.robust(Huber(1.0))
    assert [type(f) for f in robust.factors] == [type(f) for f in sample.graph.factors]
    assert robust.chi2(sample.values) < before == sample.graph.chi2(sample.values)
    assert all(f.kernel is None for f in sample.graph.factors)
    assert all(f.kernel == Huber(1.0) for f in robust.factors)
    assert len(robust.fixed) == 1
    robust.fix(x[1])
    robust.add(sample.graph.factors[0])
    assert (len(sample.graph.fixed), len(sample.graph.factors)) == (1, len(robust.factors) - 1)
    again = robust.robust(Cauchy(2.0))  # instead, not on top
    assert all(f.kernel == Cauchy(2.0) for f in again.factors)
    assert again.factors[0].noise.noise is sample.graph.factors[0].noise


def test_everything_rejected_is_said() -> None:
    """A Tukey kernel that gives no measurement any weight leaves nothing to determine the unknown."""
    graph = FactorGraph([Prior(q[[0, 0]], [[0.0], [0.1]], Robust(Isotropic(0.01), Tukey(3.0)))])
    for optimizer in (GaussNewton(), LevenbergMarquardt(), Dogleg()):
        with pytest.raises(UnderconstrainedError, match="q0"):
            graph.optimize(Values({q: (R(1), [[50.0]])}), optimizer)


class Halved(Cauchy):
    """A weight that is another derivative than that of its rho."""

    def weight(self, s: Array) -> Array:
        return 0.5 * super().weight(s)


def test_check_jacobians_checks_the_weight_of_a_kernel() -> None:
    factor, at = Prior(q[0], [1.0, 2.0], Isotropic(0.1)), Values({q: (R(2), [0.0, 0.0])})
    for kernel in KERNELS.values():
        assert check_jacobians(factor.robust(kernel(1.5)), at) < 1e-6
    refused(
        lambda: check_jacobians(factor.robust(Halved(2)), at), GraphError, r"Halved\(2\): weight is .* d rho / ds is"
    )
