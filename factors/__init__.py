"""Measurements with their noise: motions, ranges, bearings, contacts, pixels.

A file holds one kind of measurement: noise and spaces bound into whitened Jacobians and errors. Each is imported when
it is first used: a pose graph needs none of a sonar.
"""

TYPE_CHECKING = False  # to a type checker always true
if TYPE_CHECKING:
    from factors.base import Factor as Factor
    from factors.bearing import Bearing as Bearing
    from factors.bearing_range import BearingRange as BearingRange
    from factors.between import Between as Between
    from factors.between_sensors import BetweenSensors as BetweenSensors
    from factors.bundle import BundleProjection as BundleProjection
    from factors.check import check_jacobians as check_jacobians
    from factors.drifting_step import DriftingStep as DriftingStep
    from factors.dvl_leg import DvlLeg as DvlLeg
    from factors.elevation import Elevation as Elevation, ElevationHinge as ElevationHinge
    from factors.epipolar_arc import EpipolarArc as EpipolarArc
    from factors.gravity import Gravity as Gravity
    from factors.heading import Heading as Heading
    from factors.landmark import Landmark as Landmark
    from factors.line import Line as Line
    from factors.noise import (
        Covariance as Covariance,
        Diagonal as Diagonal,
        Information as Information,
        Isotropic as Isotropic,
        Noise as Noise,
        SqrtInformation as SqrtInformation,
    )
    from factors.position import Position as Position
    from factors.prior import Prior as Prior
    from factors.projection import Projection as Projection
    from factors.range import Range as Range
    from factors.range_azimuth import RangeAzimuth as RangeAzimuth
    from factors.robust import (
        DCS as DCS,
        Cauchy as Cauchy,
        GemanMcClure as GemanMcClure,
        Huber as Huber,
        Kernel as Kernel,
        Robust as Robust,
        Tukey as Tukey,
        Welsch as Welsch,
    )
    from factors.scaled_range import ScaledRange as ScaledRange
    from factors.sequential_match import SequentialMatch as SequentialMatch
    from factors.shifted import Shifted as Shifted
    from factors.sighting import Sighting as Sighting
    from factors.sonar import sonar_factors as sonar_factors
    from factors.wheels import Wheels as Wheels
    from factors.xyh import XYH as XYH
    from factors.zpr import ZPR as ZPR

    __all__: list[str]

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
    "factors.gravity": "Gravity",
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

if not TYPE_CHECKING:  # mypy would take it for a circle
    import os
    import sys

    if os.path.basename(script := getattr(sys.modules["__main__"], "__file__", None) or "") == "nls.py":
        raise ImportError(f"{script} has the name of the package 'nls' of leadline and hides it; rename the script")
    import nls.lazy  # refuses packages of other programs that shadow `models`, too

    __getattr__, __dir__, __all__ = nls.lazy.importer("factors", _WHERE)
    del TYPE_CHECKING, os, script, sys
