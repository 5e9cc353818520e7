"""A log as a table of text: any separator, header and decimal sign; cells are numbers only where they are asked for.

Lines that are blank or begin with ``#`` or ``%`` are skipped. A header may itself begin with one of these signs. It is
the last such line before the rows where these begin with a number and have as many cells.
"""

import copy
import csv
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any, Self

import numpy as np

from models.algebra import Array, Index, Mask
from models.errors import GraphFileError
from models.options import did_you_mean
from nls.io.files import read_bytes
from nls.io.text import NUMBER
from nls.missions.importing.headers import dimension
from nls.stages import announce

Missing = tuple[str | float, ...]  # words and numbers of cells that stand for none

MISSING = frozenset(("", "nan", "na", "n/a", "null", "none", "-", "--", "nat"))  # words of an empty cell, lower case
COMMENTS = ("#", "%")
SEPARATORS = {"tab": "\t", "semicolon": ";", "comma": ",", "blank": " "}
BRACKETS = "[](){}<> "  # around a unit
DECIMAL_COMMA = re.compile(r"\s*[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?\s*")


class Log:
    """A table of named columns, from a text file or a topic of a bag.

    Parameters
    ----------
    path : for messages.
    title : for notes.
    names : of its columns.
    rows : (n,) the cells of each.
    lines : (n,) places of the rows in the file, counted from 0.
    """

    noun = "line"  # a row of the file
    decimal = "."
    text: Sequence[str] = ()  # the lines of the file

    def __init__(self, path: str, title: str, names: Sequence[str], rows: list[list[Any]], lines: Index) -> None:
        self.path, self.title, self.names, self.rows, self.lines = path, title, list(names), rows, lines
        self.first = int(lines[0]) if len(lines) else 0
        self.notes: list[str] = []
        self.units: dict[str, str] = {}  # of columns whose header does not say it

    def __len__(self) -> int:
        """Rows."""
        return len(self.lines)

    def part(self, rows: slice) -> Self:
        """Some rows of the log as a log."""
        part = copy.copy(self)
        part.lines, part.rows = self.lines[rows], self.rows[rows]
        return part

    def words(self, name: str, missing: Missing = ()) -> list[str]:
        """Cells (n,) of a column as text, trimmed; True and False are ``true`` and ``false``, missing ones empty."""
        place = self.names.index(self.column(name))
        return blanked([row[place].strip() for row in self.rows], missing)

    def numbers(self, name: str, missing: Missing = ()) -> Array:
        """Numbers (n,) of a column; nan where its cell is empty or missing, or says that it is no number.

        Raises
        ------
        GraphFileError
            Another cell, with its line.
        """
        words = self.words(name, missing)
        if self.decimal == ",":
            words = [word.replace(",", ".") for word in words]
        if "_" not in "".join(words):  # which float() takes
            for _ in range(2):
                with suppress(ValueError):
                    return np.fromiter(map(float, words), float, len(words))
                words = ["nan" if word.lower() in MISSING else word for word in words]
        good = [word.lower() in MISSING or bool(NUMBER.fullmatch(word.encode())) for word in words]
        k = good.index(False)
        cure = ", or rows = [1] for a row of units" if self.lines[k] == self.first else ""
        rest = f"in the mapping write missing = {words[k][:40]!r} where it stands for none{cure}"
        raise self.error(k, f"{name}: {words[k][:40]!r} is not a number; correct it, or name another column; {rest}")

    def whole(self, name: str) -> Index | None:
        """Whole numbers (n,) of a column, exact; None where it has others, or empty cells."""
        words = self.words(name)
        if not all(word.isdecimal() and (len(word), word) <= (19, "9223372036854775807") for word in words):
            return None
        return np.fromiter(map(int, words), np.int64, len(words))

    def error(self, row: int, message: str) -> GraphFileError:
        """An error at a row."""
        return GraphFileError(message, self.path, self.number(row), self.text[self.lines[row]].strip())

    def refuse(self, bad: Mask, rows: Index, problem: Callable[[int], str]) -> None:
        """Refuse the first of rows (n,) that is bad (n,); `problem` says what is wrong with number k of them.

        Raises
        ------
        GraphFileError
        """
        if bad.any():
            k = int(np.argmax(bad))
            raise self.error(int(rows[k]), problem(k))

    def number(self, row: int) -> int:
        """The number of a row in the file, from 1."""
        return int(self.lines[row]) + 1

    def place(self, row: int) -> str:
        """Where a row stands, for notes."""
        return f"{self.title}{':' if self.noun == 'line' else f', {self.noun} '}{self.number(row)}"

    def column(self, name: str) -> str:
        """The name itself.

        Raises
        ------
        GraphFileError
            No such column, or several; names the closest one.
        """
        if (count := self.names.count(name)) == 1:
            return name
        if count > 1:
            cure = "give them names of their own; header = false and skip = 1 of the mapping call them 1, 2, ..."
            raise GraphFileError(f"{self.title} has {count} columns {name!r}; {cure}", self.path)
        near = did_you_mean(name, self.names) or ";"
        raise GraphFileError(f"{self.title} has no column {name!r}{near} it has {self.listed(40)}", self.path)

    def listed(self, most: int) -> str:
        """The names of its columns for a message, so many of them."""
        return ", ".join(map(repr, self.names[:most])) + (", ..." if len(self.names) > most else "")


