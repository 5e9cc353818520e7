"""The statistics of the evidence about the hovering vehicle, and which landmarks it takes for well observed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import sim
from nls import kinds
from nls.filters.consistency import nees_bounds

x, l = kinds("x", "l")


SCRIPT = "hauv"


def test_normalized_errors_of_their_own_covariance(evidence: Any) -> None:
    dim = 6
    rng = np.random.default_rng(dim)
    L = np.tril(rng.standard_normal((400, dim, dim))) + 3 * np.eye(dim)
    P, v = L @ L.mT, rng.standard_normal((400, dim))
    e = (L @ v[..., None])[..., 0]
    np.testing.assert_allclose(evidence.normalized(e, P), (v**2).sum(axis=1))
    low, high = nees_bounds(dim, 400)
    assert low < evidence.normalized(e, P).mean() < high
    assert (low, high) == pytest.approx(
        (dim - 1.96 * np.sqrt(2 * dim / 400), dim + 1.96 * np.sqrt(2 * dim / 400)), rel=0.01
    )


@pytest.mark.parametrize("make", [sim.hauv_floor, sim.hauv_hull])
def test_alone_keeps_the_well_observed(evidence: Any, make: Any) -> None:
    mission = make(np.random.default_rng(1), passes=1, elevation="free")
    well, kept = evidence.well_observed(mission), evidence.alone(mission)
    assert 0 < kept.landmarks == well.sum() < mission.landmarks
    np.testing.assert_array_equal(kept.truth.stack("l").numbers, np.flatnonzero(well))
    np.testing.assert_array_equal(kept.truth[l], mission.truth[l][well])
    assert evidence.well_observed(kept).all()
    found = evidence.nees(kept)
    assert len(found.all) == kept.landmarks
    assert found.landmark == found.all[kept.landmarks // 2]
