"""Pictures of graphs and values, and a report that puts them on one page.

Here alone is matplotlib imported, and lazily.
Pictures of missions are registered in `OF_MISSIONS`, and imported when they are first used.
"""

from nls.lazy import importer
from nls.plot.ellipses import ellipses as ellipses
from nls.plot.factor_graph import factor_graph as factor_graph
from nls.plot.filters import belief as belief
from nls.plot.matrices import correlations as correlations, spy as spy
from nls.plot.offsets import offsets as offsets
from nls.plot.player import animation as animation
from nls.plot.report import report as report
from nls.plot.trajectory import before_after as before_after, convergence as convergence, trajectory as trajectory
from nls.plot.view import view as view, view_page as view_page

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

NOW = "animation before_after belief convergence correlations ellipses factor_graph offsets report spy"
NOW += " trajectory view view_page"

if not TYPE_CHECKING:
    __getattr__, __dir__, __all__ = importer("nls.plot", OF_MISSIONS, *NOW.split())
