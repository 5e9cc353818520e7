"""The files of a simulated harbor: keyframes, scans and, apart from what was measured, the truth.

keyframes.csv     keyframe, time, s, x, y, m, yaw, rad: dead reckoning
scans.csv         keyframe, range, m, azimuth, rad, intensity (1: not simulated)
truth.csv         time, s, x, y, m, yaw, rad

The frame of the files has x north and y west: yaw is positive counterclockwise, azimuths are positive to port.
"""

from __future__ import annotations

import numpy as np

from nls.missions.folder.table import csv_text
from sim.worlds.harbor import Harbor

__all__ = ["harbor_files", "harbor_rows"]

HOLDS = "keyframes.csv, scans.csv: dead reckoning and what the sonar detected.\ntruth.csv: the true keyframes.\n"
WEST = np.array([1.0, -1.0, -1.0])  # from y east, yaw clockwise


def harbor_files(world: Harbor) -> tuple[dict[str, bytes], str]:
    """The files by name, and the lines of README.txt on what they are."""
    p, count = world.scans.points, np.arange(len(world.truth))
    z = np.column_stack([np.hypot(*p.T), -np.arctan2(p[:, 1], p[:, 0])])
    pose = ["x", "y", "yaw"]
    return {
        "keyframes.csv": csv_text(["keyframe", "time", *pose], count, world.times, world.poses * WEST),
        "scans.csv": csv_text(
            ["keyframe", "range", "azimuth", "intensity"], world.scans.keyframe, z, np.ones(len(z), dtype=int)
        ),
        "truth.csv": csv_text(["time", *pose], world.times, world.truth * WEST),
    }, HOLDS


def harbor_rows(world: Harbor) -> list[tuple[str, str]]:
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
