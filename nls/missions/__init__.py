"""From a vehicle's log to a chart: mission folders, their checks, contacts and scans, and what a solution is worth."""

from nls.lazy import importer

TYPE_CHECKING = False  # to a type checker always true
if TYPE_CHECKING:
    from nls.missions.association import (
        associated as associated,
    )
    from nls.missions.folder import (
        DivesReport as DivesReport,
    )
    from nls.missions.folder import (
        MissionReport as MissionReport,
    )
    from nls.missions.folder import (
        read_dives as read_dives,
    )
    from nls.missions.folder import (
        read_mission as read_mission,
    )
    from nls.missions.folder import (
        write_mission as write_mission,
    )
    from nls.missions.solution import (
        Elevations as Elevations,
    )
    from nls.missions.solution import (
        Track as Track,
    )
    from nls.missions.solution import (
        elevations as elevations,
    )
    from nls.missions.solution import (
        track_of as track_of,
    )

_WHERE = {
    "nls.missions.association": "associated",
    "nls.missions.folder": "DivesReport MissionReport read_dives read_mission write_mission",
    "nls.missions.solution": "Elevations Track elevations track_of",
}
_MODULE = {name: module for module, names in _WHERE.items() for name in names.split()}

__all__ = sorted(_MODULE)

if not TYPE_CHECKING:
    __getattr__ = importer("nls.missions", _MODULE)
    del importer, TYPE_CHECKING
