"""Ceres' C++ library: a reader and a cost of ours, start from the file, two trust regions."""

from __future__ import annotations

from peers import combined

SOURCE, LIBRARIES = "ceres_driver.cpp", ("blas", "ceres", "glog")  # BLAS first: CHOLMOD takes the one all others use
COST = "g2o"
VARIANTS = combined(("file",), ("LM", "dogleg"))
