"""Dead reckoning: exact where the equations are, covariances that the errors obey, drop-outs, refusals by name."""

from __future__ import annotations

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
