r"""Robust kernels: the limited cost of a measurement far from its prediction, as a weight on its whitened residual.

With s = |b_i|^2, the squared whitened residual of measurement i, least squares minimizes sum s. A kernel minimizes

    chi2 = sum rho(s),   rho(s) = s near 0, growing more slowly farther out

and is solved by weights w = d rho / ds, taken at the linearization point: A_i <- sqrt(w) A_i, b_i <- sqrt(w) b_i. Then
A'b is exactly half the downhill gradient of chi2, and a weight of 1 means an inlier, near 0 an outlier.

    Huber(c)          rho = s                        for s <= c^2,  2 c sqrt(s) - c^2                beyond
    Cauchy(c)         rho = c^2 log(1 + s / c^2)
    GemanMcClure(c)   rho = c^2 s / (c^2 + s)
    Welsch(c)         rho = c^2 (1 - exp(-s / c^2))
    Tukey(c)          rho = c^2/3 (1 - (1 - s/c^2)^3) for s <= c^2,  c^2 / 3                         beyond
    DCS(phi)          rho = s                        for s <= phi,  phi (3 s - phi) / (s + phi)      beyond

Huber is convex; the others forget what is far out, and have local minima: they want a good start. Sources: Z. Zhang,
"Parameter estimation techniques", Image and Vision Computing 15, 1997, table 1; P. Agarwal et al., "Robust map
optimization using dynamic covariance scaling", ICRA 2013 (rho is the cost whose weights are that paper's s^2).
"""

from __future__ import annotations

import math
from abc import abstractmethod

import numpy as np

from factors.noise import Noise
from models.abstract import Abstract
from models.algebra import Array
from models.errors import NoiseModelError, OptionError
from models.options import did_you_mean, is_number

__all__ = [
    "DCS",
    "KERNELS",
    "Cauchy",
    "GemanMcClure",
    "Huber",
    "Kernel",
    "Robust",
    "Tukey",
    "Welsch",
    "kernel_from_text",
    "reweighted",
]


class Kernel(Abstract):
    """A robust cost rho of the squared whitened residual s, and its weight w = d rho / ds.

    Parameters
    ----------
    c : where it leaves the parabola, in sigmas; for `DCS` the squared residual phi.

    Raises
    ------
    OptionError
        c is no number above 0, or its square overflows or vanishes.
    """

    c: float

    def __init__(self, c: float) -> None:
        if not is_number(c) or not c > 0 or not 0 < float(c) * float(c) < math.inf:
            raise OptionError(f"{type(self).__name__}(c)", c, "a number above 0 whose square is finite, in sigmas")
        self.c = float(c)

    @abstractmethod
    def rho(self, s: Array) -> Array:
        """Cost (n,) of squared whitened residuals s (n,)."""

    @abstractmethod
    def weight(self, s: Array) -> Array:
        """d rho / ds (n,), in [0, 1]."""

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash((type(self), self.c))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.c:g})"


class Huber(Kernel):
    """Linear beyond c sigmas; convex.

    Examples
    --------
    >>> import numpy as np
    >>> Huber(2.0).weight(np.array([1.0, 16.0])), Huber(2.0).rho(np.array([1.0, 16.0]))
    (array([1. , 0.5]), array([ 1., 12.]))
    """

    def rho(self, s: Array) -> Array:
        c = self.c
        return np.where(s <= c * c, s, 2 * c * np.sqrt(s) - c * c)

    def weight(self, s: Array) -> Array:
        return self.c / np.maximum(np.sqrt(s), self.c)


class Cauchy(Kernel):
    """Logarithmic: no residual is ignored, none counts much."""

    def rho(self, s: Array) -> Array:
        return np.asarray(self.c**2 * np.log1p(s / self.c**2))

    def weight(self, s: Array) -> Array:
        return self.c**2 / (self.c**2 + s)


class GemanMcClure(Kernel):
    """Bounded by c^2."""

    def rho(self, s: Array) -> Array:
        return s * (self.c**2 / (self.c**2 + s))

    def weight(self, s: Array) -> Array:
        return (self.c**2 / (self.c**2 + s)) ** 2


class Welsch(Kernel):
    """Bounded by c^2, with weights that vanish exponentially."""

    def rho(self, s: Array) -> Array:
        return np.asarray(-(self.c**2) * np.expm1(-s / self.c**2))

    def weight(self, s: Array) -> Array:
        return np.asarray(np.exp(-s / self.c**2))


