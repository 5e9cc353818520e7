"""The depths of a raw log: depth.csv as it is, or pressure.csv by the density or the latitude of water.csv.

The tide is subtracted: depths are below the level that tide.csv counts from, such as chart datum, and not below the
surface.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array
from models.pressure import ATMOSPHERE, depth_by_density, depth_unesco
from nls.missions.folder.report import MissionReport
from nls.missions.folder.rows import one_row
from nls.missions.folder.table import Table


def depths_of(tables: dict[str, Table], report: MissionReport) -> tuple[Table, Array, Array]:
    """The table of depths or pressures, its times (n,), s, and the depths (n, 1), m.

    Raises
    ------
    GraphFileError
        Times that do not rise; nothing that says how heavy the water is; a tide that is not known at all times.
    """
    if (depth := tables.get("depth")) is not None:
        for name in ("water", "tide"):
            if name in tables:
                raise tables[name].at(0, f"depth.csv has depths; {name}.csv is for pressure.csv, leave it out")
        return depth, depth.rising("time_s"), depth.measured("z_m")
    pressure = tables["pressure"]
    t, p = pressure.rising("time_s"), pressure.measured("pressure_pa")
    z = _depth(pressure, p, tables.get("water"), report)
    if (tide := tables.get("tide")) is not None:
        times, height = tide.rising("time_s"), tide.measured("tide_m")[:, 0]
        if t[0] < times[0] or t[-1] > times[-1]:
            rest = f"pressure.csv lasts from {float(t[0])!r} to {float(t[-1])!r} s; give a row before and one after it"
            raise tide.at(0, f"the tide is known from {float(times[0])!r} to {float(times[-1])!r} s, and {rest}")
        z = z - np.interp(t, times, height)[:, None]
    if (above := z[:, 0] < -1).any():  # m: waves and weather
        k = int(np.argmax(above))
        cure = "is it relative to the atmosphere? Then atmosphere_pa of water.csv is 0"
        report.warn(f"{pressure.place(k)}: pressure_pa gives {-float(z[k, 0]):.3g} m above the surface; {cure}")
    return pressure, t, z


def _depth(pressure: Table, p: Array, water: Table | None, report: MissionReport) -> Array:
    """Depths (n, 1) below the surface."""
    given: dict[str, float] = {}
    if water is not None:
        given = one_row(water)
        water.measured(*water.names)  # within what their units allow
        if given.keys() >= {"density_kg_m3", "latitude_deg"}:
            raise water.at(0, "density_kg_m3 and latitude_deg both say how heavy the water is; leave one of them")
    if "atmosphere_pa" not in given:
        cure = "atmosphere_pa of water.csv says it"
        report.notes.append(f"pressure.csv: {ATMOSPHERE:.0f} Pa of it are taken for the atmosphere; {cure}")
    above = p - given.get("atmosphere_pa", ATMOSPHERE)
    if (density := given.get("density_kg_m3")) is not None:
        assert water is not None
        water.positive("density_kg_m3")
        return depth_by_density(above, density)
    latitude = given.get("latitude_deg")
    if latitude is None and report.plane is not None:
        latitude = report.plane.lat
        report.notes.append(f"pressure.csv: depths by the formula of UNESCO at {latitude:.6g} degrees, of origin.csv")
    if latitude is None:
        cure = "add water.csv, one row with density_kg_m3, or with latitude_deg for sea water by the formula of UNESCO"
        raise pressure.at(0, f"nothing says how heavy the water is; {cure}")
    if abs(latitude) > 90:
        assert water is not None
        raise water.at(0, f"latitude_deg is {latitude!r}; expected -90 to 90")
    return depth_unesco(above, latitude)
