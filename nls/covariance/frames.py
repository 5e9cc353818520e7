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
from typing import Any

import numpy as np

from factors.keys import Keys
from models.algebra import Array, Index, congruence
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
    return manifold.world_axes(X) if frame == "world" and manifold.body_axes else None, manifold.components


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


def batches_of(keys: Sequence[Keys | Sequence[Keys]]) -> list[Keys]:
    """The variables that a joint covariance is asked for, batches and lists of them one after the other.

    Raises
    ------
    GraphError
        No variable at all, one that is given twice, or what is no variable.
    """
    batches: list[Any] = [batch for given in keys for batch in (given if isinstance(given, list | tuple) else [given])]
    for batch in batches:
        if not isinstance(batch, Keys):
            cure = f"frame={batch!r}, by name" if isinstance(batch, str) else "x[0], x[[1, 2]] or a list of such"
            raise GraphError(f"joint covariance: {batch!r:.60} is no variable; expected {cure}")
    single = [key for batch in batches for key in batch]
    if not single:
        raise GraphError("joint covariance: no variable is given")
    if len(set(single)) < len(single):
        again = next(key for key in single if single.count(key) > 1)
        raise GraphError(f"joint covariance: {again!r} is given twice", [again])
    return batches


def joint_of(
    batches: Sequence[Keys],
    shown: Sequence[tuple[Array | None, tuple[str, ...]]],
    columns: Sequence[Index],
    Sigma: Array,
) -> Joint:
    """The joint covariance of batches of variables.

    Parameters
    ----------
    batches : the variables.
    shown : per batch J (n, k, d) and the names of the k components, see `axes`.
    columns : per batch (n, d); only the shape is used.
    Sigma : (N, N) of the tangent steps of all, in order.
    """
    for _ in range(2):  # J Sigma, then J (J Sigma)' = J Sigma J'
        ends = np.cumsum([c.size for c in columns])[:-1]
        rows = [
            block if J is None else (J @ block.reshape(*c.shape, -1)).reshape(-1, block.shape[1])
            for block, c, (J, _) in zip(np.split(Sigma, ends), columns, shown, strict=True)
        ]
        Sigma = np.concatenate(rows).T
    single = [(key, names) for batch, (_, names) in zip(batches, shown, strict=True) for key in batch]
    ends = np.cumsum([len(names) for _, names in single]).tolist()
    parts = list(map(slice, [0, *ends], ends))
    names = tuple(f"{key!r}: {name}" for key, names in single for name in names)
    return Joint((Sigma + Sigma.T) / 2, names, tuple(key for key, _ in single), parts)


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
