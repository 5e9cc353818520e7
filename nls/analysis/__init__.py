"""Numbers about a graph: free directions, suspected measurements, the information about one variable. No sentences.

`observability` tells what a data set determines of one variable, such as a mounting, and `helpful_motions` which motion
would help. `landmark_information` has the information of every landmark. `unverified_groups` has loop closures that
carry the map although nothing verifies them. `variance_components` finds the scale of the sigmas of every kind.
"""

from nls.analysis.helpful import Motion, Motions, helpful_motions
from nls.analysis.landmarks import LandmarkInformation, landmark_information
from nls.analysis.observable import Observability
from nls.analysis.redundancy import Unverified, unverified_groups
from nls.analysis.variable import observability
from nls.analysis.variance_components import VarianceComponent, VarianceComponents, variance_components

__all__ = [
    "LandmarkInformation",
    "Motion",
    "Motions",
    "Observability",
    "Unverified",
    "VarianceComponent",
    "VarianceComponents",
    "helpful_motions",
    "landmark_information",
    "observability",
    "unverified_groups",
    "variance_components",
]
