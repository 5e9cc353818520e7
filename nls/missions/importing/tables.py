"""The rows of mission tables from the columns of logs: units, flags, empty cells, order of time, axes."""

from dataclasses import dataclass, field

import numpy as np

from models.algebra import Array, Index, Mask, wrap
from models.errors import OptionError
from models.listing import several
from nls.missions.folder.columns import ANGLES, COLUMNS, optional
from nls.missions.importing.cell import Cell, sigma_words, sigmas_out
from nls.missions.importing.dates import EXAMPLE
from nls.missions.importing.frames import angles_of, axes, turn
from nls.missions.importing.headers import guess, mission_unit, nearest, plain
from nls.missions.importing.mapping import Section
from nls.missions.importing.quantities import DAY, FULL_TURN, WEEK, Stamps, convert_column, hemispheres, stamps
from nls.missions.importing.text_log import MISSING, Log, blanked, is_number
from nls.stages import announce

TIMES = ("time_s", "time_i_s", "time_j_s")
WORDS = ("name", "kernel")
WHOLE = ("i", "j", "landmark", "beacon", "beams", "bins", "ways")
STRICT = ("dvl", "ahrs", "depth", "poses", "truth", "ship")  # tables of one row a time
FLAGS = {"true": 1.0, "false": 0.0}


@dataclass
class Rows:
    """The rows of one section.

    Attributes
    ----------
    section : of the mapping.
    log : they are from; of constants one without columns.
    none : (n,) rows in which `Section.together` says that there is none.
    rows : (n,) of the log.
    numbers : (n,) by column, with units and axes of the mission.
    words : (n,) by column.
    times : (n,) by column.
    notes : what was assumed and left out.
    """

    section: Section
    log: Log
    none: Mask
    rows: Index
    numbers: dict[str, Array] = field(default_factory=dict)
    words: dict[str, list[str]] = field(default_factory=dict)
    times: dict[str, Stamps] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def rows_of(section: Section, log: Log) -> Rows:
    """The rows of a section.

    Parameters
    ----------
    section : of the mapping.
    log : that has its columns; where all are constants one of a row without columns.

    Raises
    ------
    GraphFileError
        A column that is not there or not in the log, a cell that is no number, times that do not rise; a unit that
        cannot be. The error has the line in the log or in the mapping.
    """
    _refuse_missing(section, log)
    if (between := section.options.get("rows")) is not None:
        log = log.part(slice(between[0], *between[1:] or [None]))
        if not len(log):
            raise section.error("rows", f"rows = {between} leaves no row")
    count = len(log)
    rows = Rows(section, log, np.full(count, bool(section.together)), np.arange(count))
    for column, cell in section.cells.items():
        announce(f"{section.table}.csv, {column}: {count:,} rows")
        if column in TIMES and cell.columns:
            _known(section, column, cell, log)
            rows.times[column] = stamps(section, log, column, rows.notes)
        elif column in WORDS:
            own = [log.words(name, cell.missing) for name in _known(section, column, cell, log).columns]
            rows.words[column] = own[0] if own else [str(cell.constant)] * count
        elif cell.row is None:
            rows.numbers[column] = _numbers(section, column, cell, log, count, rows.notes)
    for source, values in section.together:
        cells = log.words(source) if source in log.names else [str(source)]
        rows.none &= [not word for word in blanked(cells, values)]
    if section.rotation is not None:
        _rotate(section, log, rows, count)
    _keep(rows, *_complete(rows, count))
    if "time_s" in rows.times:
        _order(rows)
    for column, cell in section.cells.items():
        if cell.row is not None:  # numbered when it is known which rows there are
            rows.numbers[column] = (cell.row + np.arange(float(len(rows.rows)))) * cell.scale + cell.offset
    _refuse_sigmas(rows)
    _turned(rows)
    return rows


