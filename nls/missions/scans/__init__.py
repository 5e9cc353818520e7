"""From the points of scans to closures and a map: fields, matches, submaps, candidates, and the rounds of closing."""

from nls.missions.scans.closing import Closing as Closing, Matches as Matches, Round as Round, Verdict as Verdict
from nls.missions.scans.closing import close as close
from nls.missions.scans.correlation import Field as Field, Match as Match, match as match
from nls.missions.scans.dead_reckoning import Drift as Drift, dead_reckoning as dead_reckoning
from nls.missions.scans.online import OnlineClosing as OnlineClosing
from nls.missions.scans.scans import Scans as Scans, submap as submap
