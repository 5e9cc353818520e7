r"""FastSLAM 1.0 and 2.0: particles for the pose, and in each of them one small filter for every landmark.

Given the path, landmarks do not depend on each other. So a particle is a pose X and per landmark a mean l and a
covariance C. With whitened Jacobians A and innovations b of the factors (unit noise), at each step, for every particle:

    motion      m, Lambda = A_u' A_u                   where it leads, and the information of that
    proposal    Lambda <- Lambda + sum A_x' S^-1 A_x,   g = sum A_x' S^-1 b,   S = I + A_l C A_l'        (2.0 only)
    draw        X = m Exp(delta),   delta ~ N(Lambda^-1 g, Lambda^-1)
    weight      w <- w p(X|u) / q(X) prod N(b; 0, S)    at the X drawn, q the density of the proposal
    landmarks   l <- l [+] K b,   C <- (I - K A_l) C (I - K A_l)' + K K',   K = C A_l' S^-1
    first seen  l from the measurement itself,   C = (A_l' A_l)^-1: the pose of a particle is exact
    resample    where the effective number of particles is below one half

The sums and products run over the landmarks seen before. All particles are evaluated in one call of a factor. Source:
M. Montemerlo, S. Thrun, FastSLAM, 2007, chapters 3 and 4; S. Thrun, W. Burgard, D. Fox, Probabilistic Robotics, 2005,
tables 13.1 and 13.3.
"""

from typing import Literal

import numpy as np

from factors.base import Factor
from factors.keys import Keys
from models.algebra import Array
from models.errors import GraphError, OptionError
from models.options import check_whole
from nls.filters.base import Filter, Step
from nls.filters.motion import Copies, Factors, copies, information, most_likely, slot_of
from nls.filters.particles import ParticleMap, covariance, each_once, effective, mean, normalized_weights, systematic
from nls.values import Values


