"""Worlds with known truth: poses, measurements with seeded noise, graphs, and ways to spoil them.

Everything is imported when it is first used: a command that is interrupted while NumPy is imported can then say so.
"""

from nls.lazy import importer

TYPE_CHECKING = False  # to a type checker always true; the import of typing takes as long as all others of a start
if TYPE_CHECKING:
    from sim.camera_sonar import Rig, RigErrors
    from sim.corrupt import outliers
    from sim.landmark_world import LandmarkWorld
    from sim.mission import Mission
    from sim.scene import Scene
    from sim.sonar_images import contacts, sonar_image
    from sim.spoil import drop_contacts, exchange_contacts, false_contacts, poor_odometry
    from sim.survey_log import SurveyLog
    from sim.world import World, chain, measure, position_error
    from sim.worlds.grid3d import grid3d
    from sim.worlds.harbor import Harbor, harbor
    from sim.worlds.hauv_floor import hauv_floor
    from sim.worlds.hauv_hull import hauv_hull
    from sim.worlds.lines import lines
    from sim.worlds.manhattan import manhattan
    from sim.worlds.rig import rig
    from sim.worlds.ring import ring
    from sim.worlds.sphere import sphere
    from sim.worlds.subsea import subsea
    from sim.worlds.survey import survey
    from sim.worlds.torus import torus

_WHERE = {
    "sim.camera_sonar": "Rig RigErrors",
    "sim.corrupt": "outliers",
    "sim.landmark_world": "LandmarkWorld",
    "sim.mission": "Mission",
    "sim.scene": "Scene",
    "sim.sonar_images": "contacts sonar_image",
    "sim.spoil": "drop_contacts exchange_contacts false_contacts poor_odometry",
    "sim.survey_log": "SurveyLog",
    "sim.world": "World chain measure position_error",
    "sim.worlds.grid3d": "grid3d",
    "sim.worlds.harbor": "Harbor harbor",
    "sim.worlds.hauv_floor": "hauv_floor",
    "sim.worlds.hauv_hull": "hauv_hull",
    "sim.worlds.lines": "lines",
    "sim.worlds.manhattan": "manhattan",
    "sim.worlds.rig": "rig",
    "sim.worlds.ring": "ring",
    "sim.worlds.sphere": "sphere",
    "sim.worlds.subsea": "subsea",
    "sim.worlds.survey": "survey",
    "sim.worlds.torus": "torus",
}
_MODULE = {name: module for module, names in _WHERE.items() for name in names.split()}

if not TYPE_CHECKING:
    __getattr__ = importer("sim", _MODULE)
    del importer, TYPE_CHECKING  # no names for users


def __dir__() -> list[str]:
    return sorted(__all__)


__all__ = [
    "Harbor",
    "LandmarkWorld",
    "Mission",
    "Rig",
    "RigErrors",
    "Scene",
    "SurveyLog",
    "World",
    "chain",
    "contacts",
    "drop_contacts",
    "exchange_contacts",
    "false_contacts",
    "grid3d",
    "harbor",
    "hauv_floor",
    "hauv_hull",
    "lines",
    "manhattan",
    "measure",
    "outliers",
    "poor_odometry",
    "position_error",
    "rig",
    "ring",
    "sonar_image",
    "sphere",
    "subsea",
    "survey",
    "torus",
]
