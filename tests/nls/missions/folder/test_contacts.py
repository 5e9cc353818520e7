"""contacts.csv: rows of a time are of the pose at this time, as rows of a pose are of that pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import RangeAzimuth
from nls import GraphFileError, Values
from nls.graph import FactorGraph
from nls.io.report import LoadReport
from tests.nls.missions.folder.mission_files import TINY, folder

PATH = "time_s,x_m,y_m,z_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_z_m,sigma_yaw_rad\n" + "".join(
    f"{t},{0.5 * t},0,5,0,0.01,0.01,0.01,0.01\n" for t in range(3)
)
ROWS = [(0, 11, 4.7), (1, 11, 4.3), (2, 11, 3.8)]  # a time and a pose, a landmark, m


def loaded(path: Path, pose: str, rows: list[tuple[float, int, float]]) -> tuple[FactorGraph, Values, LoadReport]:
    """The mission of a path with these contacts; their first column is `pose`."""
    contacts = f"{pose}landmark,range_m,azimuth_rad,sigma_range_m,sigma_azimuth_rad\n"
    contacts += "".join(f"{f'{when},' * bool(pose)}{k},{r},0.05,0.01,0.004\n" for when, k, r in rows)
    return nls.load(folder(path, {"path": PATH, "sonar": TINY["sonar"], "contacts": contacts}))


def test_times_of_poses_are_these_poses(tmp_path: Path) -> None:
    (by_time, X, _), (by_pose, _, _) = (loaded(tmp_path, pose, ROWS) for pose in ("time_s,", "i,"))
    assert list(map(repr, by_time.factors)) == list(map(repr, by_pose.factors))
    assert by_time.chi2(X) == by_pose.chi2(X) > 1


def test_a_contact_between_two_rows_gets_a_pose_and_one_outside_is_left_out(tmp_path: Path) -> None:
    graph, X, report = loaded(tmp_path, "time_s,", [(-5, 12, 4.0), *ROWS, (0.25, 11, 4.6)])
    assert report.vertex_times["x"].tolist() == [0, 0.25, 1, 2]
    k, contacts = next((k, f) for k, f in enumerate(graph.factors) if isinstance(f, RangeAzimuth))
    assert contacts.keys[0].numbers.tolist() == [0, 2, 3, 1]
    assert np.ravel(contacts.z[:, 0]).tolist() == [4.7, 4.3, 3.8, 4.6]
    assert [report.place(k, row).rsplit(":")[-1] for row in range(4)] == ["3", "4", "5", "6"]
    assert list(X.stack("l").numbers) == [11]
    words = "contacts.csv:2: the first row of 1 that are left out, of 5: not within the track, 0.0 to 2.0 s"
    assert words in str(report)


def test_a_time_or_a_pose(tmp_path: Path) -> None:
    with pytest.raises(GraphFileError, match="has neither; expected either time_s or i"):
        loaded(tmp_path, "", ROWS)
