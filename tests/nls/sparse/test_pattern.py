"""A and b equal a slow dense reference, the double sum over measurements and slots; H and A'b too."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from itertools import pairwise
from weakref import ref

import numpy as np
import pytest

from factors import Between, Diagonal, Isotropic, Prior
from models import SE2, R
from models.algebra import Array
from nls import FactorGraph, GaussNewton, LinearSystem, Marginals, Values, factorize
from nls.linear import best_decomposition
from nls.linear.cholesky import cholmod
from nls.sparse.elimination import Elimination
from nls.sparse.hessian import Hessian
from nls.sparse.pattern import Pattern
from nls.values import Stack
from tests.nls.graphs import SAMPLES, Sample, mixed, pose_graph, x
from tests.nls.solving import near


def columns_of(values: Values, fixed: set[str]) -> dict[str, list[int]]:
    """Column numbers of every free variable, by name: kind after kind, in the order of the stacks."""
    out, n = {}, 0
    for name, stack in values.stacks.items():
        for number in stack.numbers:
            if f"{name}{number}" not in fixed:
                out[f"{name}{number}"] = list(range(n, n + stack.manifold.dim))
                n += stack.manifold.dim
    return out


def reference(sample: Sample) -> tuple[Array, Array, Array, Array]:
    """Dense A, b, H = sum A_a'A_c and g = sum A_a'b, one measurement and one pair of slots at a time."""
    fixed = {repr(key) for keys in sample.graph.fixed for key in keys}
    columns = columns_of(sample.values, fixed)
    n = sum(map(len, columns.values()))
    H, g = np.zeros((n, n)), np.zeros(n)
    A_rows, b_rows = [], []
    for factor in sample.graph.factors:
        model, X = sample.values.gather(factor)
        A, b = model.linearize(*X)
        for k in range(len(factor)):
            row = np.zeros((model.dim, n))
            names = [repr(keys[[k]]) for keys in factor.keys]
            for a, name in enumerate(names):
                if name not in columns:
                    continue
                row[:, columns[name]] += A[a][k]
                g[columns[name]] += A[a][k].T @ b[k]
                for c, other in enumerate(names):
                    if other in columns:
                        H[np.ix_(columns[name], columns[other])] += A[a][k].T @ A[c][k]
            A_rows.append(row)
            b_rows.append(b[k])
    return np.concatenate(A_rows), np.concatenate(b_rows), H, g


@pytest.mark.parametrize("name", SAMPLES)
def test_A_b_and_H_equal_the_double_sum(name: str) -> None:
    sample = SAMPLES[name]()
    system = sample.graph.linearize(sample.values)
    A, b, H, g = reference(sample)
    assert np.array_equal(system.A.toarray(), A)
    assert np.array_equal(system.b, b)
    unpacked_A, unpacked_b = system
    assert unpacked_A is system.A
    assert unpacked_b is system.b
    assert system.chi2 == pytest.approx(float(b @ b), rel=1e-14)
    assert sample.graph.chi2(sample.values) == pytest.approx(float(b @ b), rel=1e-14)
    near(system.H.toarray(), H, 1e-12)
    near(A.T @ A, H, 1e-12)
    assert (system.H != system.H.T).nnz == 0  # symmetric to the bit
    near(system.gradient, g, 1e-12)
    np.testing.assert_allclose(system.column_norms, np.linalg.norm(A, axis=0), rtol=1e-13)
    cosine = np.abs(A.T @ b) / (np.linalg.norm(A, axis=0) * np.linalg.norm(b))
    assert system.scaled_gradient == pytest.approx(cosine.max(), rel=1e-10)


def test_H_stores_one_block_per_joined_pair_whatever_its_factors() -> None:
    sample = pose_graph(SE2, n=8)
    ends = np.concatenate([np.stack([k.numbers for k in f.keys], axis=1) for f in sample.graph.factors[:3]])
    pairs = {frozenset(pair) for pair in ends.tolist()}
    assert len(pairs) < len(sample.graph) - 1  # there are duplicates
    assert sample.graph.linearize(sample.values).H.nnz == 9 * (8 + 2 * len(pairs))


@pytest.mark.parametrize("name", list(SAMPLES))
def test_any_elimination_order_gives_the_same_H(name: str) -> None:
    """The lower triangle, with the rows of a column rising: a factorization reads it without sorting."""
    sample = SAMPLES[name]()
    system = sample.graph.linearize(sample.values)
    hessian = system.pattern.hessian(lambda u, v, V: np.random.default_rng(0).permutation(V))
    lower, p = hessian.matrix(hessian.data(system.H_blocks)), hessian.permutation
    H = (system.A.T @ system.A).toarray()[np.ix_(p, p)]
    np.testing.assert_allclose(lower.toarray(), np.tril(H), rtol=0, atol=1e-12 * np.abs(H).max())
    assert all((np.diff(lower.indices[a:b]) > 0).all() for a, b in pairwise(lower.indptr))


def test_labels_name_every_row_and_column() -> None:
    sample = mixed(0, held=True)
    system = sample.graph.linearize(sample.values)
    assert (len(system.rows), len(system.cols)) == (system.A.shape[0], system.A.shape[1])
    assert system.cols[:2] == ["l-1: x", "l-1: y"]  # l5 is held
    assert system.cols[6:9] == ["x40: x", "x40: y", "x40: yaw"]
    assert system.cols[9] == "x8: x"  # x7 is held
    assert (system.rows[0], system.rows[2]) == ("Between(x40, x7): x", "Between(x40, x7): yaw")
    assert system.rows[-3] == "Prior(l77): y"  # one component alone
    assert system.rows[-1] == "Prior(y2): x"
    for label, row in zip(system.rows, system.A.toarray(), strict=True):
        for column in np.flatnonzero(row):
            assert system.cols[column].split(":")[0] in label
    for k, label in enumerate(system.cols):
        key, component = system.column(k)
        assert label == f"{key!r}: {component}"


def test_everything_held_leaves_no_columns_and_what_is_not_measured_zeros() -> None:
    sample = pose_graph(SE2)
    sample.graph.fix(x[0:8])
    system = sample.graph.linearize(sample.values)
    assert (system.A.shape, system.A.nnz) == ((len(system.b), 0), 0)
    assert (system.H.shape, system.gradient.shape, system.scaled_gradient) == ((0, 0), (0,), 0.0)
    graph = FactorGraph([Prior(x[1], [0.0, 0.0, 0.0], Diagonal([1.0, 0.5, 0.25]))])
    system = graph.linearize(Values({x: (SE2, SE2.identity(3))}))
    assert system.A.shape == (3, 9)
    assert system.H.toarray().diagonal().tolist() == [0.0] * 3 + [1.0, 4.0, 16.0] + [0.0] * 3


def test_an_empty_batch_has_no_rows() -> None:
    sample = pose_graph(SE2)
    before = sample.graph.linearize(sample.values).A
    sample.graph.add(Between(x[[]], x[[]], np.zeros((0, 3)), Isotropic(1)))
    after = sample.graph.linearize(sample.values)
    assert np.array_equal(after.A.toarray(), before.toarray())
    assert after.H.nnz > 0


def test_a_pattern_serves_the_same_factors_over_the_same_variables_and_no_others() -> None:
    graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], [1.0, 0.0, 0.5], Isotropic(0.1))])
    values = Values({x: (SE2, np.zeros((3, 3)))})
    pattern, stack = graph.pattern(values), values.stack("x")
    moved = values.retract(np.ones(9))
    assert pattern.serves(graph.factors, moved)
    assert graph.pattern(moved) is pattern
    others = (Stack("x", R(3), stack.X, stack.numbers), Stack("x", SE2, stack.X, stack.numbers.copy()))
    for other in others:
        assert not pattern.serves(graph.factors, Values.of([other]))
    assert not pattern.serves([*graph.factors, Prior(x[0], [0, 0, 0], Isotropic(1.0))], values)
    assert not pattern.serves([graph.factors[0][[0, 1]]], values)


def test_a_structure_serves_the_same_held_variables_and_the_same_order_alone() -> None:
    sample = pose_graph(SE2, n=12)
    pattern, order = sample.graph.pattern(sample.values), best_decomposition().order
    first, second = np.arange(12) == 0, np.arange(12) == 3
    held = pattern.holding(first)
    assert pattern.holding(first.copy()) is held
    assert held.hessian(order) is held.hessian(order)
    assert held.hessian() is not held.hessian(order)
    backward = held.hessian(lambda u, v, V: np.arange(V)[::-1])
    assert backward.elimination.variables.tolist() == [*range(11)][::-1]
    assert held.hessian(order).elimination.variables.tolist() != [*range(11)][::-1]
    other = pattern.holding(second)
    assert other is not held
    assert (other.starts[[0, 3]].tolist(), held.starts[[0, 3]].tolist()) == ([0, -1], [-1, 6])
    assert other.hessian(order) is not held.hessian(order)
    assert held.holding(second).hessian(order) is not held.hessian(order)
    first[:] = second  # the mask belongs to the caller
    assert pattern.holding(first).held.tolist() == second.tolist()
    assert held.held.tolist() == (np.arange(12) == 0).tolist()


def test_factorizations_of_one_structure_have_numbers_of_their_own() -> None:
    sample = pose_graph(SE2, n=30)
    moved = sample.graph.optimize(sample.values).values
    pattern = sample.graph.pattern(moved).holding(np.arange(30) == 0)
    systems = [LinearSystem.at(pattern, values) for values in (sample.values, moved)]
    kept = [factorize(system) for system in systems]
    g = systems[0].gradient
    solutions = [H.solve(g) for H in kept]
    for system, solution in zip(systems, solutions, strict=True):
        expected = np.linalg.solve(system.H.toarray(), g)
        np.testing.assert_allclose(solution, expected, atol=1e-9 * np.abs(expected).max())
    assert np.abs(solutions[0] - solutions[1]).max() > 1e-3 * np.abs(solutions[0]).max()
    before = Marginals(sample.graph, moved)
    sample.graph.optimize(sample.values)
    after = Marginals(sample.graph, moved)
    assert np.array_equal(before.all(x, frame="body"), after.all(x, frame="body"))


@pytest.mark.skipif(cholmod() is None, reason="CHOLMOD alone analyzes a structure")
def test_a_graph_is_analyzed_once_for_all_its_solves(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    for cls in (Elimination, Hessian):
        monkeypatch.setattr(cls, "__init__", _counted(cls, made))
    sample = pose_graph(SE2, n=20)
    result = sample.graph.optimize(sample.values)
    once = list(made)
    sample.graph.optimize(result.values)
    Marginals(sample.graph, result.values).all(x, frame="body")
    whole = sample.graph.only([np.ones(len(f), dtype=bool) for f in sample.graph.factors])
    whole.optimize(result.values)
    assert made == once == ["Elimination", "Hessian"]
    masks = [np.ones(len(f), dtype=bool) for f in sample.graph.factors]
    masks[0][-1] = False
    sample.graph.only(masks).optimize(result.values)
    assert made == [*once, "Elimination", "Hessian"]
    whole.add(sample.graph.factors[0])
    whole.optimize(result.values)
    assert len(made) == 6


def _counted(cls: type, made: list[str]) -> object:
    init = cls.__init__  # type: ignore[misc]

    def counted(self: object, *arguments: object) -> None:
        made.append(cls.__name__)
        init(self, *arguments)

    return counted


PAGES = """
import resource
import numpy as np
{first}

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

def iteration():
    arrays = [np.ones(1 << 18) for _ in range(8)]

for _ in range(3):
    iteration()
begin = faults()
for _ in range(5):
    iteration()
print(faults() - begin)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries keep memory in their own way")
def test_arrays_of_the_next_iteration_need_no_new_pages() -> None:
    def new_pages(first: str) -> int:
        command = [sys.executable, "-c", PAGES.format(first=first)]
        env = {k: v for k, v in os.environ.items() if not k.startswith(("MALLOC_", "GLIBC_"))}
        return int(subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout)

    assert new_pages("import nls.graph") < new_pages("") / 5  # 0 and 20,000 of 4 KB


def test_gauss_newton_has_one_linearization_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    at, arrays = LinearSystem.at, list[ref[Array]]()

    def watched(pattern: Pattern, values: Values) -> LinearSystem:
        assert not any(array() is not None for array in arrays)
        system = at(pattern, values)
        arrays.extend(map(ref, (system.b, *system.blocks[0])))
        return system

    monkeypatch.setattr(LinearSystem, "at", watched)
    sample = pose_graph(SE2)
    assert sample.graph.optimize(sample.values, GaussNewton()).converged
    assert len(arrays) >= 3 * 3