class TextLog(Log):
    """A text file.

    Parameters
    ----------
    path : the file, which may be gzip-compressed.
    separator : comma, semicolon, tab or blank, or the sign itself; by the header when omitted.
    decimal : the decimal sign; a comma is recognized where commas do not separate.
    header : whether a line names the columns; otherwise they are ``1``, ``2``, ...
    skip : lines before all others that do not count.
    join : so many lines are one row.
    where : a column and the text of its cells in the rows that count; others may have any number of cells.

    Raises
    ------
    GraphFileError
        No such file, no header, no row, a row with another count of cells.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "log.csv")
    ...     _ = file.write_text("%time;v [mm/s]\\n0;1,5\\n1;\\n")
    ...     log = TextLog(file)
    >>> log.names, log.numbers("v [mm/s]"), log.place(1)
    (['time', 'v [mm/s]'], array([1.5, nan]), 'log.csv:3')
    """

    def __init__(
        self,
        path: Any,
        separator: str | None = None,
        decimal: str | None = None,
        header: bool = True,
        skip: int = 0,
        where: tuple[str, str] | None = None,
        join: int = 1,
    ) -> None:
        data = read_bytes(path)
        try:
            text = data.decode("utf-8")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
        self.text = text.replace("\r\n", "\n").split("\n")
        self.path = str(path)
        announce(f"{len(self.text):,} lines of {self.path}")
        kept = [k for k, line in enumerate(self.text) if k >= skip and line.lstrip()[:1] not in ("", *COMMENTS)]
        if not kept:
            raise GraphFileError("has no row; expected a line of names and rows of values", self.path)
        head = self._header(kept, separator) if header else ""
        sign = _separator(head or self.text[kept[0]], separator)
        names = [name.strip() for name in next(_cells([head], sign))] if head else []
        cells = self._split(kept, sign)
        units = dict(zip(names, (cell.strip(BRACKETS) for cell in cells[0]), strict=False)) if cells else {}
        if line := kept[0] + 1 if _names_units(cells) else 0:
            kept, cells = kept[1:], cells[1:]
        if join > 1:
            if len(cells) % join:
                raise GraphFileError(f"{len(cells)} lines are no multiple of {join}, which are one row", self.path)
            cells = [[word for line in cells[k : k + join] for word in line] for k in range(0, len(cells), join)]
            kept = kept[::join]
        if not cells:
            raise GraphFileError("has names and no row below them", self.path, kept[0] + 1 if kept else 1)
        if not head:
            names = [str(k + 1) for k in range(max(map(len, cells)))]
        super().__init__(self.path, self.path.replace("\\", "/").rsplit("/", 1)[-1], names, cells, np.array(kept))
        if where is not None:
            column, value = where
            place = names.index(self.column(column))
            own = [row[place].strip().lower() if len(row) > place else None for row in cells]
            chosen = [k for k, word in enumerate(own) if word == value.lower()]
            if not chosen:
                raise GraphFileError(f"no row has {value!r} in column {column!r}", self.path)
            self.lines, self.rows = self.lines[chosen], [cells[k] for k in chosen]
            self.names = names if head else names[: len(self.rows[0])]
        if line:
            self.units = {name: unit for name, unit in units.items() if any(map(str.isalpha, unit)) or dimension(unit)}
            self.notes.append(f"{self.title}:{line} is taken for a row of units")
        self._refuse_counts()
        self.decimal = decimal or self._decimal(sign)

    def _header(self, kept: list[int], separator: str | None) -> str:
        """The line of names, which is taken out of the rows where it is one of them."""
        first = self.text[kept[0]]
        words = [word.strip() for word in next(_cells([first], _separator(first, separator)))]
        if not any(is_number(word) for word in words):
            kept.pop(0)
            return first
        for k in range(kept[0] - 1, -1, -1):
            line = self.text[k].strip()
            if line:
                line = line.lstrip("#% ")
                sign = _separator(line, separator)
                names = next(_cells([line], sign), [])
                if len(names) == len(next(_cells([first], sign))) and not any(is_number(name) for name in names):
                    return line
                break
        cure = "header = false calls them 1, 2, ..., and skip = N leaves out lines before the names"
        problem = f"the first line has numbers and names no columns; in a mapping, {cure}"
        raise GraphFileError(problem, self.path, kept[0] + 1, first.strip())

    def _split(self, kept: list[int], sign: str) -> list[list[str]]:
        """The cells of rows."""
        try:
            cells = list(_cells([self.text[k] for k in kept], sign))
        except csv.Error as error:
            raise GraphFileError(f"cannot be split into cells: {error}", self.path) from error
        if len(cells) != len(kept):
            odd = next((k for k in kept if self.text[k].count('"') % 2), kept[0])
            raise GraphFileError("a quotation mark is not closed on its line", self.path, odd + 1)
        return cells

    def _refuse_counts(self) -> None:
        """Refuse a row with another count of cells; one empty cell too many, behind a last separator, is none."""
        expected = len(self.names)
        for k, row in enumerate(self.rows):
            if len(row) == expected:
                continue
            if len(row) == expected + 1 and not row[-1].strip():
                row.pop()
                continue
            cure = "in the mapping where = { column = ..., equals = ... } takes rows of one kind"
            raise self.error(k, f"{len(row)} cells, expected {expected}: {', '.join(self.names[:12])}; {cure}")

    def _decimal(self, sign: str) -> str:
        """A comma where numbers of the first rows have one and it separates nothing."""
        one = next((cell.strip() for row in self.rows[:100] for cell in row if DECIMAL_COMMA.fullmatch(cell)), "")
        if sign == "," or not one:
            return "."
        self.notes.append(f"{self.title}: a comma is taken for the decimal sign, as in {one!r}")
        return ","


