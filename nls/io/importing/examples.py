"""A value of every column that templates and drafts show."""

from __future__ import annotations

from nls.io.importing.units import mission_unit

__all__ = ["example"]

EXAMPLES = {  # by column, or by table and column
    **{"name": "dvl_scale", "kernel": "huber:1.345", "time_s": "0.0", "time_i_s": "10.0", "time_j_s": "95.0"},
    **{"i": "0", "j": "1", "landmark": "7", "beacon": "1", "beams": "256", "bins": "500", "ways": "2", "valid": "1"},
    **{"lat_deg": "54.1", "lon_deg": "10.2", "sound_speed_m_s": "1500.0", "vx_m_s": "1.2", "range_m": "12.5"},
    **{"range_min_m": "1.0", "range_max_m": "20.0", "fan_rad": "2.1", "aperture_rad": "0.35", "scale": "0.005"},
    **{"travel_time_s": "0.0167", "turn_around_s": "0.0", "delay_s": "0.0", "sigma_bridge_m_s_sqrt_s": "0.05"},
    **{"sigma_travel_time_s": "0.0001", "value": "0.0", "sigma": "0.01", "z_m": "5.0"},
    **{"sonar.name": '"sonar"', "sonar.z_m": "0.0", **{f"sonar.{a}_rad": "0.0" for a in ("roll", "pitch", "yaw")}},
    **{"contacts.sigma_range_m": "0.02", "contacts.sigma_azimuth_rad": "0.005", "path.sigma_yaw_rad": "0.01"},
    **{"fixes.sigma_x_m": "2.0", "fixes.sigma_y_m": "2.0", "path.sigma_x_m": "0.05", "path.sigma_y_m": "0.05"},
}
SMALL = {"rad": "0.01", "deg": "1.0", "m": "0.5", "m/s": "0.02", "s": "0.01"}


def example(table: str, column: str) -> str:
    """A value that a column of a table may have.

    Examples
    --------
    >>> example("sonar", "beams"), example("contacts", "sigma_range_m"), example("zpr", "sigma_z_m")
    ('256', '0.02', '0.5')
    """
    known = EXAMPLES.get(f"{table}.{column}", EXAMPLES.get(column))
    if known is not None:
        return known
    unit = mission_unit(column)[1]
    small = SMALL.get(unit, "1.0")
    return small if column.startswith("sigma") or unit in ("rad", "m/s") else "0.0" if unit else "1.0"
