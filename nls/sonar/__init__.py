"""Two views of an imaging sonar: what they leave unknown, a factor that claims no more, and motions that show it.

`two_views` makes a factor between two poses that says nothing along what is not seen, and `elevation_information` tells
how to fly so that the elevation is. Weak directions of landmarks: `nls.analysis.landmark_information`, and
`nls.linear.truncated_inverse`, which leaves them out of a step.
"""

from nls.sonar.elevation import elevation_information
from nls.sonar.two_view import TwoView, two_views

__all__ = ["TwoView", "elevation_information", "two_views"]
