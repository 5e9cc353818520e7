"""The table that a simulated world prints, and the files of its folder.

A world is graph.npz and truth.npz, a pose graph also graph.g2o and truth.g2o, a mission also the CSV files that nls
solve reads, a rig also rig.json and rig.png.

A survey is a mission, its truth apart, and the same log as the loggers of a vehicle write it:

dvl.csv, ahrs.csv, ...      the mission, for nls solve
truth/                      truth.csv (twice a second), beacons.csv, calibration.csv
raw/                        one file an instrument, in its own units and words, and mapping.toml for nls import

A harbor has a frame with x north and y west: yaw is positive counterclockwise, azimuths are positive to port.

keyframes.csv     keyframe, time, s, x, y, m, yaw, rad: dead reckoning
scans.csv         keyframe, range, m, azimuth, rad, intensity (1: not simulated)
truth.csv         time, s, x, y, m, yaw, rad
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from models import euler
from nls import GaussNewton, Result, kinds
from nls.missions.folder.table import csv_text
from sim.camera_sonar import Rig
from sim.mission import Mission
from sim.survey_log import SurveyLog
from sim.survey_raw import raw_files
from sim.survey_track import every
from sim.world import Simulated, World, position_error
from sim.worlds.harbor import Harbor

__all__ = ["HOLD", "Files", "native_files", "simulated"]

Contents = tuple[dict[str, bytes], str]  # by name, folders with a slash, and what they hold
Files = Callable[[], Contents]
Rows = list[tuple[str, str]]  # label and text

HOLD = "graph.npz: measurements and initial guess, for nls solve.\ntruth.npz: measurements and true values.\n"
FOLDER = "A mission folder, as nls solve reads it: one CSV file a sensor, units in the names of the columns.\n"
SURVEY = FOLDER + (
    "truth/: the true track, beacons and calibrations; nls solve does not read it.\n"
    "raw/: the same log in the words and units of loggers, and mapping.toml for nls import.\n"
)
HARBOR = "keyframes.csv, scans.csv: dead reckoning and detections of the sonar.\ntruth.csv: the true keyframes.\n"
RIG = "rig.png: the initial guess and the optimum.\nrig.json: errors before and after, m and rad.\n" + HOLD
WEST = np.array([1.0, -1.0, -1.0])  # from y east, yaw clockwise
ALIGNED = "rigid, of cameras and points together; the sonar is not aligned"
(s,) = kinds("s")


def simulated(world: World | Mission | Rig | SurveyLog | Harbor, out: str | None) -> tuple[Rows, Files]:
    """The table of a world, and what makes its files; a folder with those of another mission is refused."""
    if isinstance(world, Rig):
        result = calibrated(world)
        return calibration_rows(world, result), lambda: calibration_files(world, result)
    if isinstance(world, World):
        return rows(world), lambda: graph_files(world)
    makers: dict[type, tuple[Callable[[Any], Rows], Callable[[Any], Contents]]] = {
        Mission: (mission_rows, mission_folder),
        SurveyLog: (survey_rows, survey_files),
        Harbor: (harbor_rows, harbor_files),
    }
    table, contents = makers[type(world)]

    def files() -> Contents:
        from nls.missions.folder.write import refuse_mixed

        made = contents(world)
        refuse_mixed(str(out), made[0])
        return made

    return table(world), files


def native_files(world: Simulated) -> dict[str, bytes]:
    """graph.npz and truth.npz by name.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> list(native_files(sim.rig(np.random.default_rng(0), poses=3, points=5)))
    ['graph.npz', 'truth.npz']
    """
    from nls.io import rendered  # only here: a table needs no file formats

    values = {"graph.npz": world.start, "truth.npz": world.truth}
    return {name: rendered(name, world.graph, estimate)[0] for name, estimate in values.items()}


# --- pose graphs and missions -----------------------------------------------------------------------------------------


def rows(world: World) -> Rows:
    """The table, one (label, text) a line."""
    odometry, closures = world.graph.factors
    return [
        ("world", f"{world.name}, seed {world.seed}"),
        ("poses", f"{world.poses} in {world.truth.stack('x').manifold}"),
        ("edges", f"{len(world.graph)}: {len(odometry)} odometry, {len(closures)} loop closures"),
        ("chi2 at start", f"{world.graph.chi2(world.start):.6g}"),
        ("chi2 at truth", f"{world.graph.chi2(world.truth):.6g}, expected {world.rows} (rows of A)"),
        ("dof", f"{world.dof}: the expected chi2 at the optimum"),
        ("start error", f"{position_error(world.start, world.truth):.4g} m (RMSE of positions, first pose aligned)"),
    ]


def mission_rows(mission: Mission) -> Rows:
    """The table of a sonar mission."""
    wrong = int(mission.wrong.sum())
    return [
        ("world", f"{mission.name}, seed {mission.seed}"),
        ("poses", f"{mission.poses} in SE3, {mission.distance:.4g} m of way"),
        ("landmarks", f"{mission.landmarks}"),
        ("contacts", f"{len(mission.contacts)}" + (f", {wrong} of them wrong" if wrong else "")),
        ("elevation", mission.elevation),
        ("chi2 at truth", f"{mission.sensed.chi2(mission.truth):.6g}, expected {mission.rows} (numbers not wrong)"),
        ("dead reckoning", f"{mission.ate(mission.start):.4g} m (ATE, rmse of positions, nothing aligned)"),
    ]


def graph_files(world: World) -> Contents:
    """The graph with the start and with the truth, in two formats; the one that a folder stands for is written last."""
    from nls.io import rendered

    values = {"graph.g2o": world.start, "truth.g2o": world.truth}
    text = {name: rendered(name, world.graph, estimate)[0] for name, estimate in values.items()}
    return {**text, **native_files(world)}, HOLD + "graph.g2o, truth.g2o: the same for other programs.\n"


def mission_folder(mission: Mission) -> Contents:
    """The files of a mission."""
    from nls.missions.folder.write import mission_files  # only here: a table needs no file formats

    files = mission_files(mission.graph, mission.sonar, mission.offset, mission.truth)
    return {**files, **native_files(mission)}, FOLDER + HOLD


# --- surveys and harbors ----------------------------------------------------------------------------------------------


def survey_files(log: SurveyLog) -> Contents:
    """The files of a survey."""
    mission = {f"{name}.csv": csv_text(list(table), *table.values()) for name, table in log.tables.items()}
    return {**mission, **truth_files(log), **raw_files(log)}, SURVEY


def truth_files(log: SurveyLog) -> dict[str, bytes]:
    """truth/: the true track, beacons and calibrations."""
    t = every(0.5, 0.0, log.duration)
    track = np.round(euler.from_se3(log.track.pose(t)), 9)
    beacon = np.arange(1, len(log.beacons) + 1)
    true, place, m = log.calibration, ["x_m", "y_m", "z_m"], len(log.landmarks)
    return {
        "truth/truth.csv": csv_text(["time_s", "roll_rad", "pitch_rad", "yaw_rad", *place], t, track),
        "truth/beacons.csv": csv_text(["beacon", *place], beacon, log.beacons),
        "truth/calibration.csv": csv_text(["name", "value"], list(true), list(true.values())),
        **({"truth/landmarks.csv": csv_text(["landmark", *place], np.arange(m), log.landmarks)} if m else {}),
    }


def survey_rows(log: SurveyLog) -> Rows:
    """The table of a survey, one (label, text) a line."""
    tables = log.tables
    lost, lowest = int((tables["dvl"]["valid"] == 0).sum()), tables["dvl"]["altitude_m"].min()
    wrong = int(log.wrong.sum())
    contacts = len(tables["contacts"]["i"]) if "contacts" in tables else 0
    count = {name: len(table["time_s"]) for name, table in tables.items() if "time_s" in table}
    true = ", ".join(f"{name} {value:.4g}" for name, value in log.calibration.items())
    return [
        ("world", f"{log.name}, seed {log.seed}"),
        ("way", f"{log.distance:.4g} m in {log.duration} s"),
        ("DVL", f"{count['dvl']} pings, {lost} without bottom lock, {lowest:.3g} m up or more"),
        ("AHRS, depth", f"{count['ahrs']} and {count['depth']}"),
        ("GPS", f"{count['fixes']} fixes at the surface"),
        ("LBL", f"{count['ranges']} travel times to {len(log.beacons)} beacons"),
        ("USBL", f"{count['usbl']} fixes from the ship" + (f", {wrong} of them wrong" if wrong else "")),
        *([("sonar", f"{contacts} contacts of {len(log.landmarks)} landmarks")] if contacts else []),
        ("calibration", true),
    ]


def harbor_files(world: Harbor) -> Contents:
    """The files of a harbor."""
    p, count = world.scans.points, np.arange(len(world.truth))
    z = np.column_stack([np.hypot(*p.T), -np.arctan2(p[:, 1], p[:, 0])])
    pose = ["x", "y", "yaw"]
    return {
        "keyframes.csv": csv_text(["keyframe", "time", *pose], count, world.times, world.poses * WEST),
        "scans.csv": csv_text(
            ["keyframe", "range", "azimuth", "intensity"], world.scans.keyframe, z, np.ones(len(z), dtype=int)
        ),
        "truth.csv": csv_text(["time", *pose], world.times, world.truth * WEST),
    }, HARBOR


def harbor_rows(world: Harbor) -> Rows:
    """The table of a harbor, one (label, text) a line."""
    scene, n = world.scene, len(world.truth)
    parts = {"walls": scene.walls, "piles": scene.piles, "rocks": scene.rocks}
    return [
        ("world", f"harbor, {world.name}, seed {world.seed}"),
        ("scene", ", ".join(f"{len(rows)} {name}" for name, rows in parts.items() if len(rows))),
        ("keyframes", f"{n} in SE2, {world.times[-1]:.4g} s"),
        ("scans", f"{len(world.scans.points)} points, {len(world.scans.points) / n:.3g} of a keyframe"),
        ("dead reckoning", f"{world.ate(world.poses):.4g} m (ATE, rmse of positions, rigid alignment)"),
    ]


# --- rigs -------------------------------------------------------------------------------------------------------------


def calibrated(rig: Rig) -> Result:
    """The optimum by Gauss-Newton from the start of the rig."""
    return rig.graph.optimize(rig.start, GaussNewton())


def calibration_rows(rig: Rig, result: Result) -> Rows:
    """The table, one (label, text) a line."""
    shown = [
        (f"{100 * e.poses:.3g} cm", f"{100 * e.points:.3g} cm", f"{100 * e.extrinsic_m:.3g} cm, {angle:.3g} deg")
        for e in (rig.errors(rig.start), rig.errors(result.values))
        for angle in [np.degrees(e.extrinsic_rad)]
    ]
    return [
        ("world", f"{rig.name}, seed {rig.seed}"),
        ("poses", f"{rig.poses} in SE3"),
        ("points", f"{rig.points}"),
        ("measured", f"{len(rig.images)} images, {len(rig.contacts)} sonar contacts"),
        ("chi2 at truth", f"{rig.graph.chi2(rig.truth):.6g}, expected {rig.rows} (rows of A)"),
        ("chi2", f"{result.chi2_initial:.6g} -> {result.chi2_final:.6g}, dof {result.dof}"),
        ("solved", f"{result.status.name}, {result.iterations} iterations of {result.method}: {result.reason}"),
        *zip(("cameras", "points", "sonar"), map(" -> ".join, zip(*shown, strict=True)), strict=True),
        ("alignment", ALIGNED),
    ]


def calibration_files(rig: Rig, result: Result) -> Contents:
    """rig.json and rig.png beside the graph."""
    from nls.cli.outputs import json_text
    from nls.plot.picture import drawn
    from sim.pictures import rig_before_after

    before, after = rig.errors(rig.start), rig.errors(result.values)
    changes = {
        "cameras [cm]": (100 * before.poses, 100 * after.poses),
        "points [cm]": (100 * before.points, 100 * after.points),
        "sonar, position [cm]": (100 * before.extrinsic_m, 100 * after.extrinsic_m),
        "sonar, angle [deg]": (float(np.degrees(before.extrinsic_rad)), float(np.degrees(after.extrinsic_rad))),
    }
    fields = ("method", "linear_solver", "converged", "reason", "iterations", "chi2_initial", "chi2_final", "dof")
    report: dict[str, Any] = {
        "world": rig.name,
        **{name: getattr(rig, name) for name in ("seed", "poses", "points")},
        **{name: len(getattr(rig, name)) for name in ("images", "contacts")},
        **{name: getattr(result, name) for name in fields},
        "alignment": ALIGNED,
        "before": asdict(before),
        "after": asdict(after),
        "extrinsic": {  # x y z qx qy qz qw, sonar to camera
            name: values[s[0]].tolist()
            for name, values in (("truth", rig.truth), ("before", rig.start), ("after", result.values))
        },
    }
    figure = rig_before_after(rig.truth, rig.start, result.values, rig.camera, changes)
    pictured = {"rig.json": json_text(report).encode(), "rig.png": drawn("rig.png", figure)}
    return {**pictured, **native_files(rig)}, RIG
