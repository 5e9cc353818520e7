"""The kinds of input of a command: a graph file, a mission or several dives, a scan mission.

Each reads, solves, writes and draws, and lists the options that mean nothing to it. No other file of the command line
asks which kind it has.
"""

import argparse
import os

from nls.cli.graph_file import GraphFile


def input_of(options: argparse.Namespace) -> GraphFile:
    """The input of a command, by its files."""
    if not os.path.isdir(options.file):
        return GraphFile(options)
    from nls.missions.scans.folder import is_scan_mission

    dives = getattr(options, "dives", [])
    if any(map(is_scan_mission, [options.file, *dives])):
        from nls.cli.scan_mission import ScanMission

        return ScanMission(options)
    from nls.cli.mission import Dives, Mission

    return Dives(options) if dives else Mission(options)
