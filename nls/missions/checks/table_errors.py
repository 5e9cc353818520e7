r"""Errors of whole tables: a clock that is late or fast, an arm, a scale, a turn. Which are evident, which hidden?

An error nabla of all rows of a table is C nabla in their whitened residuals b. The optimum takes up a part of it. By
the rest chi2 grows by nabla'M nabla. Without a number that was measured so,

    nabla = C'b / M,    fall of chi2 = (C'b)^2 / M,    M = C'(I - A (A'A)^-1 A') C

The fall is the square of Baarda's w. Where it is more than `EVIDENT` times what is left per degree of freedom, and the
track moves by more than its own standard deviation, the error is evident. A smaller one is hidden,

    |nabla| < (sqrt(EVIDENT) + SURE) / sqrt(M)

A row measured c before its time has z(t - c), so C = -W dz/dt. Of a clock that runs fast by r since the first pose,
c is r (t - t_0). The walk of motion.csv measures nothing: its rows hardly count, and nothing is evident.

Source: W. Baarda, "A testing procedure for use in geodetic networks", 1968: w-test, internal and external reliability.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from factors import Heading, Position
from factors.shifted import Shifted
from factors.xyh import HorizontalStep
from models.algebra import Array, apply
from models.manifolds.so3 import rotation3
from nls.gauge import choose_gauge, fixed_variables, touched_variables
from nls.graph import FactorGraph
from nls.linear import factorize
from nls.linear.factorization import SingularSystemError
from nls.missions.checks.findings import Cause, Reading, TableError
from nls.missions.folder.calibration import NAMES
from nls.missions.folder.folder import MissionReport
from nls.missions.folder.timeline import CLOCKED, rates_by_time, total, twists
from nls.sparse.pattern import Batch, Pattern
from nls.sparse.threads import single_thread
from nls.system import LinearSystem
from nls.values import Values

EVIDENT = 25.0  # fall of chi2 per its ratio: a chance of 1e-5 for a dozen errors
SURE = 2.0  # standard deviations of the root of the fall: 98 of 100 errors of the hidden size are evident
HIDDEN = {"heading": 0.2, "depth": 1.0, "zero of the depth": 2.0, "scale": 0.02, "place": 10.0}  # sizes that matter
HIDDEN |= {"clock": 1.0, "arm": 5.0}
LARGEST_BELOW = {"heading": 1.0, "depth": 1.0, "clock": 3600.0, "arm": 100.0}  # beyond it any is: a turn is not linear
LARGEST_SIZE = {"clock": 60.0, "drift": 0.1, "arm": 30.0, "scale": 0.3}  # beyond it another mistake is likelier
ARMS = {"fixes.csv": ("arm_x_m", "arm_y_m"), "dvl.csv": ("x_m", "y_m")}


@single_thread()
def table_errors(graph: FactorGraph, values: Values, chi2: float, dof: int, report: MissionReport) -> list[TableError]:
    """The errors of whole tables that are evident, and those that would be hidden; none where something is free.

    Parameters
    ----------
    graph, values, chi2, dof : of a mission, its optimum.
    report : of its folder.
    """
    whole = graph.pattern(values)
    fixed = fixed_variables(graph.fixed, values) | ~touched_variables(whole)
    pattern = whole.holding(choose_gauge("first", whole, values, fixed).held)
    linear = LinearSystem.at(pattern, values)
    files = [file.removesuffix(".gz") for file in report.tables]
    walked = [file.endswith("motion.csv") for file in files]
    light = [1e-3 if walk else 1.0 for walk in walked]  # part of the weight of a random walk, so that no pose is free
    blocks = [tuple(part * A for A in of) for of, part in zip(linear.blocks, light, strict=False)]
    system = LinearSystem(pattern, [*blocks, *linear.blocks[len(blocks) :]], linear.b)
    sampled = np.linspace(0, len(values.stack("x")) - 1, 6).astype(int)
    at = pattern.starts[pattern.offsets["x"] + sampled]
    places = (at[at >= 0, None] + np.arange(3)).ravel()
    errors = _columns(pattern, values, report, files) if len(places) else {}
    if not errors:
        return []
    unit = np.zeros((pattern.n, len(places)))
    unit[places, np.arange(len(places))] = 1.0
    try:
        factor = factorize(system)
        variance = float(np.trace(factor.solve(unit)[places]))
    except SingularSystemError:
        return []
    times, out = report.vertex_times.get("x", np.zeros(1)), []
    for (file, quantity), C in errors.items():
        taken = factor.solve(system.A.T @ C)
        left, moved = C - system.A @ taken, taken[places]  # by one unit of the error
        M, largest = left.T @ left, float(np.linalg.eigvalsh(C.T @ C).max())
        least = HIDDEN.get(quantity, np.inf)
        if not np.linalg.eigvalsh(M).min() > 1e-9 * largest:
            checked = quantity == "scale" and not {"gyro.csv", "pressure.csv"} & {*files}  # by the way down
            out.append(TableError(file, quantity, np.inf, hidden=least < np.inf and not checked))
            continue
        size, far = left.T @ linear.b / np.diag(M), np.sqrt(np.sum(moved**2, axis=0) / variance)
        fall = size**2 * np.diag(M)
        j = int(np.argmax(fall))
        ratio = max(1.0, float(chi2 - fall[j]) / max(dof, 1))
        below = float((np.sqrt(EVIDENT) + SURE) * np.sqrt(ratio) / _root_of_fall(M))
        hidden = bool(below > least and below * far.max() > 1)
        below = below if below < LARGEST_BELOW.get(quantity, np.inf) else np.inf
        entry = TableError(file, quantity, below, hidden=hidden)
        if not any(walked) and (reading := _reading(file, quantity, j, float(size[j]), float(times.min()))):
            evident = bool(fall[j] > EVIDENT * ratio and abs(size[j]) * far[j] > 1)
            entry = replace(entry, reading=reading, sigma=float(M[j, j] ** -0.5), fall=float(fall[j]), evident=evident)
        out.append(entry)
    wholly = {error.file for error in out if error.quantity == "depth" and error.hidden}
    return [error for error in out if error.quantity != "zero of the depth" or error.file not in wholly]


def _root_of_fall(M: Array) -> float:
    """The least root of the fall by an error of size 1, of one number or of two whose direction is not known."""
    angle = np.linspace(0.0, np.pi, 36 if len(M) > 1 else 1)
    u = np.stack([np.cos(angle), np.sin(angle)][: len(M)])
    return float((np.abs(M @ u) / np.sqrt(np.diag(M))[:, None]).max(axis=0).min())


def _columns(
    pattern: Pattern, values: Values, report: MissionReport, files: Sequence[str]
) -> dict[tuple[str, str], Array]:
    """C (m, k) of what may be wrong with a table, by its file and quantity; factors are from files."""
    errors: dict[tuple[str, str], Array] = {}
    t = report.vertex_times.get("x")
    t = None if t is None or not (np.diff(t) > 0).all() else t
    moving = {} if t is None else _moving(pattern, values, t)
    tags = {tag.removesuffix(".gz") for tag in report.tags}
    for batch, source, file in zip(pattern.batches, report.sources, files, strict=False):
        if file.endswith("motion.csv") or batch.model.factor.limit_only or len(batch) == 1 or not source.lines.any():
            continue
        weights = np.sqrt(batch.model.factor.weights(values))[:, None, None]
        for name, quantity, C in _errors(batch, values, t, moving, tags, file):
            rows = errors.setdefault((name, quantity), np.zeros((pattern.m, C.shape[2])))
            rows[batch.rows] += (weights * C).reshape(-1, C.shape[2])
    return errors


def _reading(file: str, quantity: str, component: int, size: float, since: float) -> Reading | None:
    """The name of an error of this size; a clock runs fast since a time."""
    table = file.rpartition("/")[2].removesuffix(".csv")
    if not abs(size) < LARGEST_SIZE.get(quantity, np.inf):
        return None
    if quantity == "heading drift":
        return Reading(Cause.DRIFT, file, "yaw_rad", size)
    if quantity == "clock" and f"{table}_clock_s" not in NAMES:
        return Reading(Cause.CLOCK, file, "time_s", size)
    if quantity == "drift":
        return Reading(Cause.DRIFT, file, "time_s", size, size / (1 + size) * since)
    if quantity == "arm":
        return Reading(Cause.ARM, "dvl_mount.csv" if table == "dvl" else file, ARMS[f"{table}.csv"][component], size)
    if quantity == "scale" and table == "depth":
        return Reading(Cause.SCALE, file, "z_m", 1 + size)
    names = {"clock": f"{table}_clock_s", "scale": "dvl_scale", "turn": "dvl_yaw_rad", "heading": "declination_rad"}
    if quantity not in names:
        return None
    size = -size if quantity in ("turn", "heading") else size
    return Reading(Cause.CALIBRATION, "calibration.csv", names[quantity], size)


def _errors(
    batch: Batch, values: Values, t: Array | None, moving: dict[str, Array], tags: set[str], file: str
) -> Iterator[tuple[str, str, Array]]:
    """The errors that all measurements of a factor may share: file, name, and C (n, m, k) of k numbers."""
    factor, W, name = batch.model.factor, batch.model.W, file.rpartition("/")[2]
    table = name.removesuffix(".csv")
    known = any(keys.kind == f"{table}_clock_s" for keys in factor.keys)  # a variable
    while isinstance(factor, Shifted):
        factor = factor.factor
    W = W if W.ndim == 3 else W[:, :, None] * np.eye(W.shape[1])
    W = np.broadcast_to(W, (len(batch), *W.shape[1:]))
    X = values.stack("x")
    poses = [X.index(keys) for keys in factor.keys if keys.kind == "x"]
    if not poses:
        return
    at = poses[0]
    if isinstance(factor, HorizontalStep) and name == "dvl.csv" and t is not None:
        yield from _of_legs(W, factor.z, t[at], t[poses[1]])
    elif (tilts := factor.tilts(batch.model)) is not None:
        z, w = tilts[:, :1], W[:, :, :1]
        yield file, "zero of the depth", w
        if file.replace(name, "dvl.csv") not in tags:
            yield file, "depth", w * (z - z.mean())[:, :, None]
            return
        yield file, "scale", w * z[:, :, None]
        if t is not None:
            yield from _late(file, -w[:, :, 0] * np.gradient(z[:, 0], t[at])[:, None], t[at], t[0])
    elif isinstance(factor, Heading):
        yield file, "heading", W[:, :, :1]
        if t is not None:
            yield file, "heading drift", W[:, :, :1] * (t[at] - t[0])[:, None, None]
        if t is not None and "motion.csv" not in tags and not known:
            yield from _late(file, -W[:, :, 0] * np.gradient(np.unwrap(factor.z[:, 0]), t[at])[:, None], t[at], t[0])
    elif isinstance(factor, Position):
        yield file, "place", W[:, :, :2]
        if np.any(factor.offset):
            yield file, "arm", -W[:, :, :2] @ rotation3(X.X[at, 3:])[:, :2, :2]
    if table in CLOCKED and t is not None and not known:
        by_kind = rates_by_time(factor, values, moving)
        yield from _late(file, -apply(W, total(by_kind)), t[at], t[0])
        if "s" in by_kind:  # the clock of the ship
            yield from _late("ship.csv", apply(W, by_kind["s"]), t[at], t[0])


def _of_legs(W: Array, z: Array, t_i: Array, t_j: Array) -> Iterator[tuple[str, str, Array]]:
    """Of legs (n, 3) between times: a DVL that is late, runs fast, or is elsewhere on the vehicle."""
    v, middle = z[:, :2] / (t_j - t_i)[:, None], (t_i + t_j) / 2
    begin, end = (np.column_stack([np.interp(t, middle, axis) for axis in v.T]) for t in (t_i, t_j))
    yield from _late("dvl.csv", apply(W[:, :, :2], begin - end), middle, t_i[0])
    yield "dvl.csv", "scale", apply(W[:, :, :2], z[:, :2])[:, :, None]
    yield "dvl.csv", "turn", (W[:, :, :2] @ np.stack([-z[:, 1], z[:, 0]], axis=1)[:, :, None])
    c, s = np.cos(z[:, 2]) - 1, np.sin(z[:, 2])
    yield "dvl.csv", "arm", -W[:, :, :2] @ np.moveaxis(np.array([[c, -s], [s, c]]), -1, 0)


def _late(file: str, late: Array, t: Array, first: float) -> Iterator[tuple[str, str, Array]]:
    """Of rows at times (n,) that are late, or run fast since the first pose, with whitened rates (n, m)."""
    yield file, "clock", late[:, :, None]
    yield file, "drift", (late * (t - first)[:, None])[:, :, None]


def _moving(pattern: Pattern, values: Values, t: Array) -> dict[str, Array]:
    """Twists (k, 6) of the vehicle, whose poses are at times (n,), and of a ship whose poses all see it at a time."""
    out = {"x": twists(values.stack("x").X, t)}
    times = np.full(len(values.stacks.get("s", ())), np.nan)
    for batch in pattern.batches:
        keys = {keys.kind: keys for keys in batch.model.factor.keys}
        if {"x", "s"} <= keys.keys():
            times[values.stack("s").index(keys["s"])] = t[values.stack("x").index(keys["x"])]
    return out | ({"s": twists(values.stack("s").X, times)} if len(times) and np.isfinite(times).all() else {})
