"""Pictures, and a page of them; here alone is matplotlib imported, and lazily.

Pictures of missions are registered in `OF_MISSIONS`, and imported when they are first used.
"""

from nls.lazy import importer
from nls.plot.ellipses import ellipses
from nls.plot.factor_graph import factor_graph
from nls.plot.filters import belief
from nls.plot.matrices import correlations, spy
from nls.plot.offsets import offsets
from nls.plot.player import animation
from nls.plot.report import report
from nls.plot.trajectory import before_after, convergence, trajectory

TYPE_CHECKING = False  # to a type checker always true
if TYPE_CHECKING:
    from nls.missions.pictures.elevation_map import elevation_map as elevation_map
    from nls.missions.pictures.sonar import fan_image as fan_image
    from nls.missions.pictures.sonar import frustum as frustum
    from nls.missions.pictures.sonar import polar_image as polar_image

OF_MISSIONS = {
    "nls.missions.pictures.elevation_map": "elevation_map",
    "nls.missions.pictures.sonar": "fan_image frustum polar_image",
}

__all__ = [
    "animation",
    "before_after",
    "belief",
    "convergence",
    "correlations",
    "elevation_map",
    "ellipses",
    "factor_graph",
    "fan_image",
    "frustum",
    "offsets",
    "polar_image",
    "report",
    "spy",
    "trajectory",
]

if not TYPE_CHECKING:
    __getattr__, __dir__, _ = importer("nls.plot", OF_MISSIONS)
