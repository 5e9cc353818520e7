"""Worlds with known truth: poses, measurements with seeded noise, graphs, and ways to spoil them.

Everything is imported when it is first used: a command that is interrupted while NumPy is imported can then say so.
"""

from nls.lazy import importer

TYPE_CHECKING = False  # to a type checker always true; the import of typing takes as long as all others of a start
if TYPE_CHECKING:
    from sim.camera_sonar import Rig as Rig, RigErrors as RigErrors
    from sim.corrupt import outliers as outliers
    from sim.landmark_world import LandmarkWorld as LandmarkWorld
    from sim.mission import Mission as Mission
    from sim.pictures import against_truth as against_truth
    from sim.scene import Scene as Scene
    from sim.sonar_images import contacts as contacts, sonar_image as sonar_image
    from sim.spoil import drop_contacts as drop_contacts, exchange_contacts as exchange_contacts
    from sim.spoil import false_contacts as false_contacts, poor_odometry as poor_odometry
    from sim.survey_log import SurveyLog as SurveyLog
    from sim.world import World as World, chain as chain, measure as measure, position_error as position_error
    from sim.worlds.grid3d import grid3d as grid3d
    from sim.worlds.harbor import Harbor as Harbor, harbor as harbor
    from sim.worlds.hauv import hauv_floor as hauv_floor, hauv_hull as hauv_hull
    from sim.worlds.lines import lines as lines
    from sim.worlds.manhattan import manhattan as manhattan
    from sim.worlds.rig import rig as rig
    from sim.worlds.ring import ring as ring
    from sim.worlds.sphere import sphere as sphere
    from sim.worlds.subsea import subsea as subsea
    from sim.worlds.survey import survey as survey
    from sim.worlds.torus import torus as torus

_WHERE = {
    "sim.camera_sonar": "Rig RigErrors",
    "sim.corrupt": "outliers",
    "sim.landmark_world": "LandmarkWorld",
    "sim.mission": "Mission",
    "sim.pictures": "against_truth",
    "sim.scene": "Scene",
    "sim.sonar_images": "contacts sonar_image",
    "sim.spoil": "drop_contacts exchange_contacts false_contacts poor_odometry",
    "sim.survey_log": "SurveyLog",
    "sim.world": "World chain measure position_error",
    "sim.worlds.harbor": "Harbor harbor",
    "sim.worlds.hauv": "hauv_floor hauv_hull",
    **{
        f"sim.worlds.{name}": name
        for name in ["grid3d", "lines", "manhattan", "rig", "ring", "sphere", "subsea", "survey", "torus"]
    },
}

if not TYPE_CHECKING:
    __getattr__, __dir__, __all__ = importer("sim", _WHERE)
    del importer, TYPE_CHECKING  # no names for users
