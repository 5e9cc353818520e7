r"""Which one constant explains chi2 of a mission? The solver tries each of them, and then a kernel for one table.

A calibration of calibration.csv is a variable c with a wide prior, which is solved again where it came out:

    c_0 = each begin,    c_k+1 = argmin chi2(X, c; linear about c_k)

Angles begin at quarter turns, clocks at several lags. Other readings of columns (`readings`) are ranked by chi2 of
their dead reckoning, and the best are solved. So is each error of a whole table (`table_errors`) that explains chi2.
The rows that the track covers may become more with a clock and never fewer. Constants explain chi2 by the rule of
`nls.analysis.calibrations`. All that the data do not distinguish are found.

Where no constant explains, a Cauchy kernel is tried on one type of measurement at a time. That is the cure where it
ignores few of them and noise explains all others. Last, sigmas of one table may be too small: variance components scale
it alone, and its residuals are white and normal then.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from factors.keys import Kind
from factors.robust import Cauchy
from models.errors import EvaluationError, GraphFileError, SingularGeometryError
from nls.analysis.alternatives import HALF_CHI2, REFUSED, Fit, expected, nearest, solved
from nls.analysis.calibrations import explains
from nls.analysis.variance_components import variance_components
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.missions.checks.alone import ROBUST
from nls.missions.checks.findings import Cause, Explained, Implausible, Reading, TableError, Trial
from nls.missions.checks.log import Alternative, corrected, readings
from nls.missions.contacts.associate import associated
from nls.missions.determination import LEFT
from nls.missions.folder.calibration import NAMES, wide
from nls.missions.folder.columns import COLUMNS, GEODETIC
from nls.missions.folder.folder import MissionReport, report_of
from nls.missions.folder.read import graph_of
from nls.missions.folder.table import Table, csv_text
from nls.missions.folder.timeline import TIMED
from nls.optimizers.result import TWICE
from nls.stages import announce
from nls.system import LinearSystem
from nls.values import Values

Tables = dict[str, Table]
BEGINS = {  # of a constant, by the end of its name
    "_rad": (0.0, np.pi / 2, -np.pi / 2, np.pi),
    "_s": (0.0, 12.0, -12.0),
    "_scale": (0.0,),
}
LATER = {Cause.UNKNOWN, Cause.OUTLIERS, Cause.CLOCK, Cause.NORTH, Cause.AXES, Cause.EARTH, Cause.SWAPPED, Cause.SIGN}
MOST_ROWS = 2000  # of a table with which all are tried; those that explain it are solved with all rows
SETTLED = 1e-5  # part by which the last solution of one constant moves, or a dead reckoning differs
ROUGH = 1.4  # scale of sigmas that are too small


def explained(
    tables: Tables, chi2: float, dof: int, errors: Sequence[TableError] = (), elevation: str = "hinge"
) -> Explained:
    """The constants that explain chi2 of a mission, else the one table that a kernel cures, or whose sigmas are small.

    Parameters
    ----------
    tables : of the mission, as `nls.missions.folder.folder.read_tables` has them.
    chi2, dof : of its optimum.
    errors : of whole tables, of which one is evident where chi2 alone is plausible. No other constants are tried then.
    elevation : as of `nls.missions.folder.read.read_mission`.

    Raises
    ------
    GraphFileError
        The tables as they are cannot be read.
    """
    own = tables["calibration"].text_of("name") if "calibration" in tables else []
    linear = [
        Trial(e.reading, e.sigma, chi2 - e.fall, dof) for e in errors if e.reading and e.reading.column not in own
    ]
    if chi2 <= TWICE * dof:
        return Explained(chi2, dof, tuple(sorted(nearest(linear), key=_is_drift)))
    center = Table("dvl_mount.csv", COLUMNS["dvl_mount"], data=csv_text(COLUMNS["dvl_mount"], np.zeros((1, 6))))
    tables = ({"dvl_mount": center} if "dvl" in tables else {}) | tables
    whole = _mission(tables, elevation, chi2, dof)
    steps = {name: -(-len(tables[name]) // MOST_ROWS) if name in TIMED else 1 for name in tables}
    few = {name: table.part(slice(None, None, steps[name])) for name, table in tables.items()}
    thinned = max(steps.values()) > 1
    mission = _mission(few, elevation) if thinned else whole
    trials = [] if expected(mission) else [*_calibrations(mission), *_tried(mission, readings(mission.tables))]
    if thinned:
        trials = [trial for earlier in _best(mission, trials) for trial in _again(whole, earlier)]
    for near in (t for t in linear if t.reading.cause is not Cause.CALIBRATION and explains(t, chi2, dof)):
        drifts = near.reading.column == "yaw_rad"  # by the time, and not by its number
        trials += [near] if drifts else _tried(whole, [corrected(near.reading)], near.sigma)
    return Explained(chi2, dof, tuple(_best(whole, trials) or [*_kernels(whole)] or _sigmas(whole)))


def worth_trying(findings: Sequence[Implausible]) -> bool:
    """Whether the solver may tell more than the findings of the tables: none is of special values or units."""
    return all(reading.cause in LATER for finding in findings for reading in finding.readings)


@dataclass(frozen=True)
class Mission:
    """Tables as they are, their graph and dead reckoning, chi2 of that as a limit, chi2 and dof of their optimum."""

    tables: Tables
    elevation: str
    graph: FactorGraph
    start: Values
    report: MissionReport
    limit: float
    chi2: float
    dof: int

    def optima(self, others: Sequence[Tables], most: int, anywhere: bool = False) -> Iterator[tuple[int, Fit]]:
        """The optima of other tables, by number; only of those, so many, whose dead reckoning fits best.

        As many rows count as here. Begun anywhere, dead reckoning may fit worse than here.
        """
        begun = []
        for number, tables in enumerate(others):
            try:
                graph, start, _ = _read(tables, self.elevation)
                begun.append((graph.chi2(start), number, graph, start))
            except (GraphFileError, EvaluationError, SingularGeometryError):  # which are refused are no answer
                continue
        for chi2, number, graph, start in sorted(begun, key=itemgetter(0))[:most]:
            if chi2 <= self.limit or anywhere:
                fit = brief(graph, start)
                if fit is not None and fit.dof >= self.dof:
                    yield number, fit


def brief(graph: FactorGraph, start: Values) -> Fit | None:
    """A brief solution, from a dead reckoning that is near where the reading is right."""
    return solved(graph, start, start=False, iterations=8)


def _mission(tables: Tables, elevation: str, chi2: float = 0.0, dof: int = 0) -> Mission:
    """A mission with chi2 and dof as given, or as solved."""
    graph, start, report = _read(tables, elevation)
    if not dof and (fit := brief(graph, start)) is not None:
        chi2, dof = fit.chi2, fit.dof
    try:
        limit = graph.chi2(start) * (1 + SETTLED)
    except (EvaluationError, SingularGeometryError):  # dead reckoning ends where a bearing has none
        limit = np.inf
    return Mission(tables, elevation, graph, start, report, limit, chi2, dof)


def _read(tables: Tables, elevation: str) -> tuple[FactorGraph, Values, MissionReport]:
    report = report_of(next(iter(tables.values())).path, tables)
    return associated(*graph_of(tables, report, elevation), report)


def _best(mission: Mission, trials: list[Trial]) -> list[Trial]:
    """Trials of least chi2 that the data do not distinguish; a wrong place on the Earth is no accident."""
    alike = {t.reading for t in nearest([replace(t, chi2=t.chi2 - t.dof + mission.dof) for t in trials])}
    place = {t.reading: t.reading.column.startswith(GEODETIC) for t in trials}
    ordered = sorted(trials, key=lambda t: (not place[t.reading], _is_drift(t), t.chi2 - t.dof))
    return [trial for trial in ordered if trial.reading in alike]


def _is_drift(trial: Trial) -> bool:
    """Whether a trial is of a clock that runs fast, which is rarer than one that is late."""
    return trial.reading.cause is Cause.DRIFT


def _again(mission: Mission, trial: Trial) -> Iterator[Trial]:
    """A trial of fewer rows with all of them."""
    if trial.reading.cause is Cause.CALIBRATION:
        yield from _calibration(mission, trial.reading.column, (trial.reading.factor,))
    else:
        yield from _tried(mission, [a for a in readings(mission.tables) if a.reading == trial.reading])


def _calibrations(mission: Mission) -> Iterator[Trial]:
    table = mission.tables.get("calibration")
    for name in NAMES:
        of = "ranges" if name == "sound_speed_scale" else name.partition("_")[0]
        if (table is None or name not in table.text_of("name")) and (of == "declination" or of in mission.tables):
            yield from _calibration(mission, name)


def _calibration(mission: Mission, name: str, begins: tuple[float, ...] = ()) -> Iterator[Trial]:
    announce(f"trying {name}")
    usual, prior = next(begins for end, begins in BEGINS.items() if name.endswith(end)), wide(name)

    def at(*values: float, anywhere: bool = False) -> list[tuple[Fit, float]]:
        tables = [mission.tables | {"calibration": _with_row(mission.tables, name, c, prior)} for c in values]
        return [(fit, values[k]) for k, fit in mission.optima(tables, len(tables), anywhere)]

    fit, value = min(at(*(begins or usual)), key=lambda pair: pair[0].chi2, default=(None, 0.0))
    if fit is None or fit.chi2 > HALF_CHI2 * mission.chi2:
        return
    for _ in range(6):
        before, value = value, float(fit.values[Kind(name)[0]][0])
        if abs(value - before) < SETTLED * prior or not (again := at(value, anywhere=True)):
            break
        fit = again[0][0]
    if not explains(fit, mission.chi2, mission.dof):
        return
    marginals = Marginals(fit.graph, fit.values)
    if marginals.status(Kind(name))[0] != "estimated":
        return
    sigma = float(np.sqrt(marginals.covariance(Kind(name)[0])[0, 0]))
    if sigma < LEFT * prior:  # else nothing measures it
        yield Trial(Reading(Cause.CALIBRATION, "calibration.csv", name, value), sigma, fit.chi2, fit.dof)


def _with_row(tables: Tables, name: str, value: float, sigma: float) -> Table:
    """calibration.csv with one more row."""
    old = tables.get("calibration")
    names = old.text_of("name") if old else []
    numbers = old.floats("value", "sigma") if old else np.zeros((0, 2))
    data = csv_text(COLUMNS["calibration"], [*names, name], np.vstack([numbers, [value, sigma]]))
    return Table("calibration.csv", COLUMNS["calibration"], data=data)


def _tried(mission: Mission, alternatives: Sequence[Alternative], sigma: float = 0.0) -> Iterator[Trial]:
    """Trials of the readings of a mission's tables whose factor has a standard deviation, where they explain chi2."""
    others = [(a, tables) for a in alternatives if (tables := a.on_tables(mission.tables))]
    announce("trying other readings")
    for number, fit in mission.optima([tables for _, tables in others], 6):  # whose dead reckoning fits best
        if explains(fit, mission.chi2, mission.dof):
            yield Trial(others[number][0].reading, sigma, fit.chi2, fit.dof)


