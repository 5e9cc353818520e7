"""Rotation matrices and matrices of rigid motions: taken apart, and refused where they are none."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Mask
from models.errors import GraphError
from models.finite import finite

__all__ = ["homogeneous", "rigid_parts", "rotation_parts"]

RIGID = 1e-3  # entries of R'R - I: matrices written with six digits are off by 1e-6, hand-written ones by 1e-4


def homogeneous(R: Array, t: Array) -> Array:
    """[[R, t], [0, 1]] (..., d+1, d+1) of rotations (..., d, d) and translations (..., d)."""
    d = t.shape[-1]
    T = np.zeros((*np.broadcast(R[..., 0], t).shape[:-1], d + 1, d + 1))
    T[..., :d, :d], T[..., :d, d], T[..., d, d] = R, t, 1.0
    return T


def rigid_parts(who: str, T: npt.ArrayLike, d: int) -> tuple[Array, Array]:
    """Rotations (..., d, d) and translations (..., d) of homogeneous matrices (..., d+1, d+1).

    Parameters
    ----------
    who : the function that was called, for the message.
    T : anything.
    d : 2 or 3.

    Raises
    ------
    GraphError
        No such matrices, or one that is no rigid motion; names the matrix.
    """
    T = _matrices(who, T, d + 1)
    last = np.eye(d + 1)[d]
    wrong = np.abs(T[..., d, :] - last).max(axis=-1) > RIGID
    if wrong.any():
        matrix, number = _first(T, wrong)
        transposed = np.abs(matrix[:, d] - last).max() <= RIGID
        raise GraphError(
            f"{who}: matrix {number} has the last row {matrix[d].tolist()}, expected {last.tolist()}"
            + ("; it is transposed, give T.mT" if transposed else "")
        )
    return _checked_rotations(who, T[..., :d, :d]), T[..., :d, d]


def rotation_parts(who: str, R: npt.ArrayLike, d: int) -> Array:
    """Rotation matrices (..., d, d), checked; parameters and errors as for `rigid_parts`."""
    return _checked_rotations(who, _matrices(who, R, d))


def _matrices(who: str, M: npt.ArrayLike, k: int) -> Array:
    array = finite(who, "the matrix", M)
    if array.ndim < 2 or array.shape[-2:] != (k, k):
        raise GraphError(f"{who}: shape {array.shape}, expected ({k}, {k}) or (n, {k}, {k})")
    return array


def _checked_rotations(who: str, R: Array) -> Array:
    off = np.abs(R.mT @ R - np.eye(R.shape[-1])).max(axis=(-2, -1))
    if (wrong := off > RIGID).any():
        matrix, number = _first(R, wrong)
        raise GraphError(
            f"{who}: matrix {number} is no rigid motion: its rotation part {matrix.tolist()} times its transpose "
            f"differs from the identity by {np.max(_first(off[..., None], wrong)[0]):.3g}, above {RIGID:g}; take scale "
            "and shear out"
        )
    if (wrong := np.linalg.det(R) < 0).any():
        matrix, number = _first(R, wrong)
        raise GraphError(
            f"{who}: matrix {number} is a reflection: the determinant of its rotation part {matrix.tolist()} is -1, "
            "expected 1; check the directions of its axes"
        )
    return R


def _first(M: Array, wrong: Mask) -> tuple[Array, int]:
    """The first wrong one of a stack, and its number."""
    number = int(np.argmax(wrong))
    return M.reshape(-1, *M.shape[np.ndim(wrong) :])[number], number
