"""Names of variables: kinds, numbers, batches."""

from __future__ import annotations

import numpy as np

from factors.keys import Keys, Kind, kinds
from models.errors import GraphError
from tests.factors.evaluated import refused

x, l = kinds("x", "l")


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
