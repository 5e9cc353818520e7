r"""Simulated worlds, and the three steps that all of them share: measure, chain, build.

    z = h Exp(v),   v ~ N(0, Sigma),   h = x_i^{-1} x_j

The noise is drawn in the tangent space at the true h. So the residual Log(h^-1 z) of the convention `log` is v itself.
chi2 at the truth is a chi-square variable with as many degrees of freedom as measured numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from factors import Between, Diagonal, Factor
from models import LieGroup
from models.algebra import Array, Index
from models.dead_reckoning.chain import chain
from models.errors import GraphError
from models.options import check_positive
from nls import FactorGraph, Values, kinds
from nls.metrics import ate
from sim.checks import check_not_negative, check_rng

F = TypeVar("F", bound=Factor)

__all__ = ["Simulated", "World", "chain", "measure", "position_error", "reflected"]


@dataclass(frozen=True)
class Simulated:
    """Numbers and measurements of every simulated world.

    Attributes
    ----------
    name : of the function that made it.
    truth : the true poses, kind ``x``, and what else is to be found.
    graph : the measurements.
    start : where a solver begins.
    """

    name: str
    truth: Values
    graph: FactorGraph
    start: Values

    @property
    def poses(self) -> int:
        """Number of poses."""
        return len(self.truth.stack("x"))

    @property
    def landmarks(self) -> int:
        """Number of landmarks."""
        return len(self.truth.stack("l"))

    def measured(self, factor: int, kind: type[F]) -> F:
        """A factor of the graph, which is of a kind."""
        measurements = self.graph.factors[factor]
        assert isinstance(measurements, kind)
        return measurements

    def ate(self, estimate: Values, align: str = "none") -> float:
        """Absolute trajectory error of an estimate, m rmse, after one of the alignments of `nls.metrics.ate`."""
        (x,) = kinds("x")
        return ate(estimate[x], self.truth[x], align).rmse


@dataclass(frozen=True)
class World(Simulated):
    """A simulated problem together with its answer.

    Attributes
    ----------
    name : of the function that made it.
    truth : the true poses, kind ``x``, numbers 0 .. n-1.
    graph : two factors: ``graph.factors[0]`` the odometry from each pose to the next, ``graph.factors[1]`` the loop
        closures. Relative measurements only: the gauge is free.
    start : the noisy odometry chained from the first true pose.
    seed : the whole number the generator was made from; None where it was made in another way.
    description : what the world is, in sentences with the numbers.
    """

    seed: int | None
    description: str

    @property
    def closures(self) -> int:
        """Number of loop closures."""
        return len(self.graph.factors[1])

    @property
    def rows(self) -> int:
        """Measured numbers, the rows of A: the expected chi2 at the truth."""
        return len(self.graph) * self.truth.stack("x").manifold.dim

    @property
    def dof(self) -> int:
        """Rows minus free columns with one pose held: the expected chi2 at the optimum."""
        return self.rows - self.truth.dim + self.truth.stack("x").manifold.dim


def measure(
    rng: np.random.Generator, group: LieGroup, X_i: Array, X_j: Array, sigmas: npt.ArrayLike, scale: float = 1.0
) -> Array:
    r"""Relative poses as a sensor would report them, z = h Exp(v) with h = X_i^{-1} X_j.

    Parameters
    ----------
    rng : source of the noise.
    group : the group of the poses.
    X_i, X_j : (n, size) true poses, in the stored form of the group.
    sigmas : (dim,) standard deviations of v, m and rad, translation first.
    scale : factor on the noise; 0 for exact measurements.

    Returns
    -------
    (n, size) array.

    Examples
    --------
    >>> import numpy as np
    >>> from models import SE2
    >>> X = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.5]])
    >>> measure(np.random.default_rng(0), SE2, X[:1], X[1:], [0.1, 0.1, 0.01], scale=0.0)
    array([[1. , 1. , 0.5]])
    """
    h = group.between(X_i, X_j)  # (n, size)
    v = rng.standard_normal((len(h), group.dim)) * np.asarray(sigmas, dtype=float)  # (n, dim)
    return group.retract(h, scale * v)


def build(
    name: str,
    group: LieGroup,
    X: Array,
    i: Index,
    j: Index,
    rng: np.random.Generator,
    sigma_t: float,
    sigma_r: float,
    noise_scale: float,
    description: str,
) -> World:
    """A world from its true poses and the pairs that see each other.

    Parameters
    ----------
    name : of the world.
    group : SE2 or SE3.
    X : (n, size) true poses, m and rad or unit quaternions.
    i, j : (k,) the pairs of the loop closures; pose j is measured from pose i.
    rng : source of the noise.
    sigma_t, sigma_r : standard deviations per component of translation, m, and rotation, rad.
    noise_scale : factor on the drawn noise; 0 gives exact measurements with unchanged weights.
    description : sentences; the counts and the noise are added here.

    Raises
    ------
    OptionError
        A standard deviation that is not above 0, a scale below 0.
    """
    check_rng(rng)
    check_positive(sigma_t=sigma_t, sigma_r=sigma_r)
    check_not_negative(noise_scale=noise_scale)
    (x,) = kinds("x")
    n, d = len(X), group.point_dim
    sigmas = np.repeat([sigma_t, sigma_r], [d, group.dim - d])
    step = np.arange(n - 1)
    odometry = measure(rng, group, X[:-1], X[1:], sigmas, noise_scale)
    closures = measure(rng, group, X[i], X[j], sigmas, noise_scale)
    graph = FactorGraph([Between(x[step], x[step + 1], odometry, Diagonal(sigmas))])
    graph.add(Between(x[i], x[j], closures, Diagonal(sigmas)))
    sentences = (
        f"{description} {n} poses in {group}, {n - 1} odometry measurements and {len(i)} loop closures; standard "
        f"deviation {noise_scale * sigma_t:g} m and {noise_scale * sigma_r:g} rad per component, weighted as "
        f"{sigma_t:g} m and {sigma_r:g} rad. Relative measurements only: the gauge is free."
    )
    truth = Values({x: (group, X)})
    start = Values({x: (group, chain(group, truth.stack(x).X[0], odometry))})
    return World(name, truth, graph, start, seed_of(rng), sentences)


def position_error(estimate: Values, truth: Values) -> float:
    r"""Root mean square distance of positions, m, after the estimate is moved onto the truth at the first pose.

    .. math:: \sqrt{\frac{1}{n} \sum_k |t(G \hat{x}_k) - t(x_k)|^2}, \quad G = x_0 \hat{x}_0^{-1}

    Parameters
    ----------
    estimate, truth : poses of kind ``x`` with the same numbers.

    Returns
    -------
    float, m.

    Raises
    ------
    GraphError
        The two do not hold the same poses.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
    >>> position_error(world.truth, world.truth)
    0.0
    """
    ours, true = estimate.stack("x"), truth.stack("x")
    group = true.manifold
    assert isinstance(group, LieGroup)
    if ours.manifold is not group or not np.array_equal(ours.numbers, true.numbers):
        raise GraphError(f"position_error: the estimate is {estimate!r}, the truth {truth!r}; expected the same poses")
    G = group.between(group.inverse(true.X[:1]), group.inverse(ours.X[:1]))
    away = group.position(group.compose(G, ours.X)) - group.position(true.X)
    return float(np.sqrt(np.mean(np.sum(away * away, axis=-1))))


def reflected(ranges: npt.ArrayLike) -> Array:
    r"""Ranges with noise as a sensor gives them: those below 0 are reflected at 0.

    .. math:: z = |h + v|, \quad v \sim N(0, \sigma^2)

    The mean square of z is that of h + v. The mean of z exceeds h by 0.8 sigma at h = 0, by 0.17 at h = sigma, by 0.02
    at 2 sigma and by 0.001 at 3 sigma. Drawing again until h + v is not negative has more bias, 0.29 sigma at h =
    sigma, and would change the random numbers that follow.

    Examples
    --------
    >>> reflected([1.5, -0.25])
    array([1.5 , 0.25])
    """
    return np.asarray(np.abs(ranges), dtype=float)


def seed_of(rng: np.random.Generator) -> int | None:
    """The whole number given to `numpy.random.default_rng`, where there was one."""
    sequence = getattr(rng.bit_generator, "seed_seq", None)
    entropy = getattr(sequence, "entropy", None)
    return int(entropy) if isinstance(entropy, int) and not getattr(sequence, "spawn_key", ()) else None
