"""From a vehicle's log to a chart: mission folders, their checks, contacts and scans, and what a solution is worth."""

from nls.lazy import importer

TYPE_CHECKING = False  # to a type checker always true
if TYPE_CHECKING:
    from nls.missions.association import associated as associated
    from nls.missions.folder import (
        DivesReport as DivesReport,
        MissionReport as MissionReport,
        read_dives as read_dives,
        read_mission as read_mission,
        write_mission as write_mission,
    )
    from nls.missions.landmarks import Elevations as Elevations, elevations as elevations
    from nls.missions.solution import Track as Track, track_of as track_of

_WHERE = {
    "nls.missions.association": "associated",
    "nls.missions.folder": "DivesReport MissionReport read_dives read_mission write_mission",
    "nls.missions.landmarks": "Elevations elevations",
    "nls.missions.solution": "Track track_of",
}
_MODULE = {name: module for module, names in _WHERE.items() for name in names.split()}

__all__ = sorted(_MODULE)

if not TYPE_CHECKING:
    __getattr__, __dir__ = importer("nls.missions", _MODULE)
    del importer, TYPE_CHECKING
