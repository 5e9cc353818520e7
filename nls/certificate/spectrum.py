r"""The proof at a point: the smallest eigenvalues of its certificate matrix, and how far the optimum may be below it.

At a stationary point M of the certifiable cost let Lambda = blkdiag(Lambda_i) be the multipliers of Y_i'Y_i = I and
S = Q - Lambda. For every other N = [Z q] with Z_i'Z_i = I, of any number of rows, and any mu >= 0,

    tr N Q N' = tr N (S + mu D) N' - mu n d + tr Lambda      D: 1 for columns of Y, 0 for those of p

Where S + mu D has no negative eigenvalue the first term is none either, so that

    optimum >= tr Lambda - mu n d

whatever the start, and whether or not M is exactly stationary. S has r eigenvalues 0, of the rows of M, so mu has to be
above 0 for a Cholesky factorization to tell. mu is so small that mu n d is half a millionth of the cost, or half of 1
where that is less; or 100 eps times the largest entry of Q, where that is more. Then the gap may be as wide as this mu
makes it, up to a hundredth of the cost. It is never wider than 1: one measurement that contradicts the others raises
the cost without bound, and a millionth of it would hide another minimum. So would rounding, where one edge is a million
times as precise as all others.

Source: D. Rosen, L. Carlone, A. Bandeira, J. Leonard, "SE-Sync: a certifiably correct algorithm for synchronization
over the special Euclidean group", IJRR 38(2-3), 2019, section 4.

**Staircase**, out of a local minimum: rows are added to the poses until the minimum is the global one, then it is
rounded. A negative eigenvalue of the certificate matrix does not prove a better pose graph, but one with a row more.
Its eigenvector v, as a new row below each M, is a descent direction. From there Newton's method goes on. Where the new
minimum is certified, it is that of all pose graphs of any number of rows; if it needs no more than d of them, which is
so for all but very bad measurements, they are the global optimum. torus3D, stuck at 45112 from the start in its file,
passes 34802 with one row more and reaches 24227 with two, in 40 s.

Source: N. Boumal, V. Voroninski, A. Bandeira, "The non-convex Burer-Monteiro approach works on smooth semidefinite
programs", NeurIPS 2016; D. Rosen et al., "SE-Sync", IJRR 38(2-3), 2019, algorithms 1 and 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.algebra import Array, Mask
from models.errors import EvaluationError
from nls.certificate.newton import Optimum, nearest, newton, rotations
from nls.certificate.problem import Problem
from nls.linear.factorization import Factorization, SingularSystemError

BOUND = 1.0  # of chi2 and of the cost, a sigma: a wider gap is one, however high the cost


@dataclass(frozen=True)
class Spectrum:
    """The certificate at a point.

    Attributes
    ----------
    eigenvalues : (d + 1,) the smallest ones of S, positions eliminated.
    v : (n, d + 1) the eigenvector of the first.
    lowest : no pose graph costs less.
    certified : the cost of the point is that, but for a millionth, or for rounding of at most a hundredth; or 1.
    """

    eigenvalues: Array
    v: Array
    lowest: float
    certified: bool


def negligible(cost: float) -> float:
    """The widest gap below a cost that is none."""
    return min(1e-6 * cost, BOUND)


def spectrum(problem: Problem, optimum: Optimum) -> Spectrum:
    """The smallest eigenvalues at an optimum, by Lanczos on the inverse of S + mu D, and what they prove.

    Raises
    ------
    EvaluationError
        Weights of positions that differ by more than the digits of numbers hold.
    """
    n, d = problem.n, problem.d
    multipliers = problem.multipliers(optimum.M, problem.product(optimum.M))
    S = problem.on_diagonal - multipliers
    S[problem.held, d, d] += problem.W[:, d].max()  # S is 0 for a shift of all positions: that alone changes by this
    D = np.diag([1.0] * d + [0.0])
    size = float(problem.on_diagonal.max())
    # 100 eps of the largest entry of Q: the smallest shift that rounding does not hide
    smallest = mu = max(negligible(optimum.cost) / (2 * n * d), 100 * np.finfo(float).eps * size)
    while True:
        try:
            state = problem.factorized(S + mu * D, problem.off)
            break
        except SingularSystemError as error:
            if mu > 1e20 * size:  # nothing of S is left but the positions
                raise EvaluationError(
                    "certify: the weights of positions differ by more than the digits of numbers hold, so that "
                    "rounding leaves some of them free; check sigmas and units"
                ) from error
            mu *= 10.0
    lowest = max(float(np.trace(multipliers, axis1=1, axis2=2).sum()) - n * d * mu, 0.0)
    gap = optimum.cost - lowest
    # a gap wider than 1e-2 of the cost is one, even where rounding could be its cause
    certified = gap <= min(2 * n * d * smallest, max(1e-2 * optimum.cost, problem.rounding(optimum.M)), BOUND)
    theta, v = _largest_of_inverse(state, np.tile(np.arange(d + 1) < d, n), d + 1)
    return Spectrum(1 / theta - mu, v.reshape(n, d + 1), lowest, certified)


def _largest_of_inverse(state: Factorization, turns: Mask, count: int) -> tuple[Array, Array]:
    """Eigenvalues theta of the rotation part of the inverse, falling, and the first one's vector, with positions."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    inside = np.flatnonzero(turns)

    def whole(v: Array) -> Array:
        g = np.zeros(len(turns))
        g[inside] = v.ravel()
        return state.solve(g)

    inverse = LinearOperator((len(inside), len(inside)), matvec=lambda v: whole(v)[inside], dtype=float)
    start = np.random.default_rng(0).normal(size=len(inside))
    theta, vectors = eigsh(inverse, k=count, which="LA", v0=start, tol=1e-6)
    return theta[::-1], whole(vectors[:, -1]) / theta[-1]


