"""`schur`: which unknowns are eliminated, and what happens where one of them, or another one, is free."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import nls
from factors import Isotropic, Landmark, Prior, Range
from models import SE2, SE3, R
from nls import FactorGraph, GaussNewton, Schur, Values
from nls.linear.factorization import SingularSystemError
from nls.linear.schur.solver import _heaviest, independent
from tests.nls.graphs import Sample, diagonal, pose_graph
from tests.nls.landmarks import l, landmarks, said, same, seen_by_range, step, two_kinds, x
from tests.nls.solving import near

# ---- what is eliminated


def test_the_kinds_with_the_most_columns_are_eliminated() -> None:
    """o is joined to l: l and m go together, 69 columns; o and m would be 10."""
    sample = two_kinds()
    system = sample.graph.linearize(sample.values)
    assert said(system) == "schur, l and m eliminated: 69 of 106 columns"
    same(system)


def test_held_variables_join_nothing() -> None:
    """With every other pose held no pose is joined to another one; with all held none is left."""
    sample = pose_graph(SE3, n=9)
    sample.graph.fix(x[[0, 2, 4, 6, 7, 8]])
    system = sample.graph.linearize(sample.values)
    assert said(system) == "schur, x eliminated: 18 of 18 columns"
    same(system)
    sample.graph.fix(x[0:9])
    system = sample.graph.linearize(sample.values)
    assert said(system) == "schur, nothing eliminated: 0 of 0 columns"
    assert step(Schur(), system).shape == (0,)


def test_a_pose_graph_loses_single_poses() -> None:
    sample = pose_graph(SE2, n=40)
    system = sample.graph.linearize(sample.values)
    blocks = system.pattern.blocks
    gone, words = independent(system.pattern, blocks)
    assert not (gone[blocks.u] & gone[blocks.v]).any()
    assert words == f"{gone.sum()} of 40 x eliminated: {3 * gone.sum()} of 120 columns"
    same(system)


def test_of_few_kinds_the_best_set_and_of_many_a_set_in_time() -> None:
    """Kinds in pairs, joined in a ring: a search among 40 of them takes half an hour."""
    rng = np.random.default_rng(0)
    for n in (3, 8, 16, 17, 40, 1000):
        joined, columns = np.zeros((n, n), dtype=bool), rng.integers(1, 100, n)
        joined[np.arange(n), np.arange(n) - 1] = joined[np.arange(n) - 1, np.arange(n)] = True
        taken = _heaviest(range(n), joined, columns)
        assert not joined[np.ix_(taken, taken)].any()
        others = np.setdiff1d(np.arange(n), taken)
        assert joined[np.ix_(others, taken)].any(axis=1).all()  # none could be added
        if n <= 8:
            sets = [np.flatnonzero([c >> k & 1 for k in range(n)]) for c in range(1 << n)]
            assert columns[taken].sum() == max(columns[s].sum() for s in sets if not joined[np.ix_(s, s)].any())
        assert columns[taken].sum() >= columns.sum() / 3  # each leaves out two of no more columns


# ---- singular


def loose_pose() -> Sample:
    """A pose more that only looks at one landmark: it can turn around it."""
    sample = landmarks(SE2, seed=13)
    graph = FactorGraph(sample.graph.factors)
    graph.add(Landmark(x[99], l[0], [[1.0, 2.0]], Isotropic(0.1)))
    values = Values({x: (SE2, np.vstack([sample.values[x], [0, 0, 0]]), [*range(12), 99]), l: (R(2), sample.values[l])})
    return Sample(graph, values, values)


@pytest.mark.parametrize(
    ("case", "key"),
    [(lambda: seen_by_range(4), "l99"), (loose_pose, "x99"), (lambda: landmarks(SE2, anchored=False), "x0")],
)
def test_singular_systems_are_refused_by_name(case: Callable[[], Sample], key: str) -> None:
    sample = case()
    system = sample.graph.linearize(sample.values)
    with pytest.raises(SingularSystemError):
        step(Schur(), system)
    with pytest.raises(nls.UnderconstrainedError, match=key):
        sample.graph.optimize(sample.values, GaussNewton(), Schur(), gauge="none")
    same(system, 1e-3 * (1 + diagonal(system)))  # damping holds what is free


def test_a_singular_landmark_shows_before_anything_is_divided_by_its_pivot() -> None:
    sample = seen_by_range(4)
    sample.graph.fix(x[4])
    with pytest.raises(SingularSystemError, match="in a variable that is eliminated by itself"):
        step(Schur(), sample.graph.linearize(sample.values))
    two = seen_by_range(4, 9)
    same(two.graph.linearize(two.values))


def test_a_weak_direction_of_a_landmark_costs_no_digits_elsewhere() -> None:
    """A point known across the line of sight 1e5 times worse than along it: information 1e-10, above rounding."""
    sample = landmarks(SE2, seed=14)
    graph = FactorGraph(sample.graph.factors)
    graph.add(Range(x[[3, 3]], l[[99, 99]], [3.0, 3.1], Isotropic(0.1)))
    graph.add(Prior(l[99], [0.0, 0.0], Isotropic(1e4)))
    points = np.vstack([sample.values[l], sample.values[x][3, :2] + [2.0, 2.0]])
    values = Values({x: (SE2, sample.values[x]), l: (R(2), points, [*range(30), 99])})
    system = graph.linearize(values)
    expected = np.linalg.lstsq(system.A.toarray(), system.b)[0]
    near(step(Schur(), system)[:36], expected[:36], 1e-9)
