"""Sensors that are off, on a survey with positions: variables within sigmas, constants exactly; a mounted sonar."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy import stats

import nls
from factors import Diagonal, Elevation, Isotropic, Position, Prior, RangeAzimuth, Sighting
from factors.keys import Keys, Kind
from models import SE3, euler
from models.algebra import Array
from models.manifolds.so3 import rotation3
from nls import FactorGraph, Values
from nls.cli import main
from nls.missions import MissionReport, elevations
from nls.missions.folder.columns import COLUMNS, GYRO
from nls.missions.folder.table import csv_text
from tests.nls.missions.folder.mission_files import RAW, TINY, folder

RATE, LENGTH = 200, 240  # Hz of the truth, s
SIGMA = {"v": 0.005, "tilt": 0.002, "yaw": 0.005, "z": 0.02, "fix": 0.2}
x, l, o = nls.kinds("x", "l", "o")


class Survey:
    """Legs of 40 s at 1 m/s, turned by half a circle within 15 s each, with a little pitch and roll.

    off : true values by the name of calibration.csv, and gyro_bias, rad/s.
    straight : without the turns.
    """

    def __init__(self, seed: int | None = 0, straight: bool = False, arm: Array | None = None, **off: float) -> None:
        self.off, self.rng = off, np.random.default_rng(seed)
        self.noisy = 0.0 if seed is None else 1.0
        t = self.t = np.arange(0.0, LENGTH + 6.0, 1 / RATE)
        phase = (t - 3.0) % 110.0
        turn = np.pi / 15.0 * (((phase > 40) & (phase < 55)) * 1.0 - ((phase > 95) & (phase < 110)) * 1.0)
        rate = np.zeros(len(t)) if straight else np.convolve(turn, np.ones(RATE) / RATE, "same")
        yaw = 0.3 + np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) / RATE))
        self.rpy = np.column_stack([0.06 * np.sin(0.31 * t), 0.05 * np.cos(0.23 * t), yaw])
        R = rotation3(euler.quaternion_from_angles(self.rpy))
        self.v = np.column_stack([1 + 0.2 * np.sin(0.11 * t), 0.05 * np.sin(0.4 * t), 0.02 * np.cos(0.3 * t)])
        world = np.einsum("nij,nj->ni", R, self.v)
        self.p = np.zeros((len(t), 3))
        self.p[1:] = np.cumsum(0.5 * (world[1:] + world[:-1]) / RATE, axis=0)
        self.p[:, 2] += 20.0
        # the DVL is at an arm: v + w x arm, w of the body by differences of R
        self.arm = np.zeros(3) if arm is None else np.asarray(arm)
        dR = np.gradient(R, 1 / RATE, axis=0)
        W = np.einsum("nji,njk->nik", R, dR)
        self.w = np.column_stack([W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]])
        self.at_dvl = self.v + np.cross(self.w, self.arm)

    def noise(self, sigma: float, *shape: int) -> Array:
        return self.noisy * self.rng.normal(0, sigma, shape)

    def tables(self, gyro: bool = False) -> dict[str, tuple[Sequence[str], tuple[object, ...]]]:
        """Columns of the files by name."""
        every = {"dvl": RATE // 5, "ahrs": RATE // 10, "depth": RATE // 2, "gyro": RATE // 20}
        rows = {name: np.arange(3 * RATE, (LENGTH + 3) * RATE + 1, step) for name, step in every.items()}
        k, off = rows["dvl"], self.off
        a, scale = off.get("dvl_yaw_rad", 0.0), 1 + off.get("dvl_scale", 0.0)
        turned = np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]])
        v = scale * self.at_dvl[k] @ turned.T + self.noise(SIGMA["v"], len(k), 3)
        ones = np.ones(len(k), dtype=int)
        out: dict[str, tuple[Sequence[str], tuple[object, ...]]] = {
            "dvl": (RAW["dvl"], (self.t[k], v, ones)),
            "dvl_mount": (COLUMNS["dvl_mount"], (np.append(self.arm, np.zeros(3))[None],)),
        }
        k = rows["ahrs"]
        late = np.column_stack([np.interp(self.t[k] - off.get("ahrs_clock_s", 0.0), self.t, y) for y in self.rpy.T])
        late[:, 2] -= off.get("declination_rad", 0.0)
        late += self.noise(1.0, len(k), 3) * [SIGMA["tilt"], SIGMA["tilt"], SIGMA["yaw"]]
        out["ahrs"] = (RAW["ahrs"][: 4 - gyro], (self.t[k], late[:, : 3 - gyro]))
        depth = rows["depth"]
        out["depth"] = (RAW["depth"], (self.t[depth], self.p[depth, 2:] + self.noise(SIGMA["z"], len(depth), 1)))
        noise = ["sigma_v_m_s", "scale", "sigma_bridge_m_s_sqrt_s", "sigma_roll_rad", "sigma_pitch_rad", "sigma_z_m"]
        sigmas = [SIGMA["v"], 0.0, 0.05, SIGMA["tilt"], SIGMA["tilt"], SIGMA["z"]]
        if gyro:
            k, density = rows["gyro"], 3e-4
            bias = off.get("gyro_bias", 0.0)
            w = self.w[k] + [0.0, 0.0, bias] + self.noise(density * np.sqrt(RATE / every["gyro"]), len(k), 3)
            out["gyro"] = (RAW["gyro"], (self.t[k], w))
            noise, sigmas = [*noise, *GYRO], [*sigmas, density, 0.005, 1e-6]
        else:
            noise, sigmas = [*noise, "sigma_yaw_rad"], [*sigmas, SIGMA["yaw"]]
        out["noise"] = (noise, ([sigmas],))
        return out

    def load(
        self,
        path: Path,
        calibration: dict[str, tuple[float, float]],
        fixes: int = 20,
        gyro: bool = False,
        replace: dict[str, str] | None = None,
    ) -> tuple[FactorGraph, Values, MissionReport]:
        """The mission with this calibration.csv, and a position every so many poses; 0 for none."""
        texts = {name: csv_text(names, *columns).decode() for name, (names, columns) in self.tables(gyro).items()}
        if calibration:
            numbers = np.array(list(calibration.values()), dtype=float)
            texts["calibration"] = csv_text(COLUMNS["calibration"], list(calibration), numbers).decode()
        texts["anchor"] = self.anchor([0], 0.01)
        graph, values, report = nls.load(folder(path, {**texts, **(replace or {})}))
        if fixes:
            i = np.arange(0, LENGTH - 1, fixes)
            z = self.p[(3 + i) * RATE, :2] + self.noise(SIGMA["fix"], len(i), 2)
            graph.add(Position(x[i], z, Isotropic(SIGMA["fix"]), components=("x", "y")))
        return graph, values, report

    def anchor(self, i: npt.ArrayLike, sigma: float) -> str:
        """The file of the true places of poses, and of their headings, which are hardly known."""
        i = np.asarray(i)
        k = (3 + i) * RATE
        level = np.column_stack([self.p[k, :2], self.rpy[k, 2], np.tile([sigma, sigma, 0.5], (len(i), 1))])
        return csv_text(COLUMNS["anchor"], i, level).decode()

    def true(self, values: Values) -> Array:
        """True Euler vectors (n, 6) of the poses."""
        k = (3 + values.stack("x").numbers) * RATE
        return np.column_stack([self.rpy[k], self.p[k]])


def away(survey: Survey, values: Values) -> Array:
    """Distances (n,) in x and y of the poses from the truth."""
    return np.asarray(np.linalg.norm(SE3.position(values.stack("x").X)[:, :2] - survey.true(values)[:, 3:5], axis=1))


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


PAGE = Path(__file__).parents[4] / "docs" / "theory" / "sonar.md"


def test_the_example_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (code,) = re.findall(r"```python\n(import nls\n.*?)```", PAGE.read_text(), re.DOTALL)
    folder(tmp_path / "survey")
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    said = re.fullmatch(r"pitch (.*) deg from sonar.csv, known to (.*) deg\n", capsys.readouterr().out)
    away, sigma = map(float, said.groups())
    assert 0 < sigma < np.degrees(0.1)  # more than was known before
    assert 0 < abs(away) < 3 * sigma


def mounted(graph: nls.FactorGraph, values: nls.Values, offset: Keys | np.ndarray) -> nls.FactorGraph:
    return nls.FactorGraph([f.mounted(offset) if isinstance(f, Sighting) else f for f in graph.factors])


def test_elevations_seen_from_a_mounting_that_is_a_variable(tmp_path: Path) -> None:
    """All but known it is the fixed one; less well known, elevations are less well known."""
    graph, values, report = nls.load(folder(tmp_path / "m"))
    fixed = graph.optimize(values).values
    expected = elevations(graph, fixed, sigmas=True)
    values.add(o, SE3, report.offset)
    free = mounted(graph, values, o[0])
    sigmas = {}
    for sigma in (1e-6, 0.1):
        known = nls.FactorGraph([*free.factors, Prior(o[0], report.offset, Diagonal([1e-6] * 4 + [sigma, 1e-6]))])
        solved = known.optimize(values).values
        found = elevations(known, solved, sigmas=True)
        sigmas[sigma] = found.sigma
        if sigma < 1e-3:
            for name in ("landmarks", "poses", "views", "range", "azimuth", "elevation", "along"):
                np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=0, atol=1e-5)
            np.testing.assert_allclose(found.sigma, expected.sigma, rtol=1e-4)
    assert (sigmas[0.1] > 1.01 * sigmas[1e-6]).all()
    marginals = nls.Marginals(known, solved)  # H Sigma H' over pose, landmark and mounting
    for k, (pose, landmark) in enumerate(zip(found.poses.tolist(), found.landmarks.tolist(), strict=True)):
        model, X = solved.gather(Elevation(x[pose], l[landmark], 0.0, Isotropic(1.0), o[0]))
        H = np.hstack([A[0] for A in model.linearize(*X)[0]])
        Sigma = marginals.joint([x[pose], l[landmark], o[0]], frame="body").matrix
        assert found.before[k] == pytest.approx(float(np.sqrt((H @ Sigma @ H.T)[0, 0])), rel=1e-4)


def test_contacts_in_several_factors_with_mountings_of_their_own(tmp_path: Path) -> None:
    graph, values, report = nls.load(folder(tmp_path / "m", contacts=TINY["contacts"]))
    fixed = graph.optimize(values).values
    expected = elevations(graph, fixed)
    (contacts,) = [f for f in graph.factors if isinstance(f, RangeAzimuth)]
    rest = [f for f in graph.factors if f is not contacts]
    odd = np.arange(len(contacts)) % 2 == 1
    assert {int(k) for k in contacts.keys[1].numbers[:3][odd[:3]]} == {12}
    parts = [contacts[odd], contacts[~odd].mounted(np.tile(report.offset, ((~odd).sum(), 1)))]
    found = elevations(nls.FactorGraph([*rest, *parts]), fixed)
    for name in ("landmarks", "poses", "range", "azimuth", "elevation", "along"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)
    turned = SE3.retract(report.offset[None], np.array([[0.0, 0, 0, 0, 0.2, 0]]))
    found = elevations(nls.FactorGraph([*rest, parts[0], contacts[~odd].mounted(turned)]), fixed)
    away = np.abs(found.elevation - expected.elevation)
    assert (away[found.landmarks != 12] > 0.1).all()  # only 12 is first seen by the other factor
    assert away[found.landmarks == 12] == pytest.approx(0.0, abs=1e-12)
