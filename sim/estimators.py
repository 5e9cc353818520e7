r"""Every estimator by name on a simulated world, and how far it is from the truth: the same numbers for all of them.

A batch solution is recorded as a filter is: every pose and its covariance, but given all measurements, later ones too.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from time import perf_counter
from typing import Any, Literal

import numpy as np

from factors.keys import Keys
from models import LINE
from models.algebra import Array
from models.errors import GraphWarning, LeadlineError, OptionError
from nls import Marginals, initialize
from nls.filters.base import POSE, Filter, Track, landmark_kind
from nls.filters.consistency import nees, regular
from nls.filters.ekf import EKF
from nls.filters.fastslam import FastSLAM
from nls.filters.smoother import Smoother
from sim.landmark_world import LandmarkWorld
from sim.worlds.lines import lines
from sim.worlds.subsea import subsea

__all__ = ["ESTIMATORS", "SCENES", "batch", "errors", "estimator", "followed", "of_seed", "tracked"]

History = list[tuple[Keys, Array]]  # at every step, the landmarks found so far and their covariances (m, d, d)
ESTIMATORS = ("ekf", "ekf-first-estimates", "fastslam1", "fastslam2", "fixed-lag", "online", "batch")
SCENES: dict[str, Callable[..., LandmarkWorld]] = {"subsea": subsea, "lines": lines}


def tracked(world: LandmarkWorld, name: str, particles: int = 100, lag: int = 20, iterations: int = 1) -> Track:
    """The solution of a world by one estimator.

    Parameters
    ----------
    world : its `landmarks_as` is the EKF's prior of new landmarks, its seed also that of the particles.
    name : one of `ESTIMATORS`. Landmarks stay in the window of fixed-lag.
    particles : of fastslam1 and fastslam2.
    lag : poses in the window of fixed-lag.
    iterations : how often at most ekf linearizes an update.

    Returns
    -------
    Track

    Raises
    ------
    OptionError
        No such estimator, or an option it cannot have.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    >>> errors(world, tracked(world, "ekf"))["ate"] < 0.5 < world.ate(world.start)
    True
    """
    chosen = estimator(world, name, particles, lag, iterations)
    with _named(name):
        return batch(world) if chosen is None else chosen.run(world.graph, world.start)


def followed(world: LandmarkWorld, name: str, **settings: int) -> tuple[Track, History]:
    """`tracked`, and what was known of the landmarks at each step; of a batch, always what is known in the end."""
    chosen = estimator(world, name, **settings)
    with _named(name):
        if chosen is None:
            track = batch(world)
            return track, [(track.landmarks, track.P_landmarks)] * len(track.x)
        history: History = []

        def watched(act: Callable[..., None]) -> Callable[..., None]:
            def acted(*given: Any) -> None:
                act(*given)
                keys, _, P = chosen.landmarks
                history.append((keys, P.copy()))

            return acted

        chosen.start, chosen.step = watched(chosen.start), watched(chosen.step)  # type: ignore[method-assign]
        return chosen.run(world.graph, world.start), history


@contextmanager
def _named(name: str) -> Iterator[None]:
    """An error of this estimator has its name as a note."""
    try:
        yield
    except LeadlineError as error:
        error.add_note(f"(estimator {name})")
        raise


def batch(world: LandmarkWorld) -> Track:
    """The graph solved at once, from the best start that `nls.initialize` finds.

    Warns
    -----
    GraphWarning
        It did not converge.
    """
    began = perf_counter()
    start, *_ = initialize(world.graph, world.start)
    result = world.graph.optimize(start, gauge="none")
    if not result.converged:
        warnings.warn(f"batch: {result.status.value}: {result.reason}", GraphWarning, stacklevel=2)
    marginals = Marginals(world.graph, result.values, gauge="none")
    poses, kind = result.values.stack(POSE), landmark_kind(world.graph)
    x, l = Keys(POSE, np.sort(poses.numbers)), Keys(kind or "l", result.values.stack(kind).numbers if kind else [])
    P, P_l = (marginals.covariance(keys, frame="body") if len(keys) else np.zeros((0, 0, 0)) for keys in (x, l))
    seconds = np.full(len(x), (perf_counter() - began) / len(x))
    return Track("batch", x, poses.manifold, result.values[x], P, result.values, l, P_l, seconds)


def errors(world: LandmarkWorld, track: Track) -> dict[str, float]:
    """How far a track is from the truth, and from what it says of itself.

    Returns
    -------
    dict
        ``ate``, ``aligned``: rmse of the positions when they were the latest, nothing and rigidly aligned, m;
        ``smoothed``: of the positions in the final estimate, m; ``final``: error of the last position, m;
        ``landmarks``: rmse of the landmarks in the end, m, nothing aligned; of walls that of r, and ``walls``: that of
        alpha, deg; ``sigma``: of the last position as it is reported, per axis, m; ``nees``: of the last pose, left out
        where its covariance is singular, as that of particles is which are one or two in the end.
    """
    truth = world.truth
    last, X = track.x[[len(track.x) - 1]], truth[track.x][-1:]
    away = track.manifold.position(track.X[-1:]) - track.manifold.position(X)
    away_l, walls = track.landmark_errors(truth), truth.stack(track.landmarks.kind).manifold is LINE
    statistics = {
        "ate": track.ate(truth).rmse,
        "aligned": track.ate(truth, "rigid").rmse,
        "smoothed": track.ate(truth, smoothed=True).rmse,
        "final": float(np.linalg.norm(away)),
        "landmarks": _rms(away_l[:, 1:] if walls else away_l),
        "sigma": float(np.sqrt(np.trace(track.P[-1, :2, :2]) / 2)),
    }
    if walls:
        statistics["walls"] = float(np.degrees(_rms(away_l[:, :1])))
    if regular(track.P[-1:])[0]:
        statistics["nees"] = float(nees(last, track.manifold, track.X[-1:], track.P[-1:], X)[0])
    return statistics


def _rms(e: Array) -> float:
    """Root of the mean square length of errors (n, d)."""
    return float(np.sqrt(np.mean(np.sum(np.square(e), axis=1))))


def of_seed(
    seed: int, scene: str, estimators: Sequence[str], options: Mapping[str, Any], settings: Mapping[str, int]
) -> dict[str, dict[str, float]]:
    """`errors` of estimators in the scene of one seed, by name, for `sim.monte_carlo.runs`.

    Parameters
    ----------
    seed : of the world, and of the particles.
    scene : one of `SCENES`.
    estimators : some of `ESTIMATORS`.
    options : of the scene.
    settings : of the estimators, see `tracked`.

    Returns
    -------
    dict
        Also ``dead reckoning``, with its ``ate`` alone.

    Examples
    --------
    >>> found = of_seed(3, "subsea", ["batch"], {"laps": 1, "known_start": True}, {})
    >>> found["batch"]["ate"] < 0.5 < found["dead reckoning"]["ate"]
    True
    """
    world = SCENES[scene](np.random.default_rng(seed), **options)
    return {"dead reckoning": {"ate": world.ate(world.start)}} | {
        name: errors(world, tracked(world, name, **settings)) for name in estimators
    }


def estimator(
    world: LandmarkWorld, name: str, particles: int = 100, lag: int = 20, iterations: int = 1
) -> Filter | None:
    """A filter by name, with the settings of `tracked`; None is the batch solution."""
    landmarks: Any = world.landmarks_as
    match name:
        case "ekf":
            return EKF(landmarks, iterations=iterations)
        case "ekf-first-estimates":
            return EKF(landmarks, first_estimates=True)
        case "fastslam1" | "fastslam2":
            version: Literal[1, 2] = 1 if name == "fastslam1" else 2
            return FastSLAM(particles, version, rng=np.random.default_rng([world.seed or 0, particles, version]))
        case "fixed-lag":
            return Smoother(lag, landmarks="stay")
        case "online":
            return Smoother()
        case "batch":
            return None
    raise OptionError("estimators", name, "one of " + ", ".join(ESTIMATORS))
