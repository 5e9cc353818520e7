"""What sonar leaves unknown, and how to live with it: weak directions of landmarks, truncated blocks, two views.

`landmark_information` finds the directions, `truncated_inverse` leaves them out of a step, `two_views` makes a factor
between two poses that says nothing along them, and `elevation_information` tells how to fly so that there are none.
"""

from nls.degeneracy.elevation import elevation_information
from nls.degeneracy.information import LandmarkInformation, landmark_information
from nls.degeneracy.truncated import truncated_inverse
from nls.degeneracy.two_view import TwoView, two_views

__all__ = [
    "LandmarkInformation",
    "TwoView",
    "elevation_information",
    "landmark_information",
    "truncated_inverse",
    "two_views",
]
