"""g2o's C++ libraries: own reader, start from the file or along a spanning tree, two methods, CHOLMOD."""

from __future__ import annotations

from peers import combined

SOURCE, LIBRARIES = "g2o_driver.cpp", ("g2o_types_slam2d", "g2o_types_slam3d", "g2o_solver_cholmod", "g2o_core")
COST = "g2o"
VARIANTS = combined(("file", "spanning tree"), ("GN", "LM"))