def _kernels(mission: Mission) -> Iterator[Trial]:
    """The tables of which a kernel ignores few rows, and noise explains the rest."""
    graph = mission.graph
    for name, file in _files(mission).items():
        announce(f"trying a kernel for {file}")
        robust = [f.robust(Cauchy(1.0)) if f.name == name else f for f in graph.factors]
        fit = solved(FactorGraph(robust, graph.fixed), mission.start, start=False)
        if fit is None:
            continue
        kept = [(factor, factor.weights(fit.values) > 0.1) for factor in robust]  # of others the kernel ignores
        rest = sum(float(f.chi2(fit.values)[rows].sum()) for f, rows in kept)
        lost = [(f, int((~rows).sum())) for f, rows in kept if f.name == name]
        share = sum(count for _, count in lost) / sum(len(f) for f, _ in lost)
        dof = fit.dof - sum(count * fit.values.gather(f)[0].space.dim for f, count in lost)
        trial = Trial(Reading(Cause.KERNEL, file, name, share), 0.0, rest, dof)
        if share <= 0.25 and expected(trial):
            yield trial


def _files(mission: Mission) -> dict[str, str]:
    """The file of every type of measurement; not of contacts, which are tested one by one."""
    files = {f"{name}.csv" for name in TIMED if name != "contacts"}
    files_of = [file.removesuffix(".gz") for file in mission.report.tables]
    pairs = zip(mission.graph.factors, files_of, strict=True)
    return {factor.name: file for factor, file in pairs if file in files}


