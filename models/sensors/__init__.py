"""Equations of sensors, h and its Jacobians, for whole stacks of geometry: the factors, the simulator and you use them.

Each function returns (h, J): the prediction (n, size) and its derivative (n, size, dim) with respect to its argument.
"""

from models.sensors.bundle import project
from models.sensors.direction import direction, point_from_direction_range
from models.sensors.distance import distance
from models.sensors.frame import point_in_frame, point_on_body
from models.sensors.heading import heading
from models.sensors.singular import SingularAt

__all__ = [
    "SingularAt",
    "direction",
    "distance",
    "heading",
    "point_from_direction_range",
    "point_in_frame",
    "point_on_body",
    "project",
]
