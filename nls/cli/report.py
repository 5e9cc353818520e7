"""``nls solve --report OUT.html``: what the page is told of the command, the file and the solution."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nls.cli.timing import rows

if TYPE_CHECKING:
    from models.errors import UnderconstrainedError
    from nls.certificate import Certificate
    from nls.cli.mission import Solved
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.optimizers import Result
    from nls.plot.report.told import Rejected
    from nls.robust import Doubt
    from nls.values import Values

__all__ = ["write_report"]


def write_report(
    options: argparse.Namespace,
    graph: FactorGraph,
    before: Values,
    report: LoadReport,
    starts: tuple[str, dict[str, float]],
    result: Result | UnderconstrainedError,
    timings: dict[str, float],
    solved: Solved | None,
    certificate: Certificate | None,
    path: str,
    rejected: Sequence[Rejected] = (),
    doubts: Sequence[Doubt] = (),
) -> None:
    """Write the page.

    Parameters
    ----------
    options, report : of the command and of the file.
    graph, before, result : as for `nls.plot.report`.
    starts : the start that was taken, and chi2 of all that were tried.
    timings : of `Clock`.
    solved, certificate : of a mission; of ``--certify``.
    path : of the page.
    rejected, doubts : by graduated non-convexity, and why its choice may be wrong.
    """
    from nls.io.files import write_bytes
    from nls.plot.report import report as page

    init, tried = starts
    text = page(
        graph,
        before,
        result,
        title=Path(report.path).name,
        init=init,
        marginals=None if solved is None else solved.marginals,
        certificate=certificate,
        rejected=rejected,
        doubts=doubts,
        facts=_facts(options, result, report, tried),
        seconds={name: timings[name] for name in rows(timings) if name != "process"},
        pictures={} if solved is None else _pictures(solved),
        shell=True,
    )
    write_bytes(path, text.encode(errors="backslashreplace"))  # names of files can be any bytes


def _facts(
    options: argparse.Namespace, result: Result | UnderconstrainedError, report: LoadReport, tried: dict[str, float]
) -> dict[str, str]:
    """Where the solution comes from, by name."""
    import nls

    facts = {
        "file": report.path,
        "format": f"{report.format}, {report.dimension}",
        "lines": ", ".join(f"{count:,} {tag}" for tag, count in report.tags.items()),
        "command": shlex.join(["nls", *map(str, options.argv)]),
        "convention": report.convention,
        "starts": ", ".join(f"{name}: chi2 {chi2:.6g}" for name, chi2 in tried.items()),
        "linear solver": getattr(result, "linear_solver", ""),
        "robust kernel": options.robust or "",
        "held": ", ".join(f"all {kind}" for kind in options.hold),
        "notes": "; ".join(report.notes),
        "version": f"leadline {nls.__version__}",
    }
    return {name: fact for name, fact in facts.items() if fact}


def _pictures(solved: Solved) -> dict[str, Any]:
    """The track of a mission, and its landmarks."""
    from nls.plot.mission import landmark_map, track

    truth = solved.report.truth
    shown = {"The track": track(solved.values, solved.dead, truth, solved.marginals, solved.tracks)}
    if solved.contacts and solved.report.sonar is not None:
        aperture = solved.report.sonar.aperture
        shown["The landmarks"] = landmark_map(solved.values, solved.elevations, truth, aperture)
    return shown