class FastSLAM(Filter):
    """Particles for the path, small filters for the landmarks.

    Parameters
    ----------
    particles : their number N, at least 2.
    version : 1: poses are drawn from the motion alone; 2: from the motion and what is seen at the new pose, so that
        fewer of them are drawn where nothing was seen. 2.0 needs far fewer particles where the sensor is good.
    rng : source of everything drawn; the same generator state gives the same bits.

    Attributes
    ----------
    X : (N, size) the latest pose of each particle.
    parents : (N,) of the latest step, which particle of the step before each one descends from. It is 0, 1, ... N - 1
        where the step resampled nothing. Followed back over all steps, it gives the path of a particle.
    map : the landmarks of each particle; None before the first is found.

    Raises
    ------
    OptionError
        A number of particles or a version there is not.

    Notes
    -----
    The covariance of the pose is that of the sample. It is too small, the more so the longer the path and the fewer the
    particles. Each resampling keeps some paths and forgets the rest. So all particles soon descend from one of long ago
    and share its errors. For the same reason the landmarks of a loop are not corrected when it closes, beyond what the
    particles that are left still differ in.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import BearingRange, Between, Diagonal, Isotropic, Prior
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([
    ...     Prior(x[0], [0.0, 0.0, 0.0], Isotropic(1e-3)),
    ...     Between(x[0], x[1], [1.0, 0.0, 0.0], Isotropic(0.2)),
    ...     BearingRange(x[[0, 1]], l[0], [[0.0, 5.0], [0.0, 4.1]], Diagonal(bearing=0.01, range=0.01)),
    ... ])
    >>> start = Values({x: (SE2, SE2.identity(2)), l: (R(2), [0.0, 0.0])})
    >>> track = FastSLAM(particles=200, version=2, rng=np.random.default_rng(1)).run(graph, start)
    >>> track.X[1].round(1) + 0.0
    array([0.9, 0. , 0. ])
    """

    def __init__(self, particles: int, version: Literal[1, 2] = 2, *, rng: np.random.Generator) -> None:
        if version not in (1, 2):
            raise OptionError("FastSLAM: version", version, "1 or 2")
        if not isinstance(rng, np.random.Generator):
            raise OptionError("FastSLAM: rng", rng, "a numpy.random.Generator such as numpy.random.default_rng(1)")
        self.particles = check_whole("FastSLAM: particles", particles, 2)
        self.version, self.rng = version, rng

    @property
    def method(self) -> str:
        return f"FastSLAM {self.version}.0, {self.particles} particles"

    def start(self, step: Step, values: Values) -> None:
        """Draw the first pose from its own measurements, and use the sightings from there."""
        self.start_values, self.manifold = values, values.stack(step.pose.kind).manifold
        self.map: ParticleMap | None = None
        self.log_w, self.parents = np.zeros(self.particles), np.arange(self.particles)
        alone = [f for f in step.observations if self._about(f, step.pose) == "pose"]
        X = np.tile(values[step.pose], (self.particles, 1))
        others = [f for f in step.observations if f not in alone]
        self._move(step.pose, X, [(self._copies(f), 0, ()) for f in alone], others)

    def step(self, step: Step) -> None:
        """Move every particle to the next pose and weigh it by the sightings there."""
        self.parents = np.arange(self.particles)
        if effective(self.weights) < self.particles / 2:
            self._resample()
        motion = [(self._copies(f), slot_of(f, step.pose), (self.X,)) for f in step.motion]
        self._move(step.pose, self.X, motion, step.observations)

    @property
    def weights(self) -> Array:
        """Weights (N,) of the particles, adding up to 1."""
        return normalized_weights(self.log_w)

    @property
    def pose(self) -> tuple[Array, Array]:
        """Mean (size,) of the latest pose over the particles and their covariance (d, d); too small, see the class."""
        X, w = self.X[:, None], self.weights
        center = mean(self.manifold, X, w)
        return center[0], covariance(self.manifold, center, X, w)[0]

    @property
    def landmarks(self) -> tuple[Keys, Array, Array]:
        """The landmarks over all particles: the mean of their covariances, and the spread of their means."""
        if self.map is None:
            return Keys("l", np.zeros(0, dtype=np.int64)), np.zeros((0, 0)), np.zeros((0, 0, 0))
        return self.map.estimate(self.weights)

    def _move(self, pose: Keys, X: Array, motion: Factors, observations: list[Factor]) -> None:
        """Draw the new pose of every particle from the proposal, weigh it, and update the landmarks there."""
        about = [(f, self._about(f, pose)) for f in observations]
        for factor in (f for f, role in about if role == "landmark"):
            self._know(factor)
        sightings = [f for f, role in about if role == "sighting"]
        alone = [self._copies(f) for f, role in about if role == "pose"]

        m, Lambda = most_likely(motion, self.manifold, X, pose)
        g = np.zeros((self.particles, self.manifold.dim))
        if self.version == 2 and (parts := self._looks(m, alone, sightings)):
            more, g = information(parts, self.particles)
            Lambda = Lambda + more
        U = np.linalg.cholesky(Lambda)  # Lambda = U U', delta = Lambda^-1 g + U^-T epsilon
        epsilon = self.rng.standard_normal(g.shape)
        white = np.linalg.solve(U, g[..., None])[..., 0] + epsilon
        self.X = self.manifold.retract(m, np.linalg.solve(U.mT, white[..., None])[..., 0])

        log_q = np.log(np.diagonal(U, axis1=1, axis2=2)).sum(axis=1) - np.square(epsilon).sum(axis=1) / 2
        log_p = [-copied.chi2(*states[:slot], self.X, *states[slot:]) / 2 for copied, slot, states in motion]
        log_p += [-copied.chi2(self.X) / 2 for copied in alone]
        self.log_w = self.log_w + np.sum(log_p, axis=0) - log_q
        for factor in sightings:
            for once in each_once(factor):
                self._see(once)

    def _looks(self, m: Array, alone: list[Copies], sightings: list[Factor]) -> list[tuple[Array, Array]]:
        """Whitened A_x and b (per row, unit noise) of what is measured at poses m, the landmarks uncertain."""
        parts = []
        for copied in alone:
            (A_x,), b = copied.linearize(m)
            parts.append((A_x, b))
        for factor in sightings:
            of = self._map(factor.keys[1].kind)
            known, _ = of.known(factor)
            if known is not None:
                A, b, S = of.innovation(self._copies(known), m)
                V = np.linalg.cholesky(S)  # S = V V',  A_x' S^-1 A_x = (V^-1 A_x)'(V^-1 A_x)
                A_x = A[:, :, : self.manifold.dim]
                parts.append((np.linalg.solve(V, A_x), np.linalg.solve(V, b[..., None])[..., 0]))
        return parts

    def _see(self, factor: Factor) -> None:
        """Weigh the particles by sightings of different landmarks, and update these; start those not known."""
        of = self._map(factor.keys[1].kind)
        known, new = of.known(factor)
        if known is not None:
            self.log_w = self.log_w + of.update(self._copies(known), self.X)
        if new is not None:
            of.start(new, self.manifold, self.X)

    def _know(self, factor: Factor) -> None:
        """Knowledge of landmarks without a pose, such as a chart: they begin there, or are updated."""
        of = self._map(factor.keys[0].kind)
        for once in each_once(factor):
            known, new = of.known(once)
            if known is not None:
                self.log_w = self.log_w + of.update(self._copies(known))
            if new is not None:
                of.start_alone(new, self.start_values[new.keys[0]])

    def _resample(self) -> None:
        self.parents = systematic(self.weights, self.rng)
        self.X, self.log_w = self.X[self.parents], np.zeros(self.particles)
        if self.map is not None:
            self.map.resample(self.parents)

    def _map(self, kind: str) -> ParticleMap:
        if self.map is None:
            self.map = ParticleMap(kind, self.start_values.stack(kind).manifold, self.particles)
        return self.map

    def _copies(self, factor: Factor) -> Copies:
        """The factor for every particle."""
        manifolds = [self.start_values.stack(keys.kind).manifold for keys in factor.keys]
        return copies(factor, manifolds, self.particles)

    def _about(self, factor: Factor, pose: Keys) -> str:
        """Subject of a factor: the pose, a landmark, or a sighting of a landmark from the pose."""
        if factor.kernel is not None:
            message = f"{factor!r} has a robust kernel; particles are weighed by Gaussian noise alone"
            raise GraphError(f"FastSLAM: {message}", factor.keys, factor.name)
        match [keys.kind == pose.kind for keys in factor.keys]:
            case [True]:
                return "pose"
            case [False]:
                return "landmark"
            case [True, False]:
                return "sighting"
        message = f"{factor!r} is about more than {pose} and a landmark seen from it"
        cure = "use a graph or a Smoother for factors that connect several poses"
        raise GraphError(f"FastSLAM: {message}; {cure}", factor.keys, factor.name)
