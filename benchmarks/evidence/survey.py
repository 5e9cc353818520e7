"""A raw log with wrong calibrations: are they found, are the covariances right, what do wrong USBL fixes cost?

    python benchmarks/evidence/survey.py [--seeds 100] [--out DIR]

The reference world `sim.survey`, seeds 0, 1, 2, ...: each is written as a mission folder, read back and solved with the
default options. Nothing is aligned.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from script import Table, make_page, over, spread, timed

import nls
import sim
from models import SE3
from models.algebra import Array
from nls import Kind, Marginals, kinds
from nls.filters.consistency import nees_bounds
from nls.metrics import ate
from nls.missions.folder.table import csv_text

Record = dict[str, Any]
UNITS = {  # of a calibration: how it is printed, its unit in that of the file, digits
    "sound_speed_scale": ("speed of sound too high by, %", 100.0, 3),
    "dvl_scale": ("scale of the DVL, %", 100.0, 3),
    "dvl_yaw_rad": ("mounting of the DVL, deg", float(np.degrees(1.0)), 3),
    "ahrs_clock_s": ("clock of the AHRS, s", 1.0, 4),
}
WRONG = 0.1  # of the USBL fixes
WORSE = 1.2  # times the error without wrong fixes: the most that a robust kernel may let through
FAR = 3.0  # sigmas
PLACES = 24  # poses of a survey whose positions are tested
(x,) = kinds("x")


def solved(seed: int, outliers: float = 0.0, kernel: bool = True, beacons: bool = True) -> Record:
    """One survey: errors of its calibrations in sigmas, NEES of two positions, errors of all, processor time."""
    log = sim.survey(np.random.default_rng(seed), usbl_outliers=outliers)
    with TemporaryDirectory() as folder:
        for name, table in log.tables.items():
            if name in ("ranges", "beacons") and not beacons:
                continue
            names = [column for column in table if kernel or column != "kernel"]
            rows = slice(None)
            if name == "calibration" and not beacons:
                rows = table["name"] != "sound_speed_scale"  # nothing measures it any more
            text = csv_text(names, *(table[column][rows] for column in names))
            Path(folder, f"{name}.csv").write_bytes(text)
        (graph, start, report), loading = timed(nls.load, folder)
    result, seconds = timed(graph.optimize, start)
    values = result.values
    marginals = Marginals(graph, values)
    times, numbers = report.vertex_times["x"], values.stack("x").numbers
    X, truth = values[x[numbers]], log.track.pose(times)
    record: Record = {
        "converged": result.converged,
        "seconds": loading + seconds,
        "poses": len(numbers),
        "chi2_dof": result.chi2_final / result.dof,
        "dead_reckoning": ate(start[x[numbers]], truth).rmse,
        "ate": ate(X, truth).rmse,
    }
    whole = np.flatnonzero(np.abs(times - np.round(times)) < 1e-9)  # where no sensor is interpolated
    k = whole[np.linspace(0, len(whole) - 1, PLACES + 1).astype(int)[1:]]
    e = SE3.local(X[k], truth[k])[:, :3]
    P = np.stack([marginals.covariance(x[numbers[row]], frame="body")[:3, :3] for row in k])
    nees = np.sum(e * np.linalg.solve(P, e[..., None])[..., 0], axis=-1)
    sigma = np.sqrt(np.trace(P[:, :2, :2], axis1=1, axis2=2) / 2)
    for place, row in (("middle", PLACES // 2), ("last", -1)):
        record |= {f"nees_{place}": float(nees[row]), f"sigma_{place}": float(sigma[row])}
    record |= {"nees_all": float(nees.mean()), "sigma_all": float(sigma.mean())}
    for name in (name for name in UNITS if name in values.stacks):
        variable = Kind(name)[0]
        record[name] = float(values[variable].item())
        record[f"sigma {name}"] = float(np.sqrt(marginals.covariance(variable).item()))
        record[f"z {name}"] = (record[name] - log.calibration[name]) / record[f"sigma {name}"]
    return record


def calibrations(clean: dict[str, Array], seeds: int) -> list[str]:
    """A row a calibration."""
    half = 1.96 / np.sqrt(seeds)  # of the mean of z
    low, high = (float(np.sqrt(bound / 1.0)) for bound in nees_bounds(1, seeds))
    titles = ["calibration", "true", "mean estimate", "sigma", f"mean of z, expected within +-{half:.2f}"]
    table = Table([*titles, f"rms of z, expected {low:.2f}-{high:.2f}", f"within {FAR:g} sigma"])
    true = sim.survey(np.random.default_rng(0), legs=1, leg=10.0).calibration
    for name, (label, unit, digits) in UNITS.items():
        z = clean[f"z {name}"]
        mean, rms = float(z.mean()), float(np.sqrt(np.mean(z**2)))
        numbers = [f"{unit * clean[column].mean():.{digits}f}" for column in (name, f"sigma {name}")]
        numbers += [f"{mean:+.2f}{outside(abs(mean) <= half)}", f"{rms:.2f}{outside(low <= rms <= high)}"]
        table.add(label, f"{unit * true[name]:.4g}", *numbers, f"{np.sum(np.abs(z) <= FAR)}/{seeds}")
    return table


def positions(clean: dict[str, Array], seeds: int) -> list[str]:
    """A row a place."""
    bounds = nees_bounds(3, seeds)
    half = 1.96 * float(clean["nees_all"].std()) / np.sqrt(seeds)
    table = Table(["position", "NEES, expected 3", "within", "mean sigma, m"])
    for place, low, high in (("middle", *bounds), ("last", *bounds), ("all", 3 - half, 3 + half)):
        mean = float(clean[f"nees_{place}"].mean())
        label = f"{PLACES} over the survey" if place == "all" else place
        numbers = f"{mean:.2f}{outside(low <= mean <= high)}", f"{low:.2f}-{high:.2f}"
        table.add(label, *numbers, f"{clean[f'sigma_{place}'].mean():.3f}")
    return table


def wrong_fixes(clean: dict[str, Array], seeds: int) -> list[str]:
    """A row a log: without wrong fixes, with them and a kernel, with them and none; with beacons and without."""
    titles = ["log", "USBL fixes", "error, m", "times the error without wrong fixes", "converged", "s"]
    table = Table(titles, names=2)
    for log, options in (("with beacons", {}), ("USBL alone below", {"beacons": False})):
        right = over(partial(solved, **options), seeds) if options else clean
        spoiled = partial(solved, outliers=WRONG, **options)
        for fixes, numbers, most in (
            ("all right", right, np.inf),
            (f"{100 * WRONG:.0f} % wrong, kernel", over(spoiled, seeds), WORSE),
            (f"{100 * WRONG:.0f} % wrong, no kernel", over(partial(spoiled, kernel=False), seeds), np.inf),
        ):
            times = float(numbers["ate"].mean() / right["ate"].mean())
            cells = [log, fixes, spread(numbers["ate"]), f"{times:.2f}{outside(times < most)}"]
            table.add(*cells, f"{numbers['converged'].sum()}/{seeds}", f"{numbers['seconds'].mean():.1f}")
    return table


def outside(right: bool) -> str:
    """What marks a number that is not as expected."""
    return "" if right else " **outside**"


def page(seeds: int) -> list[str]:
    """The page."""
    log = sim.survey(np.random.default_rng(0))
    clean = over(solved, seeds)
    return [
        f"{log.duration} s, {log.distance:.0f} m, {clean['poses'].mean():.0f} poses. At the start, by dead "
        f"reckoning, positions are {spread(clean['dead_reckoning'])} m off. Chi2 over the degrees of freedom: "
        f"{spread(clean['chi2_dof'])}. Brackets: the least and the most of the seeds.",
        f"## Calibrations, seeds 0 to {seeds - 1}",
        *calibrations(clean, seeds),
        "z: the error of an estimate in its standard deviations. The log states 0 for each, with standard "
        "deviations of 3 %, 2 %, 2.9 deg and 0.5 s.",
        f"## Positions, seeds 0 to {seeds - 1}",
        *positions(clean, seeds),
        "- NEES: e' P^-1 e of the position in three dimensions, with the error e and its covariance P. Its mean "
        "should lie within the 95 % bounds.",
        "- Positions are at whole seconds, where no sensor is interpolated.",
        f"- Positions of one seed have common errors. So the bounds of all {PLACES} are 1.96 standard errors, from the "
        "spread between the seeds.",
        "- Sigma: in the horizontal, per axis.",
        f"## Wrong USBL fixes, seeds 0 to {seeds - 1}",
        *wrong_fixes(clean, seeds),
        "Error: rmse of all positions, nothing aligned. A wrong fix has any bearing and a range that is 80 to 160 m "
        "too long. s: processor time from the folder to the optimum.",
    ]


if __name__ == "__main__":
    make_page("A survey from its raw log", page, seeds=(100, "of every table"))
