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
    "start": ("try another initial guess", "nls.initialize(graph, values)", "--init"),
    "start at better": ("continue from there", "graph.optimize(certificate.better)", "--improve"),
    "certify": ("check whether there is a lower minimum", "nls.certify(graph, values)", "nls solve --certify"),
    "damp": ("damp the steps", "nls.LevenbergMarquardt()", "--method levenberg-marquardt"),
    "qr": ("keep twice the digits", "linear_solver=nls.QR()", "--linear-solver qr"),
    "truncate": ("damp only the landmarks", "nls.Schur(block_inverse=nls.linear.truncated_inverse)", None),
    "explain": ("see", "nls.explain(graph, values)", "{0}"),
    "written": "written: {0}",
    # what is fixed or added
    "gauge": ("fix one pose of every part", "gauge='first'", "--gauge first"),
    "fix": "fix {0}",
    "prior": "add a prior on {0}",
    "measure": "measure {0}",
    "view": "observe {0} from another place",
    "second place": "observe {0} from a second place to the side",
    "roll": "observe {0} from a pose with another roll, higher or lower",
    "spread ranges": "measure more ranges, from places that are not in one line",
    "move rig": "let the rig move and turn while it observes the same points",
    "guess": "give a guess and leave calibrate out",
    "off axis": "observe a point that is not on that axis, or measure the attitude",
    "tighten": "tighten the prior there",
    "relative": "check whether {0} may be declared relative: as it is, no pose is fixed as the gauge",
    "distance": "measure one distance, or fix a second variable: directions alone do not determine the scale",
    "aperture": ("use the aperture of the sonar", "an Elevation prior, or ElevationHinge", "--elevation prior"),
    "join": "add a measurement between the parts",
    "split": "solve every part by itself",
    "factors": "add the factors that are missing",
    "drop": "leave {0} out of the values",
    "close": "add a loop closure, or another measurement of the same quantity",
    "second sensor": "measure the same quantity with a second sensor",
    # measurements
    "odometry": "connect the sessions by odometry",
    "robust": ("use a robust kernel", "graph.robust({0}({1}))", "--robust {2}:{1}"),
    "wider kernel": "use a wider kernel",
    "gentle kernel": "use a kernel whose weight never reaches zero, such as Cauchy",
    "gnc": ("find wrong loop closures", "nls.gnc(graph, values)", "nls solve --robust gnc-tls"),
    "judge all": ("test all measurements from the given values", "preselect=False", None),
    "doubt": ("name the factors to test", "doubted=[...]", None),
    "inspect": "look at {0}",
    "remove": "remove {0}",
    "remove copies": "remove copies: each counts again, and the covariances come out too small",
    "leave out": "leave out {0}, which came with this update",
    "take out": ("remove an earlier measurement", "smoother.remove(factor) of {0}", None),
    "remove all": "or remove all measurements of {0} at once: a variable is removed with its last one",
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
    "merge": "merge them if they are the same: give both one number",
    "wrap": ("wrap the difference of the angles", "models.algebra.wrap(z - h)", ""),
    "larger sigma": "give it a larger sigma",
    "smaller sigma": "give it a smaller sigma",
    "compare sigmas": "compare the sigmas with those of the other rows",
    "larger sigmas": "take larger sigmas",
    "smaller sigmas": (
        "take smaller sigmas, if the measurements are real",
        "nls.variance_components(graph, values)",
        "nls solve --sigmas estimate",
    ),
    "squares": ("check for mixed-up sigmas, variances and informations", "Isotropic and Diagonal take sigmas", ""),
    "units": "check sigmas and units",
    "frames": "check signs, units and frames, and the order of the information matrix",
    # files
    "dialect": ("name the dialect", "dialect=...", "--dialect"),
    "info": "see which sigmas each dialect gives: nls info --dialect NAME FILE",
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
        "nls evaluate has no such option: convert the file with it, and compare the result",
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
