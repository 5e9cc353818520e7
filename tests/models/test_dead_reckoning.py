"""Dead reckoning: exact where the equations are, covariances that errors obey, drop-outs over many legs, refusals."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from models import SE3, SO3, euler
from models.algebra import Array
from models.dead_reckoning import Legs, chained, integrate
from models.errors import GraphError, OptionError
from models.sensors.dvl import dvl_velocity
from tests.combinations import for_all

MOUNT = np.concatenate([[0.4, -0.2, 0.3], SO3.exp(np.array([0.2, -0.1, 0.7]))])
TILTED = SO3.exp(np.array([0.3, -0.2, 1.0]))
AHEAD, TURN = np.array([0.8, -0.1, 0.05]), np.array([0.02, -0.05, 0.3])


def constant(t: Array) -> tuple[Array, Array, Array]:
    """DVL velocities, rates and attitudes (n, ...) of a vehicle that goes on and turns the same for ever."""
    n = len(t)
    v_d, _ = dvl_velocity(np.tile(AHEAD, (n, 1)), np.tile(TURN, (n, 1)), MOUNT[None])
    return v_d, np.tile(TURN, (n, 1)), SO3.compose(np.tile(TILTED, (n, 1)), SO3.exp(t[:, None] * TURN))


@for_all(sensor=["gyro", "quaternions", "angles"])
def test_constant_velocity_and_rate_are_exact_at_any_times(sensor: str) -> None:
    """With a lever arm, a turned mounting, irregular samples, boundaries between them and a leg within one step."""
    t = np.sort(np.r_[0.0, np.random.default_rng(0).uniform(0, 20, 150), 20.0])
    b = np.array([1.0, 4.3, 4.301, 12.0, 19.0])
    v_d, w, q = constant(t)
    given: dict[str, Any] = {"w": w, "sigma_w": 1e-3}
    if sensor != "gyro":
        attitude = q if sensor == "quaternions" else euler.angles_from_quaternion(q)
        given = {"attitude": attitude, "sigma_attitude": 1e-3}
    legs = integrate(t, v_d, boundaries=b, sigma_v=0.01, mount=MOUNT, longest=9.0, **given)
    twist = np.concatenate([AHEAD, TURN])
    np.testing.assert_allclose(SE3.local(SE3.exp(np.diff(b)[:, None] * twist), legs.z), 0, atol=1e-13)
    start = np.concatenate([[5.0, 6.0, 7.0], TILTED])
    along = SE3.compose(start, SE3.exp((b - b[0])[:, None] * twist))
    np.testing.assert_allclose(SE3.local(along, legs.track(start)), 0, atol=1e-12)
    assert len(legs) == 4
    assert not legs.bridged.any()


def wave(t: Array) -> tuple[Array, Array]:
    """A body's velocity and rate that change all the time."""
    v = np.column_stack([0.8 + 0.3 * np.sin(0.5 * t), 0.1 * np.cos(0.3 * t), 0.1 * np.sin(0.2 * t)])
    return v, np.column_stack([0.1 * np.sin(0.7 * t), 0.08 * np.cos(0.4 * t), 0.1 + 0.25 * np.sin(0.25 * t)])


def test_second_order_in_the_step() -> None:
    def end(n: int) -> Array:
        t = np.linspace(0, 20, n)
        v, w = wave(t)
        v_d, _ = dvl_velocity(v, w, MOUNT[None])
        return integrate(t, v_d, w, boundaries=[0.0, 20.0], sigma_v=0.01, sigma_w=1e-3, mount=MOUNT).z

    best = end(3201)
    coarse, fine = (np.linalg.norm(SE3.local(best, end(n))) for n in (101, 201))
    assert coarse < 0.01
    assert 3.9 < coarse / fine < 4.1


def test_times_of_their_own_for_velocity_and_rate() -> None:
    """A slow DVL and a fast gyro: the gyro is integrated at its own rate."""
    slow, fast = np.linspace(0, 20, 41), np.linspace(0, 20, 2001)
    v, w = np.tile(AHEAD, (41, 1)), wave(fast)[1]
    legs = integrate(slow, v, w, t_w=fast, boundaries=[0.0, 7.77, 20.0], sigma_v=0.01, sigma_w=1e-3)
    every = integrate(fast, np.tile(AHEAD, (2001, 1)), w, boundaries=[0.0, 7.77, 20.0], sigma_v=0.01, sigma_w=1e-3)
    np.testing.assert_allclose(legs.z, every.z, atol=1e-12)
    np.testing.assert_allclose(legs.Sigma[:, 3:, 3:], every.Sigma[:, 3:, 3:], rtol=1e-9)


