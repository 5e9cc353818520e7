"""Raw logs: how long a track they make, and that no reading counts twice in its covariances."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from models import SE3
from tests.nls.io.g2o_files import assert_refused
from tests.nls.missions.folder.mission_files import folder, raw
from tests.nls.missions.folder.test_velocity import log

(x,) = nls.kinds("x")


def test_the_last_pose_is_in_the_log_despite_rounding(tmp_path: Path) -> None:
    assert 12.46 + 68.0 > 80.46  # what floor() of the difference, 68.0, would make a pose of
    for first, last, poses in ((12.46, 80.46, 68), (0.1, 80.1, 81), (0.0, 3.0, 4)):
        t = np.append(np.arange(first, last - 0.1, 0.5), last)
        _, values, report = nls.load(folder(tmp_path / "m", log({"valid": 1}, t=t)))
        times = report.vertex_times["x"]
        assert (len(values), len(times)) == (poses, poses)
        assert times[0] == first
        assert last - 1 < times[-1] <= last


def test_rows_without_bottom_lock_at_the_ends_are_left_out(tmp_path: Path) -> None:
    t = np.arange(0.0, 30.1, 0.5)
    files = log({"valid": 1 * ((t >= 2.5) & (t <= 28.0) & (t != 10.0))}, t=t)
    _, values, report = nls.load(folder(tmp_path / "m", files))
    assert report.vertex_times["x"].tolist() == np.arange(2.5, 28.1).tolist()
    assert np.ptp(SE3.position(values[x])[:, 0]) == pytest.approx(25.0)
    assert "the DVL has no bottom lock in its first 2.5 s and its last 2 s: left out" in report.notes
    for poses, line in (("0,2.0\n1,9.0\n", 2), ("0,2.5\n1,28.5\n", 3)):
        place = folder(tmp_path / "poses", files, poses=f"i,time_s\n{poses}")
        assert_refused(line, "dvl.csv with bottom lock 2.5 to 28.0 s", nls.load, place)
    _, values, _ = nls.load(folder(tmp_path / "poses", files, poses="i,time_s\n0,2.5\n1,28.0\n"))
    assert np.ptp(SE3.position(values[x])[:, 0]) == pytest.approx(25.5)


def test_logs_too_short_and_too_long(tmp_path: Path) -> None:
    t = np.arange(0.0, 3.1, 0.5)
    for files, words in (
        (log({"valid": 0}, t=t), "0 of 7 rows are valid; expected two"),
        (log({"valid": 1 * (np.arange(7) < 1)}, t=t), "1 of 7 rows are valid; expected two"),
        (log({"valid": 1}, t=np.array([0.0, 1e12, 1.7e12])), "the logs last 1.7e+12 s"),
    ):
        assert_refused(None, f"dvl.csv: {words}", nls.load, folder(tmp_path / "m", files))


def test_poses_denser_than_the_rows_of_a_log_say_no_more_than_these(tmp_path: Path) -> None:
    files = log({"valid": 1}, t=np.arange(0.0, 30.1))
    t = np.arange(0.0, 30.1, 0.25)
    poses = "i,time_s\n" + "".join(f"{k},{s!r}\n" for k, s in enumerate(t.tolist()))
    _, zpr, heading = nls.load(folder(tmp_path / "m", files, poses=poses))[0].factors[:3]
    assert np.median(heading.noise.sigma) == pytest.approx(0.01 * 2, rel=0.05)
    assert np.median(zpr.noise.sigmas, axis=0) == pytest.approx([0.05 * 2, 0.002 * 2, 0.002 * 2], rel=0.05)


def test_steps_say_nothing_of_the_yaw_and_know_the_way_given_the_heading(tmp_path: Path) -> None:
    found = []
    for sigma_yaw in ("0.01", "0.3"):
        files = raw()
        files["noise"] = files["noise"].replace("0.002,0.01,0.05", f"0.002,{sigma_yaw},0.05")
        graph, _, _ = nls.load(folder(tmp_path / sigma_yaw, files))
        found.append(graph.factors[0].noise.sqrt_information(len(graph.factors[0]), ("x", "y", "yaw")))
        assert not found[-1][:, 2].any()
        assert not found[-1][:, :, 2].any()
    assert found[0] == pytest.approx(found[1], rel=1e-9)  # the noise of the heading is in Heading alone
    Sigma = np.linalg.inv(found[0][5, :2, :2].T @ found[0][5, :2, :2])
    dt, n = 0.25, 5  # samples of 1/8, 1/4, 1/4, 1/4, 1/8 s in a leg of 1 s at 1 m/s, 0.2 % of it by the scale
    white = 0.01**2 * dt**2 * (n - 1)  # the samples at its ends, half in either leg, count by half, not a quarter
    assert Sigma[0, 0] == pytest.approx(white + 0.002**2, rel=1e-3)
    assert Sigma[1, 1] == pytest.approx(white, rel=1e-2)
