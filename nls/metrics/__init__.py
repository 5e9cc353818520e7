"""How far an estimate is from the truth: absolute and relative errors of trajectories, matched by time; circles."""

from nls.metrics.errors import (
    ALIGNMENTS,
    DISTANCES,
    RelativeError,
    TrajectoryError,
    ate,
    cep,
    circles,
    displacements,
    drms2,
    rpe,
)
from nls.metrics.matching import Matched, matched

__all__ = [
    "ALIGNMENTS",
    "DISTANCES",
    "Matched",
    "RelativeError",
    "TrajectoryError",
    "ate",
    "cep",
    "circles",
    "displacements",
    "drms2",
    "matched",
    "rpe",
]
