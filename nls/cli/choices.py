"""Names that options of the command line take.

Most are copies: the modules that own them import NumPy, and a page of help waits for none. A test compares the two.
"""

from __future__ import annotations

ALIGNMENTS = ("none", "first", "yaw", "rigid", "similarity")
CONVENTIONS = ("log", "g2o", "graphslam", "gtsam")
DIALECTS = ("auto", "g2o", "toro", "isam", "isam-covariance", "graph", "pyfg", "bal", "npz", "json")
FORMATS = (*DIALECTS[1:], "tum", "kitti", "csv", "ply")
GAUGES = ("first", "prior", "free", "none")
OPTIMIZERS = ("gauss-newton", "levenberg-marquardt", "dogleg")
SIGMAS = ("stated", "estimate", "estimate:units", "estimate:components")
SOLVERS = ("cholesky", "cholesky-pcg", "schur", "pcg", "qr", "lu", "dense-cholesky", "dense-qr", "pinv")
STARTS = ("file", "odometry", "spanning-tree", "chordal", "incremental")
TREATMENTS = ("free", "hinge", "prior")  # of the elevation of a sonar contact
