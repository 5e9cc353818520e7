"""Formats by suffix: what the commands read and write, graphs and trajectories alike."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nls.graph import FactorGraph
    from nls.io import LoadReport
    from nls.values import Values

__all__ = ["SUFFIXES", "format_of", "formats", "read", "write"]

TRAJECTORIES = ("tum", "kitti")
SUFFIXES = {f".{name}": name for name in ("g2o", "toro", "isam", "pyfg", "bal", *TRAJECTORIES)}


def formats() -> tuple[str, ...]:
    """Everything that can be written, by name."""
    from nls.io import DIALECTS

    return (*DIALECTS[1:], *TRAJECTORIES)


def format_of(path: str) -> str | None:
    """The format a suffix stands for; None where it stands for none of ours."""
    return SUFFIXES.get(Path(path.lower().removesuffix(".gz")).suffix)


def read(options: argparse.Namespace) -> tuple[FactorGraph, Values, LoadReport]:
    """The graph, start and report of the file of a command; a trajectory is a graph without measurements."""
    import nls
    from models import SE3
    from nls.io.trajectory import read_kitti, read_tum

    form = format_of(options.file)
    if form not in TRAJECTORIES:
        return nls.load(options.file, options.convention, options.dialect, options.repair_information)
    X = read_tum(options.file)[1] if form == "tum" else read_kitti(options.file)
    report = nls.LoadReport(options.file, form, "3-D", options.convention, {"poses": len(X)})
    return nls.FactorGraph(), nls.Values({"x": (SE3, X)}), report


def write(path: str, form: str, graph: FactorGraph, values: Values, report: LoadReport) -> list[str]:
    """Write in a format; returns remarks about what the file does not hold."""
    import nls

    if form in TRAJECTORIES:
        return _write_trajectory(path, form, graph, values, report)
    nls.save(path, graph, values, report, form)
    return []


def _write_trajectory(path: str, form: str, graph: FactorGraph, values: Values, report: LoadReport) -> list[str]:
    """Poses in the order of their times or numbers."""
    import numpy as np

    from models import SE2, SE3
    from models.errors import GraphError
    from nls.io.pyfg import PyfgReport
    from nls.io.trajectory import write_kitti, write_tum

    poses = [stack for stack in values.stacks.values() if stack.manifold in (SE2, SE3)]
    if len(poses) != 1:
        names = ", ".join(stack.kind for stack in poses) or "none"
        raise GraphError(f"{path}: a trajectory file holds the poses of one kind, this graph has {names}")
    (stack,) = poses
    timed = isinstance(report, PyfgReport) and stack.kind in report.vertex_times
    times = report.vertex_times[stack.kind] if timed else stack.numbers.astype(float)  # type: ignore[attr-defined]
    order = np.argsort(times, kind="stable")
    X = np.array(stack.X)[order]
    if form == "tum":
        write_tum(path, times[order], X)
    else:
        write_kitti(path, X)
    notes = [] if timed or form == "kitti" else ["the file has no times: the numbers of the poses stand for them"]
    if left := len(values) - len(stack):
        notes.append(f"a trajectory file holds no {left} variables of other kinds")
    if len(graph):
        notes.append(f"a trajectory file holds no measurements: {len(graph)} are not in it")
    return notes
