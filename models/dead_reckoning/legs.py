r"""From the log of a DVL and of a gyro, or of an attitude sensor, to relative poses with covariances.

Everything happens in the frame of the DVL, whose pose on the vehicle is O = (a, R_bd). Over one step of time dt

    T_k+1 = T_k Exp(xi_k),    xi_k = ((v_k + v_k+1)/2 dt,  turn_k)
    turn_k = R_bd' (w_k + w_k+1)/2 dt          of a gyro
    turn_k = Log(q_k^-1 q_k+1)                 of attitudes q of the DVL

which is exact while velocity and rate are constant in the axes of the vehicle, and of second order in dt otherwise. A
leg is the motion from one boundary to the next; the body's follows without a rate, because the arm turns with the body:

    z_d = T_i^-1 T_j,    z = O z_d O^-1

Covariances: `models.dead_reckoning.noise`; drop-outs: `models.dead_reckoning.drop_outs`. Source: P. Groves, Principles
of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2013, chapter 6; C. Forster et al., "On-manifold
preintegration for real-time visual-inertial odometry", IEEE T-RO 33(1), 2017, for factors made of many samples.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Index, Mask, apply, product
from models.dead_reckoning.chain import chained
from models.dead_reckoning.checks import (
    attitudes,
    bottom_lock,
    bridge,
    fraction,
    mounting,
    not_negative,
    positive,
    rising,
    turning,
    unused,
    vectors,
    within,
)
from models.dead_reckoning.drop_outs import bridged_variance, inside, losses
from models.dead_reckoning.noise import at_nodes, from_samples, sum_by_leg
from models.dead_reckoning.samples import mixture
from models.errors import GraphError
from models.manifolds.se3 import SE3
from models.manifolds.so3 import SO3

__all__ = ["Legs", "integrate"]


@dataclass(frozen=True)
class Legs:
    """Relative poses of the vehicle from each boundary to the next; ``print`` gives the sentence.

    Attributes
    ----------
    t : (k + 1,) boundaries, s.
    z : (k, 7) pose at boundary i + 1 as seen from that at i, SE3.
    Sigma : (k, 6, 6) covariance of (x, y, z, roll, pitch, yaw), the right increment of z, m and rad.
    bridged : (k,) time without a measured velocity, s.
    unturned : (k,) time without a measured attitude or rate, s.
    """

    t: Array
    z: Array = field(repr=False)
    Sigma: Array = field(repr=False)
    bridged: Array = field(repr=False)
    unturned: Array = field(repr=False)

    def __len__(self) -> int:
        return len(self.z)

    def __str__(self) -> str:
        summary = (
            f"{len(self)} legs over {self.t[-1] - self.t[0]:.6g} s; the velocity is bridged for "
            f"{self.bridged.sum():.3g} s, in {np.count_nonzero(self.bridged)} of them"
        )
        if self.unturned.any():
            summary += f"; the attitude for {self.unturned.sum():.3g} s, in {np.count_nonzero(self.unturned)}"
        return summary

    def track(self, start: npt.ArrayLike) -> Array:
        """Poses (k + 1, 7) at the boundaries, dead-reckoned from the pose start (7,)."""
        return SE3.compose(SE3.stack(start), chained(self.z))


def integrate(
    t: npt.ArrayLike,
    v: npt.ArrayLike,
    w: npt.ArrayLike | None = None,
    *,
    boundaries: npt.ArrayLike,
    sigma_v: npt.ArrayLike,
    attitude: npt.ArrayLike | None = None,
    sigma_w: npt.ArrayLike | None = None,
    sigma_attitude: npt.ArrayLike | None = None,
    t_w: npt.ArrayLike | None = None,
    valid: npt.ArrayLike | None = None,
    sigma_bridge: float | None = None,
    sigma_turn: npt.ArrayLike | None = None,
    longest: float | None = None,
    scale: float = 0.0,
    sigma_bias: npt.ArrayLike = 0.0,
    mount: npt.ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
) -> Legs:
    r"""Relative poses between boundaries, from DVL velocities and gyro rates or attitudes.

    Parameters
    ----------
    t : (n,) times of the velocities, s, rising.
    v : (n, 3) velocity of the DVL over the bottom, in its own axes, m/s; anything where it is not valid.
    w : (m, 3) rates of a gyro in body axes, rad/s, known biases already subtracted; or give attitude.
    boundaries : (k + 1,) times at which legs begin and end, s, rising, where there are samples before and after.
    sigma_v : standard deviation of one velocity, m/s: a number, (3,) along the axes of the DVL, or (n, 3). A noise
        density N, m/s/sqrt(Hz), has the standard deviation N / sqrt(step of time).
    attitude : (m, 4) unit quaternions x y z w or (m, 3) roll, pitch, yaw, body to world, rad.
    sigma_w : noise density of the gyro, rad/s/sqrt(Hz), a number or (3,) along the axes of the body.
    sigma_attitude : standard deviation of one attitude, rad, a number or (3,) about the axes of the body.
    t_w : (m,) times of w or attitude, s, rising; t when omitted.
    valid : (n,) whether the DVL had bottom lock; always when omitted.
    sigma_bridge : how far the true velocity wanders from the straight line between the velocities before and after a
        drop-out, m/s/sqrt(s); needed where there is a drop-out.
    sigma_turn : how far the true attitude wanders from an even turn where attitudes or rates are further apart than
        longest, rad/sqrt(s). A number, (3,) about the axes of the body, or (m, 3) after each sample; needed there.
    longest : valid velocities, attitudes or rates further apart than this are a drop-out too, s; twice the median step
        of their times when omitted.
    scale : standard deviation of the scale factor of the velocity, a fraction: one error for the whole of a leg.
    sigma_bias : that of an error which stays the same over a leg, a number or (3,) along the axes of the body. Of the
        rates, rad/s, or of the attitudes, rad: such as the alignment of the attitude sensor and the DVL.
    mount : (7,) pose of the DVL on the vehicle, SE3.

    Returns
    -------
    Legs

    Raises
    ------
    GraphError
        Shapes that do not fit, times that do not rise, numbers that are not finite, boundaries without samples around.
    OptionError
        A sigma that is missing, not positive, or of the sensor that is not given.

    Notes
    -----
    Sample errors are independent of each other. Legs share the bridge of a drop-out, and the samples at its ends or at
    a boundary. These count in each leg so that the sum is right: exact in a straight line, on the safe side else. A leg
    alone is known better than its covariance says. Errors that last count once a leg. Scale and bias go on from leg to
    leg, but each `Between` of a graph takes them for its own. So the covariance of a long track comes out too small. A
    heading that is wrong by the same angle throughout turns all legs in the world and shows in none: measure it by
    `Heading`. Neighbors share the error of the attitude at their boundary with opposite signs. A chain of legs knows
    less than its attitudes, so add those to the graph as well.

    400,000 samples in legs of 1 s take 5 s and 0.8 GB.

    Examples
    --------
    Two meters ahead while turning by a quarter to starboard, with a gyro of 0.1 deg/sqrt(s):

    >>> import numpy as np
    >>> t = np.linspace(0.0, 4.0, 41)
    >>> v, w = np.tile([0.5, 0.0, 0.0], (41, 1)), np.tile([0.0, 0.0, np.pi / 8], (41, 1))
    >>> legs = integrate(t, v, w, boundaries=[0.0, 2.0, 4.0], sigma_v=0.01, sigma_w=np.radians(0.1))
    >>> print(legs)
    2 legs over 4 s; the velocity is bridged for 0 s, in 0 of them
    >>> legs.track([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])[:, :3].round(3) + 0.0
    array([[0.   , 0.   , 0.   ],
           [0.9  , 0.373, 0.   ],
           [1.273, 1.273, 0.   ]])

    In a graph, where x are the poses at the boundaries:

    >>> from factors import Between, Covariance
    >>> from nls import kinds
    >>> (x,) = kinds("x")
    >>> Between(x[:2], x[1:3], legs.z, Covariance(legs.Sigma))
    Between(x[0, 1], x[1, 2])

    The bottom is lost for a second; what the velocity did meanwhile is not known.

    >>> lost = (t > 1.4) & (t < 2.6)
    >>> sigmas = dict(sigma_v=0.01, sigma_w=np.radians(0.1), sigma_bridge=0.05)
    >>> blind = integrate(t, v, w, boundaries=[0.0, 2.0, 4.0], valid=~lost, **sigmas)
    >>> blind.bridged.round(3)
    array([0.6, 0.6])
    >>> [float(np.sqrt(found.Sigma[0, 0, 0])) for found in (legs, blind)]
    [0.0045, 0.0179]
    """
    t, tw = rising("t", t), rising("t_w", t if t_w is None else t_w)
    b, ok = rising("boundaries", boundaries), bottom_lock(valid, len(t))
    v, tv, e_v = vectors("v", v, len(t), ok)[ok], t[ok], positive("sigma_v", sigma_v, len(t))[ok]
    within(b, tv, "valid velocities")
    within(b, tw, "attitudes" if w is None else "rates")
    O, scale, e_bias = mounting(mount), fraction(scale), not_negative("sigma_bias", sigma_bias)

    # values at the nodes of a grid of times, errors e of the samples
    lost, lost_w = losses(t, ok, longest), losses(tw, np.ones(len(tw), dtype=bool), longest)
    grid = np.unique(np.concatenate([b, *(s[(s > b[0]) & (s < b[-1])] for s in (tv, tw, inside(tw, lost_w)))]))
    dt = np.diff(grid)[:, None]
    mix_v, mix_w = mixture(grid, tv), mixture(grid, tw)
    v_k = mix_v.of(v)
    if attitude is None and w is not None:
        unused("sigma_attitude", sigma_attitude, "w")
        e_w = positive("sigma_w", sigma_w, len(tw)) / np.sqrt(np.gradient(tw))[:, None]
        turn, A, B = _turns_of_rates(mix_w.of(vectors("w", w, len(tw))), dt, O)
    elif attitude is not None and w is None:
        unused("sigma_w", sigma_w, "attitude")
        e_w = positive("sigma_attitude", sigma_attitude, len(tw))
        turn, A, B = _turns_of_attitudes(mix_w.of_rotations(attitudes(attitude, len(tw))), O)
    else:
        raise GraphError("integrate: give either w, the rates of a gyro, or attitude; both or neither came")

    # T_k+1 = T_k Exp(xi_k), cut at the boundaries
    way = 0.5 * (v_k[:-1] + v_k[1:]) * dt
    xi = np.concatenate([way, turn], axis=1)
    T = chained(SE3.exp(xi))
    cut, k = np.searchsorted(grid, b), len(b) - 1
    first, steps = cut[:-1], np.diff(cut)
    z_d = SE3.between(T[first], T[cut[1:]])

    # L_k = Ad_{T_k} J_l(xi_k), then the nodes of each leg, their samples and their times dt/2 on either side
    leg, leg_n = np.repeat(np.arange(k), steps), np.repeat(np.arange(k), steps + 1)
    node = np.arange(len(leg_n)) - leg_n
    L = SE3.adjoint(SE3.between(T[first[leg]], T[:-1])) @ SE3.jl(xi)
    L_v, L_w = L[..., :3], L[..., 3:]
    half = 0.5 * dt[:, 0]
    weight = at_nodes(half, half, leg)
    C = at_nodes(half[:, None, None] * L_v, half[:, None, None] * L_v, leg)
    Sigma = from_samples(C, leg_n, mix_v[node], e_v, k, weight)
    C = at_nodes(L_w @ A, L_w @ B, leg)
    Sigma += from_samples(C, leg_n, mix_w[node], e_w, k, weight if attitude is None else None)
    G = np.concatenate([scale * apply(L_v, way)[..., None], e_bias * (L_w @ (A + B))], axis=-1)  # by scale and bias
    G = sum_by_leg(G, leg, k)
    Sigma += G @ G.mT

    dark, at = _steps_lost(grid, tw, lost_w)
    if len(dark):
        walk = np.sqrt(dt[dark]) * turning(sigma_turn, len(tw), tw[at[0]], tw[at[0] + 1])[at]
        G = L_w[dark] @ SE3.rotation(O).mT * walk[:, None, :]
        Sigma += sum_by_leg(G @ G.mT, leg[dark], k)
    unturned = sum_by_leg(dt[dark, 0], leg[dark], k)

    # from the DVL to the body: z = O z_d O^-1
    M = SE3.adjoint(O) @ SE3.adjoint_inverse(z_d)
    Sigma = M @ Sigma @ M.mT
    blind, at = _steps_lost(grid, tv, lost)
    if len(blind):  # the same along all axes, so in those of the body, too
        begin, end, T = grid[blind] - tv[at], grid[blind + 1] - tv[at], tv[at + 1] - tv[at]
        variance = bridge(sigma_bridge, tv[at[0]], tv[at[0] + 1]) ** 2 * bridged_variance(begin, end, T)
        Sigma[:, :3, :3] += np.eye(3) * sum_by_leg(variance, leg[blind], k)[:, None, None]
    bridged = sum_by_leg(dt[blind, 0], leg[blind], k)
    z = SE3.compose(SE3.compose(O, z_d), SE3.inverse(O))
    return Legs(b, z, 0.5 * (Sigma + Sigma.mT), bridged, unturned)


def _steps_lost(grid: Array, t: Array, lost: Mask) -> tuple[Index, Index]:
    """Steps of the grid that lie in drop-outs after some of the samples at t, and these samples."""
    at = np.searchsorted(t, grid[:-1], side="right") - 1
    steps = np.flatnonzero(lost[at])
    return steps, at[steps]


def _turns_of_rates(w: Array, dt: Array, O: Array) -> tuple[Array, Array, Array]:
    """turn = R_bd' (w_k + w_k+1)/2 dt of the m - 1 steps between m rates, and its derivatives by the two rates."""
    R_inv = SE3.rotation(O).mT
    H = 0.5 * dt[..., None] * R_inv
    return apply(R_inv, 0.5 * (w[:-1] + w[1:]) * dt), H, H


def _turns_of_attitudes(q: Array, O: Array) -> tuple[Array, Array, Array]:
    """turn = Log(q_k^-1 q_k+1), q of the DVL, between m attitudes, and its derivatives by increments of the body's."""
    R_inv = SE3.rotation(O).mT
    q = SO3.compose(q, np.broadcast_to(O[:, 3:], q.shape))
    turn = SO3.log(SO3.between(q[:-1], q[1:]))
    return turn, -product(SO3.jl_inv(turn), R_inv), product(SO3.jl_inv(-turn), R_inv)