def test_chained_is_the_product_of_all_before() -> None:
    steps = SE3.exp(np.random.default_rng(1).normal(size=(37, 6)))
    X = SE3.identity()
    for k, T in enumerate(chained(steps)):
        np.testing.assert_allclose(SE3.local(X, T[None]), 0, atol=1e-12)
        X = SE3.compose(X, steps[k : k + 1]) if k < 37 else X


@for_all(sensor=["gyro", "attitude"], leg=[0, 1])
def test_the_covariance_is_that_of_differences(sensor: str, leg: int) -> None:
    """Every sample moved a little, scale and bias too, at turns of half a radian a step: Sigma is what follows."""
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.5, 1.0, 7))
    v, w, bias = rng.normal(size=(7, 3)), 0.6 * rng.normal(size=(7, 3)), np.array([0.01, 0.02, 0.03])
    q = SO3.exp(0.6 * rng.normal(size=(7, 3)))
    b = [t[1], t[3], t[5]] if sensor == "attitude" else [0.5 * (t[0] + t[1]), t[3], 0.3 * t[4] + 0.7 * t[5]]
    b = b[leg : leg + 2]  # alone: two legs share a sample
    settings: dict[str, Any] = {"boundaries": b, "sigma_v": [0.1, 0.2, 0.3], "mount": MOUNT, "longest": 9.0}

    def run(v: Array, turn: Array, **more: Any) -> Legs:
        """The legs with the velocities v and rates, or attitudes, changed by a turn (7, 3)."""
        if sensor == "gyro":
            return integrate(t, v, w + turn, sigma_w=[0.01, 0.02, 0.03], **settings, **more)
        return integrate(
            t, v, attitude=SO3.compose(q, SO3.exp(turn)), sigma_attitude=[0.01, 0.02, 0.03], **settings, **more
        )

    def squared(dv: Array, turn: Array) -> Array:
        """G G' of one error of one standard deviation, by central differences."""
        h = 1e-4
        G = SE3.local(run(v - h * dv, -h * turn).z, run(v + h * dv, h * turn).z) / (2 * h)
        return G[:, :, None] * G[:, None, :]

    none = np.zeros((7, 3))
    spacing = np.gradient(t) if sensor == "gyro" else np.ones(7)
    want = squared(0.05 * v, none)
    for c, unit in enumerate(np.eye(3)):
        want += squared(none, np.tile(bias[c] * unit, (7, 1)))
        for k in range(7):
            one = np.zeros((7, 3))
            one[k, c] = 1.0
            want += squared((0.1, 0.2, 0.3)[c] * one, none)
            want += squared(none, (0.01, 0.02, 0.03)[c] / np.sqrt(spacing[k]) * one)
    legs = run(v, none, scale=0.05, sigma_bias=bias)
    np.testing.assert_allclose(legs.Sigma, want, rtol=0, atol=1e-6 * np.abs(want).max())


def straight(valid: npt.NDArray[np.bool_], **more: Any) -> Legs:
    """One meter a second ahead for ten seconds, at 10 Hz."""
    t = np.linspace(0, 10, len(valid))
    v = np.where(valid[:, None], [1.0, 0.0, 0.0], np.nan)
    given = {"t": t, "v": v, "w": np.zeros((len(t), 3)), "sigma_v": 1e-6, "sigma_w": 1e-9, "valid": valid, **more}
    return integrate(**given)


