"""Pictures: trajectories, ellipses, sparsity, convergence. matplotlib is imported in this folder only, and lazily."""

from nls.plot.convergence import convergence
from nls.plot.ellipses import ellipses
from nls.plot.sparsity import spy
from nls.plot.trajectory import before_after, trajectory

__all__ = ["before_after", "convergence", "ellipses", "spy", "trajectory"]
