r"""Directions that the measurements leave free, and every measurement against all others with these held.

The directions and the anchors that hold them come from `nls.linear.null_space`. Those of a whole part of the graph are
motions of the world: translations, rotations, scale.

A motion of the world moves a point p by v + omega x p + s p and turns a frame by omega. Its effect on the unknowns of a
part of the graph is a column of G. The motions in the span of free directions N are the k with

    (I - Q Q') G k = 0,   N = Q R,   columns scaled as those of A
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse as sp

from factors.bundle import CAMERA
from models import SO3, Manifold
from models.algebra import Array, Index, apply
from nls.analysis.leave_one_out import Checked, Linearization
from nls.linear.factorization import SingularSystemError
from nls.linear.null_space import BLOCKS, FreeDirections, column_lengths
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values

AXES = ("x", "y", "z", "roll", "pitch", "yaw", "scale")
SAME_MOTION = 1e-4  # sine of the angle between a motion and the free directions
NEAR = 1e-3  # of the extent: a center this near to a variable is there


@dataclass(frozen=True)
class Freedom:
    """The free directions, and every measurement against all others with these held.

    Attributes
    ----------
    checked : None where weights or scales differ too much for A'A although nothing is free.
    anchors : (f,) columns that were held.
    singles : (n, q) directions of one variable each, in units of the unknowns.
    combinations : (n, r) directions that move several.
    norms : (n,) lengths of the columns of A; 1 where a column is zero.
    scale : (N,) lengths with nothing held; 0 where a column is zero.
    more : there may be further ones.
    """

    checked: Checked | None
    anchors: Index
    singles: sp.csc_array
    combinations: Array
    norms: Array
    scale: Array
    more: bool

    @property
    def count(self) -> int:
        """Free directions found."""
        return int(self.singles.shape[1] + self.combinations.shape[1])


def freedom(pattern: Pattern, values: Values) -> Freedom:
    """All free directions at the values.

    Parameters
    ----------
    pattern : the graph with the gauge held.
    values : where it is linearized.
    """
    linear = Linearization(pattern, values)
    everything = pattern.holding(np.zeros_like(pattern.held))
    scale = column_lengths(LinearSystem(everything, linear.system.blocks, linear.system.b))
    free = FreeDirections(pattern.restrict(scale))

    def outcome(checked: Checked | None, more: bool = False) -> Freedom:
        return Freedom(checked, free.anchors, free.singles, free.combinations, free.norms, scale, more)

    for _ in range(BLOCKS):
        if free.count:
            linear = Linearization(free.held(pattern, values), values)
        try:
            return outcome(Checked(linear))
        except SingularSystemError:
            pass
        if not free.collect(linear.system):
            return outcome(None)
    return outcome(None, more=True)


@dataclass(frozen=True)
class Motion:
    """A velocity v (3,), rate of rotation omega (3,) and rate of growth s of the world."""

    v: Array
    omega: Array
    s: float


def generators(manifold: Manifold, X: Array) -> Array:
    """Effect of the seven motions of the world on variables at X, (n, dim, 7); zeros where that is not known."""
    n, out = len(X), np.zeros((len(X), manifold.dim, len(AXES)))
    if manifold is CAMERA:  # P = R(w) X + t
        R, w, t = SO3.rotation(SO3.exp(X[:, :3])), X[:, :3], X[:, 3:]
        out[:, 3:, :3], out[:, 3:, 6] = -R, t
        out[:, :3, 3:6] = -SO3.jr_inv(w)
        return out
    p = np.zeros((n, 3))
    position = manifold.position(X)
    p[:, : position.shape[1]] = position
    world = np.zeros((n, 6, len(AXES)))
    world[:, :3, :3] = world[:, 3:, 3:6] = np.eye(3)
    x, y, z = p.T
    world[:, :3, 3:6] = np.stack([[0 * x, z, -y], [-z, 0 * x, x], [y, -x, 0 * x]]).transpose(2, 0, 1)
    world[:, :3, 6] = p
    if not all(name in AXES for name in manifold.components):
        return out
    named = world[:, [AXES.index(name) for name in manifold.components]]
    if "z" not in manifold.components:  # the plane
        named[:, :, [2, 3, 4]] = 0.0
    return np.asarray(manifold.world_axes(X).mT @ named)


def places(manifold: Manifold, X: Array) -> Array:
    """Where variables at X are, (n, 3), z = 0 in the plane; (0, 3) where they have no place."""
    if manifold is CAMERA:
        return -apply(SO3.rotation(SO3.exp(X[:, :3])).mT, X[:, 3:])
    p = manifold.position(X)
    return np.pad(p, ((0, 0), (0, 3 - p.shape[1]))) if p.shape[1] else np.zeros((0, 3))


def motions(N: Array, G: Array) -> tuple[list[Motion], Array]:
    """The motions of the world in the span of some free directions, and an orthonormal basis of the rest of these.

    Parameters
    ----------
    N : (n, r) free directions, the rows of all unknowns of a part, columns of A scaled to length 1.
    G : (n, 7) motions, scaled likewise.
    """
    Q = np.linalg.qr(N)[0]
    length = np.linalg.norm(G, axis=0)
    active = np.flatnonzero(length > 0)
    if not len(active):
        return [], Q
    scaled = G[:, active] / length[active]
    _, s, Vt = np.linalg.svd(scaled, full_matrices=False)
    V = Vt[s > NEAR * s[0]].T  # motions that differ in what they do
    outside = scaled @ V - Q @ (Q.T @ (scaled @ V))
    _, s, Wt = np.linalg.svd(np.linalg.qr(outside, mode="r"))
    size = np.linalg.norm(scaled @ V @ Wt.T, axis=0)
    K = np.linalg.qr(V @ Wt[np.pad(s, (0, len(Wt) - len(s))) <= SAME_MOTION * size].T)[0]
    B = np.linalg.qr(scaled @ K)[0]
    U, s, _ = np.linalg.svd(Q - B @ (B.T @ Q), full_matrices=False)  # what is left of Q
    pure = [k for k in range(len(active)) if K.shape[1] and np.linalg.norm(K.T[:, k]) > 1 - SAME_MOTION]
    decomposition = np.linalg.svd(K - np.eye(len(active))[:, pure] @ K[pure], full_matrices=False)
    coefficients = np.vstack([np.eye(len(active))[pure], decomposition[0].T[: K.shape[1] - len(pure)]])
    out = np.zeros((len(coefficients), len(AXES)))
    out[:, active] = coefficients / length[active]
    return [Motion(k[:3], k[3:6], float(k[6])) for k in out], U[:, s > 0.5]
