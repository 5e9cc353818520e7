"""Equations of sensors, h and its Jacobians, for whole stacks of geometry: the factors, the simulator and you use them.

Each function returns (h, J): the prediction (n, size) and its derivative (n, size, dim) with respect to its argument.
"""

from models.sensors.bundle import project
from models.sensors.camera import Camera
from models.sensors.direction import direction, point_from_direction_range
from models.sensors.distance import distance
from models.sensors.dvl import DVL, HOLOOCEAN_DVL, dvl_velocity
from models.sensors.frame import point_in_frame, point_on_body
from models.sensors.gravity import gravity
from models.sensors.heading import heading
from models.sensors.imaging_sonar import (
    ARIS_3000,
    BLUEVIEW_M900,
    DIDSON_HIGH,
    DIDSON_LOW,
    OCULUS_M750D,
    ImagingSonar,
)
from models.sensors.line import line_from_frame, line_in_frame, normalized
from models.sensors.odometry import levelled, relative_xyh, zpr
from models.sensors.singular import SingularAt
from models.sensors.spherical import cartesian, elevation, plane_projection, range_azimuth, spherical
from models.sensors.view import seen_from

__all__ = [
    "ARIS_3000",
    "BLUEVIEW_M900",
    "DIDSON_HIGH",
    "DIDSON_LOW",
    "DVL",
    "HOLOOCEAN_DVL",
    "OCULUS_M750D",
    "Camera",
    "ImagingSonar",
    "SingularAt",
    "cartesian",
    "direction",
    "distance",
    "dvl_velocity",
    "elevation",
    "gravity",
    "heading",
    "levelled",
    "line_from_frame",
    "line_in_frame",
    "normalized",
    "plane_projection",
    "point_from_direction_range",
    "point_in_frame",
    "point_on_body",
    "project",
    "range_azimuth",
    "relative_xyh",
    "seen_from",
    "spherical",
    "zpr",
]
