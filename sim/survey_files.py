"""The files of a simulated survey: the mission, its truth apart, and the same log as the loggers of a vehicle write it.

dvl.csv, ahrs.csv, ...      the mission, for nls solve
truth/                      truth.csv (twice a second), beacons.csv, calibration.csv
raw/                        one file an instrument, in its own units and words, and mapping.toml for nls import
"""

from __future__ import annotations

import numpy as np

from models import euler
from nls.missions.folder.table import csv_text
from sim.survey_log import SurveyLog
from sim.survey_raw import raw_files
from sim.survey_track import every

__all__ = ["survey_files", "survey_rows"]

TRUTH_PERIOD = 0.5  # s
HOLDS = (
    "A mission folder, as nls solve reads it: one CSV file a sensor, units in the names of the columns.\n"
    "truth/: the true track, beacons and calibrations; nls solve does not read it.\n"
    "raw/: the same log in the words and units of loggers, and mapping.toml for nls import.\n"
)


def survey_files(log: SurveyLog) -> tuple[dict[str, bytes], str]:
    """The files by name, folders with a slash, and the lines of README.txt on what they are."""
    mission = {f"{name}.csv": csv_text(list(table), *table.values()) for name, table in log.tables.items()}
    return {**mission, **truth_files(log), **raw_files(log)}, HOLDS


def truth_files(log: SurveyLog) -> dict[str, bytes]:
    """truth/: the true track, beacons and calibrations."""
    t = every(TRUTH_PERIOD, 0.0, log.duration)
    track = np.round(euler.from_se3(log.track.pose(t)), 9)
    beacon = np.arange(1, len(log.beacons) + 1)
    true, place, m = log.calibration, ["x_m", "y_m", "z_m"], len(log.landmarks)
    return {
        "truth/truth.csv": csv_text(["time_s", "roll_rad", "pitch_rad", "yaw_rad", *place], t, track),
        "truth/beacons.csv": csv_text(["beacon", *place], beacon, log.beacons),
        "truth/calibration.csv": csv_text(["name", "value"], list(true), list(true.values())),
        **({"truth/landmarks.csv": csv_text(["landmark", *place], np.arange(m), log.landmarks)} if m else {}),
    }


def survey_rows(log: SurveyLog) -> list[tuple[str, str]]:
    """The table of a survey, one (label, text) a line."""
    tables = log.tables
    lost, wrong = int((tables["dvl"]["valid"] == 0).sum()), int(log.wrong.sum())
    contacts = len(tables["contacts"]["i"]) if "contacts" in tables else 0
    count = {name: len(table["time_s"]) for name, table in tables.items() if "time_s" in table}
    true = ", ".join(f"{name} {value:.4g}" for name, value in log.calibration.items())
    return [
        ("world", f"{log.name}, seed {log.seed}"),
        ("way", f"{log.distance:.4g} m in {log.duration} s"),
        (
            "DVL",
            f"{count['dvl']} pings, {lost} without bottom lock, {tables['dvl']['altitude_m'].min():.3g} m up or more",
        ),
        ("AHRS, depth", f"{count['ahrs']} and {count['depth']}"),
        ("GPS", f"{count['fixes']} fixes at the surface"),
        ("LBL", f"{count['ranges']} travel times to {len(log.beacons)} beacons"),
        ("USBL", f"{count['usbl']} fixes from the ship" + (f", {wrong} of them wrong" if wrong else "")),
        *([("sonar", f"{contacts} contacts of {len(log.landmarks)} landmarks")] if contacts else []),
        ("calibration", true),
    ]