def staircase(problem: Problem, optimum: Optimum, known: Spectrum) -> tuple[Optimum | None, float]:
    """The lowest minimum next to an optimum with more rows, None without one; what no pose graph is below.

    All optima on the way are rounded. Where the last one needs all its rows, an earlier one can be nearer to poses.
    """
    lifted, poses, lowest = optimum, None, known.lowest
    for _ in range(4):  # rows are added at most
        if (M := _raised(problem, lifted, known.v)) is None:
            break
        lifted = newton(problem, M)
        known = spectrum(problem, lifted)
        lowest = max(lowest, known.lowest)
        rounded = newton(problem, placed(_rounded(lifted.M), optimum.M, problem.held))
        poses = rounded if poses is None or rounded.cost < poses.cost else poses
        if known.certified:
            break
    return poses, lowest


def placed(M: Array, like: Array, held: int) -> Array:
    """M (n, d + 1, d), moved as a whole so that one pose is where it is in another."""
    R = M[held, :-1].mT @ like[held, :-1]
    M = M @ R
    M[:, -1] += like[held, -1] - M[held, -1]
    return M


def _raised(problem: Problem, optimum: Optimum, v: Array) -> Array | None:
    """M with one row more, of lower cost; None where no length of it lowers the cost."""
    length, v = 1.0, v / np.abs(v[:, :-1]).max()
    while length > 1e-5:  # a shorter row changes the cost by rounding alone
        M = nearest(np.dstack([optimum.M, length * v]))
        if problem.cost(M) < optimum.cost:
            return M
        length /= 2
    return None


def _rounded(M: Array) -> Array:
    """Rotations and positions (n, d + 1, d) from the d directions that the rotations use most."""
    Y_t = M[:, :-1]
    d = Y_t.shape[1]
    M = M @ np.linalg.eigh(np.einsum("nar,nas->rs", Y_t, Y_t))[1][:, -d:]
    if np.linalg.det(M[:, :-1]).sum() < 0:  # all of them are mirrored
        M[..., 0] *= -1
    return rotations(M)
