"""One small valid file per graph format, every tag in it, for the tests of the readers and writers."""

from __future__ import annotations

from nls.io.bal import read_bal
from nls.io.pyfg import read_pyfg
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, SPACE, UPPER_3, Loaded, read

SIX = "4 0.5 0.25 3 0.125 2"  # upper triangle of a 3x3 matrix, positive definite
THREE = "4 0.5 3"

SENSORS_2 = f"""PARAMS_SE2OFFSET 3 0.5 0.25 0.1
PARAMS_SE2OFFSET 7 -0.5 0 1.6
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1.1 0.1 0.1
VERTEX_SE2 2 1.9 1 1.6
FIX 0
VERTEX_XY 10 3 1
VERTEX_XY 11 2 -2
VERTEX_SE2 20 0.3 0.1 0.2
EDGE_SE2 0 1 1 0 0.05 {INFORMATION_2}
EDGE_SE2 1 2 1.01 0.98 1.5 {INFORMATION_2}
EDGE_SE2_XY 0 10 3.1 0.9 {THREE}
EDGE_SE2_XY 1 11 0.8 -2.1 {THREE}
EDGE_BEARING_SE2_XY 2 10 -1.5 25
EDGE_PRIOR_SE2 0 0.01 0.02 0.03 {SIX}
EDGE_PRIOR_SE2 20 0.31 0.11 0.19 {SIX}
EDGE_PRIOR_SE2_XY 1 1.05 0.15 {THREE}
EDGE_PRIOR_XY 10 3.05 0.95 {THREE}
EDGE_POINTXY 10 11 -1.05 -2.9 {THREE}
EDGE_SE2_OFFSET 0 1 3 7 0.2 -0.3 1.5 {SIX}
EDGE_SE2_OFFSET 1 2 3 3 1.2 0.7 1.4 {SIX}
EDGE_SE2_POINTXY_OFFSET 0 10 3 2.5 0.5 {THREE}
EDGE_SE2_POINTXY_OFFSET 1 10 7 0.9 -2.5 {THREE}
EDGE_SE2_CALIB 0 1 20 1.05 0.02 0.1 {SIX}
EDGE_SE2_XY_CALIB 1 11 20 0.4 -2.2 {THREE}
"""

A, B, C = ("0 0 0.19866933079506122 0.98006657784124163", "0.099833416646828155 0 0 0.99500416527802582", "0 0 0 1")
SENSORS_3 = f"""PARAMS_SE3OFFSET 3 0.5 0.25 -0.1 {A}
PARAMS_SE3OFFSET 0 0 0 0 {C}
VERTEX_SE3:QUAT 0 0 0 0 {C}
VERTEX_SE3:QUAT 1 1 0.1 0 {A}
VERTEX_SE3:QUAT 2 2 0.1 0.5 {B}
VERTEX_TRACKXYZ 10 3 1 0.5
VERTEX_TRACKXYZ 11 2 -2 1
VERTEX_SE3:QUAT 20 0.3 0.1 0.2 {A}
FIX 0 10
EDGE_SE3:QUAT 0 1 1.01 0 0.02 {A} {UPPER_3}
EDGE_SE3_TRACKXYZ 0 10 0 3.1 0.9 0.4 {SIX}
EDGE_SE3_TRACKXYZ 1 11 3 0.1 -2.6 1.2 {SIX}
EDGE_SE3_PRIOR 0 3 0.51 0.26 -0.09 {A} {UPPER_3}
EDGE_SE3_PRIOR 20 0 0.3 0.12 0.2 {A} {UPPER_3}
EDGE_SE3_XYZ_PRIOR 1 3 1.02 0.12 0.01 {SIX}
EDGE_POINTXYZ_PRIOR 11 2.1 -2.05 0.9 {SIX}
EDGE_POINTXYZ 10 11 -1.05 -2.9 0.6 {SIX}
EDGE_SE3_OFFSET 0 1 3 0 0.4 0.3 0.1 {A} {UPPER_3}
EDGE_SE3_CALIB 1 2 20 0.9 0 0.4 {B} {UPPER_3}
"""

