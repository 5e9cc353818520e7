"""``nls solve DIR`` of a folder of keyframes and scans: its options, its rounds, and the lines of the table."""

from __future__ import annotations

import argparse
import warnings
from typing import TYPE_CHECKING, Any

from factors.keys import kinds
from models.errors import GraphWarning, LeadlineError, OptionError
from models.options import did_you_mean
from nls.cli.solved_scans import GRAPH, SolvedScans
from nls.io.scan_mission import ScanReport, is_scan_mission
from nls.sonar.scans import SetupFinding, check_setup, close
from nls.sonar.scans.closing import ROUNDS, SELECTIONS
from nls.sonar.scans.setup.findings import BENDING
from nls.sonar.scans.setup.words import sentence

if TYPE_CHECKING:
    from nls.cli.job import Job
    from nls.sonar.scans import Round

__all__ = ["close_loops", "doubts", "lines", "refuse_explanation", "selection_of"]

WILD = 1.0  # m rms by which the last round may still change the track, above which the solution is none
REFUSED: dict[str, tuple[object, str]] = {  # options, with their defaults and why others have no effect
    "elevation": (None, "a scan mission is of the plane"),
    "crs": (None, "a scan mission has coordinates of its own"),
    "init": ("auto", "a scan mission starts from dead reckoning"),
    "method": ("auto", "the rounds of a scan mission choose their own"),
    "linear_solver": ("auto", "the rounds of a scan mission choose their own"),
    "max_iterations": (None, "the rounds of a scan mission stop by themselves"),
    "update_tol": (None, "the rounds of a scan mission stop by themselves"),
    "chi2_rtol": (None, "the rounds of a scan mission stop by themselves"),
    "hold": ([], "a scan mission has only its keyframes and their drift"),
    "sigmas": ("stated", "the sigmas of a scan mission are those of [drift] in mission.toml and of its matches"),
    "gauge": ("first", "the first keyframe of a scan mission is held"),
    "certify": (False, "the drifts of a scan mission are no poses"),
    "improve": (False, "the drifts of a scan mission are no poses"),
    "convention": ("g2o", "a scan mission has its own residuals"),
}
x = kinds("x")[0]


def selection_of(options: argparse.Namespace) -> str | None:
    """How matches are selected, by ``--robust``; None where the input is no scan mission.

    Raises
    ------
    OptionError
        Several folders, or an option that does nothing here.
    """
    folders = [options.file, *options.dives]
    if not any(map(is_scan_mission, folders)):
        return None
    if options.dives:
        raise OptionError("DIVE", options.dives[0], "one folder: a scan mission is solved alone")
    for name, (default, reason) in REFUSED.items():
        if (value := getattr(options, name)) != default:
            raise OptionError(f"--{name.replace('_', '-')}", value, f"nothing: {reason}")
    select = SELECTIONS[0] if options.robust is None else options.robust
    if select not in SELECTIONS:
        allowed = f"for a scan mission one of {', '.join(SELECTIONS)}: how its matches are selected"
        raise OptionError("--robust", select, allowed + did_you_mean(select.partition(":")[0], SELECTIONS))
    return str(select)


def refuse_explanation(folder: str) -> None:
    """Refuse to explain a scan mission, which has no closures before it is solved.

    Raises
    ------
    OptionError
    """
    if is_scan_mission(folder):
        allowed = (
            f"a graph: this scan mission has no closures yet; nls solve {folder} -o OUT, then nls explain OUT/{GRAPH}"
        )
        raise OptionError("input", folder, allowed)


def close_loops(job: Job) -> None:
    """Match the scans and solve, round by round; dead reckoning where no two submaps overlap."""
    from nls.cli.progress import Progress

    assert isinstance(job.report, ScanReport)
    assert job.select is not None
    job.options.phase.now(f"while matching the scans of {job.options.file}")
    with Progress("match scans", ROUNDS, job.options.quiet) as progress:

        def show(after: Round) -> None:
            progress.say(f"{int(after.matches.kept.sum())} closures, moved {after.moved:.2f} m")

        closing = close(job.graph, job.values, job.report.scans, ROUNDS, job.select, report=show)
    findings: list[SetupFinding] = []
    try:
        findings = check_setup(job.graph, job.values, job.report.scans, closing, job.report.vertex_times["x"])
    except LeadlineError as error:
        job.report.notes.append(f"the setup was not checked: {error}")
    for finding in findings:
        job.report.warn(sentence(finding))
        warnings.warn(f"{job.options.file}: {sentence(finding)}", GraphWarning, stacklevel=2)
    job.graph = job.as_read = closing.graph
    job.result = closing.result
    job.solved = SolvedScans(job.graph, job.values[x], job.result, job.report, closing, job.select, findings)
    job.clock.lap("optimize")


def lines(scans: dict[str, Any]) -> list[str]:
    """The lines of the table that say what a map from scans is worth."""
    out = [
        f"scans       {scans['keyframes']:,} keyframes over {scans['distance_m']:.4g} m, {scans['points']:,} points in "
        f"{scans['with_points']:,} of them"
    ]
    out += [
        f"round {number:<5d} {r['candidates']} candidates, {r['accepted']} accepted, {r['kept']} kept; chi2/dof "
        f"{r['chi2_dof']:.2f}; track moved {r['moved_m']:.2f} m rms"
        for number, r in enumerate(scans["rounds"], 1)
    ]
    if not scans["closures"]:
        why = (
            "no candidate is a closure"
            if scans["rounds"][-1]["candidates"]
            else "no two parts of the track show the same place"
        )
        out.append(f"unchecked   {why}: the solution is dead reckoning and matches of consecutive scans")
        if (sigma := scans.get("end_sigma_m")) is not None:
            out.append(f"end         1 sigma of the position at the end: {sigma:.3g} m, if nothing is wrong")
    elif scans["settled"]:
        out.append(f"settled     after {len(scans['rounds'])} rounds")
    else:
        out.append(f"settled     no: the last round moved the track by {scans['rounds'][-1]['moved_m']:.2f} m rms")
    if "solution" in scans:
        dead, solved = (scans[name]["ate_rmse_m"] for name in ("dead_reckoning", "solution"))
        out.append(
            f"ATE         dead reckoning {dead:.3g} m, solution {solved:.3g} m rmse of {scans['judged_keyframes']:,} "
            f"keyframes against the truth ({scans['alignment']} alignment)"
        )
    return out


def doubts(solved: object) -> list[str]:
    """Why the map is no solution: a setup that bends it, or a track that still moves."""
    assert isinstance(solved, SolvedScans)
    if bent := [finding.kind.value.replace("_", " ") for finding in solved.findings if finding.kind in BENDING]:
        return [f"no solution: the setup is wrong ({', '.join(bent)}), see the warning"]
    if solved.closing.settled or (moved := solved.closing.rounds[-1].moved) <= WILD:
        return []
    return [
        f"not settled: the last of {len(solved.closing.rounds)} rounds moved the track by {moved:.2f} m rms; state the "
        "noise of dead reckoning in [drift] of mission.toml"
    ]
