"""One CSV file as columns: a line of names, then rows of numbers, each wrong cell refused with its line.

Cells are what stands between commas; blanks around them do not count. Text may stand in quotation marks, and must where
it has a comma. Blank lines and lines that begin with ``#`` are skipped. Columns are found by name and may stand in any
order; none may be missing, unknown or there twice. Their names say the unit, and so what a number can be (`OF_ENDS`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from pathlib import Path

import numpy as np
import numpy.typing as npt

from models.advice import Advice
from models.algebra import Array, Index, Mask, Numbers
from models.errors import GraphError, GraphFileError
from models.manifolds.euler import GIMBAL_LOCK
from models.options import did_you_mean
from nls.io.decimals import PAD
from nls.io.files import read_bytes
from nls.io.report import Source
from nls.io.text import NUMBER, Text, printable, refuse_late
from nls.missions.folder.columns import BOUNDS, LARGEST, OF_ENDS, SMALLEST


class Table(Text):
    """A CSV file with a known set of columns; its tokens are the cells.

    Parameters
    ----------
    path : the file, which may be gzip-compressed.
    columns : names of all its columns.
    optional : those of them that may be left out.
    needed : whether the file itself may not be left out.
    data : what stands in the file, where it need not be read.
    others : other names of columns, for a file that other programs write: given, there may be columns that are not
        known, empty cells, and names and numbers in quotation marks.

    Attributes
    ----------
    names : of its columns, as they stand in the file.
    lines : (n,) the lines of its rows, counted from 0.
    comments : how many lines began with ``#``.

    Raises
    ------
    GraphFileError
        No such file, no line of names, other columns than these, no row, a row with another count of cells, an empty
        cell.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "depth.csv")
    ...     _ = file.write_text("z_m, time_s\\n2.5, 0\\n2.75, 1\\n")
    ...     table = Table(file, ["time_s", "z_m"])
    >>> table.floats("time_s", "z_m")
    array([[0.  , 2.5 ],
           [1.  , 2.75]])
    """

    def __init__(
        self,
        path: str | Path,
        columns: Sequence[str],
        optional: Sequence[str] = (),
        needed: bool = False,
        data: bytes | None = None,
        others: Mapping[str, str] | None = None,
    ) -> None:
        self._data = read_bytes(path) if data is None else data
        self._other: dict[str, Array] = {}
        super().__init__(self._data.replace(b",", b" "), str(path))
        self.lines, self.comments = self._split(quoted=others is not None)
        expected = ",".join(columns)
        required = ",".join(column for column in columns if column not in optional) or expected
        if not len(self.lines):
            raise self.error(f"is empty; expected a first line {required} and a row of values on every other", 0)
        self._head, self.lines = int(self.lines[0]), self.lines[1:]
        words = [self.token(k) for k in range(*self.first[self._head : self._head + 2])]
        names = self.names = [(others or {}).get(name, name) for name in map(printable, words)]
        self._refuse_no_names(words, expected)
        for problem, wrong in (
            ("unknown", [name for name in names if name not in columns and others is None]),
            ("repeated", [name for name, count in Counter(names).items() if count > 1]),
            ("no", [name for name in columns if name not in (*names, *optional)]),
        ):
            if wrong:
                message = f"{problem} column {_quoted(wrong[0])}; expected {required if problem == 'no' else expected}"
                name = wrong[0][:100]  # which is compared with the names of columns
                if problem == "unknown":
                    near = did_you_mean(name, [column for column in columns if column not in names])
                    place = Path(self.path).name.split(".csv")[0], near.split("'")[1] if near else "COLUMN", name
                    raise self.error(message + near, self._head, [Advice("map column", place)])
                raise self.at_names(message + (did_you_mean(name, names) if others is not None else ""))
        if not len(self.lines):
            cure = "expected one or more" if needed else "leave the file out where nothing was measured"
            raise self.at_names(f"has no row below its names; {cure}")
        count = np.diff(self.first)[self.lines]

        def uneven(k: int) -> str:
            cure = _separators(self.line(int(self.lines[k]))) if count[k] == 1 else ""
            return f"{count[k]} cells, expected {len(names)}: {','.join(names)}{cure}"

        self.refuse_rows(count != len(names), uneven)
        self._place = {name: k for k, name in enumerate(names)}
        if others is None:
            self.refuse_empty(names)

    def _split(self, quoted: bool) -> tuple[Index, int]:
        """Put cells, trimmed, in the place of words; empty ones have no length, ``quoted`` ones no quotation marks.

        Returns the lines that are not skipped, and how many are comments.
        """
        characters = np.frombuffer(self._data, dtype=np.uint8)
        quotes, commas = (np.flatnonzero(characters == ord(sign)) + PAD for sign in '",')
        odd = np.diff(quotes.searchsorted(self._newlines)) % 2 == 1
        self.refuse(odd, np.arange(len(odd)), lambda _: "a quotation mark is not closed on its line")
        commas = commas[quotes.searchsorted(commas) % 2 == 0]  # those inside quotation marks are text
        edges = np.sort(np.concatenate([commas, self._newlines]))
        low, high = self.starts.searchsorted(edges[:-1]), self.starts.searchsorted(edges[1:])
        filled = high > low
        starts, ends = edges[:-1] + 1, edges[:-1] + 1
        starts[filled], ends[filled] = self.starts[low[filled]], self.ends[high[filled] - 1]
        if quoted:
            within = (ends - starts > 1) & np.isin(starts, quotes) & np.isin(ends - 1, quotes)
            starts, ends = starts + within, ends - within
        self.starts, self.ends, self.first = starts, ends, edges.searchsorted(self._newlines)
        head = self.first[:-1]
        comment = self.characters(head, 1)[:, 0] == ord("#")
        blank = (np.diff(self.first) == 1) & ~filled[head]
        return np.flatnonzero(~comment & ~blank), int(comment.sum())

    def _refuse_no_names(self, words: list[bytes], expected: str) -> None:
        """Refuse a first line of numbers, and one that is not separated by commas."""
        if all(NUMBER.fullmatch(word) for word in words):
            raise self.at_names(f"the first line must name the columns: {expected}")
        if len(words) == 1 and (cure := _separators(words[0])):
            raise self.at_names(f"one column; expected {expected}{cure}")

    def has(self, *names: str) -> bool:
        """Whether the file has all of these columns."""
        return all(name in self._place for name in names)

    def __len__(self) -> int:
        """Rows."""
        return len(self.lines)

    def line(self, line: int) -> bytes:
        """One line as it stands in the file, counted from 0."""
        return self._data[self._newlines[line] + 1 - PAD : self._newlines[line + 1] - PAD]

    def _cells(self, names: Sequence[str]) -> Index:
        """The cells (n, k) of these columns."""
        return np.asarray(self.first[self.lines][:, None] + np.array([self._place[name] for name in names]))

    def filled(self, *names: str) -> Mask:
        """Which cells (n, k) of columns are not empty."""
        cells = self._cells(names)
        return np.asarray(self.starts[cells] < self.ends[cells])

    def refuse_empty(self, names: Sequence[str]) -> None:
        """Refuse a cell of these columns that is empty."""
        if not (filled := self.filled(*names)).all():
            k, column = divmod(int(np.argmin(filled)), len(names))
            raise self.at(k, f"{names[column]} is empty; expected a value in every cell")

    def floats(self, *names: str) -> Array:
        """Numbers (n, k) of columns, correctly rounded.

        Raises
        ------
        GraphFileError
            A cell that is no finite decimal number.
        """
        numbers = self.numbers(self._cells(names).reshape(-1), self.lines, len(names)).reshape(-1, len(names))
        for k, name in enumerate(names):
            if name in self._other:
                numbers[:, k] = self._other[name]
        return numbers

    def with_numbers(self, names: Sequence[str], numbers: Array) -> Table:
        """A table with other numbers (n, k) in some of its columns; lines and text stay."""
        other = copy(self)
        other._other = self._other | dict(zip(names, numbers.T, strict=True))
        return other

    def part(self, rows: Index | Mask | slice) -> Table:
        """The table of some of its rows."""
        other = copy(self)
        other.lines = self.lines[rows]
        other._other = {name: numbers[rows] for name, numbers in self._other.items()}
        return other

    def measured(self, *names: str, rows: Mask | None = None) -> Array:
        """Numbers (n, k) of columns, each within what its unit allows, see `OF_ENDS`.

        Parameters
        ----------
        names : of the columns.
        rows : (n,) those that count; the others may hold anything.

        Raises
        ------
        GraphFileError
        """
        numbers = self.floats(*names)
        limits = [next(limit for end, _, _, *limit in OF_ENDS if name.endswith(end)) for name in names]
        bad = ~(np.abs(numbers) <= [limit for limit, _ in limits])
        counts = True if rows is None else rows[:, None]
        self.refuse_numbers(bad & counts, numbers, [str(expected) for _, expected in limits], *names)
        return numbers

    def within(self, limit: float, expected: str, *names: str) -> Array:
        """Numbers (n, k) of columns whose names say no unit, none farther from 0 than a limit.

        Raises
        ------
        GraphFileError
        """
        numbers = self.floats(*names)
        self.refuse_numbers(np.abs(numbers) > limit, numbers, expected, *names)
        return numbers

    def attitude(self, *names: str) -> Array:
        """As `measured`, of a vehicle: its pitch is less than a right angle, where it has no heading.

        Raises
        ------
        GraphFileError
        """
        angles = self.measured(*names)
        upright = np.pi / 2 - 2 * GIMBAL_LOCK  # rad; a vehicle nearer to vertical has no heading
        bad = (np.abs(angles) > upright) & [name == "pitch_rad" for name in names]
        self.refuse_numbers(bad, angles, "radians, between -pi/2 and pi/2", *names)
        return angles

    def positive(self, *names: str) -> Array:
        """Numbers (n, k) of columns that must be above 0: standard deviations, ranges.

        Raises
        ------
        GraphFileError
        """
        numbers = self.floats(*names)
        self.refuse_numbers(~(numbers > 0), numbers, "a number above 0", *names)
        self.refuse_numbers((numbers < SMALLEST) | (numbers > LARGEST), numbers, " to ".join(BOUNDS), *names)
        return numbers

    def refuse_numbers(self, bad: Mask, numbers: Array, expected: str | Sequence[str], *names: str) -> None:
        """Refuse the first of the numbers of columns, (n, k) or of one (n,), that is bad; says what is expected."""
        if bad.any():
            k, column = divmod(int(np.argmax(bad)), len(names))
            came = float(numbers.reshape(bad.shape[0], -1)[k, column])
            right = expected if isinstance(expected, str) else expected[column]
            raise self.at(k, f"{names[column]} is {came!r}; expected {right}")

    def integers(self, name: str) -> Numbers:
        """Whole numbers (n,) of one column.

        Raises
        ------
        GraphFileError
            A cell that is none, or beyond 2^63.
        """
        return self.whole(self.lines, self._place[name])

    def flags(self, name: str, meaning: str) -> Mask:
        """Cells (n,) of one column that are 0 or 1, also as a program writes them: 1.0, 0.000.

        Raises
        ------
        GraphFileError
            Another cell.
        """
        cells = self._cells([name])[:, 0]
        first, second = self.characters(cells, 2).T
        true = first == ord("1")
        for k in np.flatnonzero(((first != ord("0")) & ~true) | (second != 0)):
            word = self.token(cells[k])
            if NUMBER.fullmatch(word) is None or float(word) not in (0.0, 1.0):
                raise self.at(int(k), f"{name} is {_quoted(printable(word))}; expected 0 or 1: {meaning}")
            true[k] = float(word) == 1.0
        return np.asarray(true)

    def unique(self, name: str, noun: str) -> Numbers:
        """Whole numbers (n,) of one column, none of them twice.

        Raises
        ------
        GraphFileError
            One that was given before.
        """
        ids = self.integers(name)
        self.once(ids, self.lines, f"{noun} ")
        return ids

    def rising(self, name: str) -> Array:
        """Numbers (n,) of one column that must rise from row to row: times.

        Raises
        ------
        GraphFileError
            One that does not.
        """
        t = self.measured(name)[:, 0]
        refuse_late(self, self.lines, t, name)
        return t

    def known(self, name: str, among: Numbers, problem: str) -> Numbers:
        """Whole numbers (n,) of one column, each of them among others; `problem` says what is wrong where it is not.

        Raises
        ------
        GraphFileError
        """
        ids = self.integers(name)
        self.refuse_rows(~np.isin(ids, among), lambda k: f"{name} {ids[k]}: {problem}")
        return ids

    def text_of(self, name: str) -> list[str]:
        """Cells of one column as text, without the quotation marks around them."""
        cells = self._cells([name])[:, 0]
        words = [self._data[s - PAD : e - PAD] for s, e in zip(self.starts[cells], self.ends[cells], strict=True)]
        quoted = (len(word) > 1 and word[:1] == word[-1:] == b'"' for word in words)
        pairs = zip(words, quoted, strict=True)
        return [printable(word[1:-1].replace(b'""', b'"') if within else word) for word, within in pairs]

    def source(self, rows: Index | slice = slice(None)) -> Source:
        """The source of a factor whose measurements stand in these rows."""
        return Source(self.path, self.lines[rows] + 1)

    def place(self, row: int) -> str:
        """Where a row stands, for a note about this folder: the file's name and its line."""
        return f"{Path(self.path).name}:{self.lines[row] + 1}"

    def at_names(self, message: str) -> GraphFileError:
        """An error at the line of names: about the columns."""
        return self.error(message, self._head)

    def refuse_rows(self, bad: Mask, problem: Callable[[int], str]) -> None:
        """Refuse the first row that is bad (n,); `problem` says what is wrong with row k."""
        self.refuse(bad, self.lines, problem)

    def at(self, row: int, message: str) -> GraphFileError:
        """An error at a row."""
        return self.error(message, int(self.lines[row]))


