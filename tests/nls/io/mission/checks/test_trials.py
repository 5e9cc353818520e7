"""One constant that is wrong is named by the solver, and its line, followed to the letter, brings the place back."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import nls
from factors.robust import Cauchy
from models.algebra import apply
from models.manifolds.euler import quaternion_from_angles
from models.manifolds.so3 import rotation3
from nls.io.mission.checks.trials import explained
from nls.io.mission.checks.words import sentence
from nls.io.mission.columns import ANGLES, VELOCITY
from nls.io.mission.folder import read_tables
from tests.combinations import for_all
from tests.nls.io.mission.checks.dives import Dive, Tables

Spoil = Callable[[Tables], object]
WITHIN = 1.5  # times the error without a mistake
DEG = np.pi / 180


def changed(name: str, **change: Callable[[np.ndarray], np.ndarray]) -> Spoil:  # type: ignore[type-arg]
    """Columns of a table as functions of themselves."""
    return lambda tables: tables[name].update({key: f(tables[name][key]) for key, f in change.items()})


def turned(tables: Tables) -> None:
    """The axes of the DVL by 45 deg to starboard."""
    x, y = tables["dvl"]["vx_m_s"], tables["dvl"]["vy_m_s"]
    tables["dvl"].update(vx_m_s=(x + y) / np.sqrt(2), vy_m_s=(y - x) / np.sqrt(2))


def earth(tables: Tables) -> None:
    """Velocities of the DVL north, east and down."""
    ahrs, dvl = tables["ahrs"], tables["dvl"]
    R = rotation3(quaternion_from_angles(np.column_stack([ahrs[name] for name in ANGLES])))
    dvl.update(zip(VELOCITY, apply(R, np.column_stack([dvl[name] for name in VELOCITY])).T, strict=True))


def jump(tables: Tables) -> None:
    tables["fixes"]["x_m"][9] += 44.0


def heading(degrees: float) -> Spoil:
    return changed("ahrs", yaw_rad=lambda yaw: np.remainder(yaw + degrees * DEG + np.pi, 2 * np.pi) - np.pi)


CASES: dict[str, tuple[str, Spoil, str]] = {  # what measures the place, the mistake, the start of a cure
    "heading 13 deg": ("fixes", heading(13.0), "declination_rad,-0.2"),
    "DVL at 45 deg": ("fixes", turned, "dvl_yaw_rad,0.78"),
    "DVL north, east, down": ("fixes", earth, "a column earth_axes of 1"),
    "yaw from east": ("fixes", changed("ahrs", yaw_rad=lambda yaw: np.pi / 2 - yaw), "sign = -1, offset = 1.5708"),
    "fixes 3 s late": ("fixes", changed("fixes", time_s=lambda t: t + 3.0), "fixes_clock_s,"),
    "DVL 5 %": (
        "fixes",
        changed("dvl", **dict.fromkeys(("vx_m_s", "vy_m_s", "vz_m_s"), lambda v: 1.05 * v)),
        "dvl_scale,0.05",
    ),
    "declination 130 deg": ("fixes", heading(-130.0), "declination_rad,2.26"),
    "fixes exchanged": (
        "fixes",
        lambda t: t["fixes"].update(x_m=t["fixes"]["y_m"], y_m=t["fixes"]["x_m"]),
        "exchange the names of x_m, y_m",
    ),
    "USBL 3 % long": ("usbl", changed("usbl", range_m=lambda r: 1.03 * r), "usbl_scale,0.0"),
    "USBL turned": ("usbl", changed("usbl", bearing_rad=lambda a: a - 0.1), "usbl_yaw_rad,0.09"),
    "USBL 18 s late": ("usbl", changed("usbl", time_s=lambda t: t + 18.0), "usbl_clock_s,"),
    "ranges 3 % long": ("ranges", changed("ranges", range_m=lambda r: 1.03 * r), "sound_speed_scale,0.0"),
    "a fix that jumps": ("fixes", jump, "--robust Position=cauchy:1"),
}


def solve(dive: Dive, folder: str, kernel: str = "") -> tuple[float, nls.Result]:
    """The error of a folder, m, and its result."""
    graph, values, report = nls.load(folder)
    if kernel:
        name, _, width = kernel.partition("=cauchy:")
        factors = [f.robust(Cauchy(float(width))) if f.name == name else f for f in graph.factors]
        graph = nls.FactorGraph(factors, graph.fixed)
    result = graph.optimize(nls.initialize(graph, values)[0])
    return dive.error(result.values, report), result


def follow(cure: str, folder: Path) -> str:
    """Do what a sentence says, to the letter; returns the kernel to solve with."""
    if row := re.search(r"write `(\w+,[-\d.]+,[-\d.]+)` in calibration\.csv", cure):
        (folder / "calibration.csv").write_text(f"name,value,sigma\n{row[1]}\n")
    elif names := re.search(r"of (\w+\.csv) look exchanged: exchange the names of (\w+), (\w+)", cure):
        head, _, rest = (folder / names[1]).read_text().partition("\n")
        other = {names[2]: names[3], names[3]: names[2]}
        (folder / names[1]).write_text(",".join(other.get(name, name) for name in head.split(",")) + "\n" + rest)
    elif re.search(r"multiply yaw_rad by -1, then add 1\.5708 to it", cure):
        head, *lines = (folder / "ahrs.csv").read_text().split()
        k = head.split(",").index("yaw_rad")
        rows = np.array([[float(cell) for cell in line.split(",")] for line in lines])
        rows[:, k] = 1.5708 - rows[:, k]
        (folder / "ahrs.csv").write_text("\n".join([head, *(",".join(map(repr, row)) for row in rows.tolist())]))
    elif re.search(r"give dvl\.csv a column earth_axes of 1", cure):
        head, *lines = (folder / "dvl.csv").read_text().split()
        (folder / "dvl.csv").write_text("\n".join([f"{head},earth_axes", *(f"{line},1" for line in lines)]))
    else:
        (kernel,) = re.findall(r"--robust (\S+)", cure)
        return str(kernel)
    return ""


@for_all(name=list(CASES))
@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_the_cause_is_named_and_its_cure_works(name: str, tmp_path: Path) -> None:
    """The error after it is within 1.5 times that of the right tables with the same constant left open."""
    aid, spoil, start = CASES[name]
    dive, folder = Dive(1, (aid,)), tmp_path / name
    clean, right = solve(dive, dive.write(tmp_path / f"{name}, right"))
    assert right.fit is not nls.Fit.IMPLAUSIBLE
    wrong, result = solve(dive, dive.write(folder, spoil))
    assert result.fit is nls.Fit.IMPLAUSIBLE
    assert wrong > 2 * clean
    explanation = explained(read_tables(folder)[0], result.chi2_final, result.dof)
    cures = re.split("; or ", sentence(explanation))
    (cure,) = [words for words in cures if start in words]
    after, cured = solve(dive, str(folder), follow(cure, folder))
    if calibration := re.match(r"(\w+),", start):
        (tmp_path / f"{name}, right" / "calibration.csv").write_text(f"name,value,sigma\n{calibration[1]},0,1\n")
        clean = max(clean, solve(dive, str(tmp_path / f"{name}, right"))[0])
    assert after < WITHIN * clean
    assert cured.fit is not nls.Fit.IMPLAUSIBLE
