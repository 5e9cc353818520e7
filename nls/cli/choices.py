"""Names that options of the command line take.

Most are copies: the modules that own them import NumPy, and a page of help waits for none. A test compares the two.
"""

ALIGNMENTS = ("none", "first", "yaw", "rigid", "similarity")
CONVENTIONS = ("log", "g2o", "graphslam", "gtsam")
GNC = ("gnc-tls", "gnc-gm")  # graduated non-convexity
GAUGES = ("first", "prior", "free", "none")
KERNELS = ("huber", "cauchy", "tukey", "geman-mcclure", "welsch", "dcs")
OPTIMIZERS = ("gauss-newton", "levenberg-marquardt", "dogleg")
SIGMAS = ("stated", "estimate", "estimate:units", "estimate:components")
SOLVERS = ("cholesky", "schur", "pcg", "qr", "lu", "dense-cholesky", "dense-qr", "pinv")
STARTS = ("file", "odometry", "spanning-tree", "chordal", "incremental")
TREATMENTS = ("free", "hinge", "prior")  # of the elevation of a sonar contact

PROBABILITIES = " or ".join(f"{name}[:PROBABILITY]" for name in GNC)
ROBUST = f"[TYPE=]KERNEL:SIGMAS, the kernel one of {', '.join(KERNELS)}; or none, of a mission: all contacts are kept"
ROBUST_OF_SOLVE = f"{ROBUST}; or {PROBABILITIES}"  # all that --robust takes
