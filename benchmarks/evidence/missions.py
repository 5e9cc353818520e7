"""Real logs, each by the commands of the documentation: how far dead reckoning and solution are from the truth.

    python benchmarks/evidence/missions.py [--out DIR]

Every set is imported by its mapping in ``docs/missions`` and solved with the default options; pose graphs are solved as
they are. What others published of the same set stands beside it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from script import Table, line_of, make_page

Report = dict[str, Any]
MAPPINGS = Path(__file__).parents[2] / "docs" / "missions"
RIGID = "rigid, without scale"
TITLES = ["log", "distance, m", "dead reckoning, ATE", "solution, ATE", "drift, %", "alignment", "published"]


def run(*words: str | Path) -> None:
    """A command."""
    subprocess.run([sys.executable, "-m", "nls", *map(str, words)], check=True, capture_output=True)


def nls(*words: str | Path) -> Report:
    """The report for programs of a command."""
    with TemporaryDirectory() as folder:
        file = Path(folder, "report.json")
        run(*words, "--json", file)
        return dict(json.loads(file.read_text(encoding="utf-8")))


def imported(mapping: str, folder: Path, *logs: Path) -> Path:
    """A mission of logs by a mapping of the documentation."""
    run("import", *logs, "--map", MAPPINGS / f"{mapping}.toml", "-o", folder)
    return folder


def row(name: str, mission: Report) -> str:
    """A row of a mission whose errors the solution reports, nothing aligned."""
    dead, solution = mission["dead_reckoning"], mission["solution"]
    meters = (f"{mission['distance_m']:.0f}", f"{dead['ate_rmse_m']:.2f}", f"{solution['ate_rmse_m']:.2f}")
    return line_of([name, *meters, f"{solution['drift_percent']:.2f}", "none", ""])


def vehicles(data: Path, folder: Path) -> list[str]:
    """DVL, attitude and depth at sea and simulated; nothing checks them, so the solution is dead reckoning."""
    rows = []
    sea = data / "underwater-auv-dvl"
    for number in range(1, 8):
        logs = sea / f"DVL_trajectory{number}.csv", sea / f"GT_trajectory{number}.csv"
        mission = imported("auv-dvl", folder / f"auv{number}", *logs)
        rows.append(row(f"AUV at sea, trajectory {number}", nls("solve", mission)["mission"]))
    log = data / "underwater-holoocean" / "underwater_data.txt.gz"
    mission = imported("holoocean", folder / "holoocean", log)
    return [*rows, row("HoloOcean, attitude that of the truth", nls("solve", mission)["mission"])]


def marina(data: Path, folder: Path) -> str:
    """The way of a vehicle in a marina, reckoned by itself, against the DGPS of its float."""
    logs = data / "aracati" / "keyframes.csv.gz", data / "aracati" / "truth.csv.gz"
    mission, solved = imported("aracati", folder / "aracati", *logs), folder / "aracati-solved"
    distance = nls("solve", mission, "-o", solved)["mission"]["distance_m"]
    error = nls("evaluate", solved / "trajectory.csv", mission / "truth.csv", "--align", "rigid")
    rmse = error["ate"]["rmse_m"]
    published = "dead reckoning 10.61; Bruce-SLAM 1.88 to 2.07 without USBL"
    return f"| Aracati, a marina; no sonar yet | {distance:.0f} | {rmse:.2f} | {rmse:.2f} | | {RIGID} | {published} |"


def acoustic(data: Path, folder: Path) -> list[str]:
    """What the fixes and ranges of an acoustic positioning system are worth, by their own residuals."""
    log = data / "underwater-ugps" / "g2_acoustic.csv.gz"
    mission = imported("ugps", folder / "ugps", log)
    doubtful = "--allow-doubtful"  # the stated sigmas do not fit, and a kernel for all ignores steps of the walk
    stated = nls("solve", mission, doubtful)
    report = nls("solve", mission, "--robust", "cauchy:1", "--sigmas", "estimate", doubtful)
    lines = [
        f"Acoustic positions of a vehicle, 24 min: {MEASURED}.\n"
        "Stated sigmas: 0.1 m for a range, the device's own standard deviation for a fix, 0.3 m/sqrt(s) of random "
        "walk.\n"
        f"With them chi2 over the degrees of freedom is {stated['chi2_final'] / stated['dof']:.2f}. With Cauchy "
        "kernels and `--sigmas estimate`:",
        *Table(["kind", "measurements", "scale on the stated sigma", "its sigma", "numbers that check"]),
    ]
    for kind in report["sigmas"]["kinds"]:
        scale = f"{kind['scale']:.4g} | {kind['scale_sigma']:.2g}" if kind["known"] else "not told | "
        lines.append(line_of([kind["kind"], kind["measurements"], scale, f"{kind['redundancy']:.0f}"]))
    return lines


MEASURED = "4,484 fixes, 17,168 ranges to four receivers whose places are not given"


def page(data: Path) -> list[str]:
    """The tables, in Markdown."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        return [
            "ATE: rmse of the positions, m. Drift: error at the end over the distance.",
            *Table(TITLES, "lrrrrll"),
            *vehicles(data, folder),
            marina(data, folder),
            "No measurement in these logs checks dead reckoning. `nls solve` says so, and both columns are "
            "equal.\nLogs with ranges to beacons (GOATS 14 and 15, plaza2): [scales](sigmas.md).",
            *acoustic(data, folder),
            "The fixes are computed from the same ranges, and many rows repeat the one before. So their small "
            "scale shows a\n"
            "good fit to the ranges, not a small error. There is no truth. The ranges of one ping differ by "
            "decimeters at tens of\n"
            "meters. Four receivers a meter apart give a range and a poorly known direction.",
            "The caves have no heading sensor in the log: `nls import` reads DVL and depth, and says what is missing.",
        ]


if __name__ == "__main__":
    make_page("Real logs by one command", page)
