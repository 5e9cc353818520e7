"""The files of a scan mission and the columns of each: meters, seconds and radians."""

from __future__ import annotations

from pathlib import Path

from nls.io.mission.columns import ALONE, LOG, TRACK

__all__ = ["COLUMNS", "OPTIONAL", "SETTINGS", "file_of", "is_scan_mission"]

COLUMNS: dict[str, tuple[str, ...]] = {
    "keyframes": ("keyframe", "time", "x", "y", "yaw"),
    "scans": ("keyframe", "range", "azimuth", "intensity"),
    "truth": ("time", "x", "y", "yaw"),
}
OPTIONAL: dict[str, tuple[str, ...]] = {"scans": ("intensity",), "truth": ("yaw",)}
NEEDED = ("keyframes", "scans")
SETTINGS = "mission.toml"
OTHER_MISSIONS = {*TRACK, *LOG, *ALONE} - {"odometry"}  # names of tables that a scan mission does not have


def file_of(folder: str | Path, table: str) -> Path | None:
    """The file of a table, plain or gzip-compressed; None without one."""
    names = (Path(folder, f"{table}.csv"), Path(folder, f"{table}.csv.gz"))
    return next((name for name in names if name.exists()), None)


def is_scan_mission(folder: str | Path) -> bool:
    """Whether a folder holds keyframes and scans, or one of the two and no table of another mission."""
    present = [file_of(folder, table) is not None for table in NEEDED]
    return all(present) or (any(present) and not any(file_of(folder, table) for table in OTHER_MISSIONS))
