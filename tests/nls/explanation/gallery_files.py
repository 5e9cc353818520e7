"""Broken on purpose: files."""

from __future__ import annotations

from tests.nls.explanation.gallery import Case

__all__ = ["FILES"]

VERTICES = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"
EDGE = "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\n"
PLANE = VERTICES + EDGE
LOOP = f"""{VERTICES}VERTEX_SE2 2 2 0 0
VERTEX_SE2 3 3 0 0
{EDGE}EDGE_SE2 1 2 1 0.1 0.02 {{}}
EDGE_SE2 2 3 1 0 0 100 0 0 100 0 400
EDGE_SE2 3 0 -3 0 0 100 0 0 100 0 400
"""
POSES = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\n"
EYE = "100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 400 0 0 400 0 400"
STEP = f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {EYE}\n"
SEEN = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_TRACKXYZ 1 1 0 0\nEDGE_SE3_TRACKXYZ 0 1 7 1 0 0 100 0 0 100 0 100\n"
LOAD = 'graph, values, report = nls.load("survey.g2o")\n'
SOLVE = LOAD + "result = graph.optimize(values)\n"


def _unread(
    title: str, file: str | bytes, words: str, cured_file: str = PLANE, cure: str = SOLVE, line: int = 3
) -> Case:
    """A file that is refused, with the line it is refused at; bars separate its words."""
    said = (f"survey.g2o:{line}:" if line else "survey.g2o:", *filter(None, words.split(" | ")))
    return Case(title, LOAD, "GraphFileError", said, cure, file, cured_file)


FILES = (
    _unread(
        "Information in the order of another format",
        VERTICES + "EDGE_SE2 0 1 1 0 0 100 0 100 400 0 0\n",
        "negative eigenvalue | order of its entries",
    ),
    Case(
        "An information of 1e300 on one edge",
        SOLVE,
        "UnderconstrainedError",
        ("Between(x1, x2)", "sigma 1e-150 (information 1e+300)", "give it a larger sigma"),
        SOLVE,
        LOOP.format("1e300 0 0 1e300 0 1e300"),
        LOOP.format("100 0 0 100 0 400"),
    ),
    Case(
        "A measurement of 1e200 m",
        SOLVE,
        "GraphError",
        ("Between(x0, x1)", "1e+200", "check its numbers"),
        SOLVE,
        VERTICES + EDGE.replace(" 1 1 ", " 1 1e200 "),
        PLANE,
    ),
    _unread(
        "Six numbers where a pose of space has 21",
        POSES + "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 100 100 100 400 400 400\n",
        "30 | 15",
        POSES + STEP,
    ),
    _unread("A file that ends in the middle of a line", VERTICES + EDGE[:22], ""),
    _unread("An edge to a vertex that is not there", VERTICES + EDGE.replace(" 1 ", " 2 ", 1), "vertex 2"),
    _unread("A vertex given twice", VERTICES + "VERTEX_SE2 1 2 0 0\n" + EDGE, "vertex 1"),
    _unread("An edge from a vertex to itself", VERTICES + EDGE.replace("0 1 ", "1 1 ", 1), "itself"),
    _unread(
        "Lines that mean different things in different programs",
        "EDGE2 0 1 1 0 0 100 0 100 400 0 0\n",
        "several readings | toro | isam",
        "",
        SOLVE.replace(")", ', dialect="toro")', 1),
        line=1,
    ),
    _unread("A number that is none", VERTICES + EDGE.replace("1 0 0 100", "1 nan 0 100"), "nan"),
    _unread(
        "A quaternion of zeros",
        POSES.replace("1 1 0 0 0 0 0 1", "1 1 0 0 0 0 0 0") + STEP,
        "quaternion",
        POSES + STEP,
        line=2,
    ),
    _unread("A planar edge among poses of space", POSES + EDGE, "one dimension", POSES + STEP),
    _unread(
        "A tag that nobody knows",
        PLANE + "EDGE_SONAR 0 1 3.4\n",
        "may connect variables: EDGE_SONAR (1) | ignore_tags=['EDGE_SONAR']",
        line=4,
    ),
    _unread(
        "A tag without a blank behind it",
        VERTICES.replace("VERTEX_SE2 1 ", "VERTEX_SE21 ") + EDGE,
        "'VERTEX_SE21' is no tag | VERTEX_SE2 and a blank before 1",
        line=2,
    ),
    _unread(
        "A tag typed wrong", VERTICES + EDGE.replace("EDGE", "EGDE") + EDGE, "'EGDE_SE2' is no tag | expected EDGE_SE2"
    ),
    _unread(
        "A blank that is none, from a text processor",
        VERTICES + EDGE.replace(" ", "\u00a0", 1),
        "no-break space (U+00A0) | expected a blank",
    ),
    _unread(
        "A sensor offset that was never given",
        SEEN,
        "parameter 7 | PARAMS_SE3OFFSET",
        "PARAMS_SE3OFFSET 7 0 0 0 0 0 0 1\n" + SEEN,
    ),
    _unread(
        "An id above 2^63",
        "VERTEX_SE2 9223372036854775808 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 9223372036854775808 1 1 0 0 1 0 0 1 0 1\n",
        "9223372036854775808",
        line=1,
    ),
    _unread("A file that is no text", b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", "binary", "", "", line=0),
    _unread("An empty file", "", "empty | EDGE_SE2", "", "", line=1),
)
