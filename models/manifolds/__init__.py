"""Spaces in which poses, rotations and points live; see the notation page for storage, frames and tangent order."""

from models.manifolds import euler
from models.manifolds.base import LieGroup, Manifold
from models.manifolds.line import LINE
from models.manifolds.measured import Measured
from models.manifolds.rn import R
from models.manifolds.s2 import S2
from models.manifolds.se2 import SE2
from models.manifolds.se3 import SE3
from models.manifolds.so2 import SO2
from models.manifolds.so3 import SO3

__all__ = ["LINE", "S2", "SE2", "SE3", "SO2", "SO3", "LieGroup", "Manifold", "Measured", "R", "euler"]
