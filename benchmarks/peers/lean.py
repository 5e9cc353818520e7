"""The floor: pose graphs by NumPy and CHOLMOD alone, written for speed. No labels, general factors, kernels or result.

A g2o file has one kind of pose, and its edges last. Numbers have to be finite, information definite, and poses
connected. The first pose is held. Gauss-Newton starts from the chordal relaxation; see docs/theory.

A step (s, w) in the world moves a pose to t + s + w x t and Exp(w) R. A relative pose that is measured moves with both
its ends, so its residual has the Jacobians J and -J. With W = J'OJ its blocks of H are W, W and -W, all symmetric.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_matrix
from sksparse.cholmod import CholmodNotPositiveDefiniteError, analyze

from peers import Files

PACKAGE, VARIANTS, COST = "sksparse", ("chordal",), "g2o"

CLOSE = 1e-3  # of sqrt(chi2): |A dx| of the last step
SINGULAR = 1e-13  # of its diagonal element: pivot of a pose that is not connected
UNCONNECTED = "a pose is not connected with the first"

Array = npt.NDArray[Any]


# --- the file ---------------------------------------------------------------------------------------------------------


def read(path: Path) -> tuple[type[Plane | Space], Array, Array]:
    """The kind of pose, and the numbers of vertices and of edges, a row each."""
    text = path.read_bytes()
    kind: type[Plane | Space] = Space if b"EDGE_SE3:QUAT" in text else Plane
    begin, width = text.find(b"EDGE"), 1 + kind.NUMBERS
    vertices = rows(text[:begin], b"VERTEX_" + kind.TAG, width)
    return kind, vertices, rows(text[begin:], b"EDGE_" + kind.TAG, 1 + width + kind.DIM * (kind.DIM + 1) // 2)


def rows(text: bytes, tag: bytes, width: int) -> Array:
    """Numbers (n, width) of lines that all have this tag."""
    numbers = np.fromstring(text.replace(tag, b" "), sep=" ")
    if len(numbers) != text.count(tag) * width or not np.isfinite(numbers.sum()):
        raise ValueError(f"expected lines {tag.decode()} of {width} finite numbers, edges last")
    return numbers.reshape(-1, width)


# --- the normal equations ---------------------------------------------------------------------------------------------


def places(i: Array, j: Array, n: int) -> Array:
    """Places (n,) of poses in the order of elimination, by approximate minimum degree; pose 0 is held, and last."""
    free = (np.minimum(i, j) > 0).nonzero()[0]
    a, b, diagonal = i[free] - 1, j[free] - 1, np.arange(n - 1)
    at = np.concatenate([diagonal, np.maximum(a, b)]), np.concatenate([diagonal, np.minimum(a, b)])
    graph = csc_matrix((np.ones(len(at[0])), at), shape=(n - 1, n - 1))
    place = np.empty(n, dtype=np.int32)
    place[0] = n - 1
    place[1:][analyze(graph, mode="simplicial", ordering_method="amd").P()] = diagonal
    return place


class Structure:
    """Places of the blocks of H: one a pose, and one a pair of poses, in the row of the later one."""

    def __init__(self, i: Array, j: Array, n: int) -> None:
        if (i == j).any():
            raise ValueError("an edge joins a pose with itself")
        m, N = len(i), n - 1  # the last pose is held
        pairs, pair = np.unique(np.minimum(i, j) * np.int64(n) + np.maximum(i, j), return_inverse=True)
        column, row = np.divmod(pairs, n)
        self.N, self.to_held = N, (row == N).nonzero()[0]
        self.beside_held = column[self.to_held]
        # sums over measurements: at both ends, at j minus at i, of the same pair
        ends, begin = np.stack([i, j], axis=1).ravel(), np.arange(m + 1, dtype=np.int32)
        self.ends = csc_matrix((np.ones(2 * m), ends, 2 * begin), shape=(n, m))
        self.differences = csc_matrix((np.tile([-1.0, 1.0], m), ends, 2 * begin), shape=(n, m))
        self.pairs = csc_matrix((np.ones(m), pair.astype(np.int32), begin), shape=(len(pairs), m))
        # blocks of free poses by columns
        free, diagonal = (row < N).nonzero()[0], np.arange(N)
        order = np.argsort(np.concatenate([diagonal * (n + 1), pairs[free]]), kind="stable")
        self.block = np.concatenate([diagonal, n + free])[order]
        self.column = np.concatenate([diagonal, column[free]])[order]
        self.row = np.concatenate([diagonal, row[free]])[order]
        self.size = np.bincount(self.column, minlength=N)


class System:
    """H of d x d blocks, the lower triangle; diagonal blocks are whole, CHOLMOD passes over what is above."""

    def __init__(self, structure: Structure, d: int, dtype: type = float) -> None:
        s, k = structure, np.arange(d)
        begin, size = (np.cumsum(s.size) - s.size)[s.column], s.size[s.column]
        first = d * np.arange(len(size)) + d * (d - 1) * begin  # number of a block; d * size on is its next column
        place = (first[:, None, None] + (d * size)[:, None, None] * k[:, None] + k).reshape(-1, d * d)
        self.source, rows = np.empty(place.size, dtype=np.intp), np.empty(place.size, dtype=np.int32)
        self.source[place] = d * d * s.block[:, None] + np.arange(d * d)
        rows[place] = d * s.row[:, None] + np.tile(k, d)
        ends = np.concatenate([[0], np.repeat(d * s.size, d).cumsum()]).astype(np.int32)
        self.H = csc_matrix((np.ones(place.size, dtype=dtype), rows, ends), shape=(d * s.N, d * s.N))
        self.H.has_sorted_indices = True
        self.factor = analyze(self.H, ordering_method="natural")
        self.structure, self.d = structure, d

    def solve(self, ends: Array, off: Array, g: Array) -> Array:
        """H^-1 g (N, d, k) of numbers (m, d d) at both ends of measurements and off the diagonal, column by column."""
        s = self.structure
        blocks = np.concatenate([s.ends @ ends, s.pairs @ off])
        self.H.data[:] = blocks.ravel().take(self.source)
        try:
            self.factor.cholesky_inplace(self.H)
        except CholmodNotPositiveDefiniteError as error:
            raise ValueError(UNCONNECTED) from error
        return np.asarray(self.factor.solve_A(g.reshape(s.N * self.d, -1))).reshape(g.shape)

    def refuse_singular(self) -> None:
        """Refuse a pivot of rounding."""
        if (self.factor.D().real <= SINGULAR * self.H.diagonal().real).any():
            raise ValueError(UNCONNECTED)


# --- poses of the plane -----------------------------------------------------------------------------------------------


class Plane:
    """Measurements, and poses as complex numbers: positions t (n, 1), rotations R (n, 1, 1)."""

    TAG, NUMBERS, DIM, DTYPE = b"SE2", 3, 3, complex
    ORIGIN = np.zeros(3)
    t: Array
    R: Array

    def __init__(self, z: Array, information: Array, i: Array, j: Array) -> None:
        z, (a, b, c, d, f, h) = z.T.copy(), information.T.copy()
        self.i, self.j, self.z, self.Z = i, j, z[0] + 1j * z[1], turn(z[2])
        # O (e, angle) = (alpha e + beta conj(e) + gamma angle, <gamma, e> + h angle)
        self.alpha, self.beta, self.gamma, self.h = (a + d) / 2, (a - d) / 2 + 1j * b, c + 1j * f, h
        det = a * d - b * b
        if not ((a > 0) & (det > 0) & (h * det > a * f * f - 2 * b * c * f + d * c * c)).all():
            raise ValueError("information is not positive definite")
        self.tau, self.kappa = self.alpha, h

    @staticmethod
    def pose(numbers: Array) -> tuple[Array, Array]:
        return numbers[:1] + 1j * numbers[1:2], turn(numbers[2:])[:, None]

    @staticmethod
    def nearest(M: Array) -> Array:
        return M / np.abs(M)

    def chi2(self) -> float:
        t, R = self.t[:, 0], self.R[:, 0, 0]
        self.RZ, self.t_j = R[self.i] * self.Z, t[self.j]
        back = self.RZ.conj()
        e, rotation = back * (self.t_j - t[self.i]) - self.Z.conj() * self.z, back * R[self.j]
        angle = np.arctan2(rotation.imag, rotation.real)
        self.Oe = self.alpha * e + self.beta * e.conj() + self.gamma * angle
        self.Oangle = (self.gamma.conj() * e).real + self.h * angle
        return float(np.vdot(e, self.Oe).real + angle @ self.Oangle)

    def normal(self) -> tuple[Array, Array]:
        """W (m, 9) and J'Oe (m, 3) where chi2 was computed."""
        beta, gamma, Oe = self.beta * self.RZ * self.RZ, self.gamma * self.RZ, self.Oe * self.RZ  # in the world
        u = 1j * self.t_j  # the way of j when the world turns
        k = self.alpha * u + beta * u.conj() + gamma
        W, g = np.empty((len(u), 9)), np.empty((len(u), 3))
        W[:, 0], W[:, 1], W[:, 2] = self.alpha + beta.real, beta.imag, k.real
        W[:, 3], W[:, 4], W[:, 5] = beta.imag, self.alpha - beta.real, k.imag
        W[:, 6], W[:, 7], W[:, 8] = k.real, k.imag, self.h + (u.conj() * (k + gamma)).real
        g[:, 0], g[:, 1], g[:, 2] = Oe.real, Oe.imag, self.Oangle + (u.conj() * Oe).real
        return W, g

    def move(self, step: Array) -> None:
        self.t[:-1, 0] += step[:, 0] + 1j * step[:, 1] + 1j * step[:, 2] * self.t[:-1, 0]
        self.R[:-1, 0, 0] *= turn(step[:, 2])

    def numbers(self) -> Array:
        return np.stack([self.t[:, 0].real, self.t[:, 0].imag, np.angle(self.R[:, 0, 0])], axis=1)


