"""Parts of a batch: factor[index] is these measurements and nothing else, for every factor, noise and kind of index."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from factors import (
    Bearing,
    Between,
    Covariance,
    Diagonal,
    Factor,
    Heading,
    Huber,
    Information,
    Isotropic,
    Landmark,
    Noise,
    Position,
    Prior,
    Range,
    Robust,
    SqrtInformation,
)
from models import SE2, R
from models.errors import GraphError
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import linearized, refused, same
from tests.factors.samples import SAMPLES as POSE_SAMPLES
from tests.factors.samples import Sample, full_noise, situation
from tests.factors.samples_sensors import SENSOR_SAMPLES
from tests.factors.samples_shifted import SHIFTED_SAMPLES
from tests.factors.samples_sonar import SONAR_SAMPLES

x, l, o = kinds("x", "l", "o")
SAMPLES = [
    s
    for s in [*POSE_SAMPLES, *SENSOR_SAMPLES, *SONAR_SAMPLES, *SHIFTED_SAMPLES]
    if not s.name.startswith("from_function")
]
FUNCTIONS = [s for s in POSE_SAMPLES if s.name.startswith("from_function")]
N = 7


def same_rows(part: Factor, whole: Factor, rows: list[int], values: Values) -> None:
    assert type(part) is type(whole)
    assert part.keys == tuple(keys[rows] for keys in whole.keys)
    (A, b), (A_all, b_all) = linearized(part, values), linearized(whole, values)
    for mine, all_ in zip((*A, b), (*A_all, b_all), strict=True):
        same(mine, all_[rows], rtol=1e-12, atol=1e-13)


@for_all(sample=SAMPLES, bound=[False, True])
def test_rows_of_a_part_are_rows_of_the_batch(sample: Sample, bound: bool) -> None:
    X, z = situation(sample, "large innovation", N, 11)
    values, whole = sample.values(X), sample.factor(z, full_noise(N, sample.dim, 11))
    if bound:
        values.gather(whole)
    part = whole[[5, 0, -1, 5]]
    for name in ("convention", "slots", "unmoved", "relative", "components"):
        assert getattr(part, name, None) == getattr(whole, name, None)
    np.testing.assert_array_equal(part.z, z[[5, 0, 6, 5]])
    with pytest.raises(ValueError, match="read-only"):
        part.z[:] = 0
    same_rows(part, whole, [5, 0, 6, 5], values)
    same_rows(part[[1]], whole, [0], values)  # a part of a part
    np.testing.assert_array_equal(whole.z, z)
    assert len(whole) == N


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
    for sample in FUNCTIONS:
        factor = sample.factor(situation(sample, "truth", N, 0)[1], Isotropic())
        for index in (0, slice(None), np.zeros(N, dtype=bool)):
            refused(lambda factor=factor, index=index: factor[index], GraphError, "function cannot be sliced")


DIAGONALS = np.arange(1, 4)[:, None, None] * np.eye(3)


@for_all(
    case=[
        (Isotropic([1, 2, 3]), "sigma", [3, 1]),
        (Isotropic(2), "sigma", [2]),
        (Diagonal([[1, 2, 3], [4, 5, 6], [7, 8, 9]]), "sigmas", [[7, 8, 9], [1, 2, 3]]),
        (Diagonal([1, 2, 3]), "sigmas", [[1, 2, 3]]),
        (Diagonal(x=[1, 2, 3], y=5, yaw=[7, 8, 9]), "named", {"x": [3, 1], "y": [5], "yaw": [9, 7]}),
        (Covariance(DIAGONALS), "matrix", DIAGONALS[[2, 0]]),
        (Information(DIAGONALS), "matrix", DIAGONALS[[2, 0]]),
        (SqrtInformation(2 * np.eye(3)), "matrix", [2 * np.eye(3)]),
    ]
)
def test_noise_goes_along_and_shared_noise_stays_shared(case: tuple[Noise, str, Any]) -> None:
    """Three measurements of three numbers: the length of a shared sigma must not pass for the number of them."""
    noise, kept, alone = case
    values = Values({x: (SE2, [[0, 0, 0], [1, 2, 0.5], [-1, 0, 2]])})
    for used in (noise, Robust(noise, Huber(0.1))):
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
    for factor in (Range(x[i], l[0], z, unit), Heading(x[i], z, unit), Position(x[i], z, unit, ("z",))):
        assert factor[1:].z.tolist() == [2.0, 3.0]
    assert Bearing(x[i], l[0], z, unit)[1:].z.tolist() == [2.0, 3.0]
    assert Landmark(x[i], l[0], z, unit)[1:].z.tolist() == Position(x[i], z, unit)[1:].z.tolist() == z
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
