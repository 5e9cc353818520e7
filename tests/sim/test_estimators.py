"""Estimators by name: each is the filter it says, the same errors for all, the table and the pictures."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from models.algebra import wrap
from models.errors import GraphWarning, OptionError, UnderconstrainedError
from nls import FactorGraph, GaussNewton, Marginals, Optimizer, Result, Stop, Values, kinds
from nls.filters.consistency import nees_bounds
from nls.filters.ekf import EKF
from nls.plot import offsets
from nls.plot.filters import estimator_figure, several
from sim.compare import compare, compared_rows, monte_carlo_rows
from sim.estimators import ESTIMATORS, SCENES, batch, errors, estimator, followed, of_seed, tracked
from tests.combinations import for_all
from tests.sim.scenes import thinned

(x,) = kinds("x")
METHODS = {
    "ekf": "EKF",
    "ekf-first-estimates": "EKF (first estimates)",
    "fastslam1": "FastSLAM 1.0, 30 particles",
    "fastslam2": "FastSLAM 2.0, 30 particles",
    "fixed-lag": "fixed lag 5, landmarks stay",
    "online": "online",
}


@pytest.fixture(scope="module")
def world() -> sim.LandmarkWorld:
    return thinned(sim.subsea(np.random.default_rng(1), laps=1, known_start=True))


def test_names(world: sim.LandmarkWorld) -> None:
    found = {name: estimator(world, name, particles=30, lag=5) for name in ESTIMATORS}
    assert found.pop("batch") is None
    again = estimator(world, "ekf", iterations=10)
    assert again is not None
    assert again.method == "EKF (10 iterations)"
    assert {name: chosen.method for name, chosen in found.items() if chosen is not None} == METHODS
    with pytest.raises(OptionError, match="estimators: 'kalman' is not possible; expected one of ekf, "):
        tracked(world, "kalman")


@for_all(landmarks=["first-sight", "independent"])
def test_an_ekf_reads_landmarks_as_the_world_says(landmarks: str) -> None:
    given = sim.subsea(np.random.default_rng(3), laps=1, landmarks=landmarks)  # type: ignore[arg-type]
    track = tracked(given, "ekf")
    same = EKF(landmarks).run(given.graph, given.start)  # type: ignore[arg-type]
    np.testing.assert_array_equal(track.X, same.X)
    np.testing.assert_array_equal(track.P, same.P)
    sigma = errors(given, track)["sigma"]  # of the position: 2 m of the start, less what landmarks of 4 m each add
    assert sigma == pytest.approx((1 / 4 + 6 / 16) ** -0.5, abs=0.06)


def test_batch_is_the_optimum_with_its_marginals(world: sim.LandmarkWorld) -> None:
    track = batch(world)
    result = world.graph.optimize(world.start)
    marginals = Marginals(world.graph, result.values)
    np.testing.assert_allclose(track.X, result.values[x], atol=1e-6)
    np.testing.assert_allclose(track.P, marginals.covariance(track.x, frame="body"), rtol=1e-4, atol=1e-18)
    np.testing.assert_allclose(track.P_landmarks, marginals.covariance(track.landmarks), rtol=1e-4, atol=1e-18)
    ekf = tracked(world, "ekf")  # the last pose has all measurements in both
    np.testing.assert_allclose(track.P[-1], ekf.P[-1], rtol=0.05)
    assert np.trace(track.P[20]) < 0.5 * np.trace(ekf.P[20])
    found = errors(world, track)
    assert found["smoothed"] == found["ate"]
    assert found["final"] == pytest.approx(np.linalg.norm((result.values[x] - world.truth[x])[-1, :2]), abs=1e-5)
    assert found["sigma"] == pytest.approx(np.sqrt(np.trace(track.P[-1, :2, :2]) / 2), rel=1e-12)
    assert found["nees"] == pytest.approx(track.nees(world.truth)[-1], rel=1e-9)
    assert found["aligned"] < found["ate"]


def test_a_batch_that_does_not_converge_says_so(world: sim.LandmarkWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    optimize = FactorGraph.optimize

    def once(graph: FactorGraph, values: Values, optimizer: Optimizer | None = None, gauge: str = "first") -> Result:
        return optimize(graph, values, optimizer or GaussNewton(Stop(max_iterations=1)), gauge=gauge)

    monkeypatch.setattr(FactorGraph, "optimize", once)
    with pytest.warns(GraphWarning, match="^batch: .*1 iteration"):
        batch(world)


@for_all(name=["ekf", "fastslam1", "batch"])
def test_history_is_what_was_known_at_each_step(world: sim.LandmarkWorld, name: str) -> None:
    settings = {"particles": 3} if name == "fastslam1" else {}
    track, history = followed(world, name, **settings)
    np.testing.assert_array_equal(track.X, tracked(world, name, **settings).X)
    assert len(history) == len(track.x)
    keys, P = history[-1]
    np.testing.assert_array_equal(keys.numbers, track.landmarks.numbers)
    np.testing.assert_array_equal(P, track.P_landmarks)
    i, k = world.sightings.keys
    seen = set(k.numbers[i.numbers <= 7].tolist())
    assert set(history[7][0].numbers.tolist()) == (set(range(6)) if name == "batch" else seen)
    assert 0 < len(seen) < 6


def test_comparison(world: sim.LandmarkWorld) -> None:
    names = ["batch", "ekf", "fastslam1"]
    found = compare(world, names, {"particles": 3})
    assert [each.name for each in found] == names
    assert [each.track.method for each in found] == ["batch", "EKF", "FastSLAM 1.0, 3 particles"]
    for each in found:
        assert each.errors == errors(world, each.track)
        assert each.seconds > 0
        assert each.megabytes is None
    rows = compared_rows(world, found)
    table = {label: text.split() for label, text in rows[:5]}
    assert table["estimator"] == ["ATE", "aligned", "smoothed", "final", "landmarks", "3", "sigma", "NEES", "ms/step"]
    assert table["dead reckoning"] == [f"{world.ate(world.start):.3f}"]
    e = found[1].errors
    assert [float(n) for n in table["ekf"][:6]] == pytest.approx(
        [e["ate"], e["aligned"], e["smoothed"], e["final"], e["landmarks"], 3 * e["sigma"]], abs=5.1e-4
    )
    assert float(table["ekf"][6]) == pytest.approx(e["nees"], rel=1e-3)
    assert float(table["ekf"][7]) == pytest.approx(1e3 * found[1].seconds / 31, abs=0.0051)
    assert dict(rows)["NEES"] == "of the last pose; 0.22 to 9.35 with 95 %"
    assert found[0].errors["ate"] < found[1].errors["ate"] < world.ate(world.start)
    counted = compare(world, ["batch"], {}, memory=True)
    assert 0.05 < (counted[0].megabytes or 0) < 50
    head, _, row, *_ = (text for _, text in compared_rows(world, counted))
    assert head.split()[-1] == "MB"
    assert float(row.split()[-1]) == pytest.approx(counted[0].megabytes, abs=0.0051)


def test_the_table_of_many_runs() -> None:
    seeds = range(4, 7)
    records = [of_seed(seed, "subsea", ["batch"], {"laps": 1}, {}) for seed in seeds]
    worlds = [SCENES["subsea"](np.random.default_rng(seed), laps=1) for seed in seeds]
    assert [r["dead reckoning"] for r in records] == [{"ate": w.ate(w.start)} for w in worlds]
    assert [r["batch"] for r in records] == [errors(w, batch(w)) for w in worlds]
    table = dict(monte_carlo_rows(seeds, records, dim=3))
    ate = [r["batch"]["ate"] for r in records]
    shown = [float(number) for number in table["batch"].split()]
    assert [shown[0], shown[7], shown[8]] == pytest.approx([np.mean(ate), min(ate), max(ate)], abs=5.1e-4)
    assert shown[5] == pytest.approx(3 * np.mean([r["batch"]["sigma"] for r in records]), abs=5.1e-4)
    assert shown[6] == pytest.approx(np.mean([r["batch"]["nees"] for r in records]), rel=1e-3)
    low, high = nees_bounds(3, 3)
    assert table["NEES"] == f"of the last pose, mean; {low:.2f} to {high:.2f} with 95 %"
    assert table["runs"].startswith("3, seeds 4 to 6")


@pytest.mark.parametrize("scene", sorted(SCENES))
def test_four_pictures(scene: str) -> None:
    given = SCENES[scene](np.random.default_rng(1), laps=1)
    track, history = followed(given, "batch")
    history[:40] = [(keys[:1], P[:1]) for keys, P in history[:40]]  # only the first one is known before step 40
    figure = estimator_figure(track, given.truth, history, "seed 1", given.sightings.keys)
    assert figure.get_suptitle() == "seed 1: batch"
    titled = {axes.get_title(): axes for axes in figure.axes if axes.get_title()}
    assert list(titled) == ["map", "sigma of the vehicle", "errors and 3 sigma", "sigma of the landmarks"]
    places, vehicle, _, landmarks = titled.values()
    rows = [axes for axes in figure.axes if axes.get_ylabel() in ("ahead [m]", "to the left [m]", "heading [deg]")]
    np.testing.assert_array_equal(places.lines[0].get_xydata(), given.truth[x][:, :2])
    if scene == "lines":  # walls from foot to foot of the first and last perpendicular; wall 4 is at x = -6
        i, k = given.sightings.keys
        foot = given.truth[i[k.numbers == 4]][:, 1]
        wall = places.lines[2 + 4].get_xydata()
        np.testing.assert_allclose(wall, [[-6, foot.max()], [-6, foot.min()]], atol=1e-9)
    np.testing.assert_array_equal(places.lines[1].get_xydata(), track.X[:, :2])
    outlines = np.array([path.vertices[:48] for path in places.collections[0].get_paths()])
    times = 2 if scene == "lines" else 1  # walls and wheels leave centimeters
    assert places.collections[0].get_label() == f"95 % of the vehicle{', 2 times as large' if times == 2 else ''}"
    a, X, P = (outlines[-1] - track.X[-1, :2]) / times, track.X[-1], track.P[-1, :2, :2]
    R = np.array([[np.cos(X[2]), -np.sin(X[2])], [np.sin(X[2]), np.cos(X[2])]])
    np.testing.assert_allclose(np.vecdot(a @ np.linalg.inv(R @ P @ R.T), a), 5.991, rtol=1e-3)
    e = track.manifold.local(track.X, given.truth[track.x])
    for k, (axes, unit) in enumerate(zip(rows, (1, 1, 180 / np.pi), strict=True)):
        np.testing.assert_allclose(axes.lines[0].get_ydata(), -unit * e[:, k])
        band = axes.collections[0].get_paths()[0].vertices
        assert band[:, 1].max() == pytest.approx(3 * unit * np.sqrt(track.P[:, k, k].max()))
    np.testing.assert_allclose(vehicle.lines[1].get_ydata(), np.sqrt(track.P[:, 1, 1]))
    assert len(landmarks.lines) == given.landmarks
    assert [len(line.get_xdata()) for line in landmarks.lines[:2]] == [len(track.x), len(track.x) - 40]
    P_0 = track.P_landmarks[0]
    expected = P_0[1, 1] if scene == "lines" else np.trace(P_0) / 2
    np.testing.assert_allclose(np.square(landmarks.lines[0].get_ydata()), expected)


@pytest.mark.parametrize("scene", sorted(SCENES))
def test_offsets_are_along_the_axes_of_the_world(scene: str) -> None:
    given = SCENES[scene](np.random.default_rng(1), laps=1)
    track = batch(given)
    figure = offsets(track, given.truth, "seed 1", given.sightings.keys)
    field, heading, position, landmarks = figure.axes
    e = track.X - given.truth[x]
    np.testing.assert_allclose(np.radians(heading.lines[0].get_ydata()), wrap(e[:, 2]), atol=1e-12)  # type: ignore[arg-type]
    for k in range(2):
        np.testing.assert_allclose(position.lines[3 * k].get_ydata(), e[:, k], atol=1e-12)
    R = np.array([[[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]] for a in track.X[:, 2]])
    P = R @ track.P[:, :2, :2] @ R.mT
    np.testing.assert_allclose(np.square(position.lines[4].get_ydata()), P[:, 1, 1])
    dots = np.column_stack(next(line for line in landmarks.lines if line.get_marker() == "o").get_data())
    found = errors(given, track)
    if scene == "lines":
        believed, true = track.values[track.landmarks].copy(), given.truth[track.landmarks]
        turned = np.abs(wrap(believed[:, 0] - true[:, 0])) > 1  # (alpha, r) and (alpha + pi, -r) are the same wall
        believed[turned] = believed[turned] * [1, -1] + [np.pi, 0]
        L = believed - true
        np.testing.assert_allclose(dots, np.column_stack([np.degrees(wrap(L[:, 0])), L[:, 1]]), atol=1e-9)
        assert found["landmarks"] == pytest.approx(np.sqrt(np.mean(L[:, 1] ** 2)))
        assert found["walls"] == pytest.approx(np.sqrt(np.mean(dots[:, 0] ** 2)))
    else:
        np.testing.assert_allclose(dots, track.values[track.landmarks] - given.truth[track.landmarks])
        assert found["landmarks"] == pytest.approx(np.sqrt(np.mean(np.sum(dots**2, axis=1))))
        ellipse = landmarks.collections[0].get_paths()[2].vertices - dots[2]
        np.testing.assert_allclose(np.vecdot(ellipse @ np.linalg.inv(track.P_landmarks[2]), ellipse), 1.0)  # one sigma
        common = f"common offset {np.linalg.norm(dots.mean(axis=0)):.2g} m, "
        assert landmarks.get_legend().get_texts()[1].get_text().startswith(common)
    for axes in figure.axes:
        assert axes.get_legend() is not None
    assert len(field.lines) > 2


def test_few_particles_do_not_know_how_wrong_they_are(world: sim.LandmarkWorld) -> None:
    """Of two particles the covariance has rank 1: no NEES in errors, table and picture, all else is there."""
    found = compare(world, ["ekf", "fastslam1"], {"particles": 2})
    ekf, few = (each.errors for each in found)
    assert set(ekf) - set(few) == {"nees"}
    assert few["ate"] == found[1].track.ate(world.truth).rmse
    with pytest.raises(UnderconstrainedError, match=r"NEES of x0: its covariance is singular"):
        found[1].track.nees(world.truth)
    table = dict(compared_rows(world, found))
    assert table["fastslam1"].split()[6] == "singular"
    assert table["ekf"].split()[6] == f"{ekf['nees']:.4g}"
    assert "is singular in at least one run" in table["singular"]
    assert "singular" not in dict(compared_rows(world, found[:1]))
    nees = several([each.track for each in found], world.truth, world.start).axes[3]
    np.testing.assert_allclose(nees.lines[0].get_ydata(), found[0].track.nees(world.truth))
    assert np.isnan(nees.lines[1].get_ydata()).all()  # type: ignore[arg-type]
    some = {"ekf": ekf, "fastslam1": few}, {"ekf": ekf, "fastslam1": {**few, "nees": 3.0}}
    means = dict(monte_carlo_rows(range(2), some, dim=3))
    assert means["fastslam1"].split()[6] == "singular"  # a mean over some of the runs would look better than it is
    assert means["fastslam1"].split()[0] == f"{few['ate']:.3f}"
    assert means["ekf"].split()[6] == f"{ekf['nees']:.4g}"