def _sigmas(mission: Mission) -> list[Trial]:
    """The one table whose sigmas are too small: its residuals are white, and all others as large as stated."""
    announce("trying sigmas")
    try:
        scaled = variance_components(mission.graph, mission.start)
    except REFUSED:
        return []
    large = [c for c in scaled.components if c.known and c.scale - 2 * c.sigma > ROUGH]
    files = _files(mission)
    if len(large) != 1 or large[0].name not in files:
        return []
    (name, file), scale = (large[0].name, files[large[0].name]), large[0].scale
    columns = [c for c in mission.tables[file.removesuffix(".csv")].names if c.startswith("sigma_")]
    pattern = scaled.graph.pattern(scaled.result.values)
    b = LinearSystem.at(pattern, scaled.result.values).b
    e = np.concatenate([b[k.rows].reshape(len(k), -1) for k in pattern.batches if k.model.factor.name == name])
    white = np.abs(np.sum(e[1:] * e[:-1])) < 0.4 * np.sum(e**2)
    if not (columns and white and ROBUST * np.median(np.abs(e)) > 1 / ROUGH):
        return []
    reading = Reading(Cause.SIGMA, file, ", ".join(columns), scale)
    return [Trial(reading, large[0].sigma, scaled.result.chi2_final, scaled.result.dof)]
