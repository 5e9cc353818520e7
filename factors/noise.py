r"""Noise models: from sigmas, covariance or information to the whitener W, W'W = Sigma^-1.

    A_i = W J H,   b_i = W e

Any W with W'W = Sigma^-1 gives the same step and the same chi2. Ours is the upper Cholesky factor of the information
(for a covariance L L' = Sigma, the inverse of L). A semi-definite information is legal: it says nothing in some
directions, and W has rows of zeros there. A negative one is refused, with the measurement it belongs to.

Numbers are checked when a noise is made. How many measurements and components there are is known when it is bound.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from copy import copy
from typing import Self

import numpy as np
import numpy.typing as npt

from factors.definite import NOTHING, cholesky, diagonal, once_if_equal
from factors.slices import rows
from models.abstract import Abstract
from models.algebra import Array, Index, apply, product
from models.errors import GraphError, NoiseModelError
from models.finite import first_not_finite

__all__ = ["Covariance", "Diagonal", "Information", "Isotropic", "Noise", "SqrtInformation", "square", "whiten"]

# Matrices are scaled to a diagonal of ones before they are judged, so that units do not decide.
NEGATIVE = 1e-10  # an eigenvalue below -1e-10 is no rounding of numbers written with ten digits
SHOWN = 9  # numbers of an array that `repr` shows one by one
SQUARABLE = 1e150  # a whitened error beyond this has no finite chi2, a weight below its inverse no information
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
    """The error of a batch of measurements, shared by all or one per measurement.

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
    """One standard deviation for every component.

    Parameters
    ----------
    sigma : float or (n,) array, in the unit of the measurement; 1 for an unweighted problem.

    Attributes
    ----------
    sigma : (1,) or (n,) array, as given.

    Raises
    ------
    NoiseModelError
        A sigma that is not above 0; names the measurement.

    Examples
    --------
    >>> Isotropic(0.1), Isotropic([0.1, 0.3, 0.2])
    (Isotropic(0.1), Isotropic([0.1, 0.3, 0.2]))
    """

    def __init__(self, sigma: npt.ArrayLike = 1.0) -> None:
        self.sigma = np.atleast_1d(_numbers(sigma, "sigma", 1))
        _check_positive(self.sigma[:, None])

    def sqrt_information(self, n: int, names: tuple[str, ...]) -> Array:
        sigma = _shared_or_each(self.sigma, n, "sigma")[:, None]
        return 1.0 / np.broadcast_to(sigma, (len(sigma), len(names)))

    def __repr__(self) -> str:
        return f"Isotropic({_shown(self.sigma)})"


