"""Whether a result of ``nls solve`` is doubtful, and why: for exit status, table, reports, pictures and charts alike.

A calibration far from its belief is no reason: the measurements determined it, and the table prints it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nls.optimizers.fit import shares

if TYPE_CHECKING:
    from nls.cli.job import Job
    from nls.io.mission import MissionReport
    from nls.optimizers import Result

__all__ = ["by_file", "marks", "reasons"]


def reasons(job: Job) -> list[str]:
    """Reasons to doubt the result, in words; none where it is as it should be."""
    from nls.cli.scan_mission import doubts as of_scans

    return [
        *of_tables(job),
        *([job.result.doubt] if job.result.doubt and job.result.converged else []),
        *(map(str, job.choice.doubts) if job.choice is not None else ()),
        *of_scans(job.solved),
    ]


def marks(job: Job) -> list[str]:
    """Words on pictures and charts: the reasons, and that this is no optimum."""
    return [*([] if job.result.converged else [f"not converged: {job.result.status.value}"]), *reasons(job)]


def of_tables(job: Job) -> list[str]:
    """The findings of the checks of a mission, by name; outliers of a table under a kernel are what that is for."""
    from nls.io.mission import MissionReport
    from nls.io.mission.checks.findings import Cause

    if not isinstance(job.report, MissionReport):
        return []
    factors = zip(_tables(job.report), job.graph.factors, strict=True)
    robust = {table for table, factor in factors if factor.kernel is not None}
    left = [
        f"{finding.check} ({finding.file})"
        for finding in job.report.findings
        if finding.file not in robust or any(reading.cause is not Cause.OUTLIERS for reading in finding.readings)
    ]
    return [f"implausible: {', '.join(dict.fromkeys(left))}"] if left else []


def by_file(job: Job, result: Result) -> Result:
    """The result of a mission under a kernel, with what is ignored by the file of every table."""
    from nls.io.mission import MissionReport

    if not result.shares or not isinstance(job.report, MissionReport):
        return result
    tables = zip(job.graph.factors, _tables(job.report), strict=True)
    result.shares = shares(job.graph.factors, result.values, [f"{factor.name} ({table})" for factor, table in tables])
    return result


def _tables(report: MissionReport) -> list[str]:
    """The file that every factor is from, such as ``fixes.csv``; of several dives with the name of the dive."""
    from nls.io.mission import DivesReport

    files = [Path(source.path).name for source in report.sources]
    if not isinstance(report, DivesReport):
        return files
    return [f"{dive}/{file}" for dive, file in zip(report.dive_of, files, strict=True)]
