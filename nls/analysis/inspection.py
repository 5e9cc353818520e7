"""The contents of a graph and the cost of a solve, without solving it."""

from typing import Any

import numpy as np

from nls.gauge import choose_gauge, component_labels, fixed_variables, moving_variables, touched_variables
from nls.graph import FactorGraph
from nls.linear import best_decomposition, default_solver
from nls.sparse.fill import fill_in
from nls.values import Values


def inspect(graph: FactorGraph, values: Values) -> dict[str, Any]:
    """Counts, connectivity, gauge, information, chi2 of the given values, size of A and of its factorization.

    Parameters
    ----------
    graph, values : as read; not changed.

    Returns
    -------
    dict of plain numbers and texts under plain identifiers, in reading order.
    """
    pattern = graph.pattern(values)
    labels = component_labels(pattern)
    touched = touched_variables(pattern)
    whiteners = [batch.model.W for batch in pattern.batches]
    rows = [np.abs(W) if W.ndim == 2 else np.linalg.norm(W, axis=2) for W in whiteners]
    zero = [np.broadcast_to((r == 0).any(axis=1), len(b)) for r, b in zip(rows, pattern.batches, strict=True)]
    weights = np.concatenate([np.zeros(0), *(r[r > 0] for r in rows)])
    gauge = choose_gauge("first", pattern, values, fixed_variables(graph.fixed, values))
    fill = fill_in(pattern, gauge.held, best_decomposition().order)
    sizes = np.sort(np.bincount(labels[moving_variables(pattern)]))[::-1]
    sizes = sizes[sizes > 0]
    return {
        "variables": len(values),
        "measurements": len(graph),
        "components": len(sizes),
        "component_sizes": sizes[:10].tolist(),
        "isolated_variables": int((~touched).sum()),
        "gauge": gauge.description,
        "rows_of_A": pattern.m,
        "columns_of_A": int(pattern.dims[~gauge.held].sum()),
        "numbers_in_A": pattern.numbers_in_A,
        "numbers_in_R": fill.nnz,
        "factorization_mflop": fill.flops / 1e6,
        "factorization_mb": fill.nnz * 8 / 1e6,
        "linear_solver": default_solver().name,
        "sigma_smallest": float(1 / weights.max()) if len(weights) else None,
        "sigma_largest": float(1 / weights.min()) if len(weights) else None,
        "semi_definite_measurements": sum(int(mask.sum()) for mask in zero),
        "chi2": pattern.chi2(values),
    }
