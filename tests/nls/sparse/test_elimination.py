"""Which order CHOLMOD eliminates in, AMD's or METIS's; and that an elimination is kept for its own pairs alone."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import nls.linear.cholesky as cholesky
from models.algebra import Index
from nls.sparse.elimination import Elimination, Eliminations
from nls.sparse.fill import counted

CHOLMOD = pytest.mark.skipif(cholesky.cholmod() is None, reason="needs CHOLMOD")


def cube(side: int) -> tuple[Index, Index, int]:
    """Pairs of neighbors among side^3 nodes: of all graphs of its size one with the worst fill."""
    number = np.arange(side**3).reshape(side, side, side)
    pairs = [(number[:-1], number[1:]), (number[:, :-1], number[:, 1:]), (number[:, :, :-1], number[:, :, 1:])]
    u, v = (np.concatenate([pair[s].reshape(-1) for pair in pairs]) for s in (0, 1))
    return u, v, side**3


def asked(monkeypatch: pytest.MonkeyPatch, built_with_metis: bool = True) -> list[str]:
    """The methods CHOLMOD is asked for; without METIS it falls back to AMD by itself."""
    module: Any = cholesky.cholmod()
    methods: list[str] = []

    def analyze(graph: Any, mode: str, ordering_method: str) -> Any:
        methods.append(ordering_method)
        return module.analyze(graph, mode=mode, ordering_method=ordering_method if built_with_metis else "amd")

    monkeypatch.setattr(cholesky, "cholmod", lambda: SimpleNamespace(analyze=analyze))
    return methods


def ordered(u: Index, v: Index, V: int) -> tuple[Index, float]:
    """The order, which is one, and its flops."""
    order = Elimination(u, v, V, cholesky.Cholmod.order).variables
    assert np.array_equal(np.sort(order), np.arange(V))
    return order, counted(np.ones(V, dtype=np.intp), u, v, order).flops


@CHOLMOD
def test_a_large_graph_with_much_fill_takes_metis_which_costs_less(monkeypatch: pytest.MonkeyPatch) -> None:
    u, v, V = cube(23)
    assert len(u) > cholesky.LARGE
    with monkeypatch.context() as patch:
        methods = asked(patch)
        order, flops = ordered(u, v, V)
        assert methods == ["amd", "metis"]
        assert np.array_equal(ordered(u, v, V)[0], order)  # every time the same
    with monkeypatch.context() as patch:
        methods = asked(patch, built_with_metis=False)
        without, _ = ordered(u, v, V)
        assert methods == ["amd", "metis"]
    monkeypatch.setattr(cholesky, "LARGE", len(u))
    amd, more = ordered(u, v, V)
    assert np.array_equal(without, amd)
    assert not np.array_equal(order, amd)
    assert more > cholesky.COSTLY * len(u)
    assert flops < 0.7 * more


@CHOLMOD
def test_a_large_graph_with_little_fill_stays_with_amd(monkeypatch: pytest.MonkeyPatch) -> None:
    V = 40_000
    methods = asked(monkeypatch)
    _, flops = ordered(np.arange(V - 1), np.arange(1, V), V)
    assert flops < 10 * V
    assert methods == ["amd"]


@CHOLMOD
def test_a_small_graph_is_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def counting(*_: object) -> None:
        raise AssertionError("counted")

    u, v, V = cube(21)
    assert 20_687 < len(u) <= cholesky.LARGE  # city10000, the largest public set of its kind
    monkeypatch.setattr(cholesky, "counted", counting)
    methods = asked(monkeypatch)
    _, flops = ordered(u, v, V)
    assert flops > cholesky.COSTLY * len(u)
    assert methods == ["amd"]
    with pytest.raises(AssertionError, match="counted"):
        ordered(*cube(23))


def test_an_elimination_is_kept_for_the_same_pairs_and_for_no_others() -> None:
    def backward(u: Index, v: Index, V: int) -> Index:
        return np.arange(V)[::-1]

    def forward(u: Index, v: Index, V: int) -> Index:
        return np.arange(V)

    kept, u, v = Eliminations(), np.array([0, 1, 2]), np.array([1, 2, 3])
    first = kept.of(u, v, 4, backward)
    assert kept.of(u.copy(), v.copy(), 4, backward) is first
    given = kept.of(u, v, 4, np.arange(4))  # its order is given: neither kept nor in the way of the latest
    assert given.variables.tolist() == [0, 1, 2, 3]
    assert kept.of(u, v, 4, backward) is first
    for other in ((np.array([0, 1, 1]), v, 4, backward), (u, np.array([1, 2, 0]), 4, backward), (u, v, 5, backward)):
        new = kept.of(*other)
        assert new is not first
        assert (new.u.tolist(), new.v.tolist(), len(new.variables)) == (other[0].tolist(), other[1].tolist(), other[2])
        first = kept.of(u, v, 4, backward)
        assert first.variables.tolist() == [3, 2, 1, 0]
    assert kept.of(u, v, 4, forward).variables.tolist() == [0, 1, 2, 3]