def turn(theta: Array) -> Array:
    """exp(i theta), of which `numpy.exp` takes five times as long."""
    return np.asarray(np.cos(theta) + 1j * np.sin(theta))


# --- poses of space ---------------------------------------------------------------------------------------------------

# R_rc = q' F_rc q, and 4 qq' = 1 + sum R_rc F_rc, of unit quaternions q = (x, y, z, w)
FORMS: Array = np.zeros((3, 3, 4, 4))
for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    FORMS[a, a] = np.diag([1.0 if k in (a, 3) else -1.0 for k in range(4)])
    FORMS[a, b, [a, b], [b, a]] = FORMS[b, a, [a, b], [b, a]] = 1.0
    FORMS[b, a, [c, 3], [3, c]], FORMS[a, b, [c, 3], [3, c]] = 1.0, -1.0
FORMS = FORMS.reshape(9, 16)
UPPER = np.empty((6, 6), dtype=np.intp)  # numbers of a file by row and column
UPPER[np.triu_indices(6)] = UPPER.T[np.triu_indices(6)] = np.arange(21)
AXES = np.arange(3)


def rotations(q: Array) -> Array:
    """R (n, 3, 3) of quaternions (n, 4) of any length."""
    q = q / np.sqrt((q * q).sum(axis=1))[:, None]
    return np.asarray((q[:, :, None] * q[:, None]).reshape(-1, 16) @ FORMS.T).reshape(-1, 3, 3)


