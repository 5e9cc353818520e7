"""Poses composed one after the other, all at once: by a doubling scan; in SE3 of the rotations, then a cumulative sum.

    R_k+1 = R_k dR_k,    p_k+1 = p_k + R_k dp_k

The scan multiplies every rotation by the one 1, 2, 4, ... places before it. So after log2(n) products of the whole
stack each is the product of all up to it. Source: W. Hillis, G. Steele, "Data parallel algorithms", CACM 29(12), 1986.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, apply
from models.manifolds.base import LieGroup
from models.manifolds.se3 import join, split
from models.manifolds.so3 import SO3, quaternion_product, rotation3

__all__ = ["chain", "chained"]


def chain(group: LieGroup, first: npt.ArrayLike, steps: npt.ArrayLike) -> Array:
    """Poses along a path: first, first o z_0, first o z_0 o z_1, ...

    A parallel prefix product of plain arrays: after the k-th of log2(n) passes every element is the product of the 2^k
    before it. So a chain of 5,000 poses takes 13 batched compositions. For graphs with gaps and several components
    there is `nls.starts.chain`.

    Parameters
    ----------
    group : the group of the poses.
    first : (size,) the pose the chain begins at.
    steps : (n, size) each pose as seen from the one before.

    Returns
    -------
    (n + 1, size) array.

    Examples
    --------
    >>> import numpy as np
    >>> from models import SE2
    >>> chain(SE2, [0.0, 0.0, 0.0], np.tile([1.0, 0.0, np.pi / 2], (4, 1))).round(6) + 0.0
    array([[ 0.      ,  0.      ,  0.      ],
           [ 1.      ,  0.      ,  1.570796],
           [ 1.      ,  1.      , -3.141593],
           [ 0.      ,  1.      , -1.570796],
           [ 0.      ,  0.      ,  0.      ]])
    """
    X = np.concatenate([np.asarray(first, dtype=float)[None], np.asarray(steps, dtype=float)])
    reach = 1
    while reach < len(X):
        X = np.concatenate([X[:reach], group.compose(X[:-reach], X[reach:])])
        reach *= 2
    return X


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
