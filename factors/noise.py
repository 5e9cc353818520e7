r"""Noise models: from what the user knows (sigmas, covariance, information) to the whitener W, W'W = Sigma^-1.

    A_i = W J H,   b_i = W e

Any W with W'W = Sigma^-1 gives the same step and the same chi2. Ours is the upper Cholesky factor of the information
(for a covariance L L' = Sigma, the inverse of L). A semi-definite information is legal: it says nothing in some
directions, and W has rows of zeros there. A negative one is refused, with the measurement it belongs to.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from copy import copy
from typing import Self

import numpy as np
import numpy.typing as npt

from factors.slices import rows
from models.abstract import Abstract
from models.algebra import Array, Index, Mask, apply, product
from models.errors import GraphError, NoiseModelError
from models.finite import first_not_finite

__all__ = ["Covariance", "Diagonal", "Information", "Isotropic", "Noise", "SqrtInformation", "square", "whiten"]

# Matrices are scaled to a diagonal of ones before they are judged, so that units do not decide.
NEGATIVE = 1e-10  # an eigenvalue below -1e-10 is no rounding of numbers written with ten digits
BLOCK = 1 << 11  # matrices factorized together: they stay in the cache
SQUARABLE = 1e150  # a whitened error beyond this has no finite chi2, a weight below its inverse no information
NOTHING = 1e-14  # an eigenvalue or squared pivot below 1e-14 is rounding of 0: no information in that direction
ALIASES = {"theta": "yaw", "heading": "yaw", "h": "yaw", "depth": "z", "rx": "roll", "ry": "pitch", "rz": "yaw"}


def component_names(names: Sequence[str] | str) -> tuple[str, ...]:
    """Names of components without their aliases; one may stand alone.

    Raises
    ------
    GraphError
        Not names.
    """
    sequence = (names,) if isinstance(names, str) else names
    if not isinstance(sequence, Sequence) or not all(isinstance(name, str) for name in sequence):
        raise GraphError(f"components: expected names such as ('x', 'y'), got {names!r:.60}")
    return tuple(ALIASES.get(name, name) for name in sequence)


class Noise(Abstract):
    """What is known about the error of a batch of measurements, shared by all or one per measurement.

    The arrays of a noise have the measurements as leading axis, n or 1: `take` relies on it.
    """

    @abstractmethod
    def sqrt_information(self, n: int, names: tuple[str, ...]) -> Array:
        """The whitener W of n measurements with the named components.

        Returns
        -------
        (k, m) array for a diagonal W or (k, m, m) for a full one, with k = 1 (shared) or n.

        Raises
        ------
        NoiseModelError
            Not a valid noise for this many measurements or components; names the measurement.
        """

    def take(self, index: Index, n: int) -> Self:
        """The noise of some of n measurements; shared stays shared.

        Examples
        --------
        >>> import numpy as np
        >>> Isotropic([0.1, 0.2, 0.3]).take(np.array([2, 0]), 3).sigma, Isotropic(0.1).take(np.array([2, 0]), 3).sigma
        (array([0.3, 0.1]), array([0.1]))
        """
        subset = copy(self)
        for name, value in vars(self).items():
            value_of_rows = value.take(index, n) if isinstance(value, Noise) else rows(value, index, n)
            setattr(subset, name, value_of_rows)
        return subset

    def __repr__(self) -> str:
        return type(self).__name__


class Isotropic(Noise):
    """The same standard deviation for every component.

    Parameters
    ----------
    sigma : float or (n,) array, in the unit of the measurement; 1 for an unweighted problem.
    """

    def __init__(self, sigma: npt.ArrayLike = 1.0) -> None:
        self.sigma = np.atleast_1d(_numbers(sigma, "sigma", 1))

    def sqrt_information(self, n: int, names: tuple[str, ...]) -> Array:
        sigma = np.broadcast_to(_shared_or_each(self.sigma, n, "sigma")[:, None], (len(self.sigma), len(names)))
        return _inverse_sigmas(sigma, names)


class Diagonal(Noise):
    """Independent components with their own standard deviations, in order or by name.

    Parameters
    ----------
    sigmas : (m,) shared, or (n, m), in the order of the measurement's components.
    **named : the same by component name, each a float or (n,): ``Diagonal(x=0.1, y=0.1, yaw=0.02)``.

    Examples
    --------
    >>> Diagonal(yaw=0.5, x=0.1, y=0.2).sqrt_information(1, ("x", "y", "yaw"))
    array([[10.,  5.,  2.]])
    """

    def __init__(self, sigmas: npt.ArrayLike | None = None, **named: npt.ArrayLike) -> None:
        if (sigmas is None) == (not named):
            raise NoiseModelError("Diagonal: give the sigmas in order, or each by its component's name, not both")
        self.sigmas = None if sigmas is None else np.atleast_2d(_numbers(sigmas, "sigmas", 2))
        self.named = {ALIASES.get(k, k): np.atleast_1d(_numbers(v, f"sigma of {k}", 1)) for k, v in named.items()}
        if len(self.named) != len(named):
            raise NoiseModelError(f"Diagonal: {list(named)} name one component twice")

    def sqrt_information(self, n: int, names: tuple[str, ...]) -> Array:
        if self.sigmas is not None:
            sigmas = _shared_or_each(self.sigmas, n, "sigmas")
            if sigmas.shape[1] != len(names):
                raise NoiseModelError(
                    f"Diagonal: {sigmas.shape[1]} sigmas for a measurement of {len(names)} components {names}"
                )
            return _inverse_sigmas(sigmas, names)
        if set(self.named) != set(names):
            raise NoiseModelError(
                f"Diagonal: sigmas are given for {sorted(self.named)}, the measurement's components are {list(names)}"
            )
        columns = [_shared_or_each(self.named[name], n, f"sigma of {name}") for name in names]
        return _inverse_sigmas(np.stack(np.broadcast_arrays(*columns), axis=-1), names)


class _Matrix(Noise):
    """A full symmetric matrix, (m, m) shared or (n, m, m)."""

    def __init__(self, matrix: npt.ArrayLike) -> None:
        kind = type(self).__name__
        M = _numbers(matrix, kind, 3)
        if M.ndim < 2 or M.shape[-1] != M.shape[-2]:
            raise NoiseModelError(f"{kind}: shape {M.shape}, expected (m, m) or (n, m, m)", kind)
        self.matrix = M[None] if M.ndim == 2 else M

    def _checked(self, n: int, names: tuple[str, ...]) -> Array:
        kind, M = type(self).__name__, self.matrix
        _shared_or_each(M, n, kind)
        if M.shape[-1] != len(names):
            raise NoiseModelError(
                f"{kind}: {M.shape[-1]} x {M.shape[-1]}, the measurement has {len(names)} components {names}", kind
            )
        return _once_if_equal(M)

    def _symmetric(self, n: int, names: tuple[str, ...]) -> Array:
        M, kind = self._checked(n, names), type(self).__name__
        if (M == M.mT).all():
            return M
        skewness = np.abs(M - M.mT).max(axis=(-2, -1))
        bad = skewness > 1e-9 * np.abs(M).max(axis=(-2, -1))
        if bad.any():
            k = int(np.argmax(bad))
            raise NoiseModelError(
                f"{kind} of measurement {k} is not symmetric: {M[k].tolist()}", kind, k, float(skewness[k])
            )
        return M


class Covariance(_Matrix):
    """Covariance Sigma, (m, m) shared or (n, m, m); must be positive definite."""

    def sqrt_information(self, n: int, names: tuple[str, ...]) -> Array:
        Sigma = self._symmetric(n, names)
        if (variances := _diagonal(Sigma)) is not None:
            return _inverse_sigmas(np.sqrt(np.where(variances > 0, variances, np.nan)), names, "Covariance", variances)
        L, bad = _cholesky(Sigma)
        if bad.any():
            k = int(np.argmax(bad))
            smallest = float(np.linalg.eigvalsh(Sigma[k])[0])
            raise NoiseModelError(
                f"Covariance of measurement {k} is not positive definite beyond rounding (smallest eigenvalue "
                f"{smallest:.6g}): {Sigma[k].tolist()}",
                "covariance",
                k,
                smallest,
            )
        return np.asarray(np.linalg.inv(L))


class Information(_Matrix):
    """Information Omega = Sigma^-1, (m, m) shared or (n, m, m); semi-definite is legal, negative is not."""

    def sqrt_information(self, n: int, names: tuple[str, ...]) -> Array:
        Omega = self._symmetric(n, names)
        if (weights := _diagonal(Omega)) is not None and (weights >= 0).all():
            return np.sqrt(weights)
        L, bad = _cholesky(Omega)
        W = L.mT
        if bad.any():
            W = np.ascontiguousarray(W)
            W[bad] = self._semi_definite(Omega[bad], np.flatnonzero(bad))
        return W

    def _semi_definite(self, Omega: Array, index: Index) -> Array:
        """W = diag(sqrt(lambda)) V' D, D^2 = diag(Omega), D^-1 Omega D^-1 = V diag(lambda) V'; zeros for lambda = 0."""
        d = np.sqrt(np.abs(np.diagonal(Omega, axis1=1, axis2=2)))
        D = 1 / np.where(d > 0, d, 1.0)
        scaled = D[:, :, None] * Omega * D[:, None, :]
        beyond = ~np.isfinite(scaled).all(axis=(1, 2), keepdims=True)  # far larger than their diagonal allows
        eigenvalues, V = np.linalg.eigh(np.where(beyond, -np.eye(Omega.shape[-1]), scaled))
        negative = eigenvalues[:, 0] < -NEGATIVE
        if negative.any():
            k = int(np.argmax(negative))
            smallest = float(np.linalg.eigvalsh(Omega[k])[0])
            raise NoiseModelError(
                f"information of measurement {index[k]} has the negative eigenvalue {smallest:.6g}: it is no "
                f"information matrix (check the order of its entries); {int(negative.sum())} such in this batch",
                "information",
                int(index[k]),
                smallest,
            )
        known = np.where(eigenvalues > NOTHING, eigenvalues, 0.0)
        return np.asarray(np.sqrt(known)[..., None] * V.mT * d[:, None, :])


class SqrtInformation(_Matrix):
    """The whitener itself: W with W'W = Sigma^-1, (m, m) shared or (n, m, m); any square matrix."""

    def sqrt_information(self, n: int, names: tuple[str, ...]) -> Array:
        return self._checked(n, names)


