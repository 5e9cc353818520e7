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

MOUNT = np.concatenate([[0.4, -0.2, 0.3], SO3.exp(np.array([0.2, -0.1, 0.7]))])
TILTED = SO3.exp(np.array([0.3, -0.2, 1.0]))
AHEAD, TURN = np.array([0.8, -0.1, 0.05]), np.array([0.02, -0.05, 0.3])


def constant(t: Array) -> tuple[Array, Array, Array]:
    """DVL velocities, rates and attitudes (n, ...) of a vehicle that goes on and turns the same for ever."""
    n = len(t)
    v_d, _ = dvl_velocity(np.tile(AHEAD, (n, 1)), np.tile(TURN, (n, 1)), MOUNT[None])
    return v_d, np.tile(TURN, (n, 1)), SO3.compose(np.tile(TILTED, (n, 1)), SO3.exp(t[:, None] * TURN))


# --- exact where the equations are ------------------------------------------------------------------------------------


@pytest.mark.parametrize("sensor", ["gyro", "quaternions", "angles"])
def test_constant_velocity_and_rate_are_exact_at_any_times(sensor: str) -> None:
    """With a lever arm, a turned mounting, irregular samples, boundaries between them and a leg within one step."""
    rng = np.random.default_rng(0)
    t = np.sort(np.r_[0.0, rng.uniform(0, 20, 150), 20.0])
    b = np.array([1.0, 4.3, 4.301, 12.0, 19.0])
    v_d, w, q = constant(t)
    given: dict[str, Any] = {
        "gyro": {"w": w, "sigma_w": 1e-3},
        "quaternions": {"attitude": q, "sigma_attitude": 1e-3},
        "angles": {"attitude": euler.angles_from_quaternion(q), "sigma_attitude": 1e-3},
    }[sensor]
    legs = integrate(t, v_d, boundaries=b, sigma_v=0.01, mount=MOUNT, longest=9.0, **given)
    want = SE3.exp(np.diff(b)[:, None] * np.concatenate([AHEAD, TURN]))
    np.testing.assert_allclose(SE3.local(want, legs.z), 0, atol=1e-13)
    start = np.concatenate([[5.0, 6.0, 7.0], TILTED])
    along = SE3.compose(start, SE3.exp((b - b[0])[:, None] * np.concatenate([AHEAD, TURN])))
    np.testing.assert_allclose(SE3.local(along, legs.track(start)), 0, atol=1e-12)
    assert len(legs) == 4
    assert not legs.bridged.any()


def test_the_lever_arm_and_the_mounting_count() -> None:
    t = np.linspace(0, 10, 101)
    v_d, w, _ = constant(t)
    want = SE3.exp(10 * np.concatenate([AHEAD, TURN]))
    aligned = np.concatenate([MOUNT[:3], [0.0, 0.0, 0.0, 1.0]])
    center = np.concatenate([[0.0, 0.0, 0.0], MOUNT[3:]])
    for wrong in (aligned, center):
        z = integrate(t, v_d, w, boundaries=[0.0, 10.0], sigma_v=0.01, sigma_w=1e-3, mount=wrong).z[0]
        assert np.linalg.norm(SE3.position(SE3.between(want, z))) > 0.1


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

    best = end(12801)
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


# --- covariances ------------------------------------------------------------------------------------------------------

RUNS = 120
SIGMA = {"sigma_v": 0.03, "scale": 0.01}
BIAS, BRIDGE = np.array([2e-3, 1e-3, 3e-3]), 0.05


def bridged_truth(t: Array, v: Array, valid: npt.NDArray[np.bool_], rng: np.random.Generator) -> Array:
    """Velocities that wander between the valid ones as the bridge says they may."""
    v = v.copy()
    for part in np.split(np.flatnonzero(~valid), np.flatnonzero(np.diff(np.flatnonzero(~valid)) > 1) + 1):
        a, b = part[0] - 1, part[-1] + 1
        share = ((t[a : b + 1] - t[a]) / (t[b] - t[a]))[:, None]
        walk = np.cumsum(rng.normal(size=(b - a, 3)) * BRIDGE * np.sqrt(np.diff(t[a : b + 1]))[:, None], axis=0)
        walk = np.concatenate([np.zeros((1, 3)), walk])
        v[a : b + 1] = (1 - share) * v[a] + share * v[b] + walk - share * walk[-1]
    return v


