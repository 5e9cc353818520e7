r"""In which coordinates a covariance is given: Sigma_shown = J Sigma J'.

Sigma is that of the tangent step (rho, phi). What is asked for decides J:

    frame "body"       I, the tangent space: X <- X Exp(delta), axes of the body
    frame "world"      G = blkdiag(R, R), in the plane blkdiag(R, 1): the same errors along the axes of the world
    view "position"    the rows of G for the position: x, y (, z) in the world
    view "euler"       d(roll, pitch, yaw, x, y, z) / d delta: angles about the axes of the Euler angles; world position

The matrices are the manifold's own: `Manifold.world_axes` and `Manifold.euler_axes`.

`Joint` puts names on the rows of one covariance of several variables; `outlines` draws those of positions as ellipses.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from factors.keys import Keys
from models.algebra import Array, congruence
from models.errors import GraphError, OptionError, SingularGeometryError
from models.manifolds.base import LieGroup, Manifold

EULER = ("roll", "pitch", "yaw", "x", "y", "z")


def axes(
    keys: Keys, manifold: Manifold, X: Array, frame: str | None, view: str | None
) -> tuple[Array | None, tuple[str, ...]]:
    """J (n, k, d) for the variables at X (n, size), None for the identity, and the names of the k components.

    Raises
    ------
    OptionError
        No such frame or view, or a frame is needed and none was given.
    SingularGeometryError
        Euler angles at gimbal lock.
    """
    if not (frame is None or (isinstance(frame, str) and frame in ("body", "world"))):
        raise OptionError("frame", frame, "'body' or 'world'")
    if not (view is None or (isinstance(view, str) and view in ("position", "euler"))):
        raise OptionError("view", view, "'position', 'euler' or none")
    if view is not None and frame == "body":
        raise OptionError("frame", frame, f"'world' or none: the view {view!r} has the axes of the world")
    if view == "euler":
        return _euler(keys, manifold, X), EULER
    if view == "position":
        k = manifold.position(X).shape[-1]
        if k == 0:
            raise OptionError("view", view, f"none: kind {keys.kind!r}, in {manifold}, has no position")
        return manifold.world_axes(X)[:, :k], manifold.components[:k]
    if frame is None and manifold.body_axes:
        which = f"say along which axes the covariance of {keys.kind} in {manifold} is"
        raise OptionError("frame", None, f'frame="body" or frame="world": {which}')
    J = manifold.world_axes(X) if frame == "world" and manifold.body_axes else None
    return J, manifold.components


def turned(J: Array | None, Sigma: Array) -> Array:
    """J Sigma J', exactly symmetric, for stacks (n, d, d)."""
    return Sigma if J is None else congruence(J, Sigma)


def of_motions(group: LieGroup, G: Array, C_ii: Array, C_ij: Array, C_jj: Array) -> Array:
    r"""Covariance (n, d, d) of motions G = X_i^-1 X_j (n, size) in the axes of j, from those of both poses.

    .. math:: \delta = \delta_j - Ad(G)^{-1} \delta_i
    """
    Ad = group.adjoint_inverse(G)
    cross = Ad @ C_ij
    return turned(Ad, C_ii) + C_jj - cross - cross.mT


def _euler(keys: Keys, manifold: Manifold, X: Array) -> Array:
    try:
        return manifold.euler_axes(X)
    except SingularGeometryError:
        for k in range(len(X)):  # which one: only when there is one
            try:
                manifold.euler_axes(X[k : k + 1])
            except SingularGeometryError as error:
                raise SingularGeometryError(
                    f"{keys[[k]]!r} is at gimbal lock (pitch = +-90 deg), where roll and yaw are not two numbers; ask "
                    "for frame 'body' or 'world' instead",
                    keys=[keys[[k]]],
                ) from error
        raise


@dataclass(frozen=True)
class Joint:
    """Joint covariance of several variables.

    Parameters
    ----------
    matrix : (k, k), symmetric.
    names : of its rows and columns, ``"x3: yaw"``.
    keys : the variables, in order.
    parts : the rows of each variable.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls import Marginals, kinds
    >>> (x,) = kinds("x")
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
    >>> joint = Marginals(world.graph, world.truth).joint(x[[3, 23]], frame="world")
    >>> joint.matrix.shape, joint.names[2], joint.block(x[3], x[23]).shape
    ((6, 6), 'x3: yaw', (3, 3))
    """

    matrix: Array
    names: tuple[str, ...]
    keys: tuple[Keys, ...]
    parts: Sequence[slice]

    def block(self, row: Keys, column: Keys) -> Array:
        """Covariance between two of the variables, a copy.

        Raises
        ------
        GraphError
            One of them is not in the set.
        """
        for key in (row, column):
            if key not in self.keys:
                raise GraphError(f"{key!r} is not in this joint covariance of {len(self.keys)} variables", [key])
        i, j = (self.parts[self.keys.index(key)] for key in (row, column))
        return self.matrix[i, j].copy()


def outlines(Sigma: Array, probability: float = 0.95) -> Array:
    """Outlines (n, 48, 2) around the origin of covariances (n, 2, 2), closed, in the unit of their roots.

    {r U sqrt(s) (cos a, sin a)'},   Sigma = U diag(s) U',   r^2 = -2 ln(1 - p)

    r^2 is the quantile p of a chi-square variable with two degrees of freedom, in closed form: 5.99 for 95 %.

    Examples
    --------
    >>> largest = outlines(np.array([[[4.0, 0.0], [0.0, 1.0]]]), 0.5).max(axis=1)
    >>> (largest / np.sqrt(2 * np.log(2))).round(2)
    array([[2., 1.]])
    """
    a = np.linspace(0, 2 * np.pi, 48)  # the last corner is the first
    a[-1] = 0.0
    U, s, _ = np.linalg.svd(Sigma)  # of a covariance: its eigenvectors and eigenvalues
    axes = np.sqrt(-2 * np.log1p(-probability)) * U * np.sqrt(s)[:, None, :]
    return np.asarray((axes @ np.stack([np.cos(a), np.sin(a)])).mT)
