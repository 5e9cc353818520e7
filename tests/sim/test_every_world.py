"""What holds of every world: bits of a seed, truth that fits the measurements, refusals that name their option."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import sim
from models.errors import OptionError
from sim.cli import WORLDS
from sim.files import harbor_files, native_files, survey_files
from tests.combinations import for_all
from tests.sim.scenes import MADE, four_sigma, made

nan = float("nan")
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


def content(world: Any) -> dict[str, bytes]:
    """All numbers of a world, as its files have them."""
    if isinstance(world, sim.SurveyLog):
        return survey_files(world)[0]
    return harbor_files(world)[0] if isinstance(world, sim.Harbor) else native_files(world)


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
def test_chi2_over_seeds(name: str) -> None:
    """At the truth, and of pose graphs at the optimum; of each seed and of all together."""
    worlds = [made(name, seed) for seed in range(10)]
    chi2 = [getattr(world, "sensed", world.graph).chi2(world.truth) for world in worlds]
    rows = [world.rows for world in worlds]
    assert all(map(four_sigma, chi2, rows))
    assert four_sigma(sum(chi2), sum(rows))
    if name not in WORLDS:
        return
    results = [world.graph.optimize(world.start) for world in worlds]
    for world, result, at_truth in zip(worlds, results, chi2, strict=True):
        assert result.converged, result.reason
        assert result.dof == world.dof
        assert four_sigma(result.chi2_final, world.dof)
        assert result.chi2_final < at_truth
        assert sim.position_error(result.values, world.truth) < sim.position_error(world.start, world.truth)
    assert four_sigma(sum(result.chi2_final for result in results), sum(world.dof for world in worlds))


def test_impossible_options_are_refused() -> None:
    for name, options in NOT_POSSIBLE.items():
        for option, values in options.items():
            for value in values:
                with pytest.raises(OptionError, match="is not possible") as caught:
                    made(name, **{option: value})
                assert option in caught.value.option, (name, option, value)
