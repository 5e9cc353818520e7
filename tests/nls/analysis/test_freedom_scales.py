"""Weights and lengths that rounding cannot hold together: the measurement is named, nothing is called free."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Between, Isotropic, Prior
from models import SE2
from nls import FactorGraph, Values
from tests.combinations import for_all
from tests.nls.analysis.test_freedom import names, refused
from tests.nls.graphs import x
from tests.nls.solving import null_space


def one_unlike(n: int, sigma: float, measured: float = 1.0) -> tuple[FactorGraph, Values]:
    """A chain of poses, the first held; the step from x2 to x3 has another sigma, or another length."""
    X = np.stack([np.arange(n + 0.0), np.zeros(n), np.zeros(n)], axis=1)
    i = np.delete(np.arange(n - 1), 2)
    graph = FactorGraph([Between(x[i], x[i + 1], [1.0, 0.02, 0.01], Isotropic(0.1))])
    graph.add(Between(x[2], x[3], [measured, 0.02, 0.01], Isotropic(sigma)))
    graph.add(Prior(x[0], X[0], Isotropic(0.1)))
    X[3:, 0] += measured - 1.0
    return graph, Values({x: (SE2, X)})


@for_all(n=[6, 120], sigma=[1e-150, 1e-12, 1e10, 1e149])
def test_the_measurement_whose_weight_is_unlike_all_others_is_named(n: int, sigma: float) -> None:
    """Nothing is free, whatever the weights; n = 120 is past 300 columns: the sparse path."""
    graph, values = one_unlike(n, sigma)
    error = refused(graph, values)
    assert (error.nullity, error.components) == (0, ())
    assert f"of Between(x2, x3), sigma {sigma:.3g} (information {sigma**-2:.3g}); its row of A is" in str(error)
    assert error.advice[0].action == ("larger sigma" if sigma < 0.1 else "smaller sigma")
    assert "free" not in str(error)


@for_all(measured=[1e12, 1e100])
def test_the_measurement_that_is_far_too_long_is_named(measured: float) -> None:
    graph, values = one_unlike(6, 0.1, measured)
    error = refused(graph, values)
    assert error.nullity == 0
    assert "of Between(x2, x3), sigma 0.1 (information 100, Jacobian up to" in str(error)
    assert f"its measurement is [{measured}, 0.02, 0.01]" in str(error)
    assert names(error) == ["x2", "x3"]


@for_all(sigma=[1e-12, 1e10])
def test_what_is_free_is_named_beside_a_weight_that_is_unlike_all_others(sigma: float) -> None:
    graph, values = one_unlike(6, sigma)
    X = np.concatenate([values[x[0:6]], [[0.0, 0.0, 0.0]]])
    graph.add(Prior(x[6], X[6], Isotropic(0.1), components=["x", "y"]))
    error = refused(graph, Values({x: (SE2, X)}))
    assert (names(error), error.components) == (["x6"], ("x6: yaw",))


@for_all(n=[6, 120])
def test_free_directions_do_not_depend_on_weights(n: int) -> None:
    """A floating component: the basis spans its three motions, with one edge 1e150 times as heavy."""
    graph, values = one_unlike(n, 1e-150)
    N = null_space(FactorGraph(graph.factors[:2]).linearize(values))
    assert N.shape == (3 * n, 3)
    plain = null_space(FactorGraph(one_unlike(n, 0.1)[0].factors[:2]).linearize(values))
    cosines = np.linalg.svd(np.linalg.qr(N)[0].T @ np.linalg.qr(plain)[0], compute_uv=False)
    assert cosines == pytest.approx(np.ones(3), abs=1e-6)


def test_two_kinds_of_weights_name_no_single_measurement() -> None:
    """All steps of a half are a million times as heavy as those of the other: as many rows as there are."""
    X = np.stack([np.arange(200.0), np.zeros(200), np.zeros(200)], axis=1)
    i = np.arange(199)
    sigma = np.where(i < 90, 1e-9, 1e3)
    graph = FactorGraph([Between(x[i], x[i + 1], [1.0, 0.0, 0.0], Isotropic(sigma)), Prior(x[0], X[0], Isotropic(1e3))])
    error = refused(graph, Values({x: (SE2, X)}))
    assert error.nullity == 0
    assert "and there are 270 rows of about that size" in str(error)
    assert error.advice[0].action == "compare sigmas"
