"""The mathematics of spaces and sensors: arrays in, arrays out. Knows no graph."""

from models.algebra import wrap
from models.manifolds import LINE, S2, SE2, SE3, SO2, SO3, LieGroup, Manifold, Measured, R, euler

__all__ = ["LINE", "S2", "SE2", "SE3", "SO2", "SO3", "LieGroup", "Manifold", "Measured", "R", "euler", "wrap"]


def __dir__() -> list[str]:
    return sorted(__all__)
