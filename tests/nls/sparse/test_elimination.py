"""Which order CHOLMOD eliminates in: AMD's, and METIS's where a large graph costs less in that."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import nls.linear.cholesky as cholesky
from models.algebra import Index
from nls.sparse.elimination import Elimination
from nls.sparse.fill import counted

pytestmark = pytest.mark.skipif(cholesky.cholmod() is None, reason="needs CHOLMOD")


def cube(side: int) -> tuple[Index, Index, int]:
    """Pairs of neighbors among side^3 nodes: of all graphs of its size one with the worst fill."""
    number = np.arange(side**3).reshape(side, side, side)
    pairs = [(number[:-1], number[1:]), (number[:, :-1], number[:, 1:]), (number[:, :, :-1], number[:, :, 1:])]
    u, v = (np.concatenate([pair[s].reshape(-1) for pair in pairs]) for s in (0, 1))
    return u, v, side**3


def chain(V: int) -> tuple[Index, Index, int]:
    return np.arange(V - 1), np.arange(1, V), V


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


def test_a_large_graph_with_much_fill_takes_metis_which_costs_less(monkeypatch: pytest.MonkeyPatch) -> None:
    u, v, V = cube(23)
    assert len(u) > cholesky.LARGE
    methods = asked(monkeypatch)
    order, flops = ordered(u, v, V)
    assert methods == ["amd", "metis"]
    assert np.array_equal(ordered(u, v, V)[0], order)  # every time the same
    monkeypatch.setattr(cholesky, "LARGE", len(u))
    amd, more = ordered(u, v, V)
    assert not np.array_equal(order, amd)
    assert more > cholesky.COSTLY * len(u)
    assert flops < 0.7 * more


def test_without_metis_the_order_of_amd_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    u, v, V = cube(23)
    methods = asked(monkeypatch, built_with_metis=False)
    order, _ = ordered(u, v, V)
    assert methods == ["amd", "metis"]
    monkeypatch.setattr(cholesky, "LARGE", len(u))
    assert np.array_equal(order, ordered(u, v, V)[0])


def test_a_large_graph_with_little_fill_stays_with_amd(monkeypatch: pytest.MonkeyPatch) -> None:
    u, v, V = chain(40_000)
    methods = asked(monkeypatch)
    _, flops = ordered(u, v, V)
    assert flops < 10 * len(u)
    assert methods == ["amd"]


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
