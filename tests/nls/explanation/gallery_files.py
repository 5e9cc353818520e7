"""Broken on purpose: files."""

from __future__ import annotations

from tests.nls.explanation.gallery import Case

__all__ = ["FILES"]

VERTICES = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"
EDGE = "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\n"
LOOP = f"""{VERTICES}VERTEX_SE2 2 2 0 0
VERTEX_SE2 3 3 0 0
{EDGE}EDGE_SE2 1 2 1 0.1 0.02 {{}}
EDGE_SE2 2 3 1 0 0 100 0 0 100 0 400
EDGE_SE2 3 0 -3 0 0 100 0 0 100 0 400
"""
POSES = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\n"
EYE = "100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 400 0 0 400 0 400"
LOAD = 'graph, values, report = nls.load("survey.g2o")\n'
SOLVE = LOAD + "result = graph.optimize(values)\n"

FILES = (
    Case(
        "Information in the order of another format",
        LOAD,
        "GraphFileError",
        ("survey.g2o:3:", "negative eigenvalue", "order of its entries"),
        SOLVE,
        VERTICES + "EDGE_SE2 0 1 1 0 0 100 0 100 400 0 0\n",
        VERTICES + EDGE,
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
        VERTICES + EDGE,
    ),
    Case(
        "Six numbers where a pose of space has 21",
        LOAD,
        "GraphFileError",
        ("survey.g2o:3:", "30", "15"),
        SOLVE,
        POSES + "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 100 100 100 400 400 400\n",
        POSES + f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {EYE}\n",
    ),
    Case(
        "A file that ends in the middle of a line",
        LOAD,
        "GraphFileError",
        ("survey.g2o:3:",),
        SOLVE,
        VERTICES + EDGE[:22],
        VERTICES + EDGE,
    ),
    Case(
        "An edge to a vertex that is not there",
        LOAD,
        "GraphFileError",
        ("survey.g2o:3:", "vertex 2"),
        SOLVE,
        VERTICES + EDGE.replace(" 1 ", " 2 ", 1),
        VERTICES + EDGE,
    ),
    Case(
        "A vertex given twice",
        LOAD,
        "GraphFileError",
        ("survey.g2o:3:", "vertex 1"),
        SOLVE,
        VERTICES + "VERTEX_SE2 1 2 0 0\n" + EDGE,
        VERTICES + EDGE,
    ),
    Case(
        "An edge from a vertex to itself",
        LOAD,
        "GraphFileError",
        ("survey.g2o:3:", "itself"),
        SOLVE,
        VERTICES + EDGE.replace("0 1 ", "1 1 ", 1),
        VERTICES + EDGE,
    ),
    Case(
        "Lines that mean different things in different programs",
        LOAD,
        "GraphFileError",
        ("survey.g2o:1:", "several readings", "toro", "isam"),
        """
graph, values, report = nls.load("survey.g2o", dialect="toro")
result = graph.optimize(values)
""",
        "EDGE2 0 1 1 0 0 100 0 100 400 0 0\n",
    ),
    Case(
        "A number that is none",
        LOAD,
        "GraphFileError",
        ("survey.g2o:3:", "nan"),
        SOLVE,
        VERTICES + EDGE.replace("1 0 0 100", "1 nan 0 100"),
        VERTICES + EDGE,
    ),
    Case(
        "A quaternion of zeros",
        LOAD,
        "GraphFileError",
        ("survey.g2o:2:", "quaternion"),
        SOLVE,
        POSES.replace("1 1 0 0 0 0 0 1", "1 1 0 0 0 0 0 0") + f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {EYE}\n",
        POSES + f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {EYE}\n",
    ),
    Case(
        "A planar edge among poses of space",
        LOAD,
        "GraphFileError",
        ("survey.g2o:3:", "one dimension"),
        SOLVE,
        POSES + EDGE,
        POSES + f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {EYE}\n",
    ),
    Case(
        "A tag that nobody knows",
        LOAD,
        "GraphWarning",
        ("not used", "EDGE_SONAR (1, first on line 4)"),
        "result = graph.optimize(values)\n",
        VERTICES + EDGE + "EDGE_SONAR 0 1 3.4\n",
    ),
    Case(
        "A tag without a blank behind it",
        LOAD,
        "GraphFileError",
        ("survey.g2o:2:", "'VERTEX_SE21' is no tag", "VERTEX_SE2 and a blank before 1"),
        SOLVE,
        VERTICES.replace("VERTEX_SE2 1 ", "VERTEX_SE21 ") + EDGE,
        VERTICES + EDGE,
    ),
    Case(
        "A tag typed wrong",
        LOAD,
        "GraphFileError",
        ("survey.g2o:3:", "'EGDE_SE2' is no tag", "expected EDGE_SE2"),
        SOLVE,
        VERTICES + EDGE.replace("EDGE", "EGDE") + EDGE,
        VERTICES + EDGE,
    ),
    Case(
        "A blank that is none, from a text processor",
        LOAD,
        "GraphFileError",
        ("survey.g2o:3:", "no-break space (U+00A0)", "expected a blank"),
        SOLVE,
        VERTICES + EDGE.replace(" ", "\u00a0", 1),
        VERTICES + EDGE,
    ),
    Case(
        "A sensor offset that was never given",
        LOAD,
        "GraphFileError",
        ("survey.g2o:3:", "parameter 7", "PARAMS_SE3OFFSET"),
        SOLVE,
        "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_TRACKXYZ 1 1 0 0\nEDGE_SE3_TRACKXYZ 0 1 7 1 0 0 100 0 0 100 0 100\n",
        "PARAMS_SE3OFFSET 7 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_TRACKXYZ 1 1 0 0\n"
        "EDGE_SE3_TRACKXYZ 0 1 7 1 0 0 100 0 0 100 0 100\n",
    ),
    Case(
        "An id above 2^63",
        LOAD,
        "GraphFileError",
        ("survey.g2o:1:", "9223372036854775808"),
        SOLVE,
        "VERTEX_SE2 9223372036854775808 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 9223372036854775808 1 1 0 0 1 0 0 1 0 1\n",
        VERTICES + EDGE,
    ),
    Case(
        "A file that is no text",
        LOAD,
        "GraphFileError",
        ("survey.g2o:", "binary"),
        file=b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR",
    ),
    Case(
        "An empty file",
        LOAD,
        "GraphFileError",
        ("survey.g2o:1:", "empty", "EDGE_SE2"),
    ),
)
