"""Every kind of factor explained, alone and with next to nothing else: the rank is that of a dense A."""

from __future__ import annotations

import json

import numpy as np

import nls
from factors import Isotropic
from nls import FactorGraph, Kind, Values
from nls.gauge import choose_gauge, fixed_variables
from tests.combinations import for_all
from tests.factors.samples import Sample, situation
from tests.factors.samples_sonar import ELIMINATING_SAMPLES
from tests.factors.test_conformity import SAMPLES


@for_all(sample=[sample for sample in [*SAMPLES, *ELIMINATING_SAMPLES] if sample.convention == "log"])
def test_rank_and_words(sample: Sample) -> None:
    X, z = situation(sample, "large innovation", 3, 0)
    factor = sample.factor(z, Isotropic(0.1))
    values = Values()
    for keys, manifold, elements in zip(factor.keys, sample.manifolds, X, strict=True):
        values.add(Kind(keys.kind), manifold, elements, np.unique(keys.numbers))
    graph = FactorGraph([factor])
    explanation = nls.explain(graph, values)
    pattern = graph.pattern(values)
    held = choose_gauge("first", pattern, values, fixed_variables([], values)).held
    A = nls.LinearSystem.at(pattern.holding(held), values).A.toarray()
    norms = np.linalg.norm(A, axis=0)
    A = A / np.where(norms > 1e-13 * norms.max(initial=0.0), norms, np.inf)
    rank = np.linalg.matrix_rank(A, tol=1e-9) if A.size else 0
    assert (explanation.unknowns, explanation.rank) == (A.shape[1], rank)
    assert len(explanation.free) == explanation.nullity == A.shape[1] - rank
    assert explanation.report()
    assert json.dumps(explanation.record(), allow_nan=False)
