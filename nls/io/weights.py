r"""The matrix of a measurement, between the numbers of a file and the noise of a factor.

The entries of a file are about the error e_f of the numbers it measures, those of a noise about the residual e of the
factor's convention. Where they differ, e_f = S e to first order:

    chart         e_f                            S for log (gtsam)         S for g2o, graphslam
    plain         as the residual                I                         I
    quaternion    (t, vector part)               diag(I, I/2) (gtsam: I)   I
    rotation      (t, rotation vector)           I                         diag(I, 2 I)
    angles        (t, roll, pitch, yaw)          diag(I, T^-1)             diag(I, 2 T^-1)

with T of `models.manifolds.euler` at the measured angles, phi = T d(roll, pitch, yaw) and v = phi / 2. Then

    information I_e = S' I S,    square root R_e = R S,    covariance C = S C_e S'

so that all conventions agree to first order (`gtsam` reads a quaternion's information as GTSAM does). A covariance of
poses in space is about the rotation vector, an information about the quaternion. A translation stays as it is. Like
other readers of these files, this one does not apply the difference between the axes of the two poses to it.
"""

import numpy as np

from factors.base import Factor
from factors.noise import NEGATIVE, Covariance, Information, Noise, SqrtInformation, square
from factors.robust import Robust
from models import SE3
from models.algebra import Array, Mask
from models.errors import GraphError
from models.manifolds.euler import rate_matrix, rate_matrix_inv
from nls.io.records import Record

NOISES: dict[str, type[Information] | type[SqrtInformation] | type[Covariance]] = {
    "information": Information,
    "square root": SqrtInformation,
    "covariance": Covariance,
}
HALF = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # rotation vector per quaternion vector part
HALVED = {"information": ("log",), "covariance": ("g2o", "graphslam")}  # conventions whose rotation is not the file's


def matrix(record: Record, numbers: Array, kind: str) -> Array:
    """Matrices (n, m, m) of the entries (n, k) of lines: symmetric, or upper triangular for a square root.

    Components first in memory, as the batched Cholesky wants them: 0.4 ms for 5,000 6x6 matrices, not 1.4.
    """
    m = record.element.space.dim
    rows, columns = record.places
    place = np.zeros((m, m), dtype=np.intp)
    place[columns, rows] = place[rows, columns] = np.arange(len(rows))
    M = np.asfortranarray(numbers).T[place]
    if kind == "square root":
        M[columns[rows < columns], rows[rows < columns]] = 0.0
    return M.transpose(2, 0, 1)


def noise_of(record: Record, kind: str, M: Array, measured: Array, convention: str) -> Noise:
    """The noise of a factor from matrices (n, m, m) of a kind and the measured numbers (n, width) of the lines."""
    if record.element.angles:
        S, _ = _turn(measured[:, 3:], convention)
        M = M @ S if kind == "square root" else _symmetric(S.mT @ M @ S)
    elif record.element.space is SE3 and convention in HALVED[kind]:
        M = M / (HALF[:, None] * HALF)
    return NOISES[kind](M)


def entries(record: Record, kind: str, factor: Factor, W: Array, measured: Array) -> Array:
    """Matrix entries (n, k) of the lines of a factor with the whitener W; the inverse of `noise_of`.

    Raises
    ------
    GraphError
        A robust kernel, or a covariance that does not exist.
    """
    m, noise = record.element.space.dim, factor.noise
    if isinstance(noise, Robust):
        message = f"{factor!r} has a robust kernel, which files of this kind have no place for"
        raise GraphError(message, factor.keys, factor.name)
    W = square(W)
    M: Array
    if type(noise) is NOISES[kind] and not (kind == "square root" and np.tril(noise.matrix, -1).any()):
        M = noise.matrix
    elif kind == "information":
        M = W.mT @ W
    elif kind == "square root":
        M = _upper(W)
    elif np.abs(np.linalg.det(W)).min(initial=1.0) > 0:
        W_inv = np.linalg.inv(W)
        M = W_inv @ W_inv.mT
    else:
        message = f"{factor!r} has no covariance: it measures nothing in some direction"
        raise GraphError(message, factor.keys, factor.name)
    if record.element.angles:
        _, S_inv = _turn(measured[:, 3:], factor.convention)
        M = _upper(M @ S_inv) if kind == "square root" else _symmetric(S_inv.mT @ M @ S_inv)
    elif record.element.space is SE3 and factor.convention in HALVED[kind]:
        M = M * (HALF[:, None] * HALF)
    rows, columns = record.places
    return np.broadcast_to(M, (len(factor), m, m))[:, rows, columns]


def repaired(Omega: Array) -> tuple[Array, Mask]:
    """Information matrices (n, m, m) with negative eigenvalues set to 0, and which had some.

    The matrices are scaled to a diagonal of ones for it, as they are when they are judged: units do not decide.
    """
    d = np.sqrt(np.abs(np.diagonal(Omega, axis1=1, axis2=2)))
    d = np.where(d > 0, d, 1.0)
    scaled = Omega / d[:, :, None] / d[:, None, :]
    finite = np.flatnonzero(np.isfinite(scaled).all(axis=(1, 2)))
    values, V = np.linalg.eigh(scaled[finite])
    negative = values[:, 0] < -NEGATIVE
    bad, V = finite[negative], V[negative]
    nearest = (V * np.maximum(values[negative], 0.0)[:, None, :]) @ V.mT
    out, changed = np.array(Omega), np.zeros(len(Omega), dtype=bool)
    out[bad] = _symmetric(nearest * d[bad][:, :, None] * d[bad][:, None, :])
    changed[bad] = True
    return out, changed


def _turn(angles: Array, convention: str) -> tuple[Array, Array]:
    """S and S^-1 (n, 6, 6) of the chart ``angles`` at measured angles (n, 3)."""
    k = 2.0 if convention in ("g2o", "graphslam") else 1.0
    S, S_inv = np.tile(np.eye(6), (2, len(angles), 1, 1))
    S[:, 3:, 3:], S_inv[:, 3:, 3:] = k * rate_matrix_inv(angles), rate_matrix(angles) / k
    return S, S_inv


def _upper(W: Array) -> Array:
    """R upper triangular with R'R = W'W and no negative diagonal; W itself where it is."""
    if not np.tril(W, -1).any():
        return W
    R = np.linalg.qr(W, mode="r")
    return np.asarray(R * np.where(np.diagonal(R, axis1=-2, axis2=-1) < 0, -1.0, 1.0)[..., None])


def _symmetric(M: Array) -> Array:
    return np.asarray(M / 2 + M.mT / 2)  # the sum of the largest numbers would overflow
