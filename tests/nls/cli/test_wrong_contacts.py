"""``nls`` on missions with wrong contacts: left out by default, believed on request, named by ``explain``."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import sim
from factors.sighting import Sighting
from nls import FactorGraph
from nls.missions.folder.write import write_mission
from tests.nls.cli.shell import Shell, row


@cache
def mission(outliers: float = 0.0, exchanged: float = 0.0, per_leg: int = 8) -> sim.Mission:
    """A small mission over the sea floor."""
    rng = np.random.default_rng(1)
    return sim.hauv_floor(rng, legs=2, per_leg=per_leg, outliers=outliers, wrong_associations=exchanged)


def written(folder: Path, given: sim.Mission) -> None:
    """The folder of a mission."""
    write_mission(folder, given.graph, given.sonar, given.offset, given.truth)


def test_wrong_contacts_are_left_out_and_counted(shell: Shell, undrawn: None) -> None:
    given = mission(outliers=0.1)
    written(shell / "m", given)
    out, report = shell.told("solve m -o solved")
    solved, dead = (report["mission"][name]["ate_rmse_m"] for name in ("solution", "dead_reckoning"))
    clean = mission()
    best = clean.ate(clean.graph.optimize(clean.start).values)
    assert solved < 1.5 * best < dead
    count, total = len(report["rejected"]), len(given.contacts)
    assert report["doubted"] == total
    assert given.wrong.sum() * 0.95 < count < given.wrong.sum() + 0.05 * total
    assert row(out, "outliers").startswith(f"{count} of {total:,} contacts rejected; ")
    assert f"{report['expected_by_chance']:.0f} expected by chance at 99 %" in row(out, "outliers")
    assert len([line for line in out.splitlines() if line.startswith("outliers")]) == 1
    assert report["mission"]["contacts"] == total - count - sum(each["measurements"] for each in report["left"])
    assert report["robust"] is None
    assert report["chi2_final"] < 1.2 * report["dof"]
    landmarks = {line.split(",")[0] for line in (shell / "solved" / "map.csv").read_text().splitlines()[1:]}
    assert len(landmarks) == report["mission"]["landmarks"] == given.landmarks - len(report["left"])


def test_a_clean_mission_is_solved_as_without_the_test(shell: Shell) -> None:
    written(shell / "m", mission())
    plain, judged = shell.report("solve m --robust none"), shell.report("solve m")
    assert "rejected" not in judged
    assert plain["chi2_final"] == judged["chi2_final"]
    assert plain["mission"] == judged["mission"]


def test_all_contacts_are_believed_on_request(shell: Shell, untried: None) -> None:
    written(shell / "m", mission(outliers=0.1))
    out, report = shell.told("solve m --robust none --allow-doubtful")
    assert "rejected" not in report
    assert report["mission"]["contacts"] == len(mission(outliers=0.1).contacts)
    assert report["chi2_final"] > 100 * report["dof"]
    assert "robust kernel none" not in out
    note = row(out, "note")
    assert "; leave --robust none out: wrong contacts are then found and rejected; " in note
    assert note.endswith("; see: nls explain m --robust none")  # which explains the same graph


def test_graduation_judges_the_contacts_of_a_mission(shell: Shell) -> None:
    given = mission(outliers=0.1, per_leg=12)
    written(shell / "m", given)
    out, report = shell.told("solve m --robust gnc-tls:0.999")
    assert (report["init"], report["doubted"], report["probability"]) == ("gnc-tls:0.999", len(given.contacts), 0.999)
    assert report["mission"]["solution"]["ate_rmse_m"] < report["mission"]["dead_reckoning"]["ate_rmse_m"] / 2
    assert "more" in out


@pytest.mark.usefixtures("untried")
def test_a_doubtful_choice_is_not_taken_and_a_note_says_so(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    written(shell / "m", mission(outliers=0.1))
    monkeypatch.setattr("nls.robust.verdict.HALF_DOUBTED", 1.0)  # whatever is rejected is too much
    out, _ = shell.both("solve m", 1)
    assert "all contacts are kept, though some do not fit: no selection among them can be trusted; " in out
    assert "rejected  " not in out


def test_a_misplaced_sonar_is_no_wrong_contact(shell: Shell) -> None:
    """The mounting is off by 0.3 m, and three landmarks with one contact each have a free elevation."""
    given = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=6)
    offset = given.offset + np.array([0, 0.3, 0, 0, 0, 0, 0])
    factors = [f.mounted(offset) if isinstance(f, Sighting) else f for f in given.graph.factors]
    written(shell / "m", replace(given, graph=FactorGraph(factors), offset=offset))
    contacts = shell / "m" / "contacts.csv"
    lines = contacts.read_text().splitlines()
    once = [line.split(",") for line in lines[1::200]]
    lines += [",".join([cells[0], str(900 + k), *cells[2:]]) for k, cells in enumerate(once)]
    contacts.write_text("\n".join(lines) + "\n")
    solved, explained = shell.report("solve m --init odometry", 1), shell.report("explain m --init odometry")
    assert "rejected" not in solved
    assert explained["nullity"] == len(once) == 3
    (words,) = (finding["sentence"] for finding in explained["findings"] if finding["kind"] == "calibration")
    assert "the sensor of RangeAzimuth is off by y -0.308 m" in words
    assert f"all contacts are kept, though some do not fit: {words}" in solved["notes"]


def test_explain_names_exchanged_landmarks_and_wrong_contacts(shell: Shell, untried: None) -> None:
    given = mission(exchanged=0.05)
    written(shell / "m", given)
    record = shell.report("explain m")
    swaps = [finding for finding in record["findings"] if finding["kind"] == "swapped"]
    contacts = given.contacts.keys[1].numbers[given.wrong]
    named = {int(key[1:]) for finding in swaps for key in finding["keys"]}
    assert len(swaps) > 0.3 * given.wrong.sum() / 2
    assert named <= set(contacts.tolist())
    assert record["findings"][0]["kind"] == "many_outliers"
    assert all("m/contacts.csv:" in place for finding in swaps for place in finding["places"])
    first = swaps[0]
    lines = (shell / "m" / "contacts.csv").read_text().splitlines()
    for place in first["places"]:
        cells = lines[int(place.rpartition(":")[2]) - 1].split(",")
        assert f"l{cells[1]}" in first["keys"]
    assert len(given.contacts) == len(lines) - 1
    assert "contacts rejected" in record["optimum"]
    assert shell.report("explain m --robust none")["optimum"].startswith("at its optimum (")
