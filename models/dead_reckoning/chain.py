"""Poses composed one after the other, all at once: a doubling scan of the rotations, then one cumulative sum.

    R_k+1 = R_k dR_k,    p_k+1 = p_k + R_k dp_k

The scan multiplies every rotation by the one 1, 2, 4, ... places before it, so that after log2(n) products of the whole
stack each is the product of all up to it. Source: W. Hillis, G. Steele, "Data parallel algorithms", CACM 29(12), 1986.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, apply
from models.manifolds.se3 import join, split
from models.manifolds.so3 import SO3, quaternion_product, rotation3

__all__ = ["chained"]


def chained(steps: Array) -> Array:
    """T_0 = identity, T_k+1 = T_k o step_k.

    Parameters
    ----------
    steps : (n, 7) relative poses, SE3.

    Returns
    -------
    T : (n + 1, 7) array.

    Examples
    --------
    >>> import numpy as np
    >>> from models import SE3
    >>> quarter = SE3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2])) + np.array([1.0, 0, 0, 0, 0, 0, 0])
    >>> chained(np.tile(quarter, (4, 1)))[:, :3].round(6) + 0.0
    array([[0., 0., 0.],
           [1., 0., 0.],
           [1., 1., 0.],
           [0., 1., 0.],
           [0., 0., 0.]])
    """
    dp, dq = split(steps)
    q = np.array(dq)
    back = 1
    while back < len(q):
        q[back:] = quaternion_product(q[:-back], q[back:])
        back *= 2
    q = np.concatenate([SO3.identity(), q])
    p = np.zeros((len(q), 3))
    p[1:] = np.cumsum(apply(rotation3(q[:-1]), dp), axis=0)
    return join(p, q)
