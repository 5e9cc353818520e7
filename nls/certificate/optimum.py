r"""The optimum of the certifiable cost: Newton's method leads there, the spectrum proves it, a staircase leads on.

**Newton's method** on matrices with orthonormal columns takes a few steps.

Around M the poses are moved by M + E delta, with dp free and dY = Y Omega + Y_perp K, Omega skew, Y_perp the complement
of Y, and brought back by the nearest Y with orthonormal columns. To second order in delta

    f(delta) - f = 2 g' delta + delta' H delta,    g = E' Q M',    H = E' S E,    S = Q - Lambda

with Lambda as in `Problem.multipliers`. H has the blocks of the graph. Residuals of real measurements are not small,
and Gauss-Newton, with Q instead of S, takes 27 iterations on intel where Newton takes 3. Where H is not positive
definite a shift times E'DE, D = 1 for Y and 0 for p, is added to it, ten times more until it is, and until the cost
falls by at least a tenth of what the model says.

Source: P.-A. Absil, R. Mahony, R. Sepulchre, Optimization Algorithms on Matrix Manifolds, 2008, sections 4.1, 6.2, 7.4.

**The proof** at a point: the smallest eigenvalues of its certificate matrix, and how far the optimum may be below it.

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

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from models.algebra import Array, Mask, apply, pack
from models.errors import EvaluationError
from nls.certificate.problem import Problem
from nls.linear.factorization import Factorization, SingularSystemError

DECREASE = 1e-13  # of the cost: a step that promises less is the last one
STEPS = 300
SHIFTED = 10.0  # times the shift, where a step fails; and by how much a good one lowers it


@dataclass(frozen=True)
class Optimum:
    """Where Newton's method ended: M (n, d + 1, r), its cost, whether nothing was left to gain, steps taken."""

    M: Array
    cost: float
    converged: bool
    steps: int


def tangent(M: Array) -> Array:
    """E (n, d + 1, r, D): columns are the changes of M' by p, by Omega, and by K."""
    n, r, d = len(M), M.shape[2], M.shape[1] - 1
    Y_t = M[:, :d]
    pairs = list(combinations(range(d), 2))
    E = np.zeros((n, d + 1, r, r + len(pairs) + (r - d) * d))
    E[:, d, :, :r] = np.eye(r)
    for k, (a, b) in enumerate(pairs, start=r):
        E[:, b, :, k], E[:, a, :, k] = Y_t[:, a], -Y_t[:, b]
    if r > d:
        complement = np.linalg.svd(Y_t)[2][:, d:]  # (n, r - d, r)
        for k, (a, b) in enumerate(np.ndindex(r - d, d), start=r + len(pairs)):
            E[:, b, :, k] = complement[:, a]
    return E


def nearest(M: Array) -> Array:
    """M with the nearest Y of orthonormal columns: U V' of Y = U S V'.

    Of two rows and columns that is (Y + C) / |Y + C|, with C the cofactors of Y by the sign of det Y, and |.| the
    length of a column. It takes 2 ms for 15,000 poses, as many singular value decompositions 25.
    """
    Y_t = M[:, :-1]
    if Y_t.shape[1:] == (2, 2):
        a, b, c, d = Y_t.reshape(-1, 4).T
        sign = np.where(a * d < b * c, -1.0, 1.0)
        x, y = a + sign * d, b - sign * c
        Y_t = (pack([x, y, -sign * y, sign * x]) / np.hypot(x, y)[:, None]).reshape(-1, 2, 2)
    else:
        U, _, Vt = np.linalg.svd(Y_t, full_matrices=False)
        Y_t = U @ Vt
    return np.concatenate([Y_t, M[:, -1:]], axis=1)


def rotations(M: Array) -> Array:
    """M (n, d + 1, d) with the nearest rotations."""
    U, _, Vt = np.linalg.svd(M[:, :-1])
    U[..., -1] *= np.linalg.det(U @ Vt)[:, None]
    return np.concatenate([U @ Vt, M[:, -1:]], axis=1)


def newton(problem: Problem, M: Array) -> Optimum:
    """A local minimum, from M (n, d + 1, r); the held pose stays."""
    cost, shift, smallest = problem.cost(M), 0.0, 1e-5 * float(problem.W[:, 0].max())  # shifts from there on
    E, g, H, off = _second_order(problem, M)
    D = _turns(M)
    for step in range(STEPS):
        try:
            state = problem.factorized(H + shift * np.diag(D), off)
        except SingularSystemError:
            shift = max(SHIFTED * shift, smallest)
            continue
        delta = -state.solve(g.reshape(-1)).reshape(g.shape)
        trial = nearest(M + apply(E, delta[:, None]))
        trial_cost = problem.cost(trial)
        promised = -float(np.sum(g * delta)) + shift * float(np.sum(D * np.square(delta)))
        # 1e-15 of the cost is rounding, and more than 1e-6 is always worth a step
        if promised <= max(min(DECREASE * cost, 1e-6), 1e-15 * cost) + problem.rounding(M):
            rounds = trial_cost <= (1 + DECREASE) * cost + problem.rounding(M)  # the gradient falls, the cost cannot
            return Optimum(trial, trial_cost, True, step) if rounds else Optimum(M, cost, True, step)
        ratio = (cost - trial_cost) / promised
        if ratio < 0.1:  # of the promised decrease
            shift = max(SHIFTED * shift, smallest)
            continue
        if ratio > 0.75:
            shift = shift / SHIFTED if shift > smallest else 0.0
        M, cost = trial, trial_cost
        E, g, H, off = _second_order(problem, M)
    return Optimum(M, cost, False, STEPS)


def _turns(M: Array) -> Array:
    """Diagonal of E'DE at every pose: 0 for p, 2 for Omega, 1 for K."""
    r, d = M.shape[2], M.shape[1] - 1
    return np.repeat([0.0, 2.0, 1.0], [r, d * (d - 1) // 2, (r - d) * d])


def _second_order(problem: Problem, M: Array) -> tuple[Array, Array, Array, Array]:
    """E, g (n, D), the diagonal blocks of H (n, D, D), and its blocks of the edges (m, D, D)."""
    E, QM = tangent(M), problem.product(M)
    E[problem.held] = 0.0
    rows, D = E.shape[1] * E.shape[2], E.shape[3]

    def projected(A: Array, S: Array, B: Array) -> Array:
        SB = S @ B.reshape(len(B), len(S[0]), -1)
        return np.asarray(A.reshape(-1, rows, D).mT @ SB.reshape(-1, rows, D))

    H = projected(E, problem.on_diagonal - problem.multipliers(M, QM), E)
    H[problem.held] = np.eye(D)
    g = np.einsum("nabk,nab->nk", E, QM)
    return E, g, H, projected(E[problem.graph.i], problem.off, E[problem.graph.j])


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
    """The smallest eigenvalues at an optimum, by Lanczos on the inverse of S + mu D, and the bound they prove.

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
    """The lowest minimum next to an optimum with more rows, None without one; and a lower bound for all pose graphs.

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
