"""Factors: one measurement kind per file; noise, measurement and spaces bound into whitened Jacobians and errors."""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:  # mypy would take it for a circle
    import nls.lazy  # noqa: F401  refuses packages of other programs that shadow `models`, and imports nothing

from factors.base import Factor
from factors.bearing import Bearing
from factors.bearing_range import BearingRange
from factors.between import Between
from factors.between_sensors import BetweenSensors
from factors.bundle import BundleProjection
from factors.check import check_jacobians
from factors.drifting_step import DriftingStep
from factors.dvl_leg import DvlLeg
from factors.elevation import Elevation, ElevationHinge
from factors.epipolar_arc import EpipolarArc
from factors.heading import Heading
from factors.landmark import Landmark
from factors.line import Line
from factors.noise import Covariance, Diagonal, Information, Isotropic, Noise, SqrtInformation
from factors.position import Position
from factors.prior import Prior
from factors.projection import Projection
from factors.range import Range
from factors.range_azimuth import RangeAzimuth
from factors.robust import DCS, Cauchy, GemanMcClure, Huber, Kernel, Robust, Tukey, Welsch
from factors.scaled_range import ScaledRange
from factors.sequential_match import SequentialMatch
from factors.shifted import Shifted
from factors.sighting import Sighting
from factors.sonar import sonar_factors
from factors.wheels import Wheels
from factors.xyh import XYH
from factors.zpr import ZPR

__all__ = [
    "DCS",
    "XYH",
    "ZPR",
    "Bearing",
    "BearingRange",
    "Between",
    "BetweenSensors",
    "BundleProjection",
    "Cauchy",
    "Covariance",
    "Diagonal",
    "DriftingStep",
    "DvlLeg",
    "Elevation",
    "ElevationHinge",
    "EpipolarArc",
    "Factor",
    "GemanMcClure",
    "Heading",
    "Huber",
    "Information",
    "Isotropic",
    "Kernel",
    "Landmark",
    "Line",
    "Noise",
    "Position",
    "Prior",
    "Projection",
    "Range",
    "RangeAzimuth",
    "Robust",
    "ScaledRange",
    "SequentialMatch",
    "Shifted",
    "Sighting",
    "SqrtInformation",
    "Tukey",
    "Welsch",
    "Wheels",
    "check_jacobians",
    "sonar_factors",
]


def __dir__() -> list[str]:
    return sorted(__all__)
