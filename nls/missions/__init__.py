"""From a vehicle's log to a chart: mission folders, their checks, contacts and scans, and the quality of a solution."""

from nls.lazy import importer

TYPE_CHECKING = False  # to a type checker always true
if TYPE_CHECKING:
    from nls.missions.contacts.associate import associated as associated
    from nls.missions.folder.dives import DivesReport as DivesReport, read_dives as read_dives
    from nls.missions.folder.read import read_mission as read_mission
    from nls.missions.folder.folder import MissionReport as MissionReport
    from nls.missions.folder.write import write_mission as write_mission
    from nls.missions.sonar.elevation import Elevations as Elevations, elevations as elevations
    from nls.missions.solution import TrackErrors as TrackErrors, track_of as track_of

_WHERE = {
    "nls.missions.contacts.associate": "associated",
    "nls.missions.folder.dives": "DivesReport read_dives",
    "nls.missions.folder.read": "read_mission",
    "nls.missions.folder.folder": "MissionReport",
    "nls.missions.folder.write": "write_mission",
    "nls.missions.sonar.elevation": "Elevations elevations",
    "nls.missions.solution": "TrackErrors track_of",
}

if not TYPE_CHECKING:
    __getattr__, __dir__, __all__ = importer("nls.missions", _WHERE)
    del importer, TYPE_CHECKING