def _refuse_missing(section: Section, log: Log) -> None:
    """Refuse a section without a column that its table needs, but for the flag of a DVL; says the line to write."""
    given = {"valid", *section.cells, *(ANGLES if section.rotation else ())}
    if {"lat_deg", "lon_deg"} & given:
        given |= {"x_m", "y_m"}
    given |= {*optional(section.table, [other.table for other in section.mapping.sections])}
    if absent := [name for name in COLUMNS[section.table] if name not in given]:
        near = guess(absent[0], log.names)
        write = f'{absent[0]} = "{near}"' if near else f'{absent[0]} = "COLUMN OF THE LOG", or a number'
        raise section.error("", f"[{section.table}] has no {absent[0]}; write {write}")


def _known(section: Section, column: str, cell: Cell, log: Log) -> Cell:
    """The cell itself, whose columns the log has."""
    for name in cell.columns:
        if name not in log.names:
            near = nearest(column, name, log.names)
            write = f'; write {column} = "{near}"' if near else ""
            raise section.error(column, f"{log.title} has no column {name!r}{write}; it has {log.listed(20)}")
        log.column(name)
    return cell


def _numbers(section: Section, column: str, cell: Cell, log: Log, count: int, notes: list[str]) -> Array:
    """The numbers (n,) of a column in the unit of the mission; nan where there is none."""
    if not cell.columns:
        if isinstance(cell.constant, str):
            raise section.error(column, f"{column} is {cell.constant!r}; expected a number or a column")
        if mission_unit(column)[1] == "rad" and abs(cell.constant) > FULL_TURN:
            radians, wrapped = (f"{column} = {float(f(float(cell.constant))):.4g}" for f in (np.radians, wrap))
            expected = f"expected radians, -2 pi to 2 pi; in degrees? write {radians}; or wrap it: {wrapped}"
            raise section.error(column, f"{column} is {cell.constant!r}; {expected}")
        return np.full(count, float(cell.constant))
    name = _known(section, column, cell, log).columns[0]
    if column == "valid" or cell.equals is not None or cell.above is not None:
        return _flags(section, column, cell, log)
    numbers = log.numbers(name, cell.missing)
    numbers[~np.isfinite(numbers)] = np.nan
    if not cell.scaled:
        numbers = convert_column(section, column, log, numbers, notes)
        if column == "z_m" and cell.up is None and cell.scale > 0:
            _refuse_unsaid_height(section, name)
    numbers = hemispheres(section, column, cell, log, numbers * cell.scale + cell.offset)
    if mission_unit(column)[0] == "angle" and column not in ("lat_deg", "lon_deg"):
        half = 180.0 if column.endswith("_deg") else np.pi
        far = np.abs(numbers) > half
        numbers[far] = (numbers[far] + half) % (2 * half) - half
    return numbers


def _refuse_unsaid_height(section: Section, name: str) -> None:
    """Refuse a depth from a column that says height, unless its sign is said or its frame has z up."""
    world = axes(str(section.options.get("frame", "NED")))[0]
    if world == "NED" and any(word in plain(name).split() for word in ("altitude", "height", "alt", "up")):
        write = f'z_m = {{ column = "{name}", up = true }}'
        raise section.error("z_m", f"z_m is down, and {name!r} sounds like up; write {write}, or up = false")


def _flags(section: Section, column: str, cell: Cell, log: Log) -> Array:
    """1 where a flag is true, 0 where it is not, nan where its cell is empty."""
    (name,) = cell.columns
    if cell.above is not None:
        numbers = log.numbers(name, cell.missing)
        return np.where(np.isnan(numbers), np.nan, (numbers > cell.above).astype(float))
    words = log.words(name, cell.missing)
    if cell.equals is not None:
        target = str(cell.equals).lower() if isinstance(cell.equals, bool) else cell.equals
        if isinstance(target, str):
            return np.array([float(word.lower() == target.lower()) for word in words])
        return np.asarray((log.numbers(name, cell.missing) == target).astype(float))
    kinds = {word: _flag(word) for word in set(words)}
    if strange := next((word for word, flag in kinds.items() if flag is None), None):
        write = f'{column} = {{ column = "{name}", equals = "{strange}" }}, or above = NUMBER'
        cure = f"write {write} in [{section.table}]"
        raise log.error(words.index(strange), f"{name}: {strange[:40]!r} is neither 0 or 1, nor true or false; {cure}")
    return np.array([kinds[word] for word in words], dtype=float)


