"""Holes in the attitude and depth of a raw log: what is bridged is known no better than it is, and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import XYH, ZPR, Heading
from models import euler
from models.algebra import Array
from models.manifolds.so3 import rotation3
from nls.missions.folder.attitude import holes_of
from nls.missions.folder.columns import COLUMNS
from nls.missions.folder.table import Table, csv_text
from tests.nls.io.g2o_files import assert_refused
from tests.nls.missions.folder.mission_files import folder, raw, tables

(x,) = nls.kinds("x")
LAST, RATE = 90.0, 200
SIGMA_V, SIGMA_TILT, SIGMA_YAW, SIGMA_Z = 0.005, 0.002, 0.01, 0.01
POSES = "i,time_s\n0,5.0\n1,6.0\n2,7.5\n3,8.5\n4,9.5\n5,10.5\n6,11.5\n"
FINE = np.linspace(0.0, LAST, int(LAST) * RATE + 1)


def flight(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Roll, pitch, yaw, the velocity in body axes and the position of a vehicle that turns and dives at random."""
    phase = rng.uniform(0, 2 * np.pi, 5)
    roll, pitch = 0.04 * np.sin(0.9 * FINE + phase[0]), 0.03 * np.sin(0.7 * FINE + phase[1])
    yaw = 0.15 * np.sin(0.21 * FINE + phase[2]) + 0.08 * np.sin(0.37 * FINE + phase[3])
    rpy = np.column_stack([roll, pitch, yaw])
    v = np.column_stack([np.full(len(FINE), 0.5), 0 * FINE, 0.1 * np.sin(0.15 * FINE + phase[4])])
    world = np.einsum("nij,nj->ni", rotation3(euler.quaternion_from_angles(rpy)), v)
    p = np.zeros((len(FINE), 3))
    p[1:] = np.cumsum(0.5 * (world[1:] + world[:-1]) / RATE, axis=0)
    p[:, 2] += 20.0
    return rpy, v, p


