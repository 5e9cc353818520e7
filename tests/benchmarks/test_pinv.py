"""A measurement of the pseudo-inverse benchmark: the update of a small city, by a solver and by the formula."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim


@pytest.mark.parametrize("name", ["lu", "formula"])
def test_a_measurement_leaves_the_update(
    name: str, part: Callable[[str], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pinv = part("pinv")
    monkeypatch.setattr(pinv, "RUNS", 1)
    assert pinv.measure(name, "30", str(tmp_path))["seconds"] > 0
    world = sim.manhattan(np.random.default_rng(1), n_poses=11)
    world.graph.fix(next(iter(world.truth)))
    A, b = world.graph.linearize(world.truth)
    np.testing.assert_allclose(np.load(tmp_path / "dx.npy"), np.linalg.lstsq(A.toarray(), b)[0], atol=1e-9)
