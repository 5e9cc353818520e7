"""The colors of all pictures: one thing has one color, and those that meet differ for the color-blind, too."""

ESTIMATE = "#0b4f6c"  # the solution, its track
BEFORE = "#e07a2f"  # what was there before it: dead reckoning, a start
TRUE = "#202020"
BELOW = "0.8"  # a true track, wide under an estimate
LANDMARK = "#399470"
ELLIPSE = "#b752c2"  # of poses; not the color of the track they lie on
CLOSURE, REJECTED = "#35b57c", "#ac0921"  # pairs of poses that are not neighbors
CONTACT, ARC = "#3aa0d8", "#e07a2f"  # of a sonar, and where its target may be
ECHO = "#8b9196"  # points of scans
HELD = "#cfd3d6"  # variables that are held fixed
SIGHT = "#9a9a9a"  # lines from sensor to landmark
SERIES = (ESTIMATE, BEFORE, ELLIPSE, LANDMARK, REJECTED, "#6fc5eb", "#cdb315", ECHO)  # of several alike
