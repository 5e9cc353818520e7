"""Whom `nls.explain` names: a few wrong closures planted in public graphs, and the same graphs without any.

    LEADLINE_DATA=DIR python benchmarks/evidence/explained.py [--wrong 5] [--out DIR]

A measurement is named when it stands in a finding. With many outliers the finding names the worst alone: then all are
counted as missed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from script import make_page, markdown
from wrong_closures import KINDS, SETS, solved, spoiled

import nls
from nls import FactorGraph, FindingKind

PLANTED = ("CSAIL", "FR079", "INTEL", "intel", "M3500")
CLEAN = (*PLANTED, "kitti_00", "ring", "manhattan", "smallGrid3D", "sphere2500")
NAMES = (FindingKind.WRONG_CLOSURE, FindingKind.OUTLIER)
CHANCE = 1e-3  # of one falsely named measurement in a right graph


def named(graph: FactorGraph, values: nls.Values) -> tuple[set[tuple[int, int]], list[str]]:
    """Places of the measurements that are named wrong, and the kinds of all findings."""
    findings = nls.explain(graph, graph.optimize(values).values).findings
    places = {place for finding in findings if finding.kind in NAMES for place in finding.measurements}
    return places, [finding.kind.value for finding in findings]


def planted(data: Path, count: int) -> Iterator[list[Any]]:
    """A row a graph and kind of wrong closures: named, missed, falsely named, and other findings."""
    for name in PLANTED:
        right = solved(data / SETS[name])
        for kind in KINDS:
            wrong = spoiled(right, count, kind, np.random.default_rng([0, list(KINDS).index(kind)]))
            places, kinds = named(FactorGraph([right.edges, wrong]), right.best)
            hits = sum(factor == 1 for factor, _ in places)
            others = sorted(set(kinds) - {kind.value for kind in NAMES})
            yield [name, kind, hits, count - hits, len(places) - hits, ", ".join(others)]


def clean(data: Path) -> Iterator[list[Any]]:
    """A row a graph without a wrong closure: falsely named, and how many chance names."""
    for name in CLEAN:
        right = solved(data / SETS[name])
        places, _ = named(FactorGraph([right.edges]), right.best)
        yield [name, len(places), f"{CHANCE:g}"]


def page(data: Path, wrong: int) -> list[str]:
    """Both tables."""
    rows = list(planted(data, wrong))
    sums = ["**all**", "", *(sum(row[k] for row in rows) for k in (2, 3, 4)), ""]
    titles = ("graph", "wrong ones", "named", "missed", "falsely named", "other findings")
    lines = ["## Planted", *markdown(titles, [*rows, sums], names=6), "## Clean graphs"]
    return lines + markdown(("graph", "falsely named", "expected by chance"), clean(data), names=3)


if __name__ == "__main__":
    make_page("Wrong closures that `nls.explain` names", page, wrong=(5, "closures that are planted"))
