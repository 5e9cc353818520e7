"""The 35 least-squares problems of More, Garbow and Hillstrom: functions, starts and published minima.

Each residual is written for unknowns x (n, k), components first, and returns (m, k): k points at once. It may also be
given complex numbers: `jacobian` differentiates it by a step along the imaginary axis, exact to rounding. Source:
J. More, B. Garbow, K. Hillstrom, "Testing unconstrained optimization software", ACM TOMS 7(1), 1981; the formula of
problem 11 is misprinted there, this is the one that MINPACK's tests use and that vanishes at the published solution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from factors import Factor
from models import R
from models.algebra import Array
from nls import FactorGraph, Values, kinds

(p,) = kinds("p")


@dataclass(frozen=True)
class Problem:
    """A residual of R^n, where to start, and the published values of |f|^2 at its minima, also those at infinity."""

    name: str
    residual: Callable[[Array], Array]
    start: tuple[float, ...]
    minima: tuple[float, ...]

    def f(self, X: Array) -> Array:
        """Residuals (k, m) at the points X (k, n), as a factor wants them."""
        with np.errstate(all="ignore"):  # some starts overflow: the library has to see that itself
            return np.asarray(self.residual(X.T)).T

    def jacobian(self, X: Array) -> list[Array]:
        """df/dx (k, m, n) by the imaginary part of f(x + ih) / h."""
        h = 1e-30
        columns = [self.f(X + 1j * h * unit).imag / h for unit in np.eye(X.shape[1])]
        return [np.stack(columns, axis=2)]

    def graph(self, exact: bool = True) -> FactorGraph:
        """One factor over one variable; Jacobians exact, or by the differences of the library."""
        dim = len(self.residual(np.array(self.start)[:, None]))
        return FactorGraph([Factor.from_function(self.f, p[0], dim, jacobians=self.jacobian if exact else None)])

    def values(self, multiple: float = 1.0) -> Values:
        """A multiple of the published start."""
        return Values({p: (R(len(self.start)), [multiple * np.array(self.start)])})


def freudenstein_roth(x: Array) -> Array:
    a, b = x
    return np.stack([-13 + a + ((5 - b) * b - 2) * b, -29 + a + ((b + 1) * b - 14) * b])


def powell_badly_scaled(x: Array) -> Array:
    return np.stack([1e4 * x[0] * x[1] - 1, np.exp(-x[0]) + np.exp(-x[1]) - 1.0001])


def beale(x: Array) -> Array:
    y, i = numbers("1.5 2.25 2.625"), count(3)
    return y - x[0] * (1 - x[1] ** i)


def jennrich_sampson(x: Array) -> Array:
    i = count(10)
    return 2 + 2 * i - (np.exp(i * x[0]) + np.exp(i * x[1]))


def helical_valley(x: Array) -> Array:
    a, b, c = x
    theta = np.arctan(b / a) / (2 * np.pi) + np.where(a.real < 0, 0.5, 0.0)
    return np.stack([10 * (c - 10 * theta), 10 * (np.sqrt(a * a + b * b) - 1), c])


def bard(x: Array) -> Array:
    y = numbers("0.14 0.18 0.22 0.25 0.29 0.32 0.35 0.39 0.37 0.58 0.73 0.96 1.34 2.10 4.39")
    u = count(15)
    v = 16 - u
    return y - (x[0] + u / (v * x[1] + np.minimum(u, v) * x[2]))


def gaussian(x: Array) -> Array:
    half = numbers("0.0009 0.0044 0.0175 0.0540 0.1295 0.2420 0.3521 0.3989")
    t, y = (8 - count(15)) / 2, np.concatenate([half, half[-2::-1]])
    return x[0] * np.exp(-x[1] * (t - x[2]) ** 2 / 2) - y


def meyer(x: Array) -> Array:
    y = numbers("34780 28610 23650 19630 16370 13720 11540 9744 8261 7030 6005 5147 4427 3820 3307 2872")
    return x[0] * np.exp(x[1] / (45 + 5 * count(16) + x[2])) - y


def gulf_research(x: Array) -> Array:
    t = count(99) / 100
    y = 25 + (-50 * np.log(t)) ** (2 / 3)
    distance = np.sqrt((y - x[1]) ** 2)  # |y - x2|, also for complex numbers
    return np.exp(-(distance ** x[2]) / x[0]) - t


def box_three_dimensional(x: Array) -> Array:
    t = count(10) / 10
    return np.exp(-t * x[0]) - np.exp(-t * x[1]) - x[2] * (np.exp(-t) - np.exp(-10 * t))


def powell_singular(x: Array) -> Array:
    a, b, c, d = x
    return np.stack([a + 10 * b, np.sqrt(5) * (c - d), (b - 2 * c) ** 2, np.sqrt(10) * (a - d) ** 2])


def wood(x: Array) -> Array:
    a, b, c, d = x
    tied = [np.sqrt(10) * (b + d - 2), (b - d) / np.sqrt(10)]
    return np.stack([10 * (b - a * a), 1 - a, np.sqrt(90) * (d - c * c), 1 - c, *tied])


def kowalik_osborne(x: Array) -> Array:
    u = numbers("4 2 1 0.5 0.25 0.167 0.125 0.1 0.0833 0.0714 0.0625")
    y = numbers("0.1957 0.1947 0.1735 0.16 0.0844 0.0627 0.0456 0.0342 0.0323 0.0235 0.0246")
    return y - x[0] * (u * u + u * x[1]) / (u * u + u * x[2] + x[3])


def brown_dennis(x: Array) -> Array:
    t = count(20) / 5
    return (x[0] + t * x[1] - np.exp(t)) ** 2 + (x[2] + x[3] * np.sin(t) - np.cos(t)) ** 2


def osborne_1(x: Array) -> Array:
    t = 10 * (count(33) - 1)
    return OSBORNE_1 / 1000 - (x[0] + x[1] * np.exp(-t * x[3]) + x[2] * np.exp(-t * x[4]))


def biggs_exp6(x: Array) -> Array:
    t = count(13) / 10
    y = np.exp(-t) - 5 * np.exp(-10 * t) + 3 * np.exp(-4 * t)
    return x[2] * np.exp(-t * x[0]) - x[3] * np.exp(-t * x[1]) + x[5] * np.exp(-t * x[4]) - y


def osborne_2(x: Array) -> Array:
    t = (count(65) - 1) / 10
    bells = [x[k] * np.exp(-((t - x[k + 7]) ** 2) * x[k + 4]) for k in (1, 2, 3)]
    return OSBORNE_2 / 1000 - (x[0] * np.exp(-t * x[4]) + sum(bells))


def watson(x: Array) -> Array:
    t, j = count(29) / 29, np.arange(len(x))
    value, slope = t**j @ x, (j[1:] * t ** j[:-1]) @ x[1:]
    return np.concatenate([slope - value**2 - 1, x[:1], x[1:2] - x[:1] ** 2 - 1])


def extended_powell_singular(x: Array) -> Array:
    return np.concatenate([powell_singular(x[k : k + 4]) for k in range(0, len(x), 4)])


def penalty_1(x: Array) -> Array:
    return np.concatenate([np.sqrt(1e-5) * (x - 1), [(x * x).sum(axis=0) - 0.25]])


def penalty_2(x: Array) -> Array:
    n, root, e, k = len(x), np.sqrt(1e-5), np.exp(x / 10), np.exp(count(len(x)) / 10)
    pairs = root * (e[1:] + e[:-1] - (k[1:] + k[:-1]))
    ones = root * (e[1:] - np.exp(-1 / 10))
    weighted = ((n + 1 - count(n)) * x * x).sum(axis=0) - 1
    return np.concatenate([x[:1] - 0.2, pairs, ones, [weighted]])


def variably_dimensioned(x: Array) -> Array:
    s = (count(len(x)) * (x - 1)).sum(axis=0)
    return np.concatenate([x - 1, [s, s * s]])


def trigonometric(x: Array) -> Array:
    n, i = len(x), count(len(x))
    return n - np.cos(x).sum(axis=0) + i * (1 - np.cos(x)) - np.sin(x)


def brown_almost_linear(x: Array) -> Array:
    return np.concatenate([x[:-1] + x.sum(axis=0) - (len(x) + 1), [x.prod(axis=0) - 1]])


def discrete_boundary_value(x: Array) -> Array:
    h, t = 1 / (len(x) + 1), count(len(x)) / (len(x) + 1)
    padded = np.pad(x, ((1, 1), (0, 0)))
    return 2 * x - padded[:-2] - padded[2:] + h * h * (x + t + 1) ** 3 / 2


def discrete_integral_equation(x: Array) -> Array:
    h, t = 1 / (len(x) + 1), count(len(x)) / (len(x) + 1)
    kernel = np.minimum(t, t.T) * (1 - np.maximum(t, t.T))
    return x + h / 2 * kernel @ (x + t + 1) ** 3


def broyden_tridiagonal(x: Array) -> Array:
    padded = np.pad(x, ((1, 1), (0, 0)))
    return (3 - 2 * x) * x - padded[:-2] - 2 * padded[2:] + 1


def broyden_banded(x: Array) -> Array:
    i = np.arange(len(x))
    near = (i >= i[:, None] - 5) & (i <= i[:, None] + 1) & (i != i[:, None])
    return x * (2 + 5 * x * x) + 1 - near @ (x * (1 + x))


def linear_full_rank(x: Array, m: int = 15) -> Array:
    return np.pad(x, ((0, m - len(x)), (0, 0))) - 2 / m * x.sum(axis=0) - 1


def linear_rank_1_zeros(x: Array, m: int = 15) -> Array:
    rows = np.where(count(m) < m, count(m) - 1, 0)
    return rows * (count(len(x)) * x)[1:-1].sum(axis=0) - 1


def chebyquad(x: Array) -> Array:
    n, y = len(x), 2 * x - 1
    T = [np.ones_like(y), y]
    for _ in range(n - 1):
        T.append(2 * y * T[-1] - T[-2])
    i = count(n)
    integral = np.where(i % 2 == 0, -1 / (np.where(i == 1, 2, i) ** 2 - 1), 0.0)
    return np.stack([t.mean(axis=0) for t in T[1:]]) - integral


def count(n: int) -> Array:
    """1 ... n as a column."""
    return np.arange(1.0, n + 1)[:, None]


def numbers(text: str) -> Array:
    """Data, one number after the other, as a column."""
    return np.array(text.split(), dtype=float)[:, None]


OSBORNE_1 = numbers(
    "844 908 932 936 925 908 881 850 818 784 751 718 685 658 628 603 580 558 538 522 506 490 478 467 457 448 438 "
    "431 424 420 414 411 406"
)
OSBORNE_2 = numbers(
    "1366 1191 1112 1013 991 885 831 847 786 725 746 679 608 655 616 606 602 626 651 724 649 649 694 644 624 661 "
    "612 558 533 495 500 423 395 375 372 391 396 405 428 429 523 562 607 653 672 708 633 668 645 632 591 559 597 "
    "625 739 710 729 720 636 581 428 292 162 98 54"
)


def _fractions(n: int) -> tuple[float, ...]:
    return tuple(k / (n + 1) for k in range(1, n + 1))


PROBLEMS = (
    Problem("rosenbrock", lambda x: np.stack([10 * (x[1] - x[0] ** 2), 1 - x[0]]), (-1.2, 1), (0,)),
    Problem("freudenstein_roth", freudenstein_roth, (0.5, -2), (0, 48.9842)),
    Problem("powell_badly_scaled", powell_badly_scaled, (0, 1), (0,)),
    Problem("brown_badly_scaled", lambda x: np.stack([x[0] - 1e6, x[1] - 2e-6, x[0] * x[1] - 2]), (1, 1), (0,)),
    Problem("beale", beale, (1, 1), (0,)),
    Problem("jennrich_sampson", jennrich_sampson, (0.3, 0.4), (124.362,)),
    Problem("helical_valley", helical_valley, (-1, 0, 0), (0,)),
    Problem("bard", bard, (1, 1, 1), (8.21487e-3, 17.4286)),
    Problem("gaussian", gaussian, (0.4, 1, 0), (1.12793e-8,)),
    Problem("meyer", meyer, (0.02, 4000, 250), (87.9458,)),
    Problem("gulf_research", gulf_research, (5, 2.5, 0.15), (0,)),
    Problem("box_three_dimensional", box_three_dimensional, (0, 10, 20), (0,)),
    Problem("powell_singular", powell_singular, (3, -1, 0, 1), (0,)),
    Problem("wood", wood, (-3, -1, -3, -1), (0,)),
    Problem("kowalik_osborne", kowalik_osborne, (0.25, 0.39, 0.415, 0.39), (3.07505e-4, 1.02734e-3)),
    Problem("brown_dennis", brown_dennis, (25, 5, -5, -1), (85822.2,)),
    Problem("osborne_1", osborne_1, (0.5, 1.5, -1, 0.01, 0.02), (5.46489e-5,)),
    Problem("biggs_exp6", biggs_exp6, (1, 2, 1, 1, 1, 1), (0, 5.65565e-3)),
    Problem("osborne_2", osborne_2, (1.3, 0.65, 0.65, 0.7, 0.6, 3, 5, 7, 2, 4.5, 5.5), (4.01377e-2,)),
    Problem("watson", watson, (0,) * 6, (2.28767e-3,)),
    Problem("extended_rosenbrock", lambda x: np.r_[10 * (x[1::2] - x[::2] ** 2), 1 - x[::2]], (-1.2, 1) * 5, (0,)),
    Problem("extended_powell_singular", extended_powell_singular, (3, -1, 0, 1) * 3, (0,)),
    Problem("penalty_1", penalty_1, (1, 2, 3, 4), (2.24997e-5,)),
    Problem("penalty_2", penalty_2, (0.5,) * 4, (9.37629e-6,)),
    Problem("variably_dimensioned", variably_dimensioned, tuple(1 - k / 10 for k in range(1, 11)), (0,)),
    Problem("trigonometric", trigonometric, (0.1,) * 10, (0,)),
    Problem("brown_almost_linear", brown_almost_linear, (0.5,) * 10, (0, 1)),
    Problem("discrete_boundary_value", discrete_boundary_value, tuple(t * (t - 1) for t in _fractions(10)), (0,)),
    Problem("discrete_integral_equation", discrete_integral_equation, tuple(t * (t - 1) for t in _fractions(10)), (0,)),
    Problem("broyden_tridiagonal", broyden_tridiagonal, (-1,) * 10, (0,)),
    Problem("broyden_banded", broyden_banded, (-1,) * 10, (0,)),
    Problem("linear_full_rank", linear_full_rank, (1,) * 10, (5,)),
    Problem("linear_rank_1", lambda x: count(15) * (count(len(x)) * x).sum(axis=0) - 1, (1,) * 10, (15 * 14 / 62,)),
    Problem("linear_rank_1_zeros", linear_rank_1_zeros, (1,) * 10, ((15**2 + 3 * 15 - 6) / (2 * (2 * 15 - 3)),)),
    Problem("chebyquad", chebyquad, _fractions(7), (0,)),
    Problem("chebyquad_8", chebyquad, _fractions(8), (3.51687e-3,)),
)
