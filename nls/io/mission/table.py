"""One CSV file as columns: a line of names, then rows of numbers, each wrong cell refused with its line.

Cells are what stands between commas; blanks around them do not count. Text may stand in quotation marks, and must where
it has a comma. Blank lines and lines that begin with ``#`` are skipped. Columns are found by name and may stand in any
order; none may be missing, unknown or there twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import GraphError, GraphFileError
from nls.io.decimals import PAD
from nls.io.files import read_bytes
from nls.io.text import Text, printable

__all__ = ["Table", "csv_text"]

Index = npt.NDArray[np.intp]
Numbers = npt.NDArray[np.int64]


class Table(Text):
    """A CSV file with a known set of columns; its tokens are the cells.

    Parameters
    ----------
    path : the file, which may be gzip-compressed.
    columns : names of all its columns.

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

    def __init__(self, path: str | Path, columns: Sequence[str]) -> None:
        self._given = read_bytes(path)
        super().__init__(self._given.replace(b",", b" "), str(path))
        self.lines, self.comments = self._split()
        wanted = ",".join(columns)
        if not len(self.lines):
            raise self.error(f"is empty; expected a first line {wanted} and a row of values on every other", 0)
        head, self.lines = int(self.lines[0]), self.lines[1:]
        names = self.names = [printable(self.token(k)) for k in range(self.first[head], self.first[head + 1])]
        for said, some in (
            ("unknown", [name for name in names if name not in columns]),
            ("repeated", [name for k, name in enumerate(names) if name in names[:k]]),
            ("no", [name for name in columns if name not in names]),
        ):
            if some:
                raise self.error(f"{said} column {some[0]!r:.40}; expected {wanted}", head)
        if not len(self.lines):
            raise self.error("has no row below its names; leave the file out where nothing was measured", head)
        count = np.diff(self.first)[self.lines]
        if (wrong := count != len(names)).any():
            k = int(np.argmax(wrong))
            raise self.error(f"{count[k]} cells, expected {len(names)}: {','.join(names)}", int(self.lines[k]))
        self._place = {name: k for k, name in enumerate(names)}
        cells = self._cells(names)
        if (empty := self.starts[cells] == self.ends[cells]).any():
            k, column = divmod(int(np.argmax(empty)), len(names))
            raise self.error(f"{names[column]} is empty; expected a value in every cell", int(self.lines[k]))

    def _split(self) -> tuple[Index, int]:
        """Put cells, trimmed, in the place of words; empty ones have no length.

        Returns the lines that are not skipped, and how many are comments.
        """
        characters = np.frombuffer(self._given, dtype=np.uint8)
        quotes, commas = (np.flatnonzero(characters == ord(sign)) + PAD for sign in '",')
        if (odd := np.diff(quotes.searchsorted(self._newlines)) % 2).any():
            raise self.error("a quotation mark is not closed on its line", int(np.argmax(odd)))
        commas = commas[quotes.searchsorted(commas) % 2 == 0]  # those inside quotation marks are text
        edges = np.sort(np.concatenate([commas, self._newlines]))
        low, high = self.starts.searchsorted(edges[:-1]), self.starts.searchsorted(edges[1:])
        filled = high > low
        starts, ends = edges[:-1] + 1, edges[:-1] + 1
        starts[filled], ends[filled] = self.starts[low[filled]], self.ends[high[filled] - 1]
        self.starts, self.ends, self.first = starts, ends, edges.searchsorted(self._newlines)
        head = self.first[:-1]
        comment = self.characters(head, 1)[:, 0] == ord("#")
        blank = (np.diff(self.first) == 1) & ~filled[head]
        return np.flatnonzero(~comment & ~blank), int(comment.sum())

    def __len__(self) -> int:
        """Rows."""
        return len(self.lines)

    def line(self, line: int) -> bytes:
        """One line as it stands in the file, counted from 0."""
        return self._given[self._newlines[line] + 1 - PAD : self._newlines[line + 1] - PAD]

    def _cells(self, names: Sequence[str]) -> Index:
        """The cells (n, k) of these columns."""
        return np.asarray(self.first[self.lines][:, None] + np.array([self._place[name] for name in names]))

    def floats(self, *names: str) -> Array:
        """Numbers (n, k) of columns, correctly rounded.

        Raises
        ------
        GraphFileError
            A cell that is no finite decimal number.
        """
        return self.numbers(self._cells(names).reshape(-1), self.lines, len(names)).reshape(-1, len(names))

    def positive(self, *names: str) -> Array:
        """Numbers (n, k) of columns that must be above 0, such as standard deviations.

        Raises
        ------
        GraphFileError
        """
        found = self.floats(*names)
        if (bad := ~(found > 0)).any():
            k, column = divmod(int(np.argmax(bad)), len(names))
            raise self.at(k, f"{names[column]} is {float(found[k, column])!r}; expected a number above 0")
        return found

    def integers(self, name: str) -> Numbers:
        """Whole numbers (n,) of one column.

        Raises
        ------
        GraphFileError
            A cell that is none, or beyond 2^63.
        """
        return self.whole(self.lines, self._place[name])

    def unique(self, name: str, what: str) -> Numbers:
        """Whole numbers (n,) of one column, none of them twice.

        Raises
        ------
        GraphFileError
            One that was given before.
        """
        found = self.integers(name)
        order = np.argsort(found, kind="stable")
        again = np.flatnonzero(found[order][1:] == found[order][:-1])
        if len(again):
            k = int(order[again + 1].min())
            before = int(self.lines[np.argmax(found == found[k])]) + 1
            raise self.at(k, f"{what} {found[k]} was given before, on line {before}")
        return found

    def rising(self, name: str) -> Array:
        """Numbers (n,) of one column that must rise from row to row: times.

        Raises
        ------
        GraphFileError
            One that does not.
        """
        t = self.floats(name)[:, 0]
        if (late := t[1:] <= t[:-1]).any():
            k = int(np.argmax(late)) + 1
            raise self.at(
                k, f"{name} {float(t[k])!r} does not rise over {float(t[k - 1])!r} before it; sort the rows by time"
            )
        return t

    def known(self, name: str, among: Numbers, problem: str) -> Numbers:
        """Whole numbers (n,) of one column, each of them among others; `problem` says what is wrong where it is not.

        Raises
        ------
        GraphFileError
        """
        found = self.integers(name)
        if (missing := ~np.isin(found, among)).any():
            k = int(np.argmax(missing))
            raise self.at(k, f"{name} {found[k]}: {problem}")
        return found

    def text_of(self, name: str) -> list[str]:
        """Cells of one column as text, without the quotation marks around them."""
        cells = self._cells([name])[:, 0]
        words = [self._given[s - PAD : e - PAD] for s, e in zip(self.starts[cells], self.ends[cells], strict=True)]
        quoted = [len(word) > 1 and word[:1] == word[-1:] == b'"' for word in words]
        return [
            printable(word[1:-1].replace(b'""', b'"') if within else word)
            for word, within in zip(words, quoted, strict=True)
        ]

    def at(self, row: int, message: str) -> GraphFileError:
        """An error at a row."""
        return self.error(message, int(self.lines[row]))


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
        for each in array.reshape(len(array), -1).T.tolist():
            cells.append([item if isinstance(item, str) else repr(item) for item in each])
    rows = [",".join(row) for row in zip(*cells, strict=True)]
    return ("\n".join([",".join(names), *rows]) + "\n").encode()
