"""From the points of scans to closures and a map: fields, matches, submaps, candidates, and the rounds of closing."""

from nls.sonar.scans.closing import Closing, Round, close
from nls.sonar.scans.dead_reckoning import Drift, dead_reckoning
from nls.sonar.scans.field import Field
from nls.sonar.scans.matches import Matches, Verdict
from nls.sonar.scans.matching import Match, match
from nls.sonar.scans.online import OnlineClosing
from nls.sonar.scans.scans import Scans, submap
from nls.sonar.scans.setup.checks import SetupFinding, SetupKind, check_setup
from nls.sonar.scans.setup.mounting import Mounting, mounting

__all__ = [
    "Closing",
    "Drift",
    "Field",
    "Match",
    "Matches",
    "Mounting",
    "OnlineClosing",
    "Round",
    "Scans",
    "SetupFinding",
    "SetupKind",
    "Verdict",
    "check_setup",
    "close",
    "dead_reckoning",
    "match",
    "mounting",
    "submap",
]
