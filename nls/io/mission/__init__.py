"""Mission folders: CSV files of a vehicle's track, its sonar contacts and the truth; and what a solution is worth."""

from nls.io.mission.dives import DivesReport, read_dives
from nls.io.mission.read import read_mission
from nls.io.mission.report import MissionReport
from nls.io.mission.solution import Elevations, Track, elevations, track_of
from nls.io.mission.write import write_mission

__all__ = [
    "DivesReport",
    "Elevations",
    "MissionReport",
    "Track",
    "elevations",
    "read_dives",
    "read_mission",
    "track_of",
    "write_mission",
]