def weights(noise: Noise, n: int, names: tuple[str, ...]) -> Array:
    """The whitener of n measurements, as `Noise.sqrt_information` returns it.

    Raises
    ------
    NoiseModelError
        No noise for these measurements; a weight that is infinite.
    """
    W = noise.sqrt_information(n, names)
    if (k := first_not_finite(W)) is not None:
        raise NoiseModelError(f"the noise of measurement {k} is beyond the largest number", "noise", k)
    return W


def whiten(W: Array, x: Array) -> Array:
    """W x for stacks of vectors (n, m) or matrices (n, m, d), W as `Noise.sqrt_information` returns it."""
    if W.ndim == 2:
        return W * x if x.ndim == 2 else W[..., None] * x
    return apply(W, x) if x.ndim == 2 else product(W, x)


def arranged(W: Array) -> Array:
    """Whiteners as `product` wants them: components first for small matrices, one by one for larger ones."""
    return np.asfortranarray(W) if W.shape[-1] <= 3 else np.ascontiguousarray(W)


def square(W: Array) -> Array:
    """Whiteners (n, m, m), from those or from their diagonals (n, m): W as `Noise.sqrt_information` returns it."""
    return W if W.ndim == 3 else W[..., None] * np.eye(W.shape[-1])


def _numbers(value: npt.ArrayLike, name: str, ndim: int) -> Array:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise NoiseModelError(f"{name}: expected numbers, got {value!r:.60}", name) from error
    if array.ndim > ndim:
        raise NoiseModelError(f"{name} has shape {array.shape}, expected at most {ndim} axes", name)
    stack = array if array.ndim == ndim else array[None]  # one per measurement, or one for all
    if (k := first_not_finite(stack)) is not None:
        raise NoiseModelError(f"{name} of measurement {k} has a number that is not finite", name, k)
    return array


