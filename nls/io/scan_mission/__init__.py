"""Scan missions: CSV files of keyframes and of the points that a sonar measured from them; and the files of a map."""

from nls.io.scan_mission.read import COLUMNS, ScanReport, Truth, is_scan_mission, read_scan_mission

__all__ = ["COLUMNS", "ScanReport", "Truth", "is_scan_mission", "read_scan_mission"]
