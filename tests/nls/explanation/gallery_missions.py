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


def _case(title: str, broken: str, error: str, words: tuple[str, ...], cure: str = WRITE + SOLVE) -> Case:
    """Lines after those that make a dive and what it sees."""
    return Case(title, DIVE + SEEN + broken, error, words, cure)


def _damaged(title: str, table: str, damage: str, words: tuple[str, ...]) -> Case:
    """A table that is changed after it was written."""
    lines = f'file = Path("dive", "{table}")\n_ = file.write_text(file.read_text().replace({damage}))\n'
    return _case(title, WRITE + lines + LOAD, "GraphFileError", words)


MISSIONS = (
    Case(
        "A folder that is no mission",
        'import os\nos.mkdir("dive")\nnls.load("dive")\n',
        "GraphFileError",
        ("dive:", "no mission", "odometry.csv and zpr.csv", "it is empty"),
    ),
    _case(
        "A contact of a pose that is not in the track",
        f"""{WRITE}with open("dive/contacts.csv", "a") as file:
    _ = file.write("2,7,2.1,-0.2,0.01,0.01\\n")
{LOAD}""",
        "GraphFileError",
        ("contacts.csv:4:", "i 2", "no such pose in the track"),
    ),
    _damaged(
        "A column that is not there",
        "zpr.csv",
        '"pitch_rad", "pitch_deg"',
        ("zpr.csv:1:", "unknown column 'pitch_deg'", "pitch_rad"),
    ),
    _damaged(
        "A number that is none, in a table",
        "contacts.csv",
        '"2.5", "nan"',
        ("contacts.csv:3:", "'nan' is not a number"),
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
        ("x0 is fixed", "fix it by a factor", "Position of x and y and a Heading"),
        'here = Prior(x[0], SE3.identity()[0], Isotropic(0.001), components=("x", "y", "yaw"))\n'
        + 'files = write_mission("dive", FactorGraph([step, tilt, here]))\n'
        + LOAD
        + "assert len(graph) == 1 + 2 + 2\n",
    ),
    _case(
        "Two missions in one folder",
        WRITE + 'write_mission("dive", FactorGraph([step, tilt]))\n',
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