# tags of RTAB-Map, vertigo and GTSAM, as they write them
POSES_3 = f"VERTEX_SE3:QUAT 0 0 0 0 {C}\nVERTEX_SE3:QUAT 1 1 0.1 0 {A}\nVERTEX_SE3:QUAT 2 2 0.1 0.5 {B}\n"
RTABMAP_3 = f"""{POSES_3}VERTEX_TRACKXYZ 9 3 1 0.5
EDGE_SE3:QUAT 0 1 1.01 0 0.02 {A} {UPPER_3}
EDGE_SE3 1 2 0.9 0 0.4 {B} {UPPER_3}
EDGE_SE3 0 2 2.1 0.2 0.4 {B} {UPPER_3}
EDGE_POINTXYZ_PRIOR 0 0.05 0 0.02 {SIX}
EDGE_POINTXYZ_PRIOR 9 3.1 0.9 0.6 {SIX}
EDGE_POINTXYZ_PRIOR 2 1.9 0.2 0.4 {SIX}
EDGE_POINTXYZ_PRIOR 1 1.2 0.2 -0.1 {SIX}
"""
SWITCHED_2 = f"""{PLANE}VERTEX_SWITCH 4 1
EDGE_SWITCH_PRIOR 4 1 1.0
EDGE_SE2_SWITCHABLE 0 2 4 1.9 1 1.6 {INFORMATION_2}
VERTEX_SWITCH 5 0.5
EDGE_SWITCH_PRIOR 5 0.5 8
EDGE_SE2_SWITCHABLE 3 0 5 4 -4 0.3 {INFORMATION_2}
VERTEX_SWITCH 6 1
EDGE_SWITCH_PRIOR 6 1 1
EDGE_SE2_SWITCHABLE 1 3 6 1.9 1.9 3 {INFORMATION_2}
"""
SWITCHED_3 = f"""{POSES_3}EDGE_SE3:QUAT 0 1 1.01 0 0.02 {A} {UPPER_3}
EDGE_SE3:QUAT 1 2 0.9 0 0.4 {B} {UPPER_3}
VERTEX_SWITCH 3 1
EDGE_SWITCH_PRIOR 3 1 2
EDGE_SE3_SWITCHABLE 0 2 3 2.1 0.2 0.4 {B} {UPPER_3}
"""
GTSAM_2 = f"""EDGE_SE2 0 1 1 0 0.05 {INFORMATION_2}
LANDMARK2 0 1 3.1 0.9 {THREE}
LANDMARK2 0 7 0.8 -2.1 {THREE}
EDGE_SE2 1 2 1.01 0.98 1.5 {INFORMATION_2}
LANDMARK2 1 1 2.0 0.8 {THREE}
LANDMARK2 2 1 -0.3 -0.9 {THREE}
LANDMARK2 1 7 -0.3 -2.2 {THREE}
"""
GTSAM_3 = f"""EDGE_SE3:QUAT 0 1 1.01 0 0.02 {A} {UPPER_3}
LANDMARK3 0 1 3.1 0.9 0.4 {SIX}
LANDMARK3 1 1 2.1 0.1 0.4 {SIX}
"""