def blanked(words: list[str], missing: Missing) -> list[str]:
    """Words, empty in the place of those that are missing: words in any case, numbers by value, of 32 bits too.

    Examples
    --------
    >>> blanked(["-9999.0", "na", "5"], (-9999, "NA"))
    ['', '', '5']
    """
    if not missing:
        return words
    texts = {str(value).lower() for value in missing}
    values = [float(value) for value in missing if not isinstance(value, str)]
    with np.errstate(over="ignore"):
        numbers = {*values, *np.array(values, dtype=np.float32).tolist()}

    def is_none(word: str) -> bool:
        return word.lower() in texts or (is_number(word) and float(word.replace(",", ".")) in numbers)

    none = set(filter(is_none, set(words)))
    return ["" if word in none else word for word in words]


def _names_units(cells: Sequence[Sequence[str]]) -> bool:
    """Whether the first row has units above numbers, and no number itself."""
    if len(cells) < 2 or any(is_number(cell.strip()) for cell in cells[0]):
        return False
    pairs = zip(cells[0], cells[1], strict=False)
    return any(dimension(unit.strip(BRACKETS)) and is_number(cell.strip()) for unit, cell in pairs)


def is_number(word: str) -> bool:
    """Whether a text is a decimal number, also with a comma."""
    return bool(NUMBER.fullmatch(word.encode())) or bool(DECIMAL_COMMA.fullmatch(word))


def _separator(line: str, named: str | None) -> str:
    """The sign between the cells: as named, else the first of tab, semicolon, comma that a line has, else blanks."""
    if named is not None:
        return SEPARATORS.get(named, named)
    return next((sign for sign in "\t;," if sign in line), " ")


def _cells(lines: Iterable[str], sign: str) -> Iterator[list[str]]:
    if sign == " ":
        return iter([line.split() for line in lines])
    return csv.reader(lines, delimiter=sign, skipinitialspace=True)
