"""``nls plot``: the graph as it was read."""

from __future__ import annotations

import argparse

from nls.cli.outputs import PICTURES, refuse_name, refuse_unwritable, say


def plot(options: argparse.Namespace) -> int:
    """Read, draw, write; returns the exit status."""
    from nls.cli.formats import mission_of, read
    from nls.io.files import title_of
    from nls.missions.pictures.mission import plan
    from nls.plot import trajectory
    from nls.plot.picture import write_picture

    refuse_unwritable({"OUT": options.output}, options.file)
    refuse_name("OUT", options.output, PICTURES)
    graph, values, report = read(options)
    options.phase.now(f"while writing {options.output}")
    figure = (plan if report.format == "mission" else trajectory)(graph, values)
    figure.suptitle(title_of(report.path))
    write_picture(options.output, figure)
    options.phase.written.append(options.output)
    say(f"written     {options.output}")
    if (mission := mission_of(report)) and mission.unnamed:
        say(f"note        {mission.unnamed.note(report.path)}")
    return 0
