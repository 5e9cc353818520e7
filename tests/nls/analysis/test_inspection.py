"""What a graph is made of and what a solve would cost: counts against a real factorization."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from factors import Between, Diagonal, Information, Isotropic, Prior
from models import SE2, R
from nls import FactorGraph, Values
from nls.analysis.inspection import inspect
from nls.linear import best_decomposition, factorize
from nls.linear.lu import SuperLU
from tests.nls.graphs import SAMPLES, l, x


def test_numbers_in_R_are_those_of_a_factorization() -> None:
    for name, make in SAMPLES.items():
        sample = make()
        system = sample.graph.linearize(sample.values)
        found = inspect(sample.graph, sample.values)
        assert (found["rows_of_A"], found["columns_of_A"]) == system.A.shape
        if not sample.graph.fixed:  # A has no columns of what is fixed, and is counted with them
            assert (found["numbers_in_A"], found["chi2"]) == (system.A.nnz, sample.graph.chi2(sample.values))
        if best_decomposition() is not SuperLU:  # which orders scalars itself; its fill is another
            R_, order = factorize(system).upper()
            numbers = eliminated(system.A, order)
            assert found["numbers_in_R"] == numbers <= R_.nnz, name  # supernodes are stored with zeros in them


def eliminated(A: sp.csr_array, order: np.ndarray) -> int:
    """Numbers in R by Gaussian elimination of the pattern of A'A, one column at a time."""
    ones = sp.csr_array((np.ones(A.nnz), A.indices, A.indptr), shape=A.shape).toarray()
    H = (ones.T @ ones > 0)[np.ix_(order, order)]
    for k in range(len(H)):
        below = np.flatnonzero(H[k + 1 :, k]) + k + 1
        H[np.ix_(below, below)] = True
    return int(np.triu(H).sum())


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_counts() -> None:
    noise = Information(np.diag([4.0, 0.0, 25.0]))
    graph = FactorGraph(
        [
            Between(x[[0, 1, 4]], x[[1, 2, 5]], [[1.0, 0.0, 0.0]], Isotropic(0.1)),
            Between(x[[0, 1]], x[[2, 2]], [[2.0, 0.0, 0.0]], noise),
            Prior(x[3], [0.0, 0.0, 0.0], Diagonal([0.5, 2.0, 0.05])),
        ]
    )
    values = Values({x: (SE2, np.zeros((7, 3))), l: (R(2), np.zeros((2, 2)))})
    found = inspect(graph, values)
    counts = {"variables": 9, "measurements": 6, "components": 3, "component_sizes": [3, 2, 1]}
    counts |= {"isolated_variables": 3, "gauge": "x0, x4 fixed", "semi_definite_measurements": 2}
    counts |= {"rows_of_A": 18, "columns_of_A": (3 + 2 + 1) * 3 - 2 * 3, "numbers_in_A": 5 * 3 * 6 + 3 * 3}
    assert {name: found[name] for name in counts} == counts
    numbers = [found[name] for name in ("sigma_smallest", "sigma_largest", "chi2")]
    assert numbers == pytest.approx([0.05, 2.0, 3 * 100 + 2 * 4 * 4])


def test_a_whitener_per_measurement_is_counted_by_measurement() -> None:
    Omega = np.array([np.diag([1.0, 1.0, 0.0]), np.eye(3), [[1.0, 1.0, 0], [1.0, 1.0, 0.0], [0, 0, 1.0]]])
    graph = FactorGraph([Between(x[[0, 1, 2]], x[[1, 2, 3]], [1.0, 0.0, 0.0], Information(Omega))])
    found = inspect(graph, Values({x: (SE2, np.zeros((4, 3)))}))
    assert found["semi_definite_measurements"] == 2


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_an_empty_graph() -> None:
    values = Values({x: (SE2, SE2.identity(2))})
    found = inspect(FactorGraph(), values)
    assert (found["components"], found["isolated_variables"], found["chi2"]) == (0, 2, 0.0)
    assert found["sigma_smallest"] is None