def _quoted(text: str) -> str:
    """Text in quotation marks, cut where it is long."""
    return repr(text if len(text) <= 40 else text[:37] + "...")


def _separators(line: bytes) -> str:
    """The cure for a line of cells that no comma separates."""
    separator = next((word for sign, word in ((b";", "semicolons"), (b"\t", "tabs")) if sign in line), "")
    return f"; these are separated by {separator}, separate them with commas" if separator else ""


def csv_text(names: Sequence[str], *columns: npt.ArrayLike | Sequence[str]) -> bytes:
    """A CSV file of a line of names and rows of numbers that read back bit for bit.

    Parameters
    ----------
    names : of all columns.
    columns : (n,) whole numbers or words, or (n, k) numbers for k columns, in the order of the names.

    Raises
    ------
    GraphError
        A number that is not finite.

    Examples
    --------
    >>> print(csv_text(["i", "x_m", "y_m"], [3, 4], [[0.1, 1.0], [1e-9, -2.5]]).decode())
    i,x_m,y_m
    3,0.1,1.0
    4,1e-09,-2.5
    """
    cells: list[list[str]] = []
    for column in columns:
        array = np.asarray(column)
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise GraphError(f"{names[len(cells)]}: a number is not finite; a file holds finite ones only")
        entries = array.reshape(len(array), -1).T.tolist()
        cells += [[item if isinstance(item, str) else repr(item) for item in column] for column in entries]
    return ("\n".join([",".join(names), *map(",".join, zip(*cells, strict=True))]) + "\n").encode()
