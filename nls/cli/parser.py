"""All commands and options of ``nls``."""

import argparse
import sys
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from nls.cli import choices
from nls.cli.outputs import say
from nls.io.formats import dialects, outputs

FILE = (
    "graph file, or folder of a mission, of a scan mission, or with graph.npz or graph.g2o; files may be gzipped; "
    "'-' is standard input"
)
DIVES, START = "folders of further missions there", "initial guess (default: auto)"
ELEVATION = "treatment of the unmeasured elevation of sonar contacts (default: hinge)"
COORDINATES = "coordinates in a solved mission: local (default), utm or EPSG:n, which need origin.csv and pyproj"
VIEW = "write an interactive HTML page with layers and a slider of time; needs the package plotly"
SOLVED_GRAPH = "of a mission: write the graph that was solved, with all landmarks; the suffix says the format"
REJECTING = (
    "gnc-tls or gnc-gm[:PROBABILITY] (0.99) reject wrong loop closures, and wrong contacts of a mission. Of a scan "
    "mission gnc (default), cauchy or none select the matches. "
)
SCALES = (
    "estimate: one scale on the sigmas of each kind of measurement; :units: one for lengths and one for angles; "
    ":components: one for each component (default: stated)"
)
TOLERANCE = "accepted excess of chi2 over its minimum, relative to max(chi2, 1) (default 1e-3)"
ALONE = "turns off the threshold that is not given"
FIRST, EXAMPLES = Path(__file__).with_name("help.txt").read_text(encoding="utf-8").split("\f\n")


class Parser(argparse.ArgumentParser):
    """Says what is wrong with the arguments in one line."""

    words: list[str]

    def error(self, message: str) -> NoReturn:
        if "arguments are required" in message:
            given = [word for word in self.words if word.startswith("--")]
            names = tuple(self._option_string_actions)
            if unknown := [word for word in given if not any(n.startswith(word.partition("=")[0]) for n in names)]:
                self._refuse(unknown)
        say(f"nls: {message}; see '{self.prog} --help'", error=True)
        raise SystemExit(2)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            from models.options import did_you_mean

            error.message += did_you_mean(value, action.choices or ())
            raise

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        self.words = sys.argv[1:] if args is None else list(args)
        options, unknown = super().parse_known_args(self.words, namespace)
        if unknown:
            self._refuse(unknown)
        return options, unknown

    def _refuse(self, unknown: list[str]) -> NoReturn:
        """Refuse words that are no options of this command; says which one is near."""
        from models.options import did_you_mean

        known = [name[2:] for name in self._option_string_actions if name.startswith("--")]
        word = unknown[0].partition("=")[0] if unknown[0].startswith("--") else ""
        near = did_you_mean(word[2:], known).replace("'", "'--", 1)
        self.error(f"unrecognized arguments: {' '.join(unknown)}{near}")


