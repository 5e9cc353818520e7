"""Are the tables of a mission plausible? Checks of its numbers, each with the unit, sign or frame that explains it."""

from nls.missions.checks.findings import Cause, Explained, Implausible, Reading, Trial
from nls.missions.checks.inspection import implausible, of_log
from nls.missions.checks.log import Fixes, Log

__all__ = ["Cause", "Explained", "Fixes", "Implausible", "Log", "Reading", "Trial", "implausible", "of_log"]
