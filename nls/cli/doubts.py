"""What ``nls solve`` says of a converged chi2 that no noise explains: which measurements it comes from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nls.assemble import measured_numbers
from nls.cli.outputs import typed

if TYPE_CHECKING:
    from nls.graph import FactorGraph
    from nls.optimizers import Result

__all__ = ["doubts"]

WORST = 3  # measurements that are named


def doubts(graph: FactorGraph, result: Result) -> list[str]:
    """Notes on a chi2 that is far above its expectation: its usual causes, its parts by type, the worst measurements.

    chi2 is the plain one, before any robust kernel, and its expectation the numbers per measurement.
    """
    if not result.doubt:
        return []
    parts: dict[str, list[tuple[float, int, int]]] = {}  # chi2, measurements, numbers that measure something
    worst: list[tuple[float, str]] = []
    for factor in graph.factors:
        chi2 = factor.chi2(result.values)
        model, _ = result.values.gather(factor)
        parts.setdefault(factor.name, []).append((float(chi2.sum()), len(factor), measured_numbers(model)))
        worst += [(float(chi2[k]), factor.describe(k)) for k in np.argsort(-chi2, kind="stable")[:WORST].tolist()]
    by_type = [
        f"{name} {sum(chi2 for chi2, _, _ in of) / n:.3g} ({sum(rows for _, _, rows in of) / n:.3g} expected)"
        for name, of in parts.items()
        if (n := sum(count for _, count, _ in of))
    ]
    worst.sort(key=lambda each: -each[0])
    return [
        typed(result.doubt),
        f"chi2 per measurement: {', '.join(by_type)}",
        f"farthest from what they should be: {', '.join(f'{name} {s**0.5:.3g} sigmas' for s, name in worst[:WORST])}",
    ]
