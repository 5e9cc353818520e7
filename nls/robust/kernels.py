r"""Robust kernels that are bent slowly, by a number mu, from a parabola to their final shape.

    truncated squares      w = 1 for s <= mu/(mu+1) c^2,   0 for s >= (mu+1)/mu c^2,   c sqrt(mu(mu+1)/s) - mu between
    Geman and McClure's    w = (mu c^2 / (mu c^2 + s))^2

mu of the first rises from near 0, of the second falls to 1.

Source: H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated non-convexity for robust spatial perception", RA-L
5(2), 2020.
"""

from abc import abstractmethod

import numpy as np

from factors.robust import Kernel
from models.algebra import Array

FASTER = 1.4  # mu from step to step, as in the paper


class Graduated(Kernel):
    """A kernel with a `mu` that is changed while the kernel is in use, until it is `done`."""

    mu = 1.0
    done = False

    @abstractmethod
    def begin(self, worst: float) -> None:
        """Take the mu at which the worst squared residual still pulls."""

    @abstractmethod
    def bend(self) -> None:
        """Take the next mu; done after the last."""


class TruncatedSquares(Graduated):
    """min(s, c^2), made convex by a small mu."""

    def rho(self, s: Array) -> Array:
        c, mu = self.c, self.mu
        between = 2 * c * np.sqrt(mu * (mu + 1) * s) - mu * (c * c + s)
        return np.where(s <= mu / (mu + 1) * c * c, s, np.where(s >= (mu + 1) / mu * c * c, c * c, between))

    def weight(self, s: Array) -> Array:
        c, mu = self.c, self.mu
        least = mu / (mu + 1) * c * c
        return np.clip(c * np.sqrt(mu * (mu + 1) / np.maximum(s, least)) - mu, 0.0, 1.0)

    def begin(self, worst: float) -> None:
        self.mu = self.c**2 / max(2 * worst - self.c**2, self.c**2)

    def bend(self) -> None:
        self.mu *= FASTER
        self.done = self.mu >= 1e3  # as good as truncated


class GemanMcClureSquares(Graduated):
    """Geman and McClure's kernel, c^2 s / (c^2 + s), with c^2 widened by a large mu."""

    def rho(self, s: Array) -> Array:
        wide = self.mu * self.c**2
        return wide * s / (wide + s)

    def weight(self, s: Array) -> Array:
        wide = self.mu * self.c**2
        return np.square(wide / (wide + s))

    def begin(self, worst: float) -> None:
        self.mu = max(2 * worst / self.c**2, 1.0)

    def bend(self) -> None:
        self.done, self.mu = self.mu == 1.0, max(self.mu / FASTER, 1.0)


LOSSES: dict[str, type[Graduated]] = {"tls": TruncatedSquares, "gm": GemanMcClureSquares}
