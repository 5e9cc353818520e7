"""Imaging sonar under its public path: detections, two views, and motions that show the elevation.

The room is `nls.missions.sonar`; contacts without names are `nls.sonar.contacts`, maps of scans `nls.sonar.scans`.
"""

from typing import Any

from nls.missions.sonar import Detections, TwoView, detect, elevation_sigma, two_views

__all__ = ["Detections", "TwoView", "detect", "elevation_sigma", "two_views"]


def __getattr__(name: str) -> Any:
    """The name of version 0.1 for `elevation_sigma`, which returns a standard deviation."""
    if name != "elevation_information":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import warnings

    message = "nls.sonar.elevation_information is called elevation_sigma; the old name leaves after version 0.2"
    warnings.warn(message, DeprecationWarning, stacklevel=2)
    return elevation_sigma