def _shared_or_each(array: Array, n: int, name: str) -> Array:
    if len(array) not in (1, n):
        raise NoiseModelError(f"{name}: given for {len(array)} measurements, there are {n}; give one, or {n}", name)
    return array


def _inverse_sigmas(
    sigmas: Array, names: tuple[str, ...], quantity: str = "sigma", shown: Array | None = None
) -> Array:
    bad = ~(sigmas > 0)
    if bad.any():
        k, j = (int(i) for i in np.argwhere(bad)[0])
        value = float((sigmas if shown is None else shown)[k, j])
        raise NoiseModelError(
            f"{quantity} of {names[j]}, measurement {k}, is {value:g}, expected > 0", quantity, k, value
        )
    return np.asarray(1.0 / sigmas)


def _once_if_equal(M: Array) -> Array:
    """M[:1] where all matrices of the batch are the same: whitening then is one product."""
    return M[:1] if len(M) > 1 and (M[-1] == M[0]).all() and (M == M[0]).all() else M


def _diagonal(M: Array) -> Array | None:
    """The diagonals (k, m) when no matrix of the stack has another entry."""
    off = ~np.eye(M.shape[-1], dtype=bool)
    return None if np.any(M, axis=0)[off].any() else np.asarray(np.diagonal(M, axis1=1, axis2=2))


def _cholesky(M: Array) -> tuple[Array, Mask]:
    """Lower L with L L' = M for a stack (n, m, m), and which of them are not positive definite.

    Over many matrices at a time, components first: 1 ms for 5,000 6x6 matrices, `numpy.linalg.cholesky` pays per
    matrix and refuses the stack when one fails.
    """
    L, bad = np.zeros((*M.shape[1:], len(M))), np.zeros(len(M), dtype=bool)
    for begin in range(0, len(M), BLOCK):
        block = slice(begin, begin + BLOCK)
        _factorize(np.ascontiguousarray(M[block].transpose(1, 2, 0)), L[..., block], bad[block])
    return L.transpose(2, 0, 1), bad


def _factorize(C: Array, L: Array, bad: Mask) -> None:
    """Fill L with the factors of the matrices C, both (m, m, n), and bad (n,), column by column."""
    S = np.zeros(C.shape)  # sum of L_k L_k' over the columns k < j
    for j in range(len(C)):
        pivot = C[j, j] - S[j, j]
        poor = ~(pivot > NOTHING * np.abs(C[j, j]))  # of its own diagonal: units may differ by any factor
        bad |= poor
        L[j, j] = np.sqrt(np.where(poor, 1.0, pivot))
        L_j = np.divide(C[j + 1 :, j] - S[j + 1 :, j], L[j, j], out=L[j + 1 :, j])
        S[j + 1 :, j + 1 :] += L_j[:, None] * L_j