def _flag(word: str) -> float | None:
    """The value of a flag; nan of an empty cell, None where it is none."""
    low = word.lower()
    if low in MISSING:
        return float("nan")
    number = FLAGS.get(low, float(low.replace(",", ".")) if is_number(low) else None)
    return number if number in (0.0, 1.0) else None


def _rotate(section: Section, log: Log, rows: Rows, count: int) -> None:
    """Roll, pitch and yaw from a quaternion or a matrix."""
    assert section.rotation is not None
    kind, names = section.rotation
    if isinstance(names[0], str):
        _known(section, kind, Cell(names), log)
        parts = np.column_stack([log.numbers(name, section.missing.get(kind, ())) for name in names])
    else:
        parts = np.tile(np.array(names, dtype=float), (count, 1))
    rpy, present = np.full((count, 3), np.nan), np.isfinite(parts).all(axis=1) & ~rows.none
    try:
        rpy[present] = angles_of(kind, parts[present])
    except ValueError as error:
        k, sentence = error.args
        none = f"write `missing_together = {{ {kind} = 0 }}` in [{section.table}] of the mapping"
        problem = f"{sentence}; {'is the order of its numbers right?' if parts[present][k].any() else none}"
        if not isinstance(names[0], str):
            raise section.error(kind, problem) from error
        raise log.error(int(np.flatnonzero(present)[k]), problem) from error
    rows.numbers |= dict(zip(ANGLES, rpy.T, strict=True))


def _complete(rows: Rows, count: int) -> tuple[Mask, Mask]:
    """Rows (n,) whose times are there, and rows of which nothing else is missing; makes the flag of a DVL."""
    timed = np.all([np.ones(count, dtype=bool), *(stamp.present for stamp in rows.times.values())], axis=0)
    flag = rows.numbers.pop("valid", None) if rows.section.table == "dvl" else None
    whole = np.all([~rows.none, *map(np.isfinite, rows.numbers.values())], axis=0)
    for words in rows.words.values():
        whole &= list(map(bool, words))
    if rows.section.table == "dvl":
        rows.numbers["valid"] = (whole & (flag == 1 if flag is not None else True)).astype(float)
        rows.numbers = {name: np.where(np.isfinite(n), n, 0.0) for name, n in rows.numbers.items()}
        if flag is None:
            rows.notes.append("dvl: no column says valid: rows with a velocity are")
    return timed, whole


def _keep(rows: Rows, timed: Mask, whole: Mask) -> None:
    """Leave out rows without a time or a number; of a DVL one without a velocity stays, not valid."""
    name, log = rows.section.table, rows.log
    lost = "valid = 0" if name == "dvl" else "left out"
    for bad, problem, effect in ((~timed, "time", "left out"), (timed & ~whole, "number", lost)):
        if bad.any():
            if not rows.section.used:
                raise rows.section.error("", f"[{name}] has an empty {problem}")
            first = log.place(int(np.argmax(bad)))
            count = f"{several(int(bad.sum()), 'row')} of {len(bad)}"
            if name == "fixes" and np.isnan(rows.numbers.get("z_m", whole)[bad]).any():
                effect += "; their places stay where z_m is in [depth], and not in [fixes]"
            rows.notes.append(f"{name}: {count} without a {problem}, {first} the first: {effect}")
    kept = timed if name == "dvl" else timed & whole
    if not kept.any():
        empty = [column for column, stamp in rows.times.items() if not stamp.present.any()]
        empty += [column for column, numbers in rows.numbers.items() if np.isnan(numbers).all()]
        cure = f": {empty[0]} has none; name another column, or a number" if empty else ""
        raise rows.section.error((*empty, "")[0], f"no row of {log.title} has all that [{name}] needs{cure}")
    _take(rows, np.flatnonzero(kept))


def _take(rows: Rows, index: Index) -> None:
    """Keep these rows, in this order."""
    rows.rows = rows.rows[index]
    rows.numbers = {name: numbers[index] for name, numbers in rows.numbers.items()}
    rows.words = {name: [words[k] for k in index] for name, words in rows.words.items()}
    rows.times = {name: stamp.take(index) for name, stamp in rows.times.items()}


