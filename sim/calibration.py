"""A simulated rig solved: its errors before and after as a table, a report and a picture."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from nls import GaussNewton, Result, kinds
from sim.camera_sonar import Rig

__all__ = ["calibrated"]

(s,) = kinds("s")
ALIGNED = "rigid, of cameras and points together; the sonar is not aligned"


def calibrated(rig: Rig) -> Result:
    """The optimum by Gauss-Newton from the start of the rig."""
    return rig.graph.optimize(rig.start, GaussNewton())


def calibration_rows(rig: Rig, result: Result) -> list[tuple[str, str]]:
    """The table, one (label, text) a line."""
    before, after = rig.errors(rig.start), rig.errors(result.values)
    angles = np.degrees([before.extrinsic_rad, after.extrinsic_rad])
    return [
        ("world", f"{rig.name}, seed {rig.seed}"),
        ("poses", f"{rig.poses} in SE3"),
        ("points", f"{rig.points}"),
        ("measured", f"{len(rig.images)} images, {len(rig.contacts)} sonar contacts"),
        ("chi2 at truth", f"{rig.graph.chi2(rig.truth):.6g}, expected {rig.rows} (rows of A)"),
        ("chi2", f"{result.chi2_initial:.6g} -> {result.chi2_final:.6g}, dof {result.dof}"),
        ("solved", f"{result.status.name}, {result.iterations} iterations of {result.method}: {result.reason}"),
        ("cameras", f"{100 * before.poses:.3g} cm -> {100 * after.poses:.3g} cm"),
        ("points", f"{100 * before.points:.3g} cm -> {100 * after.points:.3g} cm"),
        (
            "sonar",
            f"{100 * before.extrinsic_m:.3g} cm, {angles[0]:.3g} deg -> {100 * after.extrinsic_m:.3g} cm, "
            f"{angles[1]:.3g} deg",
        ),
        ("alignment", ALIGNED),
    ]


def calibration_files(rig: Rig, result: Result) -> dict[str, bytes]:
    """rig.json and rig.png by name."""
    from nls.cli.outputs import json_text
    from nls.missions.pictures.rig import rig_before_after
    from nls.plot.picture import drawn

    before, after = rig.errors(rig.start), rig.errors(result.values)
    changes = {
        "cameras [cm]": (100 * before.poses, 100 * after.poses),
        "points [cm]": (100 * before.points, 100 * after.points),
        "sonar, position [cm]": (100 * before.extrinsic_m, 100 * after.extrinsic_m),
        "sonar, angle [deg]": (float(np.degrees(before.extrinsic_rad)), float(np.degrees(after.extrinsic_rad))),
    }
    report: dict[str, Any] = {
        "world": rig.name,
        "seed": rig.seed,
        "poses": rig.poses,
        "points": rig.points,
        "images": len(rig.images),
        "contacts": len(rig.contacts),
        "method": result.method,
        "linear_solver": result.linear_solver,
        "converged": result.converged,
        "reason": result.reason,
        "iterations": result.iterations,
        "chi2_initial": result.chi2_initial,
        "chi2_final": result.chi2_final,
        "dof": result.dof,
        "alignment": ALIGNED,
        "before": asdict(before),
        "after": asdict(after),
        "extrinsic": {  # x y z qx qy qz qw, sonar to camera
            name: values[s[0]].tolist()
            for name, values in (("truth", rig.truth), ("before", rig.start), ("after", result.values))
        },
    }
    figure = rig_before_after(rig.truth, rig.start, result.values, rig.camera, changes)
    return {"rig.json": json_text(report).encode(), "rig.png": drawn("rig.png", figure)}