class Once(argparse.Action):
    """An option that is refused where it is given twice: the first would be lost."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, *arguments: Any) -> None:
        value, option = arguments
        if getattr(namespace, self.dest) is not None:
            parser.error(f"{option} is given twice; expected one")
        setattr(namespace, self.dest, value)


def parser() -> Parser:
    """All commands and options."""
    top = Parser("nls", description="Least squares on factor graphs: solve, explain, convert, draw.", epilog=FIRST)
    top.formatter_class, top.usage = argparse.RawDescriptionHelpFormatter, "nls COMMAND FILE [options]"
    top.add_argument("--version", action="store_true", help="print version and linear solvers, and stop")
    commands = top.add_subparsers(prog="nls", title="commands", dest="command", metavar="COMMAND", parser_class=Parser)

    def command(
        name: str, summary: str, module: str = "", function: str = "", reads_graph: bool = True
    ) -> argparse.ArgumentParser:
        own = [
            line for line in EXAMPLES.splitlines() if not line.startswith("  nls ") or line.startswith(f"  nls {name} ")
        ]
        about = f"{summary[0].upper()}{summary[1:]}."
        form, epilog = top.formatter_class, "\n".join(own)
        added = commands.add_parser(name, help=summary, description=about, epilog=epilog, formatter_class=form)
        added.set_defaults(run=partial(_run, module or name, function or name), default_of=added.get_default)
        if reads_graph:
            added.add_argument("file", metavar="FILE", help=FILE)
        return added

    solve = command("solve", "find the optimum")
    add = solve.add_argument
    add("dives", metavar="DIVE", nargs="*", default=[], help=DIVES)
    output = "write the optimum: a file whose suffix says the format, or the folder of a solved mission"
    add("-o", "--output", metavar="OUT.g2o", help=output)
    add("--report", metavar="OUT.html", help="write one HTML page: pictures, findings, covariances")
    add("--plot", metavar="OUT.png", help="draw before and after (png, pdf, svg)")
    add("--view", metavar="OUT.html", help=VIEW)
    add("--covariance", metavar="OUT.csv", help="write the covariance of every variable")
    _json(solve)
    _robust(solve, REJECTING)
    add("--init", default="auto", choices=["auto", *choices.STARTS], help=START)
    proof = "is a pose graph at its global optimum? Proof in the SE-Sync cost; exit with 1 if a better one is found"
    _flag(solve, "--certify", proof)
    how = solve.add_mutually_exclusive_group()
    _flag(how, "--quiet", "print nothing but errors")
    _flag(how, "--verbose", "print every iteration and where the time went")
    _reading(solve).add_argument("--elevation", choices=choices.TREATMENTS, help=ELEVATION)

    more = solve.add_argument_group("how it is solved")
    add = more.add_argument
    add("--method", default="auto", choices=["auto", *choices.OPTIMIZERS], help="optimizer (default: auto)")
    solvers = ["auto", *choices.SOLVERS]
    add("--linear-solver", default="auto", choices=solvers, help="linear solver (default: the best one installed)")
    _hold(more)
    add("--sigmas", default="stated", choices=choices.SIGMAS, help=SCALES)
    add("--gauge", default="first", choices=choices.GAUGES, help="how the gauge is fixed")
    better = "--certify first, and continue from each better optimum it finds"
    _flag(more, "--improve", better)
    add("--max-iterations", type=int, metavar="N", help="at most N iterations (default: 100; 1000 with --method auto)")
    uncertainty = f"converged when an update is below X of its own uncertainty (default: 1e-3); {ALONE}"
    add("--update-sigmas", type=float, metavar="X", help=uncertainty)
    add("--update-tol", type=float, metavar="X", help=f"converged when max|dx| < X (m, rad); {ALONE}")
    decrease = f"converged when an update lowers chi2 by a part below X; {ALONE}"
    add("--chi2-rtol", type=float, metavar="X", help=decrease)
    _flag(more, "--allow-unconverged", "exit with 0 at an iteration limit too")
    _flag(more, "--allow-doubtful", "exit with 0 for a doubtful result too")

    written = _writing(solve)
    written.add_argument("--write-graph", metavar="OUT.npz", help=SOLVED_GRAPH)
    written.add_argument("--crs", metavar="CRS", help=COORDINATES)

    explain = command("explain", "say in plain words what is free, what does not fit, and what helps")
    explain.add_argument("dives", metavar="DIVE", nargs="*", default=[], help=DIVES)
    _json(explain)
    _robust(explain)
    explain.add_argument("--init", default="auto", choices=["auto", *choices.STARTS], help=START)
    _hold(explain)
    _reading(explain).add_argument("--elevation", choices=choices.TREATMENTS, help=ELEVATION)

    info = command("info", "what is in a file", "graphs")
    _json(info)
    _reading(info)

    convert = command("convert", "write a graph in another format", "graphs")
    convert.add_argument("output", metavar="OUT", help="the file to write")
    _writing(convert)
    _reading(convert)

    stream = command("stream", "the optimum at every step, while lines arrive")
    add = stream.add_argument
    add("--tol", type=float, default=1e-3, metavar="X", help=TOLERANCE)
    add("--lag", type=int, metavar="N", help="keep the newest N poses (default: all)")
    landmarks = "with --lag: landmarks leave with the last pose that observed them, or stay (default: leave)"
    add("--landmarks", choices=("leave", "stay"), default="leave", help=landmarks)
    kernel = f"robust kernel on every factor: {', '.join(choices.KERNELS)}"
    add("--robust", action=Once, metavar="KERNEL:SIGMAS", help=kernel)
    state = "file of the state, written every 100 steps; the next run continues from it, with identical results"
    add("--checkpoint", metavar="STATE", help=state)
    _reading(stream, drops=False)  # a variable is made where the first edge names it

    evaluate = command("evaluate", "how far a trajectory is from the true one", reads_graph=False)
    add = evaluate.add_argument
    estimate = "a trajectory: tum, kitti, csv as trajectory.csv, a graph, or the folder of a solution"
    add("file", metavar="ESTIMATE", help=estimate)
    add("truth", metavar="TRUTH", help="the true trajectory: as ESTIMATE, or the folder of a mission")
    move = "move the estimate onto the truth first (default: none); similarity also scales"
    add("--align", default="none", choices=choices.ALIGNMENTS, help=move)
    distances = "distances of the relative errors, m (default: 10,50,100)"
    add("--distances", default="10,50,100", metavar="M,M,...", help=distances)
    gap = "longest gap of the truth to interpolate over, s (default: twice the median time between its rows)"
    add("--tolerance", type=float, metavar="S", help=gap)
    _json(evaluate)

    plot = command("plot", "draw the graph as it was read", "graphs")
    plot.add_argument("output", metavar="OUT.png", help="the picture to write (png, pdf, svg)")
    _reading(plot)

    view = command("view", "write an interactive page of the graph as it was read", "graphs")
    view.add_argument("-o", "--output", metavar="OUT.html", help="the page to write (default: NAME-view.html)")
    _reading(view)

    imports = command("import", "make a mission folder of logs", "logs", "import_logs", reads_graph=False)
    add = imports.add_argument
    add("logs", metavar="LOG", nargs="+", help="text files with columns (also gzipped), bags of ROS")
    meaning = "meaning of the columns; without it a draft is printed"
    add("--map", action=Once, metavar="MAPPING.toml", help=meaning)
    add("-o", "--output", action=Once, metavar="MISSION", help="the folder to write")

    new = command("new", "write templates of a mission", "logs", reads_graph=False)
    new.add_argument("folder", metavar="FOLDER", help="the folder to write; no file in it is overwritten")
    _flag(new, "--map", "write mapping.toml alone")
    for name, added in commands.choices.items():
        words = (f"[{a.metavar} ...]" if a.nargs == "*" else f"{a.metavar}" for a in added._get_positional_actions())
        added.usage = " ".join(["nls", name, *words, "[options]"])
        _flag(added, "--debug", "show the traceback of an error")
    return top


def _reading(command: argparse.ArgumentParser, drops: bool = True) -> argparse._ArgumentGroup:
    """Options of how FILE is read; ``drops``: some of its edges can be left out."""
    group = command.add_argument_group("how FILE is read")
    add = group.add_argument
    add("--dialect", default="auto", choices=dialects(), help="format of FILE (default: auto, by its content)")
    residual = "residual of pose measurements (default: g2o)"
    add("--convention", default="g2o", choices=choices.CONVENTIONS, help=residual)
    ignored = "leave out edges with these unknown tags; other unknown tags are errors"
    add("--ignore-tags", default="", metavar="TAG,TAG", help=ignored)
    if drops:
        _flag(group, "--drop-absent", "leave out edges to vertices without a line")
    _flag(group, "--repair-information", "make negative information semi-definite")
    return group


def _flag(command: argparse._ActionsContainer, name: str, words: str) -> None:
    """An option without a value."""
    command.add_argument(name, action="store_true", help=words)


def _writing(command: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Options of the graph that is written."""
    group = command.add_argument_group("how the output is written")
    group.add_argument("--to", choices=outputs(), help="format of the output (default: by its suffix)")
    _flag(group, "--overwrite", "let OUT replace FILE even if lines are lost, as with gnc-tls or another format")
    _flag(group, "--renumber", "give variables whose numbers clash in OUT new numbers; poses keep theirs")
    return group


def _robust(command: argparse.ArgumentParser, rejecting: str = "") -> None:
    """Kernels, and ways of rejecting measurements."""
    kernels = (
        f"{rejecting}huber:1.0 puts a kernel on every factor, RangeAzimuth=cauchy:1 on one type. Kernels: "
        f"{', '.join(choices.KERNELS)}. Of a mission none keeps all contacts; without --robust wrong ones are rejected "
        "if chi2 and residuals show some"
    )
    command.add_argument("--robust", action=Once, metavar="[TYPE=]KERNEL:SIGMAS", help=kernels)


def _hold(command: argparse._ActionsContainer) -> None:
    command.add_argument("--hold", action="append", default=[], metavar="KIND", help="fix all variables of a kind")


def _json(command: argparse.ArgumentParser) -> None:
    command.add_argument("--json", metavar="REPORT.json", help="write the report for programs ('-': standard output)")


def _run(module: str, function: str, options: argparse.Namespace) -> int:
    """Run a command, which is imported only now: none pays for the others at start-up."""
    return int(getattr(import_module(f"nls.cli.{module}"), function)(options))
