"""Errors of trajectories, absolute and relative, circles of errors, poses matched by time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models import SE2, SE3, LieGroup
from models.algebra import Array
from nls import GraphError, OptionError, SingularGeometryError
from nls.metrics import ate, cep, displacements, drms2, matched, rpe
from tests.nls.graphs import moved, walk

BOTH = pytest.mark.parametrize("group", [SE2, SE3], ids=str)


def test_by_hand() -> None:
    truth = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    estimate = np.array([[0.0, 0, 0], [1, 3, 0], [2, 4, 0]])
    found = ate(estimate, truth)
    assert (found.rmse, found.mean, found.largest) == pytest.approx((np.sqrt(25 / 3), 7 / 3, 4))
    assert found.distances.tolist() == [0, 3, 4]
    assert str(found) == "ATE 2.887 m rmse, 2.333 m mean, 4 m at most over 3 poses (alignment: none)"


def test_first_is_the_first_pose_with_its_heading() -> None:
    truth = np.array([[5.0, 5, np.pi / 2], [5, 7, np.pi / 2]])
    estimate = np.array([[0.0, 0, 0], [2, 1, 0]])
    found = ate(estimate, truth, "first")
    assert (found.T, found.distances) == (pytest.approx([5, 5, np.pi / 2]), pytest.approx([0, 1]))


@BOTH
def test_a_motion_of_the_whole_is_found(group: LieGroup) -> None:
    rng = np.random.default_rng(1)
    truth, motion = walk(group, 20, rng), group.exp(2 * rng.normal(size=(1, group.dim)))
    estimate = group.compose(group.inverse(motion), truth)
    assert ate(estimate, truth).rmse > 1
    for align in ("first", "rigid"):
        found = ate(estimate, truth, align)
        assert found.rmse < 1e-13
        assert np.abs(group.local(motion[0], found.T)).max() < 1e-13


@BOTH
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.01, 100.0))
@settings(deadline=None, max_examples=25)
def test_a_similarity_is_removed_by_its_alignment_alone(group: LieGroup, seed: int, scale: float) -> None:
    """A motion, a yaw, a scale: each alignment leaves what it does not know, and the result does not depend on it."""
    rng = np.random.default_rng(seed)
    truth, d = walk(group, 20, rng), group.point_dim
    turned = group.compose(group.exp(rng.normal(size=(1, group.dim))), truth)
    scaled = turned.copy()
    scaled[:, :d] *= scale
    size = float(np.abs(truth[:, :d]).max())
    error = ate(scaled, truth, "similarity")
    assert error.rmse < 1e-10 * size
    assert error.scale == pytest.approx(1 / scale, rel=1e-9)
    assert error.errors.shape == (20, d)
    noisy = moved(group, truth, 0.3, rng)
    assert ate(group.compose(turned[:1], noisy), truth, "rigid").rmse == pytest.approx(ate(noisy, truth, "rigid").rmse)
    levelled = group.compose(yawed(group, rng), noisy)
    assert ate(levelled, truth, "yaw").rmse == pytest.approx(ate(noisy, truth, "yaw").rmse)
    order = [ate(noisy, truth, align).rmse for align in ("similarity", "rigid", "yaw", "none")]
    assert order == sorted(order)


def yawed(group: LieGroup, rng: np.random.Generator) -> Array:
    """A random motion (1, size) that turns about the vertical."""
    delta = 3 * rng.normal(size=(1, group.dim))
    if group is SE3:
        delta[:, 3:5] = 0.0
    return np.asarray(group.exp(delta))


def test_yaw_leaves_roll_and_pitch() -> None:
    truth = walk(SE3, 20, np.random.default_rng(7))
    tilted = SE3.compose(SE3.exp([[0.0, 0, 0, 0.1, 0, 0]]), truth)
    assert ate(tilted, truth, "rigid").rmse < 1e-12 < 0.05 < ate(tilted, truth, "yaw").rmse
    T = ate(SE3.compose(SE3.exp([[1.0, 2, 3, 0, 0, 2.5]]), truth), truth, "yaw").T
    assert SE3.log(T)[3:] == pytest.approx([0, 0, -2.5])
    down = np.tile(SE3.identity()[0], (4, 1))
    down[:, 2] = np.arange(4)
    with pytest.raises(SingularGeometryError, match="4 positions on a vertical line do not determine"):
        ate(down, down, "yaw")


@BOTH
def test_rigid_is_the_least(group: LieGroup) -> None:
    """A mirror image is not turned into its original."""
    rng = np.random.default_rng(2)
    truth = walk(group, 20, rng)
    estimate = moved(group, truth, 0.3, rng)
    for align in ("none", "first"):
        assert ate(estimate, truth, "rigid").rmse < ate(estimate, truth, align).rmse
    mirrored = truth * np.r_[-1, np.ones(truth.shape[1] - 1)]
    assert ate(mirrored, truth, "rigid").rmse > 0.1
    for image in (estimate, mirrored):
        least(group, image, truth)


def least(group: LieGroup, estimate: Array, truth: Array) -> None:
    """No motion near the rigid alignment, and none of many others, brings the positions closer."""
    best, rng = ate(estimate, truth, "rigid"), np.random.default_rng(6)
    p, q = (group.position(X) for X in (estimate, truth))
    for size in 50 * [1e-3, 0.05, 2.0]:
        T = group.compose(best.T, group.exp(size * rng.normal(size=group.dim)))
        assert np.sqrt(np.mean(np.sum((q - group.act(T, p)) ** 2, axis=1))) > best.rmse


def test_what_does_not_determine_the_rotation() -> None:
    X = walk(SE3, 10, np.random.default_rng(4))
    X[:, :3] = np.linspace(0, 3, 10)[:, None] * [1.0, 2, -1] + [4, 5, 6]
    with pytest.raises(SingularGeometryError, match="10 positions on one line"):
        ate(X, X, "rigid")
    assert ate(X, X, "first").rmse < 1e-13
    line = np.column_stack([np.arange(5.0), np.zeros(5), np.zeros(5)])  # of the plane: unique there
    assert ate(line + np.array([0, 1, 0]), line, "rigid").rmse < 1e-13
    with pytest.raises(SingularGeometryError, match="3 positions on one spot"):
        ate(np.zeros((3, 3)), np.zeros((3, 3)), "rigid")


def test_what_is_no_pair_of_trajectories() -> None:
    X = walk(SE3, 3, np.random.default_rng(5))
    for estimate, truth in ((X, X[:2]), (X[:, :3], X), (X[:0], X[:0]), (X[:, :2], X[:, :2])):
        with pytest.raises(GraphError, match="expected the same"):
            ate(estimate, truth)
    with pytest.raises(GraphError, match="not finite"):
        ate(X * np.nan, X)
    with pytest.raises(OptionError, match="one of none, first, yaw, rigid, similarity"):
        ate(X, X, "umeyama")


def test_errors_beyond_the_largest_number() -> None:
    """Squares of 1e200 have no sum; one that overflows before the alignment does not hide it."""
    far = [[0, 0, 0], [1e200, 0, 0], [0, 1e308, 0.5]]
    near = [[0, 1, 0], [1, 0, 0], [-1e308, 0, 0.5]]
    for align in ("none", "first", "yaw", "rigid", "similarity"):
        for estimate, truth in ((far, near), (near, far)):
            with pytest.raises(GraphError, match="ate: the squares of these positions are beyond the largest number"):
                ate(estimate, truth, align)
    with pytest.raises(GraphError, match=r"ate: truth is not an array of numbers: .*'a'"):
        ate([[0, 0, 0]], [["a", 0, 0]])
    assert ate([[0, 1e150, 0]], [[0, 0, 0]]).rmse == 1e150


@pytest.mark.parametrize("d", [2, 3])
def test_displacements_of_points_on_a_line_and_in_general(d: int) -> None:
    rng = np.random.default_rng(3)
    group = {2: SE2, 3: SE3}[d]
    line, motion = np.arange(5.0)[:, None] * np.eye(d)[0], group.exp(rng.normal(size=(1, group.dim)))
    assert displacements(line, group.act(motion, line)) == pytest.approx(np.zeros(5), abs=1e-12)
    assert displacements(line, 1.5 * line) == pytest.approx([1, 0.5, 0, 0.5, 1])
    P, Q = walk(group, 20, rng), walk(group, 20, rng)
    assert displacements(group.position(P), group.position(Q)) == pytest.approx(ate(P, Q, "rigid").distances)
    mirrored = group.position(P) * np.r_[-1, np.ones(d - 1)]
    assert displacements(group.position(P), mirrored).max() > 0.1


def test_normal_errors() -> None:
    errors = np.random.default_rng(0).normal(size=(200_000, 3)) * [2.0, 2.0, 50.0]
    circles = [cep(errors), cep(errors, 0.95), drms2(errors)]
    assert circles == pytest.approx([2 * 1.1774, 2 * 2.4477, 2 * np.sqrt(8)], rel=0.01)
    assert [cep(errors[:, :2]), drms2(errors[:, :2])] == [circles[0], circles[2]]
    inside = np.mean(np.hypot(errors[:, 0], errors[:, 1]) < circles[2])
    assert inside == pytest.approx(0.982, abs=0.002)


def test_what_is_no_error() -> None:
    for errors in ([1.0], np.zeros((0, 2)), np.zeros((2, 7))):
        with pytest.raises(GraphError, match=r"expected \(n, 2\) or \(n, 3\)"):
            cep(errors)
    with pytest.raises(GraphError, match="not finite"):
        drms2([[np.nan, 0.0]])
    with pytest.raises(OptionError, match="between 0 and 1"):
        cep([[1.0, 0.0]], 95)


@pytest.mark.parametrize("step", [0.1, 1.0, 7.0])
def test_a_scale_of_one_percent_is_one_percent(step: float) -> None:
    truth = np.zeros((int(120 / step), 7))
    truth[:, 6] = 1.0
    truth[:, 0] = step * np.arange(len(truth))
    estimate = truth.copy()
    estimate[:, 0] *= 1.01
    for error in rpe(estimate, truth):
        steps = int(np.ceil(error.distance / step - 1e-6))
        assert (error.way, error.pairs) == (pytest.approx(steps * step), len(truth) - steps)
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


@BOTH
@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=20)
def test_frames_do_not_matter_to_relative_poses(group: LieGroup, seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = walk(group, 40, rng)
    estimate = moved(group, truth, 0.2, rng)
    motion = group.exp(3 * rng.normal(size=(2, 1, group.dim)))
    (before,) = rpe(estimate, truth, [5])
    (after,) = rpe(group.compose(motion[0], estimate), group.compose(motion[1], truth), [5])
    assert (before.pairs, before.translation) == (after.pairs, pytest.approx(after.translation))
    assert before.rotation == pytest.approx(after.rotation)


def test_no_pairs_and_mistakes() -> None:
    (error,) = rpe(np.zeros((4, 3)), np.zeros((4, 3)), [1.0])  # nothing moves
    assert (error.pairs, str(error)) == (0, "RPE over 1 m: the track is shorter")
    for distances in ([], [0.0], [-3.0], [[1.0]]):
        with pytest.raises((OptionError, GraphError)):
            rpe(np.zeros((4, 3)), np.zeros((4, 3)), distances)  # type: ignore[arg-type]
    with pytest.raises(GraphError, match="rpe: shapes"):
        rpe(np.zeros((4, 3)), np.zeros((5, 3)))


@BOTH
def test_a_steady_motion_is_met_between_the_rows(group: LieGroup) -> None:
    """Straight ahead with a constant turn rate about the vertical, that wraps around pi."""

    def poses(t: np.ndarray) -> np.ndarray:
        yaw, zero = 0.3 * t, np.zeros_like(t)
        if group is SE2:
            return np.column_stack([2 * t, -t, (yaw + np.pi) % (2 * np.pi) - np.pi])
        return np.column_stack([2 * t, -t, 0.1 * t, zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)])

    times = np.arange(0.0, 30.0, 1.0)
    at = np.array([0.0, 0.25, 7.9, 10.47, 29.0])
    pairs = matched(at, poses(at), times, poses(times))
    assert np.abs(group.local(pairs.truth, poses(at))).max() < 1e-12
    assert ate(pairs.estimate, pairs.truth).rmse < 1e-12


def test_what_has_no_match_is_counted() -> None:
    times = np.array([0.0, 1.0, 2.0, 3.0, 8.0, 9.0])  # a gap of 5 s; the median is 1 s
    truth = np.column_stack([times, 0 * times, 0 * times])
    at = np.array([-0.1, 0.5, 3.0, 5.0, 8.0, 9.0, 9.1, 20.0])
    estimate = np.column_stack([at, 0 * at, 0 * at])
    pairs = matched(at, estimate, times, truth)
    assert (pairs.outside, pairs.gaps, pairs.tolerance) == (3, 1, 2.0)
    assert pairs.rows.tolist() == [1, 2, 4, 5]  # rows of the truth beside the gap are met
    wide = matched(at, estimate, times, truth, tolerance=5.0)
    assert (wide.gaps, wide.truth[wide.times == 5.0, 0].tolist()) == (0, [5.0])
    one = matched([3.0, 4.0], truth[:2], [3.0], truth[:1])
    assert (one.rows.tolist(), one.outside) == ([0], 1)


def test_what_cannot_be_matched() -> None:
    X = np.zeros((3, 3))
    with pytest.raises(GraphError, match=r"none of 3 poses has a match. Their times are 100 to 102 s, those of the"):
        matched([100, 101, 102], X, [0, 1, 2], X)
    with pytest.raises(GraphError, match=r"times_truth\[2\], .*0.5.*, does not rise over .*1.0"):
        matched([0, 1, 2], X, [0, 1, 0.5], X)
    with pytest.raises(GraphError, match=r"times_estimate has shape \(2,\), expected \(3,\)"):
        matched([0, 1], X, [0, 1, 2], X)
    with pytest.raises(GraphError, match="matched: shapes"):
        matched([0, 1, 2], X, [0, 1, 2], np.zeros((3, 7)))
    with pytest.raises(OptionError, match="a time in seconds"):
        matched([0, 1, 2], X, [0, 1, 2], X, tolerance=-1.0)