class Tukey(Kernel):
    """Bounded by c^2 / 3; beyond c sigmas a measurement has no weight at all."""

    def _inside(self, s: Array) -> Array:
        return 1 - np.minimum(s / self.c**2, 1.0)

    def rho(self, s: Array) -> Array:
        return self.c**2 / 3 * (1 - self._inside(s) ** 3)

    def weight(self, s: Array) -> Array:
        return self._inside(s) ** 2


class DCS(Kernel):
    """Dynamic covariance scaling: a switch per measurement in closed form; c is phi, compared with s itself."""

    def rho(self, s: Array) -> Array:
        phi = self.c
        return np.where(s <= phi, s, phi * (3 - 4 * phi / (phi + s)))

    def weight(self, s: Array) -> Array:
        return np.minimum(1.0, 2 * self.c / (self.c + s)) ** 2


# Numbers that keep 95 % of the efficiency under Gaussian noise. P. Holland, R. Welsch, "Robust regression using
# iteratively reweighted least-squares", Communications in Statistics 6(9), 1977.
EFFICIENT = {"huber": 1.345, "cauchy": 2.385, "tukey": 4.685, "welsch": 2.985}
KERNELS: dict[str, type[Kernel]] = {
    "huber": Huber,
    "cauchy": Cauchy,
    "tukey": Tukey,
    "geman-mcclure": GemanMcClure,
    "welsch": Welsch,
    "dcs": DCS,
}


def kernel_from_text(text: str) -> Kernel:
    """A kernel from ``name:number``, as on the command line; of those in `EFFICIENT` the number may be left out.

    Raises
    ------
    OptionError
        No such kernel, or a number that it cannot have.

    Examples
    --------
    >>> kernel_from_text("huber:1.345")
    Huber(1.345)
    """
    name, colon, number = text.partition(":")
    allowed = "one of " + ", ".join(f"{name}:NUMBER" for name in KERNELS) + ", the number in sigmas"
    if name not in KERNELS:
        raise OptionError("robust", text, allowed + did_you_mean(name, KERNELS))
    try:
        c = float(number) if colon or name not in EFFICIENT else EFFICIENT[name]
    except ValueError as error:
        raise OptionError("robust", text, f"{name}:NUMBER, the number in sigmas") from error
    try:
        return KERNELS[name](c)
    except OptionError as error:
        raise OptionError("robust", text, error.allowed) from error


class Robust(Noise):
    """A noise whose measurements may be outliers: the noise whitens, the kernel weighs the whitened residual.

    Parameters
    ----------
    noise : the noise of an inlier.
    kernel : `Huber`, `Cauchy`, `Tukey`, `GemanMcClure`, `Welsch` or `DCS`.

    Raises
    ------
    NoiseModelError
        Not a noise and a kernel, or a noise that is robust already.

    Notes
    -----
    `Factor.weights` tells afterwards what became of each measurement.

    Examples
    --------
    >>> from factors import Huber, Isotropic, Prior, Robust
    >>> from models import R
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> fixes = Prior(x[[0, 0, 0]], [[0.0], [0.1], [50.0]], Robust(Isotropic(0.1), Huber(1.0)))
    >>> result = FactorGraph([fixes]).optimize(Values({x: (R(1), [10.0])}))
    >>> result.values[x[0]].round(1), fixes.weights(result.values).round(2)
    (array([0.1]), array([1., 1., 0.]))
    """

    def __init__(self, noise: Noise, kernel: Kernel) -> None:
        if not isinstance(noise, Noise) or isinstance(noise, Robust):
            raise NoiseModelError(f"Robust: expected a noise such as Isotropic(0.1), not robust already, got {noise!r}")
        if not isinstance(kernel, Kernel):
            raise NoiseModelError(f"Robust: expected a kernel such as Huber(1.345), got {kernel!r:.60}")
        self.noise, self.kernel = noise, kernel

    def sqrt_information(self, n: int, names: tuple[str, ...]) -> Array:
        return self.noise.sqrt_information(n, names)

    def __repr__(self) -> str:
        return f"Robust({self.noise!r}, {self.kernel!r})"


def reweighted(kernel: Kernel, A: tuple[Array, ...], b: Array) -> tuple[tuple[Array, ...], Array, Array]:
    """sqrt(w) A_k, sqrt(w) b and the costs rho (n,) of whitened Jacobians (n, m, d) and residuals (n, m)."""
    s = np.square(b).sum(axis=1)
    root = np.sqrt(kernel.weight(s))
    return tuple(A_k * root[:, None, None] for A_k in A), b * root[:, None], kernel.rho(s)
