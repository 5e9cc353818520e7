"""``nls plot``: the graph as it was read; and how a graph is drawn, before it is solved and after."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from nls.cli.outputs import PICTURES, refuse_name, refuse_unwritable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from nls.io import LoadReport

__all__ = ["drawings", "plot"]


def plot(options: argparse.Namespace) -> int:
    """Read, draw, write; returns the exit status."""
    from nls.cli.formats import read
    from nls.io.files import title_of
    from nls.plot.picture import write_picture

    refuse_unwritable({"OUT": options.output}, options.file)
    refuse_name("OUT", options.output, PICTURES)
    graph, values, report = read(options)
    options.phase.now(f"while writing {options.output}")
    as_read, _ = drawings(report)
    figure = as_read(graph, values)
    figure.suptitle(title_of(report.path))
    write_picture(options.output, figure)
    options.phase.written.append(options.output)
    print(f"written     {options.output}")
    return 0


def drawings(report: LoadReport) -> tuple[Callable[..., Figure], Callable[..., Figure]]:
    """Pictures of a graph as it was read, and before and after; a mission is drawn from above and from the side."""
    from nls.io.mission import MissionReport
    from nls.plot import before_after, trajectory
    from nls.plot.mission import plan, plan_before_after

    return (plan, plan_before_after) if isinstance(report, MissionReport) else (trajectory, before_after)