def quaternions(R: Array) -> Array:
    """Unit quaternions (n, 4), w >= 0, of rotations (n, 3, 3): the row of 4 qq' with the largest number q_k^2."""
    fourfold, every = (R.reshape(-1, 9) @ FORMS).reshape(-1, 4, 4), np.arange(len(R))
    square = fourfold[:, range(4), range(4)]
    k = square.argmax(axis=1)
    q = fourfold[every, k]
    q[every, k] += 1.0
    return np.asarray(q * (np.copysign(0.5, q[:, 3]) / np.sqrt(1.0 + square[every, k]))[:, None])


def cross(v: Array) -> Array:
    """[v]x (n, 3, 3) of vectors (n, 3)."""
    K = np.zeros((len(v), 3, 3))
    K[:, 2, 1], K[:, 0, 2], K[:, 1, 0] = v.T
    K[:, 1, 2], K[:, 2, 0], K[:, 0, 1] = -v.T
    return K


class Space:
    """Measurements, and poses: positions t (n, 3), rotations R (n, 3, 3)."""

    TAG, NUMBERS, DIM, DTYPE = b"SE3:QUAT", 7, 6, float
    ORIGIN = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    t: Array
    R: Array

    def __init__(self, z: Array, information: Array, i: Array, j: Array) -> None:
        self.i, self.j, self.z, self.Z = i, j, z[:, :3], rotations(z[:, 3:])
        self.O = information[:, UPPER]
        np.linalg.cholesky(self.O)  # refuses what is not positive definite
        self.Zt = np.ascontiguousarray(self.Z.mT)
        self.back = self.Zt @ self.z[..., None]
        self.tau, self.kappa = (self.O[:, AXES + k, AXES + k].mean(axis=1) for k in (0, 3))

    @staticmethod
    def pose(numbers: Array) -> tuple[Array, Array]:
        return numbers[:3], rotations(numbers[None, 3:])[0]

    @staticmethod
    def nearest(M: Array) -> Array:
        """Rotations of largest tr(R'M) = q' (sum M_rc F_rc) q."""
        return rotations(np.linalg.eigh((M.reshape(-1, 9) @ FORMS).reshape(-1, 4, 4))[1][..., -1])

    def chi2(self) -> float:
        self.A, self.t_j = self.Zt @ self.R.mT[self.i], self.t[self.j]
        self.q = quaternions(self.A @ self.R[self.j])
        e = np.empty((len(self.q), 6, 1))
        e[:, :3], e[:, 3:, 0] = self.A @ (self.t_j - self.t[self.i])[..., None] - self.back, self.q[:, :3]
        self.Oe = self.O @ e
        return float(np.vdot(e, self.Oe))

    def normal(self) -> tuple[Array, Array]:
        """W (m, 36) and J'Oe (m, 6) where chi2 was computed."""
        J, half = np.zeros((len(self.A), 6, 6)), -0.5 * cross(self.q[:, :3])
        half[:, AXES, AXES] = 0.5 * self.q[:, 3:]
        J[:, :3, :3], J[:, :3, 3:], J[:, 3:, 3:] = self.A, -self.A @ cross(self.t_j), half @ self.A
        return (J.mT @ (self.O @ J)).reshape(-1, 36), (J.mT @ self.Oe)[..., 0]

    def move(self, step: Array) -> None:
        w = step[:, 3:]
        self.t[:-1] += step[:, :3] + (cross(w) @ self.t[:-1, :, None])[..., 0]
        self.R[:-1] = rotations(np.concatenate([w / 2, np.ones((len(w), 1))], axis=1)) @ self.R[:-1]

    def numbers(self) -> Array:
        return np.concatenate([self.t, quaternions(self.R)], axis=1)


