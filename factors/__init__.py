"""Factors: one measurement kind per file; noise, measurement and spaces bound into whitened Jacobians and errors.

Each is imported when it is first used: a pose graph needs none of a sonar.
"""

TYPE_CHECKING = False  # to a type checker always true
if TYPE_CHECKING:
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

_WHERE = {
    "factors.base": "Factor",
    "factors.bearing": "Bearing",
    "factors.bearing_range": "BearingRange",
    "factors.between": "Between",
    "factors.between_sensors": "BetweenSensors",
    "factors.bundle": "BundleProjection",
    "factors.check": "check_jacobians",
    "factors.drifting_step": "DriftingStep",
    "factors.dvl_leg": "DvlLeg",
    "factors.elevation": "Elevation ElevationHinge",
    "factors.epipolar_arc": "EpipolarArc",
    "factors.heading": "Heading",
    "factors.landmark": "Landmark",
    "factors.line": "Line",
    "factors.noise": "Covariance Diagonal Information Isotropic Noise SqrtInformation",
    "factors.position": "Position",
    "factors.prior": "Prior",
    "factors.projection": "Projection",
    "factors.range": "Range",
    "factors.range_azimuth": "RangeAzimuth",
    "factors.robust": "DCS Cauchy GemanMcClure Huber Kernel Robust Tukey Welsch",
    "factors.scaled_range": "ScaledRange",
    "factors.sequential_match": "SequentialMatch",
    "factors.shifted": "Shifted",
    "factors.sighting": "Sighting",
    "factors.sonar": "sonar_factors",
    "factors.wheels": "Wheels",
    "factors.xyh": "XYH",
    "factors.zpr": "ZPR",
}
_MODULE = {name: module for module, names in _WHERE.items() for name in names.split()}

if not TYPE_CHECKING:  # mypy would take it for a circle
    import nls.lazy  # refuses packages of other programs that shadow `models`, too

    __getattr__ = nls.lazy.importer("factors", _MODULE)
    del TYPE_CHECKING

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
