"""How far an estimate is from the truth: absolute and relative errors of trajectories, matched by time; circles."""

from nls.metrics.absolute import ALIGNMENTS, TrajectoryError, ate, cep, circles, displacements, drms2
from nls.metrics.matching import Matched, matched
from nls.metrics.relative import DISTANCES, RelativeError, rpe

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
