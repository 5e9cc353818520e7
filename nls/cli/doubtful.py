"""Whether a result of ``nls solve`` is doubtful, and why: for exit status, table, reports, pictures and charts alike.

A calibration far from its belief is no reason: the measurements determined it, and the table prints it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nls.cli import sigmas
from nls.optimizers.fit import shares

if TYPE_CHECKING:
    from nls.cli.job import Job
    from nls.optimizers import Result

__all__ = ["by_file", "marks", "reasons"]


def reasons(job: Job) -> list[str]:
    """Reasons to doubt the result, in words; none where it is as it should be."""
    out = _of_tables(job) + [job.result.doubt] * bool(job.result.doubt and job.result.converged)
    out += [] if job.choice is None else map(str, job.choice.doubts)
    out += [] if job.sigmas is None else sigmas.doubts(job.sigmas)
    return out if job.solved is None else out + job.solved.faults()


def marks(job: Job) -> list[str]:
    """Words on pictures and charts: the reasons, and that this is no optimum."""
    return [f"not converged: {job.result.status.value}"] * (not job.result.converged) + reasons(job)


def _of_tables(job: Job) -> list[str]:
    """The findings of the checks of a mission, by name; fixes that jump are what a kernel on their table is for."""
    if job.report.format != "mission":
        return []
    from nls.io.mission import MissionReport

    assert isinstance(job.report, MissionReport)
    robust = {table for table, factor in zip(_tables(job), job.graph.factors, strict=True) if factor.kernel is not None}
    left = [
        f"{finding.check} ({finding.file})"
        for finding in job.report.findings
        if finding.file not in robust or finding.check != "jumps"
    ]
    return [f"implausible: {', '.join(dict.fromkeys(left))}"] if left else []


def by_file(job: Job, result: Result) -> Result:
    """The result of a mission under a kernel, with what is ignored by the file of every table."""
    if result.shares and job.report.format == "mission":
        factors = job.graph.factors
        names = [f"{factor.name} ({table})" for factor, table in zip(factors, _tables(job), strict=True)]
        result.shares = shares(factors, result.values, names)
    return result


def _tables(job: Job) -> list[str]:
    """The file that every factor is from, such as ``fixes.csv``; of several dives with the name of the dive."""
    from nls.io.mission import DivesReport

    files = [Path(source.path).name for source in job.report.sources]
    if not isinstance(job.report, DivesReport):
        return files
    return [f"{dive}/{file}" for dive, file in zip(job.report.dive_of, files, strict=True)]
