"""Small array helpers under every equation: angles, cross-product matrices, products of stacks of small matrices.

The batch is always the *leading* axes of an array. Underneath, stacks of 2- and 3-dimensional things are kept with the
components first in memory (one contiguous array per component). A product of 5,000 3x3 matrices then takes 0.12 ms
against 0.5 ms for `numpy.matmul`, and no function has to say so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain

import numpy as np
import numpy.typing as npt

__all__ = [
    "Array",
    "Index",
    "Mask",
    "Numbers",
    "apply",
    "arrangement",
    "components",
    "congruence",
    "distance_along",
    "dot",
    "gram",
    "matrix",
    "pack",
    "product",
    "sinc",
    "skew",
    "stumpff",
    "wrap",
]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
Numbers = npt.NDArray[np.int64]


def wrap(angle: npt.ArrayLike) -> Array:
    """Angle(s) brought to [-pi, pi), rad; the array itself where all are in it.

    Examples
    --------
    >>> import numpy as np
    >>> float(wrap(np.pi)) == -np.pi, float(wrap(0.25))
    (True, 0.25)
    """
    a = np.asarray(angle, dtype=float)
    outside = (a < -np.pi) | (a >= np.pi)  # an angle in range stays bit for bit
    if np.count_nonzero(outside):  # outside.any() takes 0.9 us longer
        a = a.copy()
        turned = np.mod(a[outside] + np.pi, 2 * np.pi) - np.pi
        a[outside] = np.where(turned >= np.pi, -np.pi, turned)  # mod can round up to its modulus
    return a


def components(X: npt.ArrayLike) -> Array:
    """View of a stack (..., k) as k arrays (k, ...), one per component."""
    X = np.asarray(X, dtype=float)
    return X.transpose(X.ndim - 1, *range(X.ndim - 1))  # 0.3 us; numpy.moveaxis takes 15


def pack(parts: Sequence[npt.ArrayLike]) -> Array:
    """Stack (..., k) of k <= 64 broadcastable arrays (...), components first in memory."""
    out = np.empty((len(parts), *np.broadcast(*parts).shape))
    for k, entries in enumerate(parts):
        out[k] = entries
    return out.transpose(*range(1, out.ndim), 0)


def matrix(rows: Sequence[Sequence[npt.ArrayLike]]) -> Array:
    """Stack of matrices (..., r, c), r c <= 64, from r rows of c broadcastable entries, components first in memory."""
    entries = list(chain.from_iterable(rows))
    flat = np.empty((len(entries), *np.broadcast(*entries).shape))
    for k, entry in enumerate(entries):
        flat[k] = entry
    out = flat.reshape(len(rows), len(rows[0]), *flat.shape[1:])
    return out.transpose(*range(2, out.ndim), 0, 1)


def arrangement(table: Sequence[Sequence[int]]) -> Callable[[npt.ArrayLike], Array]:
    """The function that takes vectors (..., k) to matrices (..., r, c) whose entries are their components, with signs.

    Parameters
    ----------
    table : r rows of c numbers: k for component k, counted from 1, -k for minus that, 0 for a zero.

    Examples
    --------
    >>> arrangement([[1, -2], [2, 1]])([3.0, 4.0])
    array([[ 3., -4.],
           [ 4.,  3.]])
    """
    sign = np.sign(table).astype(float)
    index = np.abs(table) - 1

    def arranged(X: npt.ArrayLike) -> Array:
        A: Array = components(X).take(index, axis=0)  # entry by entry takes twice as long for 400
        A = A.transpose(*range(2, A.ndim), 0, 1)
        A *= sign
        return A

    return arranged


def product(A: Array, B: Array) -> Array:
    """Matrix product of two stacks, (..., r, k) times (..., k, c); the batches broadcast.

    Up to 3x3 the sums run over the whole batch, entry by entry (4 times faster than `numpy.matmul`, which pays per
    matrix); from there on `numpy.matmul` (6x6: 0.5 ms for 5,000, against 1.0 ms the other way).
    """
    if A.shape[-1] != B.shape[-2]:
        raise ValueError(f"product of {A.shape} and {B.shape}: the inner sizes differ")
    if max(A.shape[-2:] + B.shape[-1:]) > 3:
        return np.asarray(np.matmul(A, B))
    return np.asarray(np.einsum("...ik,...kj->...ij", A, B, order="F"))


def gram(A: Array) -> Array:
    """A'A for a stack (..., r, c), symmetric.

    For larger matrices from a copy: `numpy.matmul` sees A'A of one array and takes BLAS's syrk, six times slower here.
    """
    return product(A.mT, A if max(A.shape[-2:]) <= 3 else A.copy())


def congruence(J: Array, S: Array) -> Array:
    """J S J', exactly symmetric, for stacks J (..., r, d) and symmetric S (..., d, d)."""
    turned = J @ S @ J.mT
    return np.asarray((turned + turned.mT) / 2)


def apply(A: Array, x: Array) -> Array:
    """Matrix times vector for stacks, (..., r, k) times (..., k); the batches broadcast.

    As in `product` the sums run over the whole batch, up to 4x4, which takes a fraction of the time of `numpy.matvec`.
    """
    if max(A.shape[-2:]) > 4:
        return np.asarray(np.matvec(A, x))
    return np.asarray(np.einsum("...ij,...j->...i", A, x, order="F"))


