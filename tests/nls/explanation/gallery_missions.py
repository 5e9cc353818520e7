"""Broken on purpose: mission folders."""

from __future__ import annotations

from tests.nls.explanation.gallery import Case

__all__ = ["MISSIONS"]

DIVE = """
from pathlib import Path
from factors import XYH, ZPR, RangeAzimuth
from models.sensors import DIDSON_HIGH
from nls.missions import write_mission
step = XYH(x[0], x[1], [0.5, 0.0, 0.1], Isotropic(0.01))
tilt = ZPR(x[[0, 1]], [[4.0, 0.0, 0.0], [4.2, 0.0, 0.1]], Isotropic(0.01))
"""
SEEN = "seen = RangeAzimuth(x[[0, 1]], l[7], [[3.0, 0.0], [2.5, -0.1]], Isotropic(0.01))\n"
WRITE = 'write_mission("dive", FactorGraph([step, tilt, seen]), DIDSON_HIGH)\n'
LOAD = 'graph, values, report = nls.load("dive")\n'
SOLVE = LOAD + "result = graph.optimize(values)\n"

MISSIONS = (
    Case(
        "A folder that is no mission",
        'import os\nos.mkdir("dive")\nnls.load("dive")\n',
        "GraphFileError",
        ("dive:", "no mission", "odometry.csv and zpr.csv", "it is empty"),
    ),
    Case(
        "A contact of a pose that is not in the track",
        DIVE
        + SEEN
        + WRITE
        + 'with open("dive/contacts.csv", "a") as file:\n'
        + '    _ = file.write("2,7,2.1,-0.2,0.01,0.01\\n")\n'
        + LOAD,
        "GraphFileError",
        ("contacts.csv:4:", "i 2", "no such pose in the track"),
        WRITE + SOLVE,
    ),
    Case(
        "A column that is not there",
        DIVE
        + SEEN
        + WRITE
        + 'file = Path("dive", "zpr.csv")\n'
        + '_ = file.write_text(file.read_text().replace("pitch_rad", "pitch_deg"))\n'
        + LOAD,
        "GraphFileError",
        ("zpr.csv:1:", "unknown column 'pitch_deg'", "pitch_rad"),
        WRITE + SOLVE,
    ),
    Case(
        "A number that is none, in a table",
        DIVE
        + SEEN
        + WRITE
        + 'file = Path("dive", "contacts.csv")\n'
        + '_ = file.write_text(file.read_text().replace("2.5", "nan"))\n'
        + LOAD,
        "GraphFileError",
        ("contacts.csv:3:", "'nan' is not a number"),
        WRITE + SOLVE,
    ),
    Case(
        "Angles in degrees",
        DIVE + "tilt = ZPR(x[[0, 1]], [[4.0, 0.0, 0.0], [4.2, 2.5, 0.1]], Isotropic(0.01))\n" + SEEN + WRITE + LOAD,
        "GraphFileError",
        ("zpr.csv:3:", "pitch_rad is 2.5", "expected radians"),
        "tilt = ZPR(x[[0, 1]], [[4.0, 0.0, 0.0], [4.2, np.radians(2.5), 0.1]], Isotropic(0.01))\n" + WRITE + SOLVE,
    ),
    Case(
        "A pose held by hand, which no table says",
        DIVE + 'graph = FactorGraph([step, tilt])\ngraph.fix(x[0])\nwrite_mission("dive", graph)\n',
        "GraphError",
        ("x0 is fixed", "hold it by a factor", "Position of x and y and a Heading"),
        'here = Prior(x[0], SE3.identity()[0], Isotropic(0.001), components=("x", "y", "yaw"))\n'
        + 'files = write_mission("dive", FactorGraph([step, tilt, here]))\n'
        + LOAD
        + "assert len(graph) == 1 + 2 + 2\n",
    ),
    Case(
        "Two missions in one folder",
        DIVE + SEEN + WRITE + 'write_mission("dive", FactorGraph([step, tilt]))\n',
        "GraphFileError",
        ("sonar.csv:", "another mission", "give another folder"),
        'files = write_mission("other", FactorGraph([step, tilt]))\nassert len(files) == 2\n',
    ),
    Case(
        "A noise that a table has no columns for",
        DIVE + "step = XYH(x[0], x[1], [0.5, 0.0, 0.1], Covariance(np.eye(3)))\n" + SEEN + WRITE,
        "GraphError",
        ("XYH(x0, x1)", "Covariance", "standard deviations"),
        "step = XYH(x[0], x[1], [0.5, 0.0, 0.1], Isotropic(1.0))\n" + WRITE + SOLVE,
    ),
)
