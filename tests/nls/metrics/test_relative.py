"""Relative pose errors: a scale of 1 % is 1 %, a turn rate is itself, and the frame does not matter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models import SE2, SE3, LieGroup
from nls import GraphError, OptionError
from nls.metrics import rpe
from tests.nls.graphs import moved, walk


@pytest.mark.parametrize("step", [0.1, 1.0, 7.0])
def test_a_scale_of_one_percent_is_one_percent(step: float) -> None:
    truth = np.zeros((int(120 / step), 7))
    truth[:, 6] = 1.0
    truth[:, 0] = step * np.arange(len(truth))
    estimate = truth.copy()
    estimate[:, 0] *= 1.01
    for error in rpe(estimate, truth):
        steps = int(np.ceil(error.distance / step - 1e-6))
        assert error.way == pytest.approx(steps * step)
        assert error.pairs == len(truth) - steps
        assert (error.translation, error.rotation) == pytest.approx((0.01, 0.0), abs=1e-9)


def test_a_turn_by_hand() -> None:
    """True straight on, estimated on an arc of 0.01 rad/m: chords and tangents have closed forms."""
    s, rate = np.arange(41.0), 0.01
    truth = np.column_stack([s, 0 * s, 0 * s])
    estimate = np.column_stack([np.sin(rate * s) / rate, (1 - np.cos(rate * s)) / rate, rate * s])
    (error,) = rpe(estimate, truth, [20.0])
    end = np.array([np.sin(0.2), 1 - np.cos(0.2)]) / rate
    assert (error.rotation, error.pairs) == (pytest.approx(rate), 21)
    assert error.translation == pytest.approx(np.linalg.norm(end - [20, 0]) / 20)


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=20)
def test_the_frames_do_not_matter(group: LieGroup, seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = walk(group, 40, rng)
    estimate = moved(group, truth, 0.2, rng)
    motion = group.exp(3 * rng.normal(size=(2, 1, group.dim)))
    before, after = (
        rpe(estimate, truth, [5]),
        rpe(group.compose(motion[0], estimate), group.compose(motion[1], truth), [5]),
    )
    for a, b in zip(before, after, strict=True):
        assert (a.pairs, a.translation, a.rotation) == (
            b.pairs,
            pytest.approx(b.translation),
            pytest.approx(b.rotation),
        )


def test_no_pairs_and_mistakes() -> None:
    (error,) = rpe(np.zeros((4, 3)), np.zeros((4, 3)), [1.0])  # nothing moves
    assert (error.pairs, str(error)) == (0, "RPE over 1 m: the track is shorter")
    for distances in ([], [0.0], [-3.0], [[1.0]]):
        with pytest.raises((OptionError, GraphError)):
            rpe(np.zeros((4, 3)), np.zeros((4, 3)), distances)  # type: ignore[arg-type]
    with pytest.raises(GraphError, match="rpe: shapes"):
        rpe(np.zeros((4, 3)), np.zeros((5, 3)))