class Diagonal(Noise):
    """Independent components with their own standard deviations, in order or by name.

    Parameters
    ----------
    sigmas : (m,) shared, or (n, m), in the order of the measurement's components.
    **named : the same by component name, each a float or (n,): ``Diagonal(x=0.1, y=0.1, yaw=0.02)``.

    Attributes
    ----------
    sigmas : (1, m) or (n, m) array; None where they were given by name.
    named : (1,) or (n,) array by component name, without aliases; empty where they were given in order.

    Raises
    ------
    NoiseModelError
        A sigma that is not above 0; names the component and the measurement.

    Examples
    --------
    >>> noise = Diagonal(x=0.1, y=[0.2, 0.3], theta=0.02)
    >>> noise, noise.named["y"]
    (Diagonal(x=0.1, y=[0.2, 0.3], yaw=0.02), array([0.2, 0.3]))
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
        if self.sigmas is not None:
            _check_positive(self.sigmas)
        for name, sigma in self.named.items():
            _check_positive(sigma[:, None], (name,))

    def sqrt_information(self, n: int, names: tuple[str, ...]) -> Array:
        if self.sigmas is not None:
            sigmas = _shared_or_each(self.sigmas, n, "sigmas")
            if sigmas.shape[1] != len(names):
                raise NoiseModelError(
                    f"Diagonal: {sigmas.shape[1]} sigmas for a measurement of {len(names)} components {names}"
                )
            return 1.0 / sigmas
        plain = component_names(names)  # a measurement may be named by an alias, such as depth
        if set(self.named) != set(plain):
            raise NoiseModelError(
                f"Diagonal: sigmas are given for {sorted(self.named)}, the measurement's components are {list(names)}"
            )
        columns = [_shared_or_each(self.named[name], n, f"sigma of {name}") for name in plain]
        return 1.0 / np.stack(np.broadcast_arrays(*columns), axis=-1)

    def __repr__(self) -> str:
        if self.sigmas is not None:
            return f"Diagonal({_shown(self.sigmas)})"
        return f"Diagonal({', '.join(f'{name}={_shown(sigma)}' for name, sigma in self.named.items())})"


class _Matrix(Noise):
    """A full matrix, (m, m) shared or (n, m, m)."""

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
        return once_if_equal(M)

    def __repr__(self) -> str:
        M, kind = self.matrix, type(self).__name__
        if M.size <= SHOWN:
            return f"{kind}({_shown(M)})"
        shape = " x ".join(map(str, M.shape if len(M) > 1 else M.shape[1:]))
        return f"{kind}({shape}, diagonal {_range(np.diagonal(M, axis1=1, axis2=2))})"


class _Symmetric(_Matrix):
    """A covariance or an information, checked when it is made."""

    @np.errstate(over="ignore", invalid="ignore")
    def __init__(self, matrix: npt.ArrayLike) -> None:
        super().__init__(matrix)
        M, kind = once_if_equal(self.matrix), type(self).__name__
        if not (M == M.mT).all():
            skewness = np.abs(M - M.mT).max(axis=(-2, -1))
            bad = skewness > 1e-9 * np.abs(M).max(axis=(-2, -1))
            if bad.any():
                k = int(np.argmax(bad))
                raise NoiseModelError(
                    f"{kind} of measurement {k} is not symmetric: {M[k].tolist()}", kind, k, float(skewness[k])
                )
        self._whitener(M)  # raises where it is none

    def sqrt_information(self, n: int, names: tuple[str, ...]) -> Array:
        return self._whitener(self._checked(n, names))

    @abstractmethod
    def _whitener(self, M: Array) -> Array:
        """W of these symmetric matrices (k, m, m); raises `NoiseModelError` for one that is not (semi-)definite."""


class Covariance(_Symmetric):
    """Covariance Sigma, (m, m) shared or (n, m, m); must be positive definite.

    Raises
    ------
    NoiseModelError
        A matrix that is not symmetric or not positive definite; names the measurement.

    Examples
    --------
    >>> Covariance([[0.04, 0.01], [0.01, 0.09]])
    Covariance([[0.04, 0.01], [0.01, 0.09]])
    """

    def _whitener(self, M: Array) -> Array:
        if (variances := diagonal(M)) is not None:
            _check_positive(variances, quantity="Covariance")
            return np.asarray(1.0 / np.sqrt(variances))
        L, bad = cholesky(M)
        if bad.any():
            k = int(np.argmax(bad))
            smallest = float(np.linalg.eigvalsh(M[k])[0])
            raise NoiseModelError(
                f"Covariance of measurement {k} is not positive definite beyond rounding (smallest eigenvalue "
                f"{smallest:.6g}): {M[k].tolist()}",
                "covariance",
                k,
                smallest,
            )
        return np.asarray(np.linalg.inv(L))


class Information(_Symmetric):
    """Information Omega = Sigma^-1, (m, m) shared or (n, m, m); semi-definite is legal, negative is not.

    Raises
    ------
    NoiseModelError
        A matrix that is not symmetric or has a negative eigenvalue; names the measurement.
    """

    def _whitener(self, M: Array) -> Array:
        if (weights := diagonal(M)) is not None and (weights >= 0).all():
            return np.sqrt(weights)
        L, bad = cholesky(M)
        W = L.mT
        if bad.any():
            W = np.ascontiguousarray(W)
            W[bad] = self._semi_definite(M[bad], np.flatnonzero(bad))
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


def _check_positive(sigmas: Array, names: tuple[str, ...] = (), quantity: str = "sigma") -> None:
    """Refuse standard deviations or variances (k, m) that are not above 0, by the name or number of the component."""
    if (sigmas > 0).all():
        return
    k, j = (int(i) for i in np.argwhere(~(sigmas > 0))[0])
    name = names[j] if names else f"component {j}"
    place = f"{name}, measurement {k}," if names or sigmas.shape[1] > 1 else f"measurement {k}"
    value = float(sigmas[k, j])
    raise NoiseModelError(f"{quantity} of {place} is {value:g}, expected > 0", quantity, k, value)


def _shown(array: Array) -> str:
    """The numbers of an array, or of many how many there are and their range; one for all without brackets around it.

    Examples
    --------
    >>> _shown(np.array([0.1])), _shown(np.array([[0.1, 0.2]])), _shown(np.linspace(0.1, 0.3, 500))
    ('0.1', '[0.1, 0.2]', '500 of them, 0.1 to 0.3')
    """
    if array.size > SHOWN:
        return f"{' x '.join(map(str, array.shape))} of them, {_range(array)}"
    numbers = array[0] if len(array) == 1 else array
    text = np.array2string(numbers, separator=", ", formatter={"float_kind": "{:.6g}".format}, max_line_width=1000)
    return " ".join(text.split())


def _range(array: Array) -> str:
    """``0.1 to 0.3``; one number where all are the same."""
    low, high = f"{array.min():.6g}", f"{array.max():.6g}"
    return low if low == high else f"{low} to {high}"