@pytest.mark.parametrize("sensor", ["gyro", "attitude"])
@pytest.mark.parametrize("gaps", [False, True])
def test_errors_obey_their_covariances(sensor: str, gaps: bool) -> None:
    """NEES of legs between boundaries on and off the samples, over seeds, every noise on: mean and each component."""
    rng = np.random.default_rng(11)
    t, tw, b = np.linspace(0, 12, 121), np.linspace(0, 12, 301), np.array([0.03, 4.0, 4.5, 12.0])
    w = wave(tw)[1]
    v_d, _ = dvl_velocity(*wave(t), MOUNT[None])
    valid = np.ones(len(t), dtype=bool)
    if gaps:
        valid[20:47], valid[90:97] = False, False  # over a boundary, and inside of a leg
    q = integrate(tw, np.zeros_like(w), w, boundaries=tw, sigma_v=1.0, sigma_w=1.0).track([0, 0, 0, *TILTED])[:, 3:]
    settings: dict[str, Any] = dict(boundaries=b, mount=MOUNT, t_w=tw, **SIGMA)

    def run(v: Array, w: Array, q: Array, **more: Any) -> Legs:
        if sensor == "gyro":
            return integrate(t, v, w, sigma_w=2e-3, sigma_bias=BIAS, **settings, **more)
        return integrate(t, v, attitude=q, sigma_attitude=0.01, sigma_bias=BIAS, **settings, **more)

    errors = np.empty((RUNS, 3, 6))
    for e in errors:
        v_true = bridged_truth(t, v_d, valid, rng) if gaps else v_d
        truth = run(v_true, w, q).z
        v_m = v_true * (1 + 0.01 * rng.normal()) + 0.03 * rng.normal(size=v_d.shape)
        v_m[~valid] = np.nan
        bias = BIAS * rng.normal(size=3)
        w_m = w + bias + 2e-3 / np.sqrt(tw[1]) * rng.normal(size=w.shape)
        q_m = SO3.compose(q, SO3.exp(bias + 0.01 * rng.normal(size=w.shape)))
        legs = run(v_m, w_m, q_m, valid=valid, sigma_bridge=BRIDGE)
        e[:] = SE3.local(legs.z, truth)
    nees = np.einsum("rki,kij,rkj->rk", errors, np.linalg.inv(legs.Sigma), errors)
    bound = 3 * np.sqrt(2 * 6 / RUNS)  # of the 12 legs of these four tests, one would often leave its 95 %
    alone = [2] if gaps else [0, 1, 2]  # legs that share no drop-out with another
    np.testing.assert_allclose(nees.mean(axis=0)[alone], 6, atol=bound)
    runs = nees[:, alone].mean(axis=1)  # the legs of one run share their scale and bias
    assert abs(runs.mean() - 6) < 1.96 * runs.std() / np.sqrt(RUNS)
    spread = errors.std(axis=0) / np.sqrt(np.diagonal(legs.Sigma, axis1=1, axis2=2))
    np.testing.assert_allclose(spread[alone], 1, atol=0.22)
    assert (nees.mean(axis=0) < 6 + bound).all()
    assert (spread[:2, 3:] > 0.78).all()
    np.testing.assert_allclose(legs.bridged, [2.1, 0.5, 1.0] if gaps else [0.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("sensor", ["gyro", "attitude"])
@pytest.mark.parametrize("leg", [0, 1])
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


def test_the_covariance_is_what_one_can_add_up() -> None:
    """Straight ahead at rest of turn: white velocity noise, scale, and a yaw rate that swings the end of the way."""
    t = np.linspace(0, 10, 1001)
    legs = integrate(
        t,
        np.tile([2.0, 0.0, 0.0], (1001, 1)),
        np.zeros((1001, 3)),
        boundaries=[0.0, 10.0],
        sigma_v=0.01,
        sigma_w=[1e-9, 1e-9, 0.001],
        scale=0.002,
        sigma_bias=[0.0, 0.0, 0.0003],
    )
    S = legs.Sigma[0]
    white = 0.01**2 * 0.01 * 10  # sigma^2 dt T
    assert S[0, 0] == pytest.approx(white + (0.002 * 20) ** 2, rel=2e-3)
    assert S[2, 2] == pytest.approx(white, rel=2e-3)
    assert S[5, 5] == pytest.approx(0.001**2 * 10 + (0.0003 * 10) ** 2, rel=2e-3)
    # the yaw error psi moves the end sideways by the integral of 2 m/s psi
    assert S[1, 1] == pytest.approx(white + 2.0**2 * (0.001**2 * 10**3 / 3 + 0.0003**2 * 10**4 / 4), rel=2e-3)
    assert S[1, 5] == pytest.approx(2.0 * (0.001**2 * 10**2 / 2 + 0.0003**2 * 10**3 / 2), rel=2e-3)
    np.testing.assert_allclose(S, S.T, rtol=0, atol=0)
    assert np.linalg.eigvalsh(S).min() > 0


# --- drop-outs --------------------------------------------------------------------------------------------------------


def straight(valid: npt.NDArray[np.bool_], **more: Any) -> Legs:
    """One meter a second ahead for ten seconds, at 10 Hz."""
    t = np.linspace(0, 10, 101)
    v = np.where(valid[:, None], [1.0, 0.0, 0.0], np.nan)
    return integrate(t, v, np.zeros((101, 3)), sigma_v=1e-6, sigma_w=1e-9, valid=valid, **more)


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
    assert whole.bridged[0] == pytest.approx(4.0)
    # rows that are missing are a drop-out as well
    gone = integrate(
        t[valid],
        np.tile([1.0, 0.0, 0.0], (valid.sum(), 1)),
        np.zeros((101, 3)),
        t_w=t,
        boundaries=[0.0, 10.0],
        sigma_v=1e-6,
        sigma_w=1e-9,
        sigma_bridge=0.1,
    )
    np.testing.assert_allclose(gone.Sigma, whole.Sigma, rtol=1e-6, atol=1e-15)
    assert gone.bridged[0] == pytest.approx(4.0)


def test_one_lost_velocity_is_a_drop_out_of_two_steps() -> None:
    t, valid = np.linspace(0, 10, 11), np.ones(11, dtype=bool)
    valid[5] = False
    v, w = np.tile([1.0, 0.0, 0.0], (11, 1)), np.zeros((11, 3))
    legs = integrate(t, v, w, boundaries=[0, 10], sigma_v=1e-6, sigma_w=1e-9, valid=valid, sigma_bridge=0.1)
    assert legs.bridged.tolist() == [2.0]
    assert np.sqrt(legs.Sigma[0, 0, 0]) == pytest.approx(0.1 * 2**1.5 / np.sqrt(12), rel=0.01)


def test_a_bridge_follows_the_straight_line_between_its_ends() -> None:
    t, valid = np.linspace(0, 10, 101), np.ones(101, dtype=bool)
    valid[41:60] = False
    v = np.column_stack([0.5 + 0.1 * t, np.zeros_like(t), -0.02 * t])
    v[~valid] = 1e9  # what is not valid is not looked at
    legs = integrate(
        t, v, np.zeros((101, 3)), boundaries=[0, 10], sigma_v=0.1, sigma_w=1e-3, valid=valid, sigma_bridge=0
    )
    np.testing.assert_allclose(legs.z[0, :3], [10.0, 0.0, -1.0], atol=1e-12)


def test_a_drop_out_elsewhere_asks_for_nothing() -> None:
    valid = np.ones(101, dtype=bool)
    valid[50:60] = False
    assert straight(valid, boundaries=[0.0, 4.9]).bridged.tolist() == [0.0]
    with pytest.raises(OptionError, match=r"sigma_bridge: None .* no velocity is valid between 4\.9 and 6 s"):
        straight(valid, boundaries=[0.0, 5.0])


# --- refusals ---------------------------------------------------------------------------------------------------------

T = np.linspace(0, 1, 11)
GOOD: dict[str, Any] = {
    "t": T,
    "v": np.ones((11, 3)),
    "w": np.zeros((11, 3)),
    "boundaries": [0.0, 1.0],
    "sigma_v": 0.1,
    "sigma_w": 0.01,
}


def but(x: npt.ArrayLike, place: Any, value: float) -> Array:
    out = np.array(x, dtype=float)
    out[place] = value
    return out


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"t": but(T, 4, 0.3)}, r"t\[4\] = 0\.3 s does not rise over 0\.30000000000000004 s before it; sort"),
        ({"t": but(T, 4, np.nan)}, r"t\[4\] is nan, expected finite"),
        ({"t": 1.0}, r"t has shape \(\), expected \(n,\)"),
        ({"t": "now"}, "t is not an array of numbers"),
        ({"v": np.ones((10, 3))}, r"v has shape \(10, 3\), expected \(11, 3\): one row for each of 11 times"),
        (
            {"v": but(np.ones((11, 3)), (5, 1), np.nan)},
            r"v\[5\] is \[1\.0, nan, 1\.0\].*mark what is not measured in valid",
        ),
        ({"w": np.ones((11, 2))}, r"w has shape \(11, 2\), expected \(11, 3\)"),
        ({"w": but(np.zeros((11, 3)), 7, np.inf)}, r"w\[7\] is \[inf, inf, inf\], expected finite numbers$"),
        ({"w": None}, "either w, the rates of a gyro, or attitude"),
        ({"attitude": np.zeros((11, 3))}, "either w, the rates of a gyro, or attitude"),
        (
            {"w": None, "sigma_w": None, "sigma_attitude": 0.1, "attitude": np.ones((11, 4))},
            r"attitude\[0\]: .*length 2",
        ),
        ({"w": None, "sigma_w": None, "sigma_attitude": 0.1, "attitude": np.ones((11, 5))}, r"\(11, 4\) or \(11, 3\)"),
        ({"boundaries": [0.0, 1.5]}, r"boundaries\[1\] = 1\.5 s is outside of the valid velocities, .* 0\.0 to 1\.0 s"),
        ({"boundaries": [1.0, 0.0]}, r"boundaries\[1\] = 0\.0 s does not rise"),
        ({"boundaries": [0.5]}, r"boundaries has shape \(1,\)"),
        ({"t_w": T + 0.1}, r"boundaries\[0\] = 0\.0 s is outside of the rates"),
        ({"valid": np.arange(11) > 2}, r"boundaries\[0\] = 0\.0 s is outside of the valid velocities"),
        ({"valid": np.arange(11) > 9}, "1 of 11 velocities are valid"),
        ({"valid": np.ones(3)}, r"valid has shape \(3,\)"),
        ({"valid": np.full(11, 2)}, "of True and False"),
        ({"sigma_v": np.ones(11)}, r"sigma_v has shape \(11,\), expected a number, \(3,\) or \(11, 3\)"),
        (
            {"t_w": but(T, slice(6, None), T[6:] + 1), "boundaries": [0.0, 0.9], "sigma_turn": [0.1, 0.1]},
            r"sigma_turn has shape \(2,\), expected a number, \(3,\) or \(11, 3\)",
        ),
        ({"mount": [0.0, 0.0, 0.0]}, r"mount has shape \(3,\), expected \(7,\): one pose"),
        ({"mount": np.zeros(7)}, "SE3: element 0 .* quaternion has length 0"),
    ],
)
def test_wrong_arrays_are_refused_by_name(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(GraphError, match=message):
        integrate(**{**GOOD, **wrong})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sigma_v": 0.0}, r"sigma_v: 0\.0 is not possible; expected finite and above 0"),
        ({"sigma_v": [0.1, -0.1, 0.1]}, "sigma_v: "),
        ({"sigma_w": None}, "sigma_w: None is not possible"),
        ({"sigma_attitude": 0.1}, "sigma_attitude: 0.1 is not possible; expected None where w is given"),
        ({"w": None, "attitude": np.zeros((11, 3)), "sigma_attitude": 0.1}, "sigma_w: .* None where attitude is given"),
        ({"scale": -0.01}, r"scale: -0\.01 is not possible"),
        ({"sigma_bias": np.nan}, "sigma_bias: nan"),
        ({"valid": np.arange(11) != 4}, r"sigma_bridge: None .* between 0\.3 and 0\.5 s"),
        ({"valid": np.arange(11) != 4, "sigma_bridge": -1.0}, r"sigma_bridge: -1\.0"),
        ({"valid": np.arange(11) != 4, "sigma_bridge": "a"}, "sigma_bridge: 'a'"),
        (
            {"t_w": but(T, slice(6, None), T[6:] + 1), "boundaries": [0.0, 0.9]},
            r"sigma_turn: None .* the attitude wanders in a drop-out, rad/sqrt\(s\), .* between 0\.5 and 1\.6 s",
        ),
        (
            {"t_w": but(T, slice(6, None), T[6:] + 1), "boundaries": [0.0, 0.9], "sigma_turn": -1.0},
            r"sigma_turn: -1\.0 is not possible; expected finite and 0 or above",
        ),
        ({"longest": 0.0}, r"longest: 0\.0 is not possible"),
        ({"longest": "a"}, "longest: 'a' is not possible"),
        ({"longest": np.nan}, "longest: nan is not possible"),
        ({"scale": "a"}, "scale: 'a' is not possible"),
        ({"scale": np.array([0.1, 0.2])}, r"scale: array\(\[0\.1, 0\.2\]\) is not possible"),
    ],
)
def test_wrong_numbers_are_refused_by_name(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        integrate(**{**GOOD, **wrong})
