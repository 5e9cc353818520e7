"""Recursive estimators fed with the factors of a graph: a step per pose, with the measurements up to it and none later.

Every filter takes h, its Jacobians, the noise and the differences of angles from the factors. So one `FactorGraph`
serves a filter and a batch solution alike.
"""

from nls.filters.association import Assignment, JointCompatibility, Nearest
from nls.filters.base import Filter, Step, Track, steps
from nls.filters.ekf import EKF
from nls.filters.fastslam import FastSLAM
from nls.filters.smoother import Smoother

__all__ = [
    "EKF",
    "Assignment",
    "FastSLAM",
    "Filter",
    "JointCompatibility",
    "Nearest",
    "Smoother",
    "Step",
    "Track",
    "steps",
]