# --- the solver -------------------------------------------------------------------------------------------------------


class Run:
    """A contender; see peers."""

    def __init__(self, files: Files, variant: str) -> None:
        self.files, self.said = files, {"variant": variant}

    def load(self) -> None:
        kind, vertices, edges = read(self.files.graph)
        self.ids, ends = np.unique(edges[:, :2], return_inverse=True)
        first = vertices[vertices[:, 0] == self.ids[0], 1:]
        self.held = kind.pose(first[0] if len(first) else kind.ORIGIN)
        self.n, (i, j) = len(self.ids), ends.reshape(-1, 2).T
        self.place, width = places(i, j, self.n), 2 + kind.NUMBERS
        self.graph = kind(edges[:, 2:width], edges[:, width:], self.place[i], self.place[j])

    def start(self) -> None:
        """R_j = R_i Z of matrices in least squares, the nearest rotations, then t_j = t_i + R_i z."""
        p, (t, R) = self.graph, self.held
        s = self.structure = Structure(p.i, p.j, self.n)
        d, kappa, tau = len(R), p.kappa[:, None], p.tau[:, None]
        system = System(s, d, p.DTYPE)
        Z = p.Z.reshape(-1, d, d)
        off = np.where((p.j > p.i)[:, None, None], Z.conj(), Z.mT).reshape(-1, d * d) * -kappa
        g = np.zeros((s.N, d, d), dtype=p.DTYPE)
        g[s.beside_held] = -(s.pairs @ off)[s.to_held].reshape(-1, d, d).conj() @ R.conj().T
        y = system.solve(kappa * np.eye(d).ravel(), off, g)  # R'
        system.refuse_singular()
        p.R = np.concatenate([p.nearest(y.conj().mT), R[None]])
        g = s.differences @ (tau * (p.R[p.i] @ p.z.reshape(-1, d, 1))[..., 0])
        system = System(s, 1) if d > 1 else system
        p.t = np.concatenate([system.solve(tau, -tau, g[:-1, None])[:, 0], np.zeros((1, d))]) + t

    def optimize(self) -> None:
        p, s = self.graph, self.structure
        system, dof = System(s, p.DIM), p.DIM * (len(p.i) - s.N)
        for iteration in range(1, self.files.most + 1):
            chi2 = p.chi2()
            W, Oe = p.normal()
            g = -(s.differences @ Oe)[:-1, :, None]
            step = system.solve(W, -W, g)
            p.move(step[..., 0])
            if np.vdot(step, g) <= CLOSE**2 * min(chi2, max(dof, 1)):  # |A dx|^2
                self.chi2, self.iterations = p.chi2(), iteration
                return
        raise ValueError(f"not converged in {self.files.most} iterations")

    def cost(self) -> float:
        return self.chi2

    def poses(self) -> tuple[Array, Array]:
        return self.ids.astype(np.int64), self.graph.numbers()[self.place]