def _refuse_sigmas(rows: Rows) -> None:
    """Refuse a cell of the log that makes a standard deviation that cannot be; of a DVL where it is valid."""
    section, log = rows.section, rows.log
    for column, cell in section.cells.items():
        if not cell.columns or column not in rows.numbers:
            continue
        bad = sigmas_out(column, rows.numbers[column])
        if section.table == "dvl":
            bad &= rows.numbers["valid"] == 1
        if bad.any():
            k = int(np.argmax(bad))
            number, write = float(rows.numbers[column][k]), f"missing = NUMBER in [{section.table}] of the mapping"
            cure = f"write {write} for a number that stands for none, or one standard deviation for all rows"
            problem = f"{cell.columns[0]!r} makes {column} {number!r}; expected {sigma_words(column)}"
            raise log.error(int(rows.rows[k]), f"{problem}; {cure}")


def _order(rows: Rows) -> None:
    """Rows in the order of time: refused where they are not, unless the mapping says what to do."""
    section, log = rows.section, rows.log
    t = rows.times["time_s"].ns
    if section.options.get("sort") and (t[1:] < t[:-1]).any():
        back = int((t[1:] < t[:-1]).sum())
        rows.notes.append(f"{section.table}: sorted by time; {several(back, 'row')} came before the one above")
        order = np.argsort(t, kind="stable")
        _take(rows, order)
        t = t[order]
    late = t[1:] < t[:-1]
    log.refuse(late, rows.rows[1:], lambda k: f"the time falls from the row before; {_cure_of_fall(rows, t, k + 1)}")
    if section.table not in STRICT:
        return
    again = np.append(False, t[1:] == t[:-1])
    if again.any() and section.options.get("duplicates") == "first":
        rest = f"with the time of the one before, {log.place(int(rows.rows[np.argmax(again)]))} the first: left out"
        rows.notes.append(f"{section.table}: {several(int(again.sum()), 'row')} {rest}")
        _take(rows, np.flatnonzero(~again))
    else:
        cure = f'write duplicates = "first" in [{section.table}] of the mapping to leave such rows out'
        log.refuse(again, rows.rows, lambda _: f"the time is that of the row before; {cure}")


def _cure_of_fall(rows: Rows, t: Index, k: int) -> str:
    """The cure for times (n,), ns, that fall at row k."""
    section, log = rows.section, rows.log
    fall, own, where = t[k - 1] - t[k], not rows.times["time_s"].since_1970, f"in [{section.table}] of the mapping"
    for period, event, day in ((DAY, "midnight", "the day"), (WEEK, "a new week of GPS", "the Sunday")):
        if own and t.min() >= 0 and t.max() <= period and fall > 0.9 * period:  # it begins anew
            return f'at {event}: write `date = "{EXAMPLE}"`, {day} of the first row, {where}'
    below, above = t < np.maximum.accumulate(t), t > np.minimum.accumulate(t[::-1])[::-1]
    off = min(below, above, key=np.count_nonzero)
    if off.sum() <= 5 and 2 * off.sum() < len(t) and fall > np.ptp(t[~off]):
        lines = ", ".join(str(log.number(row)) for row in rows.rows[off])
        return f"of a clock of its own: leave out {log.noun}s {lines} of {log.title}"
    return f"write sort = true {where} if the rows are of one clock"


def _turned(rows: Rows) -> None:
    """The axes of the mission in the place of those of the log."""
    section = rows.section
    if (frame := section.options.get("frame")) is None:
        return
    world, body = axes(frame)
    if "z_m" in section.cells and section.cells["z_m"].up is not None and world != "NED":
        raise section.error("z_m", f"up and frame = {frame!r} both say where z points; leave up out")
    before = rows.numbers
    try:
        rows.numbers = turn(section.table, before, frame)
    except OptionError as error:
        raise section.error("frame", str(error)) from error
    if any(not np.array_equal(before.get(name, ()), numbers) for name, numbers in rows.numbers.items()):
        rows.notes.append(f"{section.table}: {world} and {body} axes of the log are turned into NED and FRD")
