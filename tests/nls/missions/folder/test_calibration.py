"""Sensors that are off are found out by positions: as variables within their sigmas, as constants exactly."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import nls
from factors.keys import Kind
from models.algebra import Array
from nls import Values
from nls.cli import main
from nls.missions.folder.table import csv_text
from tests.nls.missions.folder.surveys import Survey, away

OFF = {"dvl_scale": 0.01, "dvl_yaw_rad": np.radians(1.0), "ahrs_clock_s": 0.3}
PRIOR = {"dvl_scale": (0.0, 0.02), "dvl_yaw_rad": (0.0, 0.05), "ahrs_clock_s": (0.0, 0.5)}
ARM = np.array([0.8, -0.3, 0.4])


def solved(
    survey: Survey, path: Path, calibration: dict[str, tuple[float, float]], **how: object
) -> tuple[Values, nls.Marginals]:
    graph, values, _ = survey.load(path, calibration, **how)
    result = graph.optimize(values)
    assert result.converged
    return result.values, nls.Marginals(graph, result.values)


def of(name: str, values: Values, marginals: nls.Marginals) -> tuple[Array, Array]:
    """Estimates and sigmas of the variables of a kind."""
    return np.asarray(values.stack(name).X)[:, 0], np.sqrt(marginals.all(Kind(name))[:, 0, 0])


def test_constants_are_taken_out(tmp_path: Path) -> None:
    off = {**OFF, "declination_rad": 0.1}
    survey = Survey(None, arm=ARM, **off)
    _, dead, _ = survey.load(tmp_path / "m", {name: (value, 0.0) for name, value in off.items()}, fixes=0)
    assert list(dead.stacks) == ["x"]
    assert away(survey, dead).max() < 0.01
    assert away(survey, survey.load(tmp_path / "n", {}, fixes=0)[1]).max() > 1.0


@pytest.mark.parametrize("name", [*OFF, "declination_rad"])
def test_one_is_found_without_noise(name: str, tmp_path: Path) -> None:
    true = {**OFF, "declination_rad": 0.1}[name]
    survey = Survey(None, arm=ARM, **{name: true})
    for k, believed in enumerate((0.0, 0.8 * true)):
        values, marginals = solved(survey, tmp_path / str(k), {name: (believed, 100 * abs(true))})
        assert of(name, values, marginals)[0] == pytest.approx(true, rel=0.02)
        assert away(survey, values).max() < 0.05


def test_three_are_found_within_their_sigmas(tmp_path: Path) -> None:
    off = []
    for seed in range(5):
        survey = Survey(seed, arm=ARM, **OFF)
        values, marginals = solved(survey, tmp_path / str(seed), PRIOR)
        for name, true in OFF.items():
            (estimate,), (sigma,) = of(name, values, marginals)
            assert sigma < 0.25 * PRIOR[name][1]
            off.append((estimate - true) / sigma)
    assert max(map(abs, off)) < 3
    low, high = stats.chi2.ppf([0.005, 0.995], len(off))
    assert low < np.square(off).sum() < high


def test_the_bias_of_a_gyro_is_found_and_the_heading_with_it(tmp_path: Path) -> None:
    normalized = []
    for seed in range(4):
        survey = Survey(seed, gyro_bias=0.002)
        values, marginals = solved(survey, tmp_path / str(seed), {}, gyro=True)
        bias, sigma = of("gyro_bias", values, marginals)
        assert len(bias) == 4
        assert np.abs(bias - 0.002).max() < 3 * sigma.max() < 3e-4
        normalized.append(np.square((bias - 0.002) / sigma).mean())
    assert np.mean(normalized) < stats.chi2.ppf(0.995, 4) / 4
    exact = Survey(None)
    _, dead, _ = exact.load(tmp_path / "exact", {}, gyro=True)
    assert away(exact, dead).max() < 0.02, "the yaw of an exact gyro is the yaw"


def test_a_hole_in_the_log_of_a_gyro_is_an_even_turn_less_well_known(tmp_path: Path) -> None:
    survey = Survey(0)
    names, (t, w) = Survey(0).tables(gyro=True)["gyro"]
    keep = (t < 60.3) | (t > 63.4)
    text = csv_text(names, t[keep], w[keep]).decode()
    graph, _, report = survey.load(tmp_path / "m", {}, gyro=True, replace={"gyro": text})
    steps = graph.factors[0]
    sigma = 1 / steps.noise.sqrt_information(len(steps), ("x", "y", "yaw"))[:, 2, 2]
    hole = np.abs(np.arange(len(sigma)) - 58.5) < 2
    assert sigma[hole].min() > 20 * np.median(sigma)
    assert sigma[~hole].max() < 2 * np.median(sigma)
    assert any("turn evenly from row to row" in note for note in report.notes)


def test_solve_says_which_calibrations_the_data_determine(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    reports = {}
    for name, straight, fixes in (("turns", False, 20), ("straight", True, 0)):
        survey = Survey(0, straight=straight, arm=ARM, **OFF)
        survey.load(tmp_path / name, PRIOR, fixes=0)
        if fixes:
            (tmp_path / name / "anchor.csv").write_text(survey.anchor(np.arange(0, 240, fixes), 0.2))
        file = tmp_path / f"{name}.json"
        assert main(["solve", str(tmp_path / name), "--json", str(file)]) == 0
        reports[name] = json.loads(file.read_text())["mission"]["calibrations"]
        assert capsys.readouterr().out.count("not determined by these data") == (3 if straight else 0)
        assert [c["name"] for c in reports[name]] == list(PRIOR)
    for c in reports["turns"]:
        assert c["determined"]
        assert c["share"] == pytest.approx(c["sigma"] / PRIOR[c["name"]][1])
        assert abs(c["value"] - OFF[c["name"]]) < 3 * c["sigma"]
    assert all(c["share"] == pytest.approx(1.0, abs=1e-3) for c in reports["straight"])
