"""Batches: names of their variables; a part is these measurements alone; joined, they are the same problem."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

import factors as f
from factors import BearingRange, Between, Cauchy, Diagonal, Factor, Information, Isotropic, Prior, Robust, Wheels
from factors.base import Model
from factors.joined import joined
from factors.keys import Keys, Kind
from models import SE2, R
from models.errors import GraphError
from nls import FactorGraph, Values, kinds
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
    for factor in (f.Range(x[i], l[0], z, unit), f.Heading(x[i], z, unit), f.Position(x[i], z, unit, ("z",))):
        assert factor[1:].z.tolist() == [2.0, 3.0]
    assert f.Bearing(x[i], l[0], z, unit)[1:].z.tolist() == [2.0, 3.0]
    assert f.Landmark(x[i], l[0], z, unit)[1:].z.tolist() == f.Position(x[i], z, unit)[1:].z.tolist() == z
    refused(lambda: f.Bearing(x[i[:2]], l[0], z[:2], unit)[0], GraphError, r"\(2,\) may be 2 measurements or one of 2")
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


close = np.testing.assert_allclose
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


def test_one_variable_and_a_batch() -> None:
    assert repr(x[17]) == "x17"
    assert repr(l[[3, 4]]) == "l[3, 4]"
    assert repr(l[[3]]) == "l3"
    assert x[17].single
    assert not x[[17]].single
    assert (len(x[17]), len(x[[3, 4, 5]]), len(x[[]])) == (1, 3, 0)
    assert x[np.arange(3)].numbers.dtype == np.int64
    assert repr(x[0:1000]).replace(" ", "") == "x[0,1,...,998,999]"


def test_any_whole_number_of_64_bits_is_a_name() -> None:
    low, high = np.iinfo(np.int64).min, np.iinfo(np.int64).max
    assert x[[low, -1, high]].numbers.tolist() == [low, -1, high]
    assert x[np.array([high], dtype=np.uint64)].numbers.tolist() == [high]
    assert repr(x[high]) == f"x{high}"
    assert x[high - 1 : high].numbers.tolist() == [high - 1]
    refused(lambda: x[high : high + 1], GraphError, r"x\[.*below 2\^63")
    refused(lambda: x[np.array([1, high + 1], dtype=np.uint64)], GraphError, rf"{high + 1} is above 2\^63 - 1")


def test_numbers_must_be_a_list_of_whole_ones() -> None:
    for bad in (1.5, [0.0, 1.0], "a", None, [True, False], [1, "b"]):
        refused(lambda bad=bad: x[bad], GraphError, r"x\[...\]: .*whole numbers, got ")
    refused(lambda: x[[[1], [2]]], GraphError, r"\(2, 1\), expected \(n,\)")


def test_equality_and_hash() -> None:
    assert x[3] == x[3]
    assert x[3] == x[[3]]
    assert x[3] != l[3]
    assert x[3] != x[4]
    assert x[[3, 4]] != x[[4, 3]]
    assert x[[3, 4]] != x[[3]]
    assert x[3] != 3
    assert {x[3]: "a", l[3]: "b"}[Keys("x", 3)] == "a"
    assert hash(x[[1, 2]]) == hash(x[np.array([1, 2], dtype=np.int32)])
    assert (x == Kind("x"), x == l, x == "x", len({x, Kind("x"), l})) == (True, False, False, 2)


def test_a_batch_does_not_follow_its_array() -> None:
    numbers = np.array([1, 2, 3])
    keys = x[numbers]
    numbers[0] = 99
    assert keys.numbers.tolist() == [1, 2, 3]


def test_kinds_have_short_names() -> None:
    assert repr(x) == "x"
    assert [kind.name for kind in kinds("pose", "l_b")] == ["pose", "l_b"]
    for bad in ("", "2x", "a b", "x,", "x1"):
        refused(lambda bad=bad: Kind(bad), GraphError, "short name")
