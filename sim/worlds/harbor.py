"""The harbor: a vehicle goes around several times, reckons its way, and an imaging sonar looks ahead."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from models import SE2
from models.algebra import Array, Index, wrap
from models.errors import GraphError, OptionError
from models.options import check_between
from models.sensors import ImagingSonar
from nls.metrics import ate
from nls.missions.scans import Drift, Scans
from sim.checks import check_not_negative, check_poses, check_rng, check_size
from sim.harbor_scans import SONAR, drawn, imaged
from sim.harbor_scenes import GEOMETRIES, way
from sim.scene import Scene
from sim.world import seed_of

__all__ = ["Harbor", "harbor"]

SPEED = 0.25  # m/s
MOST = 0.8  # of a drift: with 1 the reckoned way has no end
FIXED_POINT = 60  # iterations: 0.8^60 is 2e-6
LOUDEST = 200.0  # dB of a signal: the power is a number, and every echo is seen with far less
LOOP = 40  # keyframes of a lap at least: pairs of submaps are 20 apart


@dataclass(frozen=True)
class Harbor:
    """A harbor, and the measurements of a vehicle in it.

    All is in one frame: x north, y east, yaw positive clockwise from above; scans have x ahead, y to starboard. So
    azimuths, positive to starboard, are positive in the sense of yaw.

    Attributes
    ----------
    name : of its geometry.
    scene : walls, piles and rocks.
    truth : (n, 3) true poses of the keyframes, x, y, m, and yaw, rad.
    poses : (n, 3) as reckoned, with the headings of the compass; the first is the true one.
    times : (n,) of the keyframes, s.
    scans : the points of the sonar.
    sonar : that detected them.
    drift : how wrong dead reckoning is, as drawn.
    seed : the whole number the generator was made from; None where it was made in another way.
    description : what the harbor is, in sentences with the numbers.
    """

    name: str
    scene: Scene = field(repr=False)
    truth: Array = field(repr=False)
    poses: Array = field(repr=False)
    times: Array = field(repr=False)
    scans: Scans
    sonar: ImagingSonar = field(repr=False)
    drift: Drift = field(repr=False)
    seed: int | None
    description: str = field(repr=False)

    def ate(self, poses: npt.ArrayLike) -> float:
        """Root mean square distance, m, of estimated keyframes (n, 3) from the true ones, after one rigid motion."""
        return ate(poses, self.truth, align="rigid").rmse

    def errors(self, i: Index, j: Index, pose: npt.ArrayLike) -> Array:
        """Errors (n, 3) of poses (n, 3) of keyframes j in the frame of keyframes i, in the frame of j: m, m, rad.

        Raises
        ------
        GraphError
            Keyframes that are not in the harbor.
        """
        if len(i) and not (0 <= min(np.min(i), np.min(j)) and max(np.max(i), np.max(j)) < len(self.truth)):
            raise GraphError(f"Harbor: keyframes {i}, {j}; expected numbers from 0 to {len(self.truth) - 1}")
        e = SE2.between(SE2.between(self.truth[i], self.truth[j]), np.asarray(pose, dtype=float))
        return np.column_stack([e[:, :2], wrap(e[:, 2])])


def harbor(
    rng: np.random.Generator,
    geometry: Literal["marina", "quay", "rocks"] = "marina",
    keyframes: int = 300,
    laps: int = 2,
    drift: float = 1.0,
    signal: float = 20.0,
    false_alarms: float = 1e-5,
    images: bool = False,
) -> Harbor:
    r"""A vehicle goes around in a harbor; its speeds drift, its compass errs, and its sonar detects walls and piles.

    .. math:: \hat{p}_{k+1} = \hat{p}_k + R(\hat{\psi}_k) z_k, \quad
              z_k = \Delta_k + |z_k| d_{s(k)} + v_k, \quad
              \hat{\psi}_k = \psi_k + e_k, \quad d_s = m + w_s

    The drifts are those of `nls.sonar.scans.Drift`, for every meter of the reckoned way, 0.8 at most; a stretch is 10 m
    of the true way. The error e of the compass comes and goes,
    :math:`e_{k+1} = \rho e_k + w`, with the sigma of a heading and the sigma of a turn of a step; at the start it is 0.
    An echo is detected with the probability of its signal, false alarms are everywhere, see `sim.harbor_scans`.

    Parameters
    ----------
    rng : source of the harbor, the way and the noise.
    geometry : marina, with pontoons and boats; quay, one straight wall; rocks, on an open floor.
    keyframes : 1 m apart.
    laps : of the same way, which is keyframes / laps long and 40 m at least.
    drift : factor on the errors of dead reckoning; 0 gives the true way.
    signal : power of an echo over that of the noise, at right angles, 0 to 200 dB.
    false_alarms : share of the cells of an image, 0 to 1.
    images : whether the points are detected in an image of each keyframe, in 60 ms each, or drawn from their rates.

    Returns
    -------
    Harbor

    Raises
    ------
    OptionError
        A number or word that is not possible.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.harbor(np.random.default_rng(0), keyframes=80)
    >>> world.truth.shape, len(world.scans)
    ((80, 3), 80)
    """
    check_rng(rng)
    if geometry not in GEOMETRIES:
        raise OptionError("geometry", geometry, "one of " + ", ".join(GEOMETRIES))
    check_size("keyframes", keyframes, LOOP)
    check_size("laps", laps, 1)
    check_poses("keyframes", keyframes)
    if keyframes < LOOP * laps:
        raise OptionError("laps", laps, f"at most {keyframes // LOOP}, of {LOOP} keyframes each")
    check_not_negative(drift=drift, signal=signal)
    if signal > LOUDEST:
        raise OptionError("signal", signal, f"at most {LOUDEST:g} dB")
    check_between("false_alarms", false_alarms, 0, 1, "a rate between 0 and 1")
    if not isinstance(images, bool):
        raise OptionError("images", images, "True or False")
    loop = keyframes / laps
    scene = GEOMETRIES[geometry](rng, loop, SONAR.window[1])
    truth = way(rng, keyframes, loop)
    poses = reckoned(rng, truth, Drift(), drift)
    scans = (imaged if images else drawn)(rng, scene, truth, SONAR, signal, false_alarms)
    description = (
        f"Harbor, {geometry}: {laps} laps of {loop:.4g} m, {keyframes} keyframes 1 m apart, {len(scans.points)} points "
        f"of a {SONAR.name} up to {SONAR.window[1]:g} m, "
        f"{'detected in images' if images else 'drawn from their rates'}: "
        f"signal {signal:g} dB at right angles, false alarms {false_alarms:g} of the cells. Dead reckoning drifts by "
        f"{Drift().mean:g} of the way over the mission and {Drift().stretch:g} over {Drift().length:g} m"
        f"{'' if drift == 1 else f', drawn {drift:g} times as large'}."
    )
    times = np.arange(keyframes) / SPEED
    return Harbor(geometry, scene, truth, poses, times, scans, SONAR, Drift(), seed_of(rng), description)


def reckoned(rng: np.random.Generator, truth: Array, drift: Drift, scale: float) -> Array:
    """Poses (n, 3) of dead reckoning from the first true one."""
    n = len(truth)
    step = SE2.between(truth[:-1], truth[1:])
    length = np.linalg.norm(step[:, :2], axis=1)
    stretch = np.floor((np.cumsum(length) - length) / drift.length).astype(np.intp)
    m, w = drift.mean * rng.standard_normal(2), drift.stretch * rng.standard_normal((stretch[-1] + 1, 2))
    d = scale * (m + w[stretch])
    d *= np.minimum(1.0, MOST / np.maximum(np.linalg.norm(d, axis=1), MOST))[:, None]
    v = scale * drift.step * np.sqrt(length)[:, None] * rng.standard_normal((n - 1, 2))
    z = step[:, :2]
    for _ in range(FIXED_POINT):  # the drift is that of a meter of the reckoned way
        z = step[:, :2] + np.linalg.norm(z, axis=1)[:, None] * d + v
    yaw = truth[:, 2] + scale * _compass(rng, n, drift)
    c, s = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    moves = np.column_stack([c * z[:, 0] - s * z[:, 1], s * z[:, 0] + c * z[:, 1]])
    p = np.cumsum(np.concatenate([truth[:1, :2], moves]), axis=0)
    return np.column_stack([p, wrap(yaw)])


def _compass(rng: np.random.Generator, n: int, drift: Drift) -> Array:
    """Errors (n,) of headings: stationary but for their start at 0, var(e_{k+1} - e_k) = yaw^2."""
    from scipy.signal import lfilter

    assert drift.heading is not None
    rho = 1 - 0.5 * (drift.yaw / drift.heading) ** 2
    w = drift.heading * np.sqrt(1 - rho**2) * rng.standard_normal(n)
    w[0] = 0.0
    return np.asarray(lfilter([1.0], [1.0, -rho], w))
