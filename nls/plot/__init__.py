"""Pictures, and a page of them; here alone is matplotlib imported, and lazily."""

from nls.plot.convergence import convergence
from nls.plot.correlations import correlations
from nls.plot.elevation_map import elevation_map
from nls.plot.ellipses import ellipses
from nls.plot.factor_graph import factor_graph
from nls.plot.filters import belief
from nls.plot.offsets import offsets
from nls.plot.player import animation
from nls.plot.report import report
from nls.plot.sonar import fan_image, frustum, polar_image
from nls.plot.sparsity import spy
from nls.plot.trajectory import before_after, trajectory

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
