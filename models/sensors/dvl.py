r"""Doppler velocity logs: their own velocity over the bottom, in their own axes, off the vehicle's center.

The DVL sits at a on the vehicle, turned by R_bd (DVL axes to body axes): its mounting is the pose O = (a, R_bd). With
the body's velocity v and rate w, both in body axes,

    v_d = R_bd' (v + w x a)
    dv_d/dv = R_bd',    dv_d/dw = -R_bd' [a]x,    dv_d/d(rho, phi) = [ [R_bd' w]x, [v_d]x ],   O <- O Exp(rho, phi)

The derivatives follow from R Exp(phi) = R + R [phi]x + ... Source: P. Groves, Principles of GNSS, Inertial, and
Multisensor Integrated Navigation Systems, 2013, chapter 6, for Doppler sonar and the lever arm of a velocity sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.algebra import Array, apply, product, skew
from models.errors import OptionError
from models.manifolds.se3 import SE3, split
from models.manifolds.so3 import rotation3
from models.options import check_between, is_number

__all__ = ["DVL", "HOLOOCEAN_DVL", "dvl_velocity"]


def dvl_velocity(v: Array, w: Array, mount: Array) -> tuple[Array, tuple[Array, Array, Array]]:
    """v_d = R_bd' (v + w x a), the velocity a DVL measures.

    Parameters
    ----------
    v : (n, 3) velocity of the body's origin over the bottom, in body axes, m/s.
    w : (n, 3) rate of the body, in body axes, rad/s.
    mount : (n, 7) or (1, 7) pose of the DVL on the vehicle, SE3.

    Returns
    -------
    v_d : (n, 3) array, in DVL axes, m/s.
    H_v, H_w, H_mount : derivatives (n, 3, 3), (n, 3, 3) and (n, 3, 6); the last by a right increment of the mounting.

    Examples
    --------
    A DVL one meter behind the center of a vehicle that turns to starboard is swung to port.

    >>> import numpy as np
    >>> ahead, turn = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.2]])
    >>> v_d, _ = dvl_velocity(ahead, turn, np.array([[-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]))
    >>> v_d
    array([[ 1. , -0.2,  0. ]])
    """
    a, q = split(mount)
    R_inv = rotation3(q).mT  # R_bd'
    v_d = apply(R_inv, v + np.cross(w, a))
    H_mount = np.concatenate([skew(apply(R_inv, w)), skew(v_d)], axis=-1)
    shape = (len(v_d), 3, 3)
    return v_d, (np.broadcast_to(R_inv, shape), np.broadcast_to(-product(R_inv, skew(a)), shape), H_mount)


@dataclass(frozen=True)
class DVL:
    """A DVL as dead reckoning and simulation need it; another one is one line, or `dataclasses.replace` of this one.

    Attributes
    ----------
    name : how it prints.
    sigma : standard deviation of one velocity along each of its axes, m/s.
    scale : standard deviation of its scale factor (sound speed, beam angles), a fraction of the speed; one number for
        the whole dive. The long-term accuracy of data sheets.
    mount : (7,) pose of the DVL on the vehicle, SE3 as x y z qx qy qz qw; at the center and aligned when omitted.

    Raises
    ------
    OptionError
        A sigma that is not positive, a negative scale, a mounting that is no pose.

    Examples
    --------
    >>> import dataclasses
    >>> dataclasses.replace(HOLOOCEAN_DVL, mount=(-0.2, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0)).sigma
    0.02626
    """

    name: str
    sigma: float
    scale: float = 0.0
    mount: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        check_between("sigma", self.sigma, 0, np.inf, "a standard deviation above 0, m/s")
        if not (is_number(self.scale) and 0 <= self.scale < np.inf):
            raise OptionError("scale", self.scale, "a fraction of the speed, 0 or above: 0.002 for 0.2 %")
        mount = np.asarray(self.mount, dtype=float)
        if mount.shape != (7,) or SE3.invalid(mount[None]) is not None:
            raise OptionError("mount", self.mount, "a pose x y z qx qy qz qw with a quaternion of length 1")
        object.__setattr__(self, "mount", tuple(mount.tolist()))


# VelSigma of the example configuration, HoloOcean documentation 2.0.1, page "Doppler Velocity Log (DVL)". No product is
# here: makers publish a long-term accuracy (Water Linked for its DVL A50: 0.1 cm/s), not the noise of one velocity.
HOLOOCEAN_DVL = DVL("HoloOcean DVL", sigma=0.02626)
