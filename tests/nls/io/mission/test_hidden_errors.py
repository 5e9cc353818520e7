"""Errors of whole tables that no other measurement shows: which, and up to what size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from models.algebra import Array
from nls.io.mission import MissionReport, read_mission, redundancy
from nls.io.mission.redundancy import hidden_errors
from tests.nls.io.mission.mission_files import folder
from tests.nls.io.mission.positioned import Positioned, csv
from tests.nls.io.mission.test_motion import ARM, T, fixes, logs, state

T_FIX = np.concatenate([np.arange(12.0, 18.0), np.arange(62.0, 67.0)])
FIXES = "time_s,x_m,y_m,sigma_x_m,sigma_y_m,arm_x_m,arm_y_m,arm_z_m"


def _solved(path: Path) -> tuple[nls.FactorGraph, nls.Result, MissionReport]:
    graph, start, report = read_mission(path)
    return graph, graph.optimize(start), report


def _hidden(path: Path) -> dict[tuple[str, str], float]:
    graph, result, report = _solved(path)
    errors = hidden_errors(graph, result.values, result.chi2_final, result.dof, report)
    return {(error.quantity, error.file): error.below for error in errors}


def _places(p: Array, late: float = 0.0, arm: tuple[float, float] = (0.5, 0.0)) -> str:
    n = len(T_FIX)
    return csv(FIXES, T_FIX + late, p[:, :2], np.full((n, 2), 0.1), np.tile([*arm, 0.0], (n, 1)))


def test_nothing_checks_the_depth_the_heading_and_the_place_of_a_rov(tmp_path: Path) -> None:
    below = _hidden(folder(tmp_path / "m", logs(fixes=fixes(0 * ARM), motion="sigma_walk_m_sqrt_s\n1\n")))
    tables = {("depth", "depth.csv"), ("heading", "ahrs.csv"), ("place", "fixes.csv"), ("clock", "fixes.csv")}
    assert below == dict.fromkeys(tables, np.inf)


def test_places_with_a_depth_check_its_zero(tmp_path: Path) -> None:
    p = state(T)[:, 3:]
    names = "time_s,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m"
    below = _hidden(folder(tmp_path, logs(fixes=csv(names, T, p, np.full((len(T), 3), 0.2)))))
    assert not {what for what, file in below if file == "depth.csv"}


def test_a_dvl_and_fixes_at_both_ends_check_the_heading_and_the_clock(tmp_path: Path) -> None:
    true = Positioned(tmp_path / "truth")
    files = true.files | {"fixes": _places(true.places(T_FIX, (0.5, 0.0, 0.0)))}
    below = _hidden(folder(tmp_path / "m", files))
    assert below == {("zero of the depth", "depth.csv"): np.inf, ("place", "fixes.csv"): np.inf}


@pytest.mark.parametrize("quantity", ["heading", "clock", "arm"])
def test_chi2_is_implausible_from_the_size_on(quantity: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redundancy, "LEAST", dict.fromkeys(redundancy.LEAST, 0.0))
    true = Positioned(tmp_path / "truth", t=T_FIX)
    places = true.places(T_FIX, (0.5, 0.0, 0.0))
    file = "ahrs.csv" if quantity == "heading" else "fixes.csv"
    below = _hidden(folder(tmp_path / "m", true.files | {"fixes": _places(places)}))[quantity, file]

    def ratio(size: float) -> float:
        rows = true.files["ahrs"].splitlines()
        turned = [f"{row.rpartition(',')[0]},{float(row.rpartition(',')[2]) + size!r}" for row in rows[1:]]
        spoiled = {
            "heading": {"fixes": _places(places), "ahrs": "\n".join([rows[0], *turned]) + "\n"},
            "clock": {"fixes": _places(places, late=size)},
            "arm": {"fixes": _places(places, arm=(0.5 + size, 0.0))},
        }[quantity]
        _, result, _ = _solved(folder(tmp_path / f"{size}", true.files | spoiled))
        return result.chi2_final / result.dof

    assert ratio(0.5 * below) < 2.0
    assert ratio(2.0 * below) > 2.0
