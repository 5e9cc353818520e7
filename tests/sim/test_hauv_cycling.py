"""Undamped steps on a hull go round, and say so; see the page on sonar."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from nls import GaussNewton, Stop
from nls.optimizers import Status


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_gauss_newton_on_the_hull_says_that_it_cycles(seed: int) -> None:
    """Hinges switch on and off from step to step: chi2 goes up and down, never to the same value twice."""
    mission = sim.hauv_hull(np.random.default_rng(seed))
    result = mission.graph.optimize(mission.start, GaussNewton())
    assert result.status is Status.CYCLING
    assert "up and down" in result.reason
    assert result.chi2_final == min(step.chi2 for step in result.history)
    cut = mission.graph.optimize(mission.start, GaussNewton(Stop(max_iterations=15)))
    assert cut.status is Status.MAX_ITERATIONS  # too soon to tell
