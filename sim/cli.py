"""Command line of the simulator: a world by name, its graph and its truth as files, and one table."""

from __future__ import annotations

import argparse
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import LeadlineError, OptionError
from nls.cli.outputs import say
from nls.cli.phase import INTERRUPTED, Phase
from sim.arguments import Parser, add_outputs, add_parameters, command, flag
from sim.cli_estimators import SCENE_FILES, add_compare, add_estimators, estimated
from sim.estimators import SCENES
from sim.files import Files, simulated
from sim.mission import Mission
from sim.monte_carlo import FailedRunsError, sentence
from sim.world import World
from sim.worlds.grid3d import grid3d
from sim.worlds.harbor import harbor
from sim.worlds.hauv import hauv_floor, hauv_hull
from sim.worlds.manhattan import manhattan
from sim.worlds.rig import rig
from sim.worlds.ring import ring
from sim.worlds.sphere import sphere
from sim.worlds.survey import survey
from sim.worlds.torus import torus

__all__ = ["MISSIONS", "WORLDS", "main"]

WORLDS: dict[str, Callable[..., World]] = {f.__name__: f for f in (grid3d, manhattan, ring, sphere, torus)}
MISSIONS: dict[str, Callable[..., Mission]] = {f.__name__.replace("_", "-"): f for f in (hauv_floor, hauv_hull)}
WRITTEN: dict[str, Mapping[str, Callable[..., Any]]] = {  # files, and what makes them, by name
    "graph.npz, truth.npz, graph.g2o, truth.g2o": WORLDS,
    "a mission (CSV files, for nls solve), graph.npz, truth.npz": MISSIONS,
    "graph.npz, truth.npz, rig.png, rig.json (before and after)": {"rig": rig},
    "a raw log (CSV files, for nls solve), truth/, raw/ (for nls import)": {"survey": survey},
    "keyframes.csv, scans.csv, truth.csv": {"harbor": harbor},
    SCENE_FILES: SCENES,
}
MADE = {name: (make, written) for written, makers in WRITTEN.items() for name, make in makers.items()}
EXAMPLES = """examples:
  nls-sim sphere --out demo                       graph and truth in the folder demo, and a table
  nls-sim manhattan --poses 1000 --seed 7         the table only
  nls-sim sphere --rings 20 --per-ring 30 --sigma-r 0.05
  nls-sim torus --help                            sizes and noise of this world, with their defaults
  nls-sim hauv-floor --seed 1 --out survey        a sonar mission as a folder of CSV files, for nls solve survey
  nls-sim hauv-hull --aperture 28deg --outliers 0.05
  nls-sim survey --usbl-outliers 0.1 --out log    what DVL, AHRS, GPS, USBL and beacons write, for nls solve log
  nls-sim harbor --geometry quay --out quay       scans of a sonar along one straight wall
  nls-sim rig --out calibrated                    a camera and a sonar: raw and optimized, with a picture
  nls-sim subsea --landmarks first-sight --estimator ekf --out over-confident
  nls-sim subsea --laps 1 --runs 4           the mean over 4 seeds, on all cores
  nls-sim compare --world subsea --laps 1 --estimators ekf batch
"""


def main(argv: Sequence[str] | None = None, phase: Phase | None = None) -> int:
    """Run the command line; returns the exit status.

    0; 1 when runs failed; 2 for a mistake in the options, or an output that cannot be written; 130 when interrupted.

    Examples
    --------
    >>> main(["ring", "--laps", "2", "--per-lap", "20", "--seed", "3"])
    world           ring, seed 3
    poses           40 in SE2
    ...
    0
    """
    phase = Phase("nls-sim") if phase is None else phase
    try:
        return phase.flushed(_main(argv, phase))
    except KeyboardInterrupt:
        print(phase, file=sys.stderr)
        return INTERRUPTED


def _main(argv: Sequence[str] | None, phase: Phase) -> int:
    known, unknown = parser().parse_known_args(argv)
    arguments = vars(known)
    if unknown:
        return complain(f"{unknown[0]} is no option of {known.NAME}; see nls-sim {known.NAME} --help")
    name, seed, out = arguments.pop("NAME"), arguments.pop("seed"), arguments.pop("out")
    try:
        if out == "":
            raise OptionError("out", out, "a folder")
        call = command(name, seed, arguments)
        record_file = arguments.get("resume")
        phase.now(f"while running {name}" + (f", finished runs are in {record_file}" if record_file else ""))
        if name in SCENES or name == "compare":
            table, files, description, failed = estimated(name, seed, arguments, out is not None)
        else:
            world = MADE[name][0](np.random.default_rng(seed), **arguments)
            (table, files), description, failed = simulated(world, out), world.description, None
        if out is not None:
            phase.now(f"while writing {out}")
            phase.written += write(out, files, description, aligned(table), call)
            table.append(("written", ", ".join(phase.written)))
        say(aligned(table))
    except OptionError as error:
        wrong = f"{flag(error.option)}: {error.value!r} is not possible; give {error.allowed}"
        return complain(wrong if error.allowed else str(error))
    except OSError as error:
        return phase.unprinted(error)  # every file has an error of its own
    except LeadlineError as error:
        complain(sentence(error))
        return 1 if isinstance(error, FailedRunsError) else 2
    if failed is not None:
        complain(str(failed))
    return 0 if failed is None else 1


def aligned(table: list[tuple[str, str]]) -> str:
    """The table as lines of text."""
    width = max(14, *(len(label) for label, _ in table))
    return "\n".join(f"{label:{width}s}  {text}" for label, text in table)


def write(folder: str, files: Files, description: str, table: str, call: str) -> list[str]:
    """Write files and README.txt into the folder, which is made, all or none; returns their names."""
    from nls.io.files import new_folder, write_folder

    contents, holds = files()
    readme = f"{textwrap.fill(description, 100)}\n\n{table}\n\n{holds}Made by: {call}\n"
    with ExitStack() as folders:  # some files are in folders of their own
        for place in sorted({Path(folder, name).parent for name in contents}):
            folders.enter_context(new_folder(place))
        return write_folder(folder, {**contents, "README.txt": readme.encode()})


def parser() -> Parser:
    """One subcommand a world, its options read off the function: names, types, defaults and the docstring's lines."""
    top = Parser(
        prog="nls-sim",
        description="Simulate a SLAM problem whose answer is known: pose graph, mission, raw log, harbor, rig, scene.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    worlds = top.add_subparsers(dest="NAME", metavar="NAME", required=True, title="worlds", parser_class=Parser)
    for name, (make, written) in MADE.items():
        doc = inspect.getdoc(make) or ""
        summary = re.split(r"\nParameters\n-+\n", doc)[0]
        sub = worlds.add_parser(
            name,
            help=summary.splitlines()[0].replace("%", "%%"),
            description=summary.replace("`", ""),
            epilog=f"example:\n  nls-sim {name} --seed 1 --out {name}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        add_outputs(sub, written)
        add_parameters(sub, make)
        if name in SCENES:
            add_estimators(sub)
    add_compare(worlds)
    return top


def complain(message: str) -> int:
    """One line to stderr; the exit code of a mistake."""
    say(f"nls-sim: {message}", error=True)
    return 2
