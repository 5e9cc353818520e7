"""What holds of every world: bits of a seed, truth that fits the measurements, refusals that name their option."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import sim
from models.errors import OptionError
from sim.cli import WORLDS
from sim.files import harbor_files, native_files, survey_files
from tests.combinations import for_all

nan = float("nan")
MADE: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "manhattan": (sim.manhattan, {"n_poses": 150}),
    "grid3d": (sim.grid3d, {"n_poses": 120}),
    "ring": (sim.ring, {"laps": 2, "per_lap": 50}),
    "sphere": (sim.sphere, {"rings": 6, "per_ring": 10}),
    "torus": (sim.torus, {"coils": 6, "per_coil": 10}),
    "hauv-floor": (sim.hauv_floor, {"legs": 2, "per_leg": 12}),
    "hauv-hull": (sim.hauv_hull, {"levels": 2, "per_level": 13}),
    "subsea": (sim.subsea, {}),
    "subsea of filters": (sim.subsea, {"landmarks": "independent", "azimuth": "absolute"}),
    "subsea in part known": (sim.subsea, {"known_landmarks": 2}),
    "lines": (sim.lines, {}),
    "rig": (sim.rig, {"poses": 6, "points": 60}),
    "survey": (sim.survey, {"legs": 3, "leg": 60.0}),
    "harbor": (sim.harbor, {"keyframes": 80}),
}
GRAPHS = [name for name in MADE if name not in ("survey", "harbor")]
NOT_POSSIBLE: dict[str, dict[str, list[Any]]] = {
    "manhattan": {"n_poses": [2, 10.5, True, 10**9], "streets": [1], "block": [0], "spacing": [0.0]}
    | {"radius": [-1.0], "closure_ratio": [-0.1]},
    "grid3d": {"sigma_t": [0.0], "sigma_r": [nan], "noise_scale": [float("inf")]},
    "ring": {"laps": [0], "per_lap": [3, 10**9], "diameter": [-3.0], "wobble": [-0.1]},
    "sphere": {"rings": [1], "per_ring": ["50"], "radius": ["big"], "sigma_t": [-1.0]},
    "torus": {"coils": [2], "per_coil": [3], "tube": [20.0], "closure_share": [1.5]},
    "hauv-floor": {"passes": [0], "legs": [0, 10**8], "per_leg": [1], "points": [0], "aperture": [0.0]}
    | {"noise_scale": [1e300, -1.0], "elevation": ["guess"]},
    "hauv-hull": {"levels": [0], "per_level": [1.5], "aperture": [np.pi], "drop_outs": [1.0], "outliers": [-0.1]}
    | {"wrong_associations": [1.0, 1.1]},
    "subsea": {"laps": [0], "landmarks": ["guessed"], "azimuth": ["north"], "known_start": ["no"]}
    | {"known_landmarks": [7], "noise_scale": [-1.0, 1e31]},
    "lines": {"laps": [1.5], "noise_scale": [nan]},
    "rig": {"poses": [1, 10**8], "points": [3, 60.0], "views": [0, 7], "noise_scale": [-1.0, nan, 1e31]},
    "survey": {"legs": [0], "leg": [0.0, 1e12], "spacing": [1.0], "depth": [40.0], "speed": [0.1], "drop_outs": [1.0]}
    | {"usbl_outliers": [1.5], "ahrs_clock": [1.0], "dvl_yaw": [2.0], "noise_scale": [-1.0, 2e5, 1e20]},
    "harbor": {"geometry": ["beach"], "keyframes": [39], "laps": [3, 0], "drift": [-1.0], "signal": [nan, 3100.0]}
    | {"false_alarms": [1.0], "images": [1]},
}


def made(name: str, seed: int = 0, **options: Any) -> Any:
    make, sizes = MADE[name]
    return make(np.random.default_rng(seed), **{**sizes, **options})


def content(world: Any) -> dict[str, bytes]:
    """All numbers of a world, as its files have them."""
    if isinstance(world, sim.SurveyLog):
        return survey_files(world)[0]
    return harbor_files(world)[0] if isinstance(world, sim.Harbor) else native_files(world)


def four_sigma(chi2: float, dof: float) -> bool:
    """A chi-square variable has mean dof and variance 2 dof."""
    return abs(chi2 - dof) < 4 * np.sqrt(2 * dof)


def test_every_world_has_a_small_one() -> None:
    assert set(WORLDS) < set(NOT_POSSIBLE) < set(MADE)
    assert set(WORLDS) < set(sim.__all__)


@for_all(name=MADE)
def test_a_seed_gives_the_same_bits(name: str) -> None:
    one, other = made(name, 5), made(name, 6)
    assert content(one) == content(made(name, 5)) != content(other)
    assert (one.seed, other.seed) == (5, 6)
    with pytest.raises(OptionError, match="rng: 0 is not possible"):
        MADE[name][0](0)


@for_all(name=GRAPHS)
def test_without_noise_the_truth_is_the_optimum(name: str) -> None:
    exact, noisy = made(name, noise_scale=0.0), made(name)
    assert exact.graph.chi2(exact.truth) < 1e-15 * exact.rows
    assert exact.graph.optimize(exact.truth).converged
    assert name == "rig" or exact.ate(exact.start) < 1e-9
    away = np.subtract(*(v.stack("x").manifold.position(v.stack("x").X) for v in (noisy.start, noisy.truth)))
    assert noisy.ate(noisy.start) == pytest.approx(np.linalg.norm(away) / np.sqrt(noisy.poses))
    if isinstance(exact, sim.LandmarkWorld):
        return  # the way of these is drawn as well
    for kind in noisy.truth.stacks:  # the noise is all that differs
        np.testing.assert_array_equal(exact.truth.stack(kind).X, noisy.truth.stack(kind).X)


@for_all(name=GRAPHS)
def test_chi2_at_the_truth_over_seeds(name: str) -> None:
    worlds = [made(name, seed) for seed in range(10)]
    chi2 = [getattr(world, "sensed", world.graph).chi2(world.truth) for world in worlds]
    rows = [world.rows for world in worlds]
    assert all(map(four_sigma, chi2, rows))
    assert four_sigma(sum(chi2), sum(rows))


def test_impossible_options_are_refused() -> None:
    for name, options in NOT_POSSIBLE.items():
        for option, values in options.items():
            for value in values:
                with pytest.raises(OptionError, match="is not possible") as caught:
                    made(name, **{option: value})
                assert option in caught.value.option, (name, option, value)
