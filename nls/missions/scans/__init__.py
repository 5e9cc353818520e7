"""From the points of scans to closures and a map: fields, matches, submaps, candidates, and the rounds of closing."""

from nls.missions.scans.closing import Closing, Round, close
from nls.missions.scans.correlation import Field, Match, match
from nls.missions.scans.dead_reckoning import Drift, dead_reckoning
from nls.missions.scans.matches import Matches, Verdict
from nls.missions.scans.online import OnlineClosing
from nls.missions.scans.scans import Scans, submap

__all__ = [
    "Closing",
    "Drift",
    "Field",
    "Match",
    "Matches",
    "OnlineClosing",
    "Round",
    "Scans",
    "Verdict",
    "close",
    "dead_reckoning",
    "match",
    "submap",
]
