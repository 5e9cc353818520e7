"""Closures and maps of scans under their public path; the rooms are `nls.missions.scans` and `nls.missions.checks`."""

from nls.missions.checks.findings import SetupFinding, SetupKind
from nls.missions.checks.scan_setup import Mounting, check_setup, mounting
from nls.missions.scans import (
    Closing,
    Drift,
    Field,
    Match,
    Matches,
    OnlineClosing,
    Round,
    Scans,
    Verdict,
    close,
    dead_reckoning,
    match,
    submap,
)

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