TORO_2 = """VERTEX2 0 0 0 0
VERTEX2 1 1.1 0.1 0.1
VERTEX2 2 1.9 1 1.6
EDGE2 0 1 1 0 0.05 500 1 400 300 2 3
EDGE2 1 2 1.01 0.98 1.5 500 1 400 300 2 3
EDGE2 0 2 1.95 0.9 1.55 500 1 400 300 2 3
"""
TORO_3 = f"""VERTEX3 0 0 0 0 0 0 0
VERTEX3 1 1 0.1 0 0.1 -0.2 0.4
VERTEX3 2 2 0.1 0.5 0.2 0 0.5
EDGE3 0 1 1.01 0 0.02 0.11 -0.21 0.41 {UPPER_3}
EDGE3 1 2 0.9 0.1 0.4 0.1 0.2 0.05 {UPPER_3}
EDGE3 0 2 1.9 0.2 0.4 0.3 0.1 0.4 {UPPER_3}
"""
GRAPH_2 = TORO_2.replace("500 1 400 300 2 3", "0.02 0.001 0.03 0.01 0.002 0.003")
ISAM_2 = """ODOMETRY 0 1 1 0 0.05 20 1 2 30 3 40
LANDMARK 0 10 3.1 0.9 4 0.5 3
Constraint2 1 2 1.01 0.98 1.5 20 1 2 30 3 40
EDGE2 0 2 1.95 0.9 1.55 20 1 2 30 3 40
LANDMARK 2 10 -0.8 1.7 4 0.5 3
LANDMARK 2 11 -2.8 0.7 4 0.5 3
"""
ISAM_3 = f"""EDGE3 0 1 1.01 0 0.02 0.11 -0.21 0.41 {UPPER_3}
EDGE3 1 2 0.9 0.1 0.4 0.1 0.2 0.05 {UPPER_3}
EDGE3 0 2 1.9 0.2 0.4 0.3 0.1 0.4 {UPPER_3}
POINT3 1 10 1.9 0.2 0.4 {SIX}
POINT3 2 10 0.9 0.2 0.4 {SIX}
"""
ISAM_APART_2 = """ODOMETRY 0 1 1 0 0.05 20 1 2 30 3 40
LANDMARK 0 0 3.1 0.9 4 0.5 3
LANDMARK 1 0 2.0 0.8 4 0.5 3
Constraint2 1 2 1.01 0.98 1.5 20 1 2 30 3 40
LANDMARK 2 1 -2.8 0.7 4 0.5 3
"""
ISAM_APART_3 = ISAM_3.replace("POINT3 1 10", "POINT3 1 1").replace("POINT3 2 10", "POINT3 2 1")
COVARIANCE_2 = """ODOMETRY 0 1 1 0 0.05 0.02 0.001 0.002 0.03 0.003 0.01
LANDMARK 0 10 3.1 0.9 0.4 0.05 0.3
EDGE2 1 2 1.01 0.98 1.5 0.02 0.001 0.002 0.03 0.003 0.01
LANDMARK 2 10 -0.8 1.7 0.4 0.05 0.3
"""
CAMERA = "0\n0\n0\n0\n0\n0\n500\n0\n0\n"
BAL = f"2 1 2\n0 0 10.5 -3\n1 0 9.5 -2\n{CAMERA}{CAMERA}0.1\n0.2\n-5\n"
PYFG = """VERTEX_SE2 0.5 A0 0 0 0
VERTEX_SE2 1.5 A1 1 0 0.1
VERTEX_XY L3 4 6
EDGE_SE2 1.5 A0 A1 1 0 0.1 0.01 0 0 0.01 0 0.001
EDGE_RANGE 0.5 A0 L3 7.1 0.04
"""

EDGES_2 = "".join(line + "\n" for line in PLANE.splitlines() if line.startswith("EDGE"))
EDGES_3 = "".join(line + "\n" for line in SPACE.splitlines() if line.startswith("EDGE"))

# name: dialect, text
FILES = {
    "poses of the plane": ("g2o", PLANE + "FIX 0 1\n"),
    "poses of space": ("g2o", SPACE),
    "edges of the plane": ("g2o", EDGES_2),
    "edges of space": ("g2o", EDGES_3),
    "every tag of the plane": ("g2o", SENSORS_2),
    "every tag of space": ("g2o", SENSORS_3),
    "rtabmap, space": ("g2o", RTABMAP_3),
    "vertigo, plane": ("g2o", SWITCHED_2),
    "vertigo, space": ("g2o", SWITCHED_3),
    "gtsam, plane": ("g2o", GTSAM_2),
    "gtsam, space": ("g2o", GTSAM_3),
    "toro, plane": ("toro", TORO_2),
    "toro, space": ("toro", TORO_3),
    "graph": ("graph", GRAPH_2),
    "isam, plane": ("isam", ISAM_2),
    "isam, space": ("isam", ISAM_3),
    "isam with covariances": ("isam-covariance", COVARIANCE_2),
    "isam, plane, points numbered apart": ("isam", ISAM_APART_2),
    "isam, space, points numbered apart": ("isam", ISAM_APART_3),
    "isam with covariances, points numbered apart": ("isam-covariance", COVARIANCE_2.replace(" 10 ", " 0 ")),
}
ALL = {**FILES, "bal": ("bal", BAL), "pyfg": ("pyfg", PYFG)}


def read_any(data: bytes, dialect: str) -> Loaded:
    if dialect == "bal":
        return read_bal(data, "f.g2o")
    return read_pyfg(data, "f.g2o") if dialect == "pyfg" else read(data, dialect=dialect)