def test_a_drop_out_is_bridged_and_said() -> None:
    t, valid = np.linspace(0, 10, 101), np.ones(101, dtype=bool)
    valid[31:70] = False  # nothing between 3 and 7 s
    legs = straight(valid, boundaries=[0.0, 3.0, 5.0, 10.0], sigma_bridge=0.1)
    np.testing.assert_allclose(legs.z[:, :3], [[3, 0, 0], [2, 0, 0], [5, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(legs.bridged, [0, 2, 2], atol=1e-12)
    assert "bridged for 4 s, in 2 of them" in str(legs)
    whole = straight(valid, boundaries=[0.0, 10.0], sigma_bridge=0.1)
    assert np.sqrt(whole.Sigma[0, 0, 0]) == pytest.approx(0.1 * 4**1.5 / np.sqrt(12), rel=1e-6)
    np.testing.assert_allclose(legs.Sigma[1:, 0, 0], whole.Sigma[0, 0, 0] / 2, rtol=1e-6)
    rows = {"t": t[valid], "v": np.tile([1.0, 0.0, 0.0], (62, 1))}  # missing rows are a drop-out, too
    still = {"t_w": t, "w": np.zeros((101, 3))}
    gone = straight(valid[valid], **rows, **still, boundaries=[0.0, 10.0], sigma_bridge=0.1)
    np.testing.assert_allclose(gone.Sigma, whole.Sigma, rtol=1e-6, atol=1e-15)
    assert (whole.bridged[0], gone.bridged[0]) == pytest.approx((4.0, 4.0))
    one = np.arange(11) != 5  # one velocity is two steps of 1 s
    legs = straight(one, boundaries=[0, 10], sigma_bridge=0.1)
    assert legs.bridged.tolist() == [2.0]
    assert np.sqrt(legs.Sigma[0, 0, 0]) == pytest.approx(0.1 * 2**1.5 / np.sqrt(12), rel=0.01)


def test_a_bridge_follows_the_straight_line_between_its_ends() -> None:
    t, valid = np.linspace(0, 10, 101), np.ones(101, dtype=bool)
    valid[41:60] = False
    v = np.column_stack([0.5 + 0.1 * t, np.zeros_like(t), -0.02 * t])
    v[~valid] = 1e9  # what is not valid is not looked at
    legs = straight(valid, v=v, boundaries=[0, 10], sigma_bridge=0)
    np.testing.assert_allclose(legs.z[0, :3], [10.0, 0.0, -1.0], atol=1e-12)
    assert straight(valid, boundaries=[0.0, 4.0]).bridged.tolist() == [0.0]  # a drop-out elsewhere asks for nothing
    with pytest.raises(OptionError, match=r"sigma_bridge: None .* 4 and 6 s"):
        straight(valid, boundaries=[0.0, 5.0])


T, ONES = np.linspace(0, 1, 11), np.ones((11, 3))
GOOD: dict[str, Any] = {"t": T, "v": ONES, "w": 0 * ONES, "boundaries": [0.0, 1.0], "sigma_v": 0.1, "sigma_w": 0.01}
GAP: dict[str, Any] = {"t_w": np.r_[T[:6], T[6:] + 1], "boundaries": [0.0, 0.9]}
LOST = {"valid": np.arange(11) != 4}
TURNED: dict[str, Any] = {"w": None, "sigma_w": None, "sigma_attitude": 0.1}


def but(x: Array, place: Any, value: float) -> Array:
    out = np.array(x, dtype=float)
    out[place] = value
    return out


WRONG_ARRAYS: list[tuple[dict[str, Any], str]] = [
    ({"t": but(T, 4, 0.3)}, r"t\[4\] = 0\.3 s does not rise"),
    ({"t": but(T, 4, np.nan)}, r"t\[4\] is nan"),
    ({"t": 1.0}, r"t has shape \(\), expected \(n,\)"),
    ({"t": "now"}, "t is not"),
    ({"v": ONES[:10]}, r"v has shape \(10, 3\), expected \(11, 3\)"),
    ({"v": but(ONES, (5, 1), np.nan)}, r"v\[5\] is .*valid"),
    ({"w": ONES[:, :2]}, r"w has shape \(11, 2\), expected \(11, 3\)"),
    ({"w": but(ONES, 7, np.inf)}, r"w\[7\] is \[inf, inf, inf\]"),
    ({"w": None}, "either w, .* or attitude"),
    ({"attitude": 0 * ONES}, "either w, .* or attitude"),
    ({**TURNED, "attitude": np.ones((11, 4))}, r"attitude\[0\]: .*length 2"),
    ({**TURNED, "attitude": np.ones((11, 5))}, r"\(11, 4\) or \(11, 3\)"),
    ({"boundaries": [0.0, 1.5]}, r"boundaries\[1\] = 1\.5 s .* 0\.0 to 1\.0 s"),
    ({"boundaries": [1.0, 0.0]}, r"boundaries\[1\] = 0\.0 s does not rise"),
    ({"boundaries": [0.5]}, r"boundaries has shape \(1,\)"),
    ({"t_w": T + 0.1}, r"boundaries\[0\] = 0\.0 s is outside of the rates"),
    ({"valid": np.arange(11) > 2}, r"boundaries\[0\] = 0\.0 s is outside of the valid velocities"),
    ({"valid": np.arange(11) > 9}, "1 of 11 velocities"),
    ({"valid": np.ones(3)}, r"valid has shape \(3,\)"),
    ({"valid": np.full(11, 2)}, "True and False"),
    ({"sigma_v": np.ones(11)}, r"sigma_v has shape \(11,\)"),
    ({**GAP, "sigma_turn": [0.1, 0.1]}, r"sigma_turn has shape \(2,\)"),
    ({"mount": [0.0, 0.0, 0.0]}, r"mount has shape \(3,\), expected \(7,\)"),
    ({"mount": np.zeros(7)}, "SE3: element 0 .* length 0"),
]
WRONG_NUMBERS: list[tuple[dict[str, Any], str]] = [
    *(({"sigma_v": bad}, "sigma_v: ") for bad in (0.0, [0.1, -0.1, 0.1])),
    ({"sigma_w": None}, "sigma_w: None"),
    ({"sigma_attitude": 0.1}, "sigma_attitude: 0.1 .*expected None"),
    ({**TURNED, "sigma_w": 0.1, "attitude": 0 * ONES}, "sigma_w: .* None"),
    *(({"scale": bad}, "scale: ") for bad in (-0.01, "a", np.array([0.1, 0.2]))),
    ({"sigma_bias": np.nan}, "sigma_bias: nan"),
    (LOST, r"sigma_bridge: None .* 0\.3 and 0\.5 s"),
    *(({**LOST, "sigma_bridge": bad}, "sigma_bridge: ") for bad in (-1.0, "a")),
    (GAP, r"sigma_turn: None .* 0\.5 and 1\.6 s"),
    ({**GAP, "sigma_turn": -1.0}, r"sigma_turn: -1\.0"),
    *(({"longest": bad}, "longest: ") for bad in (0.0, "a", np.nan)),
]


def test_what_is_wrong_is_refused_by_name() -> None:
    for kind, table in ((GraphError, WRONG_ARRAYS), (OptionError, WRONG_NUMBERS)):
        for wrong, named in table:
            with pytest.raises(kind, match=named):
                integrate(**{**GOOD, **wrong})


BETA, OUT = 0.1, (5.0, 15.0)
TIMES = np.linspace(0.0, 20.0, 101)
ONWARD = np.array([1.0, 0.1, 0.05])
STILL = np.zeros((len(TIMES), 3))
ALL_VALID: dict[str, Any] = {"valid": None, "sigma_bridge": None}
NO_GYRO: dict[str, Any] = {**ALL_VALID, "w": None, "sigma_w": None, "v": STILL + np.eye(3)[0]}


def legs_of(boundaries: npt.ArrayLike, **given: Any) -> Legs:
    """A vehicle with a constant velocity, not measured for a while, and a gyro that is all but perfect."""
    gap = {"valid": (TIMES <= OUT[0]) | (TIMES >= OUT[1]), "sigma_bridge": BETA}
    return integrate(
        TIMES,
        boundaries=boundaries,
        **{"v": STILL + ONWARD, "w": STILL, "sigma_v": 1e-6, "sigma_w": 1e-9, **gap, **given},
    )


def summed(legs: Legs) -> Array:
    """Covariance (6, 6) of the whole way, were the legs independent: what a graph makes of them."""
    ends = SE3.stack(legs.track([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    M = SE3.adjoint(SE3.between(ends[-1:], ends[1:]))
    return np.asarray((M @ legs.Sigma @ M.mT).sum(axis=0))


def test_the_end_does_not_depend_on_the_number_of_legs() -> None:
    """Bridge, velocities before and after it, and rates that legs share; boundaries on samples and between them."""
    for noise in (
        {"sigma_bridge": 0.1, "sigma_v": 1e-6},
        {"sigma_bridge": 1e-6, "sigma_v": 0.05},
        {"sigma_bridge": 0.05, "sigma_v": [0.02, 0.05, 0.1]},
        {"sigma_bridge": 1e-6, "sigma_v": 1e-6, "sigma_w": 0.01},
    ):
        v = STILL if "sigma_w" in noise else STILL + ONWARD  # or the noise of the turn is part of the way
        one = summed(legs_of([0.0, 20.0], v=v, **noise))
        for boundaries in ([0.0, 9.3, 20.0], [0.0, 5.0, 15.0, 20.0], np.linspace(0, 20, 21), np.linspace(0, 20, 78)):
            many = summed(legs_of(boundaries, v=v, **noise))
            np.testing.assert_allclose(many, one, rtol=0.01, atol=1e-6 * one.max())
    for n in (2, 11, 51):
        assert np.sqrt(summed(legs_of(np.linspace(5.0, 15.0, n)))[0, 0]) == pytest.approx(BETA * 10**1.5 / 12**0.5)


def test_no_combination_of_legs_is_better_known_than_the_bridge_allows() -> None:
    b = np.array([5.0, 6.0, 6.5, 10.0, 13.0, 15.0])
    s = np.linspace(0.0, 10.0, 2001)
    kernel = BETA**2 * (np.minimum.outer(s, s) - np.outer(s, s) / 10)
    part = np.array([(s + 5.0 >= low) & (s + 5.0 < high) for low, high in pairwise(b)]) * s[1]
    C = part @ kernel @ part.T
    D = np.diag(legs_of(b).Sigma[:, 0, 0])
    np.testing.assert_allclose(D.sum(), C.sum(), rtol=1e-3)
    assert np.linalg.eigvalsh(D - C).min() > -1e-4 * C.max()
    assert (np.diagonal(D) > np.diagonal(C)).all()


def walked(sigma: float, boundaries: list[float]) -> Legs:
    """Attitudes at 10 Hz with none between 5 and 15 s, 1 m/s ahead."""
    t_w = np.linspace(0.0, 20.0, 201)
    t_w = t_w[(t_w <= OUT[0]) | (t_w >= OUT[1])]
    level = np.zeros((len(t_w), 3))
    return legs_of(boundaries, t_w=t_w, attitude=level, sigma_attitude=1e-6, sigma_turn=sigma, **NO_GYRO)


@for_all(boundaries=[[0.0, 20.0], [5.0, 15.0], [0.0, 7.3, 7.4, 9.0, 15.0, 20.0]])
def test_an_attitude_that_is_not_measured_wanders(boundaries: list[float]) -> None:
    """Yaw by sigma sqrt(T), the place of the end across the way by what that swings, in any number of legs."""
    sigma = 0.05
    legs = walked(sigma, boundaries)
    S = summed(legs)
    after = boundaries[-1] - 15.0
    assert S[5, 5] == pytest.approx(sigma**2 * 10, rel=1e-3)
    # y = integral of (time to the end) times the white rate
    assert S[1, 1] == pytest.approx(sigma**2 * ((10 + after) ** 3 - after**3) / 3, rel=2e-3)
    assert legs.unturned.sum() == pytest.approx(10.0)
    assert "; the attitude for 10 s, in " in str(legs)
    assert walked(0.0, boundaries).Sigma[:, 5, 5].max() < 1e-9


def test_each_drop_out_and_axis_of_the_attitude_has_its_own_density() -> None:
    t_w = np.delete(np.linspace(0.0, 20.0, 201), [*range(31, 50), *range(101, 140)])  # none in 3-5 s, 10-14 s
    sigma = np.zeros((len(t_w), 3))
    sigma[np.flatnonzero(np.diff(t_w) > 1)] = [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]
    turned = np.concatenate([np.zeros(3), SO3.exp(np.array([0.0, 0.0, np.pi / 2]))])  # DVL to starboard
    given: dict[str, Any] = {"t_w": t_w, "attitude": 0 * sigma, "sigma_attitude": 1e-9, "sigma_turn": sigma}
    legs = legs_of([0.0, 8.0, 20.0], mount=turned, **given, **NO_GYRO)
    found = np.diagonal(legs.Sigma[:, 3:, 3:], axis1=1, axis2=2)
    np.testing.assert_allclose(found, np.square([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]) * [[2.0], [4.0]], rtol=1e-6)
    assert legs.unturned.tolist() == pytest.approx([2.0, 4.0])


def test_rates_that_are_far_apart_are_a_drop_out_too() -> None:
    t_w = np.delete(TIMES, np.arange(30, 40))
    given: dict[str, Any] = {"t_w": t_w, "w": STILL[: len(t_w)], **ALL_VALID}
    gap, whole = legs_of([0.0, 20.0], sigma_turn=0.1, **given), legs_of([0.0, 20.0], longest=3.0, **given)
    assert gap.Sigma[0, 5, 5] == pytest.approx(0.1**2 * 2.2, rel=1e-6)
    assert gap.unturned == pytest.approx([2.2])
    assert whole.Sigma[0, 5, 5] < 1e-12
