r"""Where a motion leads, for one pose or for a stack of particles, by the factors of the graph themselves.

    X_j = argmin |b(X_i, X_j)|^2        by Newton steps dX_j = (A'A)^-1 A'b, A the whitened Jacobian for X_j

A relative factor whose Jacobian for the later pose has full rank is a motion model; several of one step add up.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from factors.base import Factor, Model
from factors.keys import Keys
from models import Manifold
from models.algebra import Array, apply, gram
from models.errors import GraphError, UnderconstrainedError

NEWTON_STEPS = 50  # a difference on a group takes one step and one that finds nothing to do


@dataclass(frozen=True)
class Copies:
    """A factor of n measurements once for each of N particles: batch axis N n, particle by particle."""

    factor: Factor
    model: Model
    n: int

    def stacked(self, *X: Array) -> tuple[Array, ...]:
        """One (N n, size) stack per slot, from (N, size), one for all measurements of a particle, or (N, n, size)."""
        return tuple(
            (np.repeat(x, self.n, axis=0) if self.n > 1 else x) if x.ndim == 2 else x.reshape(-1, x.shape[-1])
            for x in X
        )

    def linearize(self, *X: Array) -> tuple[tuple[Array, ...], Array]:
        """Whitened Jacobians A_k (N n, m, d_k) and innovations b (N n, m)."""
        return self.model.linearize(*self.stacked(*X))

    def chi2(self, *X: Array) -> Array:
        """|b|^2 (N,), summed over the measurements."""
        return np.asarray(np.square(self.model.error(*self.stacked(*X))).reshape(-1, self.n * self.model.dim).sum(1))


Factors = Sequence[tuple[Copies, int, tuple[Array, ...]]]  # with the slot of one variable, and stacks of the others


def copies(factor: Factor, manifolds: Sequence[Manifold], particles: int) -> Copies:
    """The factor for every particle: one call evaluates all of them."""
    many = factor[np.tile(np.arange(len(factor)), particles)]
    return Copies(many, many.bind(*manifolds), len(factor))


def slot_of(factor: Factor, key: Keys) -> int:
    """Which slot of a factor holds this one variable.

    Raises
    ------
    GraphError
        None does.
    """
    for slot, keys in enumerate(factor.keys):
        if keys.kind == key.kind and (keys.numbers == key.numbers).all():
            return slot
    raise GraphError(f"{factor!r} does not touch {key}", [key], factor.name)


def information(parts: Sequence[tuple[Array, Array]], particles: int) -> tuple[Array, Array]:
    """Sum of A'A (N, d, d) and of A'b (N, d) over parts A (N n, m, d), b (N n, m)."""
    Lambda = sum(gram(A).reshape(particles, -1, *A.shape[-1:] * 2).sum(axis=1) for A, _ in parts)
    g = sum(apply(A.mT, b).reshape(particles, -1, A.shape[-1]).sum(axis=1) for A, b in parts)
    return np.asarray(Lambda), np.asarray(g)


def jacobians(motion: Factors, X_i: Array, X_j: Array) -> tuple[Array, Array]:
    """Whitened A_i and A_j (rows, d) of all factors of one motion, for the pose before (1, size) and the one after.

    Parameters
    ----------
    motion : as for `most_likely`, slot that of the pose after.
    """
    blocks = [(copied.linearize(*((X_i, X_j) if slot else (X_j, X_i)))[0], slot) for copied, slot, _ in motion]
    return np.concatenate([A[1 - slot][0] for A, slot in blocks]), np.concatenate([A[slot][0] for A, slot in blocks])


def most_likely(factors: Factors, manifold: Manifold, X: Array, key: Keys) -> tuple[Array, Array]:
    """The value of one variable that its factors say, and their information there, particle by particle.

    Parameters
    ----------
    factors : with the slot of the variable, and the stacks (N, size) of the other slots, in order.
    manifold : of the variable.
    X : (N, size) where the Newton steps begin.
    key : the variable, for messages.

    Returns
    -------
    X : (N, size) array.
    Lambda : (N, d, d) information of the tangent space at X.

    Raises
    ------
    UnderconstrainedError
        The factors leave something of it free.
    GraphError
        There are none; the steps do not settle.
    """
    if not factors:
        raise GraphError(f"{key}: no measurement of its own; a filter must begin with a Prior of it", [key])
    for _ in range(NEWTON_STEPS):
        parts = []
        for copied, slot, states in factors:
            A, b = copied.linearize(*states[:slot], X, *states[slot:])
            parts.append((A[slot], b))
        Lambda, g = information(parts, len(X))
        d = np.sqrt(np.diagonal(Lambda, axis1=1, axis2=2))
        D = 1 / np.where(d > 0, d, 1.0)  # to a diagonal of ones: units do not decide
        scaled = D[:, :, None] * Lambda * D[:, None, :]
        if not np.linalg.det(scaled).min() > 1e-14:  # rounding of 0
            names = ", ".join(sorted({copied.factor.name for copied, _, _ in factors}))
            message = f"its measurements ({names}) leave a direction free; a filter must begin with a complete estimate"
            cure = f"Add a Prior of {key}; its sigmas may be large"
            raise UnderconstrainedError(f"{key}: {message}. {cure}", [key])
        dX = np.asarray(np.linalg.solve(Lambda, g[..., None])[..., 0], dtype=float)
        X = manifold.retract(X, dX)
        if np.abs(dX).max() < 1e-10:  # m, rad
            return X, Lambda
    message = f"no value of it fits its {factors[0][0].factor.name} after {NEWTON_STEPS} Newton steps"
    raise GraphError(f"{key}: {message}", [key])
