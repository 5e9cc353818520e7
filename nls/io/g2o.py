"""The tags of g2o files: poses and points of the plane and of space, sensors with fixed or unknown offsets, priors.

    VERTEX_SE2 id x y theta                     EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33
    VERTEX_SE3:QUAT id x y z qx qy qz qw        EDGE_SE3:QUAT i j x y z qx qy qz qw and 21 entries
    FIX id [id ...]                             and the rest of the table below

The information is the upper triangle row by row; that of a pose of space is of (x, y, z, qx, qy, qz). Its rotation part
belongs to the *vector part of the quaternion*, half a rotation vector. For the conventions ``g2o``, ``graphslam`` and
``gtsam`` it is taken verbatim, for ``log`` converted (rotation block / 4, mixed blocks / 2: exact in binary).

Poses are the variables ``x``, points ``l``, with the ids of the file. Vertices used only as the place of a sensor on
the vehicle are ``o``. Source: R. Kuemmerle et al., "g2o: a general framework for graph optimization", ICRA 2011, and
the types registered in its sources (slam2d, slam3d, sclam2d and their add-ons).
"""

from __future__ import annotations

from factors.bearing import Bearing
from factors.between import Between
from factors.between_sensors import BetweenSensors
from factors.landmark import Landmark
from factors.position import Position
from factors.prior import Prior
from models import SE2, SE3, R
from nls.io.records import Element, Format, Record

__all__ = ["G2O"]

POSE2, STEP2, POINT2 = Element(SE2, "x y theta"), Element(SE2, "dx dy dtheta"), Element(R(2), "x y")
ANGLE = Element(R(1), "beta")
POSE3, POINT3 = Element(SE3, "x y z qx qy qz qw"), Element(R(3), "x y z")

PLANE = (
    Record(b"VERTEX_SE2", SE2, ("pose",), POSE2),
    Record(b"VERTEX_XY", SE2, ("point",), POINT2),
    Record(b"PARAMS_SE2OFFSET", SE2, (), POSE2),
    Record(b"EDGE_SE2", SE2, ("pose", "pose"), STEP2, Between),
    Record(b"EDGE_SE2_XY", SE2, ("pose", "point"), POINT2, Landmark),
    Record(b"EDGE_BEARING_SE2_XY", SE2, ("pose", "point"), ANGLE, Bearing),
    Record(b"EDGE_PRIOR_SE2", SE2, ("either",), POSE2, Prior),
    Record(b"EDGE_PRIOR_SE2_XY", SE2, ("either",), POINT2, Position),
    Record(b"EDGE_PRIOR_XY", SE2, ("point",), POINT2, Prior),
    Record(b"EDGE_POINTXY", SE2, ("point", "point"), POINT2, Between),
    Record(b"EDGE_SE2_OFFSET", SE2, ("pose", "pose"), STEP2, BetweenSensors, parameters=2),
    Record(b"EDGE_SE2_POINTXY_OFFSET", SE2, ("pose", "point"), POINT2, Landmark, parameters=1),
    Record(b"EDGE_SE2_CALIB", SE2, ("pose", "pose", "mount"), STEP2, BetweenSensors),
    Record(b"EDGE_SE2_XY_CALIB", SE2, ("pose", "point", "mount"), POINT2, Landmark),
)
SPACE = (
    Record(b"VERTEX_SE3:QUAT", SE3, ("pose",), POSE3),
    Record(b"VERTEX_TRACKXYZ", SE3, ("point",), POINT3),
    Record(b"PARAMS_SE3OFFSET", SE3, (), POSE3),
    Record(b"EDGE_SE3:QUAT", SE3, ("pose", "pose"), POSE3, Between),
    Record(b"EDGE_SE3_TRACKXYZ", SE3, ("pose", "point"), POINT3, Landmark, parameters=1),
    Record(b"EDGE_SE3_PRIOR", SE3, ("either",), POSE3, Prior, parameters=1),
    Record(b"EDGE_SE3_XYZ_PRIOR", SE3, ("either",), POINT3, Position, parameters=1, used=False),
    Record(b"EDGE_POINTXYZ_PRIOR", SE3, ("point",), POINT3, Prior),
    Record(b"EDGE_POINTXYZ", SE3, ("point", "point"), POINT3, Between),
    Record(b"EDGE_SE3_OFFSET", SE3, ("pose", "pose"), POSE3, BetweenSensors, parameters=2),
    Record(b"EDGE_SE3_CALIB", SE3, ("pose", "pose", "mount"), POSE3, BetweenSensors),
)
G2O = Format(
    "g2o",
    PLANE + SPACE,
    "information",
    "tags such as VERTEX_SE2 and EDGE_SE3:QUAT",
    fix=True,
    aliases=(
        (b"EDGE_SE2_PRIOR", b"EDGE_PRIOR_SE2"),
        (b"EDGE_PRIOR_SE3", b"EDGE_SE3_PRIOR"),
        (b"EDGE_SE3_PRIOR:QUAT", b"EDGE_SE3_PRIOR"),
    ),
)
