"""Parts of a batch: factor[index] is these measurements and nothing else, for every factor, noise and kind of index."""

from __future__ import annotations

from typing import Any

import numpy as np

import factors as f
from factors import Bearing, Between, Diagonal, Isotropic, Position, Prior, Robust
from models import SE2, R
from models.errors import GraphError
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import refused, same_rows

x, l = kinds("x", "l")
N = 7


def test_every_kind_of_index() -> None:
    values = Values({x: (SE2, np.random.default_rng(0).normal(size=(N + 1, 3)))})
    whole = Between(x[np.arange(N)], x[np.arange(1, N + 1)], np.arange(3 * N).reshape(N, 3), Isotropic(1.0))
    for index, rows in (
        (3, [3]),
        (np.int64(-1), [6]),
        (slice(5, None, -2), [5, 3, 1]),
        (np.arange(N) % 3 == 1, [1, 4]),
        (slice(None), list(range(N))),
    ):
        same_rows(whole[index], whole, rows, values)
        assert whole[index].z.tolist() == whole.z[rows].tolist()


def test_a_function_has_no_parts() -> None:
    factor = f.Factor.from_function(np.array, x[0:N], 3)
    for index in (0, slice(None), np.zeros(N, dtype=bool)):
        refused(lambda index=index: factor[index], GraphError, "function cannot be sliced")


DIAGONALS = np.arange(1, 4)[:, None, None] * np.eye(3)


@for_all(
    case=[
        (Isotropic([1, 2, 3]), "sigma", [3, 1]),
        (Isotropic(2), "sigma", [2]),
        (Diagonal([[1, 2, 3], [4, 5, 6], [7, 8, 9]]), "sigmas", [[7, 8, 9], [1, 2, 3]]),
        (Diagonal([1, 2, 3]), "sigmas", [[1, 2, 3]]),
        (Diagonal(x=[1, 2, 3], y=5, yaw=[7, 8, 9]), "named", {"x": [3, 1], "y": [5], "yaw": [9, 7]}),
        (f.Covariance(DIAGONALS), "matrix", DIAGONALS[[2, 0]]),
        (f.Information(DIAGONALS), "matrix", DIAGONALS[[2, 0]]),
        (f.SqrtInformation(2 * np.eye(3)), "matrix", [2 * np.eye(3)]),
    ]
)
def test_noise_goes_along_and_shared_noise_stays_shared(case: tuple[f.Noise, str, Any]) -> None:
    """Three measurements of three numbers: the length of a shared sigma must not pass for the number of them."""
    noise, kept, alone = case
    values = Values({x: (SE2, [[0, 0, 0], [1, 2, 0.5], [-1, 0, 2]])})
    for used in (noise, Robust(noise, f.Huber(0.1))):
        prior = Prior(x[[0, 1, 2]], np.ones((3, 3)), used)
        part = prior[[2, 0]]
        inner = getattr(part.noise.noise if isinstance(part.noise, Robust) else part.noise, kept)
        if kept == "named":
            assert {name: sigma.tolist() for name, sigma in inner.items()} == alone
        else:
            np.testing.assert_array_equal(inner, alone)
        assert part.kernel == prior.kernel
        same_rows(part, prior, [2, 0], values)
        np.testing.assert_array_equal(part.weights(values), prior.weights(values)[[2, 0]])
    assert (part.weights(values) < 1).any()


def test_one_measurement_shared_by_all_stays_one() -> None:
    values = Values({x: (SE2, np.random.default_rng(0).normal(size=(4, 3)))})
    for z in ([1.0, 2.0, 0.5], [[1.0, 2.0, 0.5]]):
        step = Between(x[[0, 1, 2]], x[[1, 2, 3]], z, Isotropic(1.0))
        if np.ndim(z) == 1:  # three numbers for three measurements: what they are is known once the spaces are
            refused(lambda step=step: step[:2], GraphError, r"\(3,\) may be 3 measurements or one of 3")
        values.gather(step)
        same_rows(step[[2, 0]], step, [2, 0], values)
        assert step[[2, 0]].z.tolist() == step.z.tolist()


def test_plain_lists_of_numbers() -> None:
    """z (n,): told from one measurement of n numbers by what the factor measures."""
    i, z, unit = np.arange(3), [1.0, 2.0, 3.0], Isotropic(1)
    for factor in (f.Range(x[i], l[0], z, unit), f.Heading(x[i], z, unit), Position(x[i], z, unit, ("z",))):
        assert factor[1:].z.tolist() == [2.0, 3.0]
    assert Bearing(x[i], l[0], z, unit)[1:].z.tolist() == [2.0, 3.0]
    assert f.Landmark(x[i], l[0], z, unit)[1:].z.tolist() == Position(x[i], z, unit)[1:].z.tolist() == z
    refused(lambda: Bearing(x[i[:2]], l[0], z[:2], unit)[0], GraphError, r"\(2,\) may be 2 measurements or one of 2")
    flat = Prior(x[i], z, unit)
    flat.bind(R(1))
    assert flat[1:].z.tolist() == [2.0, 3.0]
    assert flat[[2, 2, 0]].chi2(Values({x: (R(1), np.zeros((3, 1)))})).tolist() == [9.0, 9.0, 1.0]


@for_all(
    case=[
        (5, "no measurement 5; the batch has 5"),
        ([0, -6], "no measurement -6; the batch has 5"),
        ([True, False], "mask of 2 for 5"),
        (np.ones((5, 1), dtype=bool), r"bool and shape \(5, 1\)"),
        (True, r"index True has type bool and shape \(\)"),
        ([0.0, 1.0], "float64"),
        ("x3", "index 'x3'"),
        (None, "index None"),
        ((1, 2, 3, 4, 5, 6, 7), "no measurement 5"),
        ([[0], [1]], r"int64 and shape \(2, 1\)"),
        ([[0], [1, 2]], r"index \[\[0\], \[1, 2\]\]: .*inhomogeneous"),
        (slice("a", None), "slice"),
    ]
)
def test_wrong_indices_are_refused(case: tuple[Any, str]) -> None:
    edges = Between(x[np.arange(5)], x[np.arange(1, 6)], np.zeros((5, 3)), Isotropic(1))
    refused(lambda: edges[case[0]], GraphError, case[1])