def dot(a: Array, b: Array) -> Array:
    """Inner product of two stacks of vectors, (..., k) and (..., k) to (...)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def distance_along(p: npt.ArrayLike) -> Array:
    """Distance (n,) travelled along positions (n, d), one at least, up to each of them.

    Examples
    --------
    >>> distance_along([[0, 0], [3, 4], [3, 5]])
    array([0., 5., 6.])
    """
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1)))


_skew = arrangement([[0, -3, 2], [3, 0, -1], [-2, 1, 0]])


def skew(w: npt.ArrayLike) -> Array:
    """Cross-product matrix, ``skew(w) @ v == cross(w, v)``; w (..., 3) to (..., 3, 3).

    Examples
    --------
    >>> skew([1.0, 2.0, 3.0])
    array([[ 0., -3.,  2.],
           [ 3.,  0., -1.],
           [-2.,  1.,  0.]])
    """
    return _skew(w)


TINY = 1e-300  # where a ratio is 0/0 its limit follows from a number this small; beside any other it is nothing


def sinc(x: Array) -> Array:
    """sin(x) / x, 1 at 0."""
    x = np.where(x == 0, TINY, x)
    return np.asarray(np.sin(x) / x)


_FACTORIAL = np.cumprod(np.concatenate([[1.0], np.arange(1.0, 30.0)]))
# 1 / (2j+k)! for k <= 6 and ten terms: below x = 2 what follows, 2^10 / 22! = 9e-19, is below rounding
_INVERSE = 1 / _FACTORIAL[np.add.outer(np.arange(0, 20, 2), np.arange(7))]


def stumpff(theta2: Array, *orders: int) -> tuple[Array, ...]:
    r"""Stumpff functions of x = theta^2, the coefficients of every exponential and Jacobian of the rotation groups.

    .. math:: c_k(x) = \sum_j (-1)^j x^j / (2j+k)!

    so that c0 = cos(theta), c1 = sin(theta)/theta, c2 = (1 - cos(theta))/theta^2, c3 = (theta - sin(theta))/theta^3,
    and c_k = 1/k! - x c_{k+2}. Up to c2 they are elementary, c2 = 2 sin^2(theta/2)/theta^2. Higher ones are summed as a
    series below x = 2 (exact to rounding at 0, where the closed forms are 0/0), above in closed form.

    Parameters
    ----------
    theta2 : (...) array, rad^2, not negative.
    orders : which of c0 .. c6.

    Returns
    -------
    tuple of (...) arrays, in the order asked for.

    Notes
    -----
    K. Stumpff, Himmelsmechanik I, 1959; for their use on SO(3) see the page on spaces in the documentation.

    Examples
    --------
    >>> import numpy as np
    >>> [float(c) for c in stumpff(np.zeros(()), 0, 1, 2, 3)]
    [1.0, 1.0, 0.5, 0.16666666666666666]
    """
    x, highest = np.asarray(theta2, dtype=float), max(orders)
    if highest <= 2:
        theta = np.sqrt(x + TINY)
        return tuple(_ELEMENTARY[k](theta) for k in orders)
    small, lowest = x < 2.0, min(orders)
    n = np.count_nonzero(small)
    if n == x.size:
        c = _series(x, lowest, highest)
    elif n == 0:
        c = _closed(x, highest)
    else:
        series, closed = _series(x, lowest, highest), _closed(np.where(small, 2.0, x), highest)
        c = {k: np.where(small, series[k], closed[k]) for k in orders}
    return tuple(c[k] for k in orders)


# c0, c1, c2 of theta > 0: nothing cancels anywhere
_ELEMENTARY: tuple[Callable[[Array], Array], ...] = (
    np.cos,
    lambda theta: np.sin(theta) / theta,
    lambda theta: 2 * np.square(np.sin(theta / 2) / theta),
)


def _closed(x: Array, highest: int) -> dict[int, Array]:
    """c0, c1, c2, and c_{k+2} = (1/k! - c_k) / x."""
    theta = np.sqrt(x)
    c = {k: elementary(theta) for k, elementary in enumerate(_ELEMENTARY)}
    for k in range(1, highest - 1):
        c[k + 2] = (_INVERSE[0, k] - c[k]) / x
    return c


def _series(x: Array, lowest: int, highest: int) -> dict[int, Array]:
    """All by their sums at once."""
    powers = np.empty((len(_INVERSE) - 1, x.size))
    powers[0] = -x.reshape(-1)
    for k in (1, 2, 4, 8):  # `numpy.multiply.accumulate` takes 25 times as long for 5,000
        rest = powers[k : 2 * k]
        np.multiply(powers[: len(rest)], powers[k - 1], out=rest)
    c = np.einsum("jk,jn->kn", _INVERSE[1:, lowest : highest + 1], powers)
    c += _INVERSE[0, lowest : highest + 1, None]
    return {k: c[k - lowest].reshape(x.shape) for k in range(lowest, highest + 1)}
