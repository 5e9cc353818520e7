"""Imaging sonar: detections in its images; two views, a factor between them, and motions that show the elevation.

`detect` finds the cells of an image that stand out of the noise, at a stated rate of false alarms.

`two_views` makes a factor between two poses without information along unobserved directions. `elevation_sigma`
tells which motion determines the elevation. Weak directions of landmarks: `nls.analysis.landmark_information`, and
`nls.linear.truncated_inverse`, which leaves them out of a step.
"""

from nls.missions.sonar.detection import Detections, detect
from nls.missions.sonar.elevation import elevation_sigma
from nls.missions.sonar.two_view import TwoView, two_views

__all__ = ["Detections", "TwoView", "detect", "elevation_sigma", "two_views"]
