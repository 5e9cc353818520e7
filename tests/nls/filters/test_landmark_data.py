"""Filters and graphs on the first minutes of public logs with landmarks, against motion capture and against GPS."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from benchmarks.evidence.logs import read_mrclam, read_victoria_park
from factors import Cauchy
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
    world = evidence.mrclam(read_mrclam(data / "mrclam6", 3), "robot 3", 100.0)
    assert (world.poses, world.landmarks) == (195, 8)
    ekf, graph = EKF().run(world.graph, world.start), batch(world)
    errors = [world.ate(world.start), ekf.ate(world.truth).rmse, graph.ate(world.truth).rmse]
    print(f"ATE {errors}, landmarks {landmark_error(world, ekf):.3f} and {landmark_error(world, graph):.3f} m")
    assert 0.4 < errors[0] < 0.7
    assert errors[1] < 0.2
    assert errors[2] < 0.15
    assert landmark_error(world, graph) < 0.15 < landmark_error(world, ekf) < 0.4


def test_an_overconfident_filter(data: Path, evidence: ModuleType) -> None:
    """Robot 5 sees its first landmarks at the end of a long turn: the EKF takes its own map for a compass.

    After 100 s its heading is off by 0.5 rad with a sigma of 0.03; first estimates and the graph stay within 0.35 m.
    """
    world = evidence.mrclam(read_mrclam(data / "mrclam6", 5), "robot 5", 100.0)
    one, first = (EKF(first_estimates=each).run(world.graph, world.start) for each in (False, True))
    errors = {name: track.ate(world.truth).rmse for name, track in (("EKF", one), ("first", first))}
    errors["graph"] = batch(world).ate(world.truth).rmse
    print(errors, one.nees(world.truth)[-1], first.nees(world.truth)[-1])
    assert errors["EKF"] > 1.0 > 0.5 > max(errors["first"], errors["graph"])
    assert one.nees(world.truth)[-1] > 100
    assert first.nees(world.truth)[-1] < 16.3  # of 3 numbers, exceeded once in 1,000
    assert one.ate(world.truth, "rigid").rmse < 0.2  # the shape is right, the whole is turned


def test_barcodes_misread(data: Path, evidence: ModuleType) -> None:
    """Four sightings of one landmark under the name of another, after 230 s: no filter forgets, gate and kernel do."""
    world = evidence.mrclam(read_mrclam(data / "mrclam6", 3), "robot 3", 260.0)
    wrong = world.sightings.chi2(world.truth) > 1000
    assert wrong.sum() == 4
    gated = EKF(gate=0.9999)
    tracks = [EKF().run(world.graph, world.start), gated.run(world.graph, world.start), batch(evidence.robust(world))]
    lost = [landmark_error(world, track) for track in tracks]
    print(f"landmarks {lost} m, {gated.left_out} left out")
    assert lost[0] > 1.0 > 0.3 > max(lost[1:])
    assert 4 <= gated.left_out < 20
    weights = world.sightings.robust(Cauchy(2.0)).weights(tracks[2].values)
    assert weights[wrong].max() < 1e-3 < np.percentile(weights, 2)


def test_trees_without_names(data: Path, evidence: ModuleType) -> None:
    """150 s of a truck in a park, against the GPS of the beginning and the end, after a rigid alignment."""
    park = evidence.victoria_park(read_victoria_park(data / "victoria-park"), 160.0)
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
