"""Filters and graphs on the first minutes of public logs with landmarks, against motion capture and against GPS."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from nls import kinds
from nls.filters.association import Nearest
from nls.filters.base import Track
from nls.filters.ekf import EKF
from sim import LandmarkWorld
from sim.estimators import batch

(x,) = kinds("x")


@pytest.fixture
def evidence(script: Callable[[str], Any]) -> Any:
    return script("landmark_logs")


def landmark_error(world: LandmarkWorld, track: Track) -> float:
    """Rms over the landmarks, m."""
    off = track.values[track.landmarks] - world.truth[track.landmarks]
    return float(np.sqrt(np.square(off).sum(axis=1).mean()))


def test_a_robot_among_landmarks(data: Path, evidence: ModuleType) -> None:
    """100 s from the true start, nothing aligned: 0.55 m by the commands alone, 0.16 m by EKF, 0.12 m by the graph."""
    world = evidence.mrclam(evidence.read_mrclam(data / "mrclam6", 3), "robot 3", 100.0)
    assert (world.poses, world.landmarks) == (195, 8)
    ekf, graph = EKF().run(world.graph, world.start), batch(world)
    errors = [world.ate(world.start), ekf.ate(world.truth).rmse, graph.ate(world.truth).rmse]
    print(f"ATE {errors}, landmarks {landmark_error(world, ekf):.3f} and {landmark_error(world, graph):.3f} m")
    assert 0.4 < errors[0] < 0.7
    assert errors[1] < 0.2
    assert errors[2] < 0.15
    assert landmark_error(world, graph) < 0.15 < landmark_error(world, ekf) < 0.4


def test_trees_without_names(data: Path, evidence: ModuleType) -> None:
    """150 s of a truck in a park, against the GPS of the beginning and the end, after a rigid alignment."""
    park = evidence.victoria_park(evidence.read_victoria_park(data / "victoria-park"), 160.0)
    ekf = EKF(associate=Nearest(0.99))
    track = ekf.run(park.graph, park.start)
    graph, start = park.named(ekf.associations, track.X)
    result = graph.optimize(start)
    assert result.converged
    errors = [park.gps_error(X).rmse for X in (park.start[x], track.X, result.values[x])]
    print(f"{len(park.t)} poses, {len(track.landmarks)} trees, rmse from GPS {errors}")
    assert len(park.t) == 685
    assert 80 < len(track.landmarks) < 130
    assert errors[0] > 1.4
    assert max(errors[1:]) < 1.1
    again = park.again(result.values)
    assert (again == ekf.associations).mean() > 0.97  # the map agrees with what the filter thought on the way
