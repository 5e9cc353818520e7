r"""In which coordinates a covariance is given: Sigma_shown = J Sigma J', Sigma that of the tangent step (rho, phi).

| asked for | J | components |
|---|---|---|
| frame "body" | I | of the tangent space: X <- X Exp(delta), axes of the body |
| frame "world" | G = blkdiag(R, R), in the plane blkdiag(R, 1) | the same errors along the axes of the world |
| view "position" | the rows of G for the position | x, y (, z) in the world |
| view "euler" | d(roll, pitch, yaw, x, y, z) / d delta | angles about the axes of the Euler angles; world position |

The matrices are the manifold's own: `Manifold.world_axes` and `Manifold.euler_axes`.
"""

from __future__ import annotations

from factors.keys import Keys
from models.algebra import Array, congruence
from models.errors import OptionError, SingularGeometryError
from models.manifolds.base import LieGroup, Manifold

__all__ = ["axes", "of_motions", "turned"]

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
        raise OptionError(
            "frame",
            None,
            f'frame="body" or frame="world": say along which axes the covariance of {keys.kind} in {manifold} is',
        )
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
