r"""Newton's method on matrices with orthonormal columns: to the optimum of the certifiable cost in a few steps.

Around M the poses are moved by M + E delta, with dp free and dY = Y Omega + Y_perp K, Omega skew, Y_perp the complement
of Y, and brought back by the nearest Y with orthonormal columns. To second order in delta

    f(delta) - f = 2 g' delta + delta' H delta,    g = E' Q M',    H = E' S E,    S = Q - Lambda

with Lambda as in `Problem.multipliers`. H has the blocks of the graph. Residuals of real measurements are not small,
and Gauss-Newton, with Q instead of S, takes 27 iterations on intel where Newton takes 3. Where H is not positive
definite a shift times E'DE, D = 1 for Y and 0 for p, is added to it, ten times more until it is, and until the cost
falls by at least a tenth of what the model says.

Source: P.-A. Absil, R. Mahony, R. Sepulchre, Optimization Algorithms on Matrix Manifolds, 2008, sections 4.1, 6.2, 7.4.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from models.algebra import Array, apply, pack
from nls.certificate.problem import Problem
from nls.linear.factorization import SingularSystemError

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
