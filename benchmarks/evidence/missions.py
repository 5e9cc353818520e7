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

from script import make_page

Report = dict[str, Any]
MAPPINGS = Path(__file__).parents[2] / "docs" / "missions"
RIGID = "rigid, without scale"


def nls(*words: str | Path) -> Report:
    """The report for programs of a command."""
    with TemporaryDirectory() as folder:
        file = Path(folder, "report.json")
        command = [sys.executable, "-m", "nls", *map(str, words), "--json", str(file)]
        subprocess.run(command, check=True, capture_output=True)
        return dict(json.loads(file.read_text(encoding="utf-8")))


def imported(mapping: str, folder: Path, *logs: Path) -> Path:
    """A mission of logs by a mapping of the documentation."""
    command = [sys.executable, "-m", "nls", "import", *map(str, logs)]
    command += ["--map", str(MAPPINGS / f"{mapping}.toml"), "-o", str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    return folder


def row(name: str, mission: Report, alignment: str, published: str = "") -> str:
    """A row of a mission whose errors the solution reports, nothing aligned."""
    dead, solution = mission["dead_reckoning"], mission["solution"]
    return (
        f"| {name} | {mission['distance_m']:.0f} | {dead['ate_rmse_m']:.2f} | {solution['ate_rmse_m']:.2f} | "
        f"{solution['drift_percent']:.2f} | {alignment} | {published} |"
    )


def vehicles(data: Path, folder: Path) -> list[str]:
    """DVL, attitude and depth at sea and simulated; nothing checks them, so the solution is dead reckoning."""
    rows = []
    sea = data / "underwater-auv-dvl"
    for number in range(1, 8):
        logs = sea / f"DVL_trajectory{number}.csv", sea / f"GT_trajectory{number}.csv"
        mission = imported("auv-dvl", folder / f"auv{number}", *logs)
        rows.append(row(f"AUV at sea, trajectory {number}", nls("solve", mission)["mission"], "none"))
    log = data / "underwater-holoocean" / "underwater_data.txt.gz"
    mission = imported("holoocean", folder / "holoocean", log)
    rows.append(row("HoloOcean, attitude that of the truth", nls("solve", mission)["mission"], "none"))
    return rows


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
        f"Acoustic positions of a vehicle, 24 min: {MEASURED}.",
        "Stated sigmas: 0.1 m for a range, the device's own standard deviation for a fix, 0.3 m/sqrt(s) of random "
        "walk.",
        f"With them chi2 over the degrees of freedom is {stated['chi2_final'] / stated['dof']:.2f}. With Cauchy "
        "kernels and `--sigmas estimate`:",
        "",
        "| kind | measurements | scale on the stated sigma | its sigma | numbers that check |",
        "|:--|--:|--:|--:|--:|",
    ]
    for kind in report["sigmas"]["kinds"]:
        scale = f"{kind['scale']:.4g} | {kind['scale_sigma']:.2g}" if kind["known"] else "not told | "
        lines.append(f"| {kind['kind']} | {kind['measurements']} | {scale} | {kind['redundancy']:.0f} |")
    return lines


MEASURED = "4,484 fixes, 17,168 ranges to four receivers whose places are not given"


def page(data: Path) -> list[str]:
    """The tables, in Markdown."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        return [
            "ATE: rmse of the positions, m. Drift: error at the end over the distance.",
            "",
            "| log | distance, m | dead reckoning, ATE | solution, ATE | drift, % | alignment | published |",
            "|:--|--:|--:|--:|--:|:--|:--|",
            *vehicles(data, folder),
            marina(data, folder),
            "",
            "Nothing in these logs checks dead reckoning: `nls solve` says so, and both columns are the same.",
            "Logs with ranges among beacons, GOATS 14 and 15, plaza2: [scales](sigmas.md).",
            "",
            *acoustic(data, folder),
            "",
            "The fixes are computed from the same ranges, and many rows repeat the one before. So their small "
            "scale shows how well",
            "they fit the ranges, not how right they are. There is no truth. The ranges of one ping differ by "
            "decimeters at tens of",
            "meters. Four receivers a meter apart give a range and a poorly known direction.",
            "",
            "The caves have no heading sensor in the log: `nls import` reads DVL and depth, and says what is missing.",
        ]


if __name__ == "__main__":
    make_page(__doc__, "missions.md", "Real logs", page)