def log(seed: int, ahrs: list[tuple[float, float]], depth: list[tuple[float, float]]) -> tuple[dict, Array]:
    """A log with no attitude and no depth at some times, and the true Euler vectors, one a second."""
    rng = np.random.default_rng(seed)
    rpy, v, p = flight(rng)
    at = {name: np.arange(0, len(FINE), RATE // hertz) for name, hertz in (("dvl", 5), ("ahrs", 10), ("depth", 2))}
    for name, holes in (("ahrs", ahrs), ("depth", depth)):
        for begin, end in holes:
            t = FINE[at[name]]
            at[name] = at[name][(t <= begin + 1e-6) | (t >= end - 1e-6)]
    k_v, k_a, k_z = at.values()
    sigmas = [SIGMA_TILT, SIGMA_TILT, SIGMA_YAW]
    files = tables(
        dvl=(FINE[k_v], v[k_v] + rng.normal(0, SIGMA_V, (len(k_v), 3)), np.ones(len(k_v), dtype=int)),
        ahrs=(FINE[k_a], rpy[k_a] + rng.normal(0, sigmas, (len(k_a), 3))),
        depth=(FINE[k_z], p[k_z, 2:] + rng.normal(0, SIGMA_Z, (len(k_z), 1))),
        noise=([[SIGMA_V, 0.0, 0.05, *sigmas, SIGMA_Z]],),
    )
    return files, np.column_stack([rpy, p])[::RATE]


def test_what_is_known_in_holes_is_known(tmp_path: Path) -> None:
    """NEES over 20 flights with 10 s without attitude and 20 s without depth: it was above 100 in both."""
    e, Sigma = np.zeros((20, 91, 6)), np.zeros((20, 91, 6, 6))
    for seed in range(20):
        files, truth = log(seed, [(30.05, 40.05)], [(60.0, 80.0)])
        graph, values, _ = nls.load(folder(tmp_path / "m", files))
        values = graph.optimize(values).values
        e[seed], Sigma[seed] = euler.from_se3(values[x]) - truth, nls.Marginals(graph, values).all(x, view="euler")
    square = e**2 / np.diagonal(Sigma, axis1=2, axis2=3)
    assert 0.1 < square[:, 31:41, 2].mean() < 1.3
    assert 0.93 < np.delete(square[..., 2], np.s_[29:43], axis=1).mean() < 1.07  # no reading of a heading counts twice
    assert 0.05 < square[:, 31:41, :2].mean() < 1.3
    assert 0.002 < square[:, 61:80, 5].mean() < 1.3
    p, P = e[:, [50, 90], 3:5], Sigma[:, [50, 90], 3:5, 3:5]
    assert 0.2 < (p * np.linalg.solve(P, p[..., None])[..., 0]).sum(axis=2).mean() < 3.3  # 2, and a heading to 0.12 rad
    sigma_yaw, sigma_z = np.sqrt(Sigma[:, [35, 70], [2, 5], [2, 5]].mean(axis=0))
    assert 10 * SIGMA_YAW < sigma_yaw < 0.3  # it turns by +-0.23 rad in all
    assert 2 * SIGMA_Z < sigma_z < 0.2  # it dives by 1.3 m meanwhile, and the DVL sees it


def test_poses_in_holes_have_no_heading_and_it_is_said(tmp_path: Path) -> None:
    files, _ = log(3, [(30.0, 40.0), (50.2, 50.6)], [(60.0, 80.0)])
    graph, values, report = nls.load(folder(tmp_path / "m", files))
    xyh, zpr, heading = (next(f for f in graph.factors if isinstance(f, kind)) for kind in (XYH, ZPR, Heading))
    seen = heading.keys[0].numbers
    assert np.setdiff1d(values.stack("x").numbers, seen).tolist() == [*range(31, 40)]
    informed = xyh.noise.sqrt_information(len(xyh), ("x", "y", "yaw"))[:, 2].any(axis=1)
    assert np.flatnonzero(informed).tolist() == [*range(30, 40)]  # the leg over 50.4 s has Heading at both its ends
    W = zpr.noise.sqrt_information(len(zpr), ("z", "pitch", "roll"))
    sure = [1 / SIGMA_Z, 1 / SIGMA_TILT, 1 / SIGMA_TILT]
    assert np.flatnonzero((W[:, 1:] < np.array(sure[1:]) * 0.999).any(axis=1)).tolist() == [*range(31, 40)]
    assert np.flatnonzero(W[:, 0] < sure[0] * 0.999).tolist() == [*range(61, 80)]
    for words in (
        "ahrs.csv:303: 2 holes, 10.4 s in all, the longest between 30 and 40 s: 9 of 91 poses",
        *("depth.csv:123: a hole between 60 and 80 s: 19 of 91 poses", "; the attitude for 10.4 s, in 11"),
    ):
        assert words in " ".join(report.notes)
    assert [files[name].splitlines()[k][:5] for name, k in (("ahrs", 302), ("depth", 122))] == ["40.0,", "80.0,"]


def test_poses_in_one_hole_count_with_all_their_covariances(tmp_path: Path) -> None:
    """The sigmas are those of the rows of K, so that diag(sigma^2) - K has no negative eigenvalue."""
    t = np.delete(np.arange(0.0, 30.1, 0.5), [*range(11, 20), *range(41, 44)])  # none from 5 to 10 and 20 to 22 s
    rng = np.random.default_rng(1)
    y = rng.normal(size=(len(t), 2))
    y[np.searchsorted(t, 22.0), 0] = y[np.searchsorted(t, 20.0), 0] + 50.0  # the half of it, 25, is above any rms
    (tmp_path / "depth.csv").write_bytes(csv_text(COLUMNS["depth"], t, y[:, :1]))
    table = Table(tmp_path / "depth.csv", COLUMNS["depth"])
    b = np.array([1.0, 5.0, 5.5, 7.7, 9.0, 10.0, 15.0, 20.5, 21.0])
    notes: list[str] = []
    found = holes_of(table, t, y, b, "are here", notes)
    assert b[found.inside].tolist() == [5.5, 7.7, 9.0, 20.5, 21.0]
    assert notes == ["depth.csv:13: 2 holes, 7 s in all, the longest between 5 and 10 s: 5 of 9 poses are here"]
    a = np.flatnonzero(found.density[:, 0])
    assert t[a].tolist() == [5.0, 20.0]
    assert found.density[a[1], 0] == pytest.approx(2 * 25 / np.sqrt(2.0))
    clear = [k for k in range(len(t)) if 2.5 <= t[k] <= 27.5 and not (2.5 < t[k] < 12.5 or 17.5 < t[k] < 24.5)]
    d = [y[k, 1] - 0.5 * (np.interp(t[k] - 2.5, t, y[:, 1]) + np.interp(t[k] + 2.5, t, y[:, 1])) for k in clear]
    change = abs(y[a[0] + 1, 1] - y[a[0], 1]) / 2
    assert found.density[a[0], 1] == pytest.approx(2 * max(np.sqrt(np.mean(np.square(d))), change) / np.sqrt(5.0))
    for begin, T, inside in ((5.0, 5.0, slice(2, 5)), (20.0, 2.0, slice(7, 9))):
        s = b[inside] - begin
        K = np.minimum.outer(s, s) * (T - np.maximum.outer(s, s)) / T
        beta = found.density[t == begin][0]
        assert found.sigma[inside] ** 2 == pytest.approx(K.sum(axis=1)[:, None] * beta**2)
    assert not found.sigma[~found.inside].any()


def test_a_yaw_over_a_hole_is_known_no_better_than_the_rows_at_its_ends(tmp_path: Path) -> None:
    """The yaw hardly changes in this log, so the hole adds little: what is left is the noise of two rows."""
    files = raw()
    files["ahrs"] = "\n".join(row for row in files["ahrs"].splitlines() if not row.startswith(("8.", "9.")))
    graph, _, _ = nls.load(folder(tmp_path / "m", {**files, "poses": POSES}))
    W = graph.factors[0].noise.sqrt_information(len(graph.factors[0]), ("x", "y", "yaw"))
    rows = 1 / (np.sqrt(2) * 0.01)
    assert np.flatnonzero(W[:, 2, 2]).tolist() == [2, 3, 4]
    assert ((W[2:5, 2, 2] > 0.8 * rows) & (W[2:5, 2, 2] < rows)).all()


def test_a_track_that_begins_in_a_hole_is_held_where_the_compass_sees_it(tmp_path: Path) -> None:
    files, truth = log(7, [(20.0, 25.0)], [])
    poses = "\n".join(["i,time_s", *(f"{k},{float(k)}" for k in range(22, 60))])
    graph, values, report = nls.load(folder(tmp_path / "m", files, poses=poses))
    assert "there is no anchor.csv: x and y of x25 are fixed at 0" in report.notes
    result = graph.optimize(values)
    assert result.converged
    e = euler.from_se3(result.values[x])[:, 2] - truth[22:60, 2]
    assert np.abs(e).max() < 0.3
    place = folder(tmp_path / "m", files, poses="i,time_s\n0,21.0\n1,22.0\n")
    assert_refused(None, "ahrs.csv: no pose has an attitude measured at its time: all are in", nls.load, place)


def test_a_hole_that_is_too_long_to_be_bridged(tmp_path: Path) -> None:
    long = [(20.0, 70.0)]
    for name, line, *holes in (("ahrs", 203, long, []), ("depth", 43, [], long)):
        files, _ = log(7, *holes)
        assert_refused(line, f"{name}.csv:{line}: no row in the 50 s", nls.load, folder(tmp_path / name, files))
        assert files[name].splitlines()[line - 1].startswith("70.0,")
