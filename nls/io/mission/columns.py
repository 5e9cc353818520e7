"""The files of a mission folder and the columns of each: names with their units, in the order they are written."""

from __future__ import annotations

__all__ = ["COLUMNS"]

PLACE = ("x_m", "y_m", "z_m")
ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")
LEVEL = ("x_m", "y_m", "yaw_rad")
TILT = ("z_m", "pitch_rad", "roll_rad")
CONTACT = ("range_m", "azimuth_rad")


def suffixed(names: tuple[str, ...]) -> tuple[str, ...]:
    """The columns of the standard deviations of columns."""
    return tuple(f"sigma_{name}" for name in names)


COLUMNS: dict[str, tuple[str, ...]] = {
    "sonar": (
        *("name", "beams", "bins", "fan_rad", "aperture_rad", "range_min_m", "range_max_m"),
        *PLACE,
        *ANGLES,
    ),
    "contacts": ("i", "landmark", *CONTACT, *suffixed(CONTACT)),
    "odometry": ("i", "j", *LEVEL, *suffixed(LEVEL)),
    "zpr": ("i", *TILT, *suffixed(TILT)),
    "anchor": ("i", *LEVEL, *suffixed(LEVEL)),
    "truth": ("i", *ANGLES, *PLACE),
    "landmarks": ("landmark", *PLACE),
    "dvl": ("time_s", "vx_m_s", "vy_m_s", "vz_m_s", "valid"),
    "ahrs": ("time_s", *ANGLES),
    "depth": ("time_s", "z_m"),
    "dvl_mount": (*PLACE, *ANGLES),
    "noise": ("sigma_v_m_s", "scale", "sigma_bridge_m_s_sqrt_s", *suffixed(ANGLES), "sigma_z_m"),
    "poses": ("i", "time_s"),
}
TRACK = ("odometry", "zpr")  # either these
LOG = ("dvl", "ahrs", "depth", "noise")  # or these must be there, all of them
