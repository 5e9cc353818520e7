"""Mission folders: CSV files of a vehicle's track, its sonar contacts and the truth."""

from nls.missions.folder.dives import DivesReport, read_dives
from nls.missions.folder.read import read_mission
from nls.missions.folder.report import MissionReport
from nls.missions.folder.write import write_mission

__all__ = ["DivesReport", "MissionReport", "read_dives", "read_mission", "write_mission"]
