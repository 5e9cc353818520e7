"""A cure as a value: an action and its object. Python and the command line write some of them differently.

Errors, results and findings carry advice; whoever shows them says in which of the two ways.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import NamedTuple

__all__ = ["ACTIONS", "Advice", "listed"]

# An action is a text that both share, or (purpose, how Python writes it, how the command line does); None: it cannot.
# Braces stand for what the action is about.
ACTIONS: dict[str, str | tuple[str, str | None, str | None]] = {
    # the way to an optimum
    "solve": ("solve first", "nls.explain(graph, graph.optimize(values).values)", "more --max-iterations"),
    "start": ("try another start", "nls.initialize(graph, values)", "--init"),
    "start at better": ("go on from there", "graph.optimize(certificate.better)", "--improve"),
    "certify": ("prove whether there is a lower minimum", "nls.certify(graph, values)", "nls solve --certify"),
    "damp": ("damp the steps", "nls.LevenbergMarquardt()", "--method levenberg-marquardt"),
    "qr": ("keep twice the digits", "linear_solver=nls.QR()", "--linear-solver qr"),
    "truncate": ("damp landmarks alone", "nls.Schur(block_inverse=nls.linear.truncated_inverse)", None),
    "explain": ("see", "nls.explain(graph, values)", "{0}"),
    "written": "written: {0}",
    # what is held or added
    "gauge": ("hold one pose of every part", "gauge='first'", "--gauge first"),
    "fix": "fix {0}",
    "prior": "add a prior on {0}",
    "measure": "measure {0}",
    "view": "see {0} from another place",
    "second place": "see {0} from a second place to the side",
    "roll": "see {0} from a pose with another roll, higher or lower",
    "spread ranges": "measure more ranges, from places that are not in one line",
    "move rig": "let the rig move and turn while it sees the same points",
    "guess": "give a guess and leave calibrate out",
    "off axis": "see a point that is not on that axis, or measure the attitude",
    "tighten": "tighten the prior there",
    "relative": "see whether {0}, which keeps the gauge from being held, may be declared relative",
    "distance": "measure one distance, or fix a second variable: directions alone say nothing of the size",
    "aperture": ("use the aperture of the sonar", "an Elevation prior, or ElevationHinge", "--elevation prior"),
    "join": "add a measurement between the parts",
    "split": "solve every part by itself",
    "factors": "add the factors that are missing",
    "drop": "leave {0} out of the values",
    "close": "add a loop closure, or another measurement of the same",
    "second sensor": "measure the same with a second sensor",
    # measurements
    "odometry": "join the sessions by odometry",
    "robust": ("use a robust kernel", "graph.robust({0}({1}))", "--robust {2}:{1}"),
    "wider kernel": "use a wider kernel",
    "gentle kernel": "use a kernel that never forgets, such as Cauchy",
    "gnc": ("find wrong loop closures", "nls.gnc(graph, values)", "nls solve --robust gnc-tls"),
    "judge all": ("judge all measurements from the values given", "preselect=False", None),
    "doubt": ("name the factors to judge", "doubted=[...]", None),
    "inspect": "look at {0}",
    "remove": "remove {0}",
    "remove copies": "remove copies: each counts again, and the covariances come out too small",
    "leave out": "leave out {0}, which came with this update",
    "take out": ("take out what was given before", "smoother.remove(factor) of {0}", None),
    "remove all": "or remove all measurements of {0} at once: a variable leaves with its last one",
    "swap": "exchange the two variables",
    "transpose": "transpose its rotation",
    "mirror": "change the sign of its angle",
    "flip": "exchange or flip its axes: another frame",
    "exchange": "exchange {0} and {1} in these sightings",
    "clock": "shift the times of these measurements",
    "calibrate mounting": (
        "measure the mounting of the sensor on the vehicle again, or estimate it",
        "factor.mounted(o[0]) with a Prior on o[0]",
        "",
    ),
    "calibrate odometry": ("calibrate the odometry, or estimate its error", "factors.Shifted", ""),
    "merge": "give both one number, if they are the same",
    "wrap": ("wrap the difference of the angles", "models.algebra.wrap(z - h)", ""),
    "larger sigma": "give it a larger sigma",
    "smaller sigma": "give it a smaller sigma",
    "compare sigmas": "compare the sigmas with those of the other rows",
    "larger sigmas": "take larger sigmas",
    "smaller sigmas": "take smaller sigmas, if the measurements are real",
    "squares": ("check for sigmas, variances and informations mixed up", "Isotropic and Diagonal take sigmas", ""),
    "units": "check sigmas and units",
    "frames": "check signs, units and frames, and the order of the information matrix",
    # files
    "dialect": ("name the dialect", "dialect=...", "--dialect"),
    "info": "see the sigmas that a dialect would mean: nls info --dialect NAME FILE",
    "read file": "read the file in it: {0}",
    "mission": "give the folder, if the table belongs to a mission",
    "import": "make a mission of a log: nls import {0} prints a mapping to start from; nls import --help",
    "template": "see the tables of a mission: nls new FOLDER writes a template of each",
    "map column": 'or let a mapping name the column of the log: [{0}] {1} = "{2}"; nls import --help',
    "renumber": (
        "give the variables whose numbers clash new numbers",
        "nls.save(..., renumber=True)",
        "--renumber",
    ),
    "native": "write a file that ends in .npz or .json, which holds every graph with its names",
    "table": "write a file that ends in .csv, a table of all variables with their names",
    "one kind": (
        "write one kind a file",
        'nls.save("{0}.{1}", nls.FactorGraph(), nls.Values.of([values.stack("{0}")]))',
        None,
    ),
    "register": "write a factor class and name it with nls.io.register: files that end in .npz and .json then hold it",
    "range line": "write a file that ends in {0}, which has a line for a range",
    "ignore tags": ("leave these lines out", "ignore_tags={1}", "--ignore-tags {0}"),
    "drop absent": ("leave such edges out", "drop_absent=True", "--drop-absent"),
    "convert first": (
        "nls evaluate has no such option: compare what nls convert writes with it",
        None,
        "nls convert {0} OUT.npz",
    ),
    "repair": ("take the nearest matrix", "repair_information=True", "--repair-information"),
}


class Advice(NamedTuple):
    """One thing to do.

    Parameters
    ----------
    action : one of `ACTIONS`.
    about : its object.

    Examples
    --------
    >>> kernel = Advice.robust("Cauchy", 1)
    >>> kernel.words(), kernel.words(shell=True)
    ('use a robust kernel: graph.robust(Cauchy(1))', 'use a robust kernel: --robust cauchy:1')
    """

    action: str
    about: tuple[str, ...] = ()

    @classmethod
    def robust(cls, kernel: str, width: float) -> Advice:
        """A robust kernel on all measurements."""
        return cls("robust", (kernel, f"{width:g}", kernel.lower()))

    def repeats(self, in_use: Collection[str]) -> bool:
        """Whether the advice asks for an option in use, as Python or the command line writes it."""
        return any(self.words(shell).endswith(f": {option}") for option in in_use for shell in (False, True))

    def words(self, shell: bool = False) -> str:
        """The purpose and how it is written, in Python or on the command line; empty where it cannot be."""
        action = ACTIONS[self.action]
        if isinstance(action, str):
            return action.format(*self.about)
        form = action[2 if shell else 1]
        return "" if form is None else ": ".join(filter(None, (action[0], form))).format(*self.about)

    def __str__(self) -> str:
        return self.words()


def listed(advice: Iterable[Advice], shell: bool = False) -> list[str]:
    """The words of all that can be written, one a line."""
    return [words for words in (piece.words(shell) for piece in advice) if words]
