"""Imaging sonar: detections in its images; two views, a factor between them, and motions that show the elevation.

`detect` finds the cells of an image that stand out of the noise, at a stated rate of false alarms.

`two_views` makes a factor between two poses without information along unobserved directions. `elevation_sigma`
tells which motion determines the elevation. Weak directions of landmarks: `nls.analysis.landmark_information`, and
`nls.linear.truncated_inverse`, which leaves them out of a step.
"""

from typing import Any

from nls.sonar.detection import Detections, detect
from nls.sonar.elevation import elevation_sigma
from nls.sonar.two_view import TwoView, two_views

__all__ = ["Detections", "TwoView", "detect", "elevation_sigma", "two_views"]


def __getattr__(name: str) -> Any:
    """The name of version 0.1 for `elevation_sigma`, which returns a standard deviation."""
    if name != "elevation_information":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import warnings

    message = "nls.sonar.elevation_information is called elevation_sigma; the old name leaves after version 0.2"
    warnings.warn(message, DeprecationWarning, stacklevel=2)
    return elevation_sigma
