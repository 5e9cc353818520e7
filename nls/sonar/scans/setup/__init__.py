"""Whether a scan mission is set up as it says: the side of the azimuths, the mounting, the clock, the sigmas."""

from nls.sonar.scans.setup.checks import SetupFinding, SetupKind, check_setup
from nls.sonar.scans.setup.mounting import Mounting, mounting

__all__ = ["Mounting", "SetupFinding", "SetupKind", "check_setup", "mounting"]
