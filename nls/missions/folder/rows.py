"""The graph that the files of a mission add to, and columns that several have: lever arms, robust kernels, sigmas."""

from dataclasses import dataclass, field

import numpy as np

from factors.base import Factor
from factors.robust import Kernel, kernel_from_text
from models.algebra import Array, Mask
from models.errors import NoiseModelError, OptionError
from nls.graph import FactorGraph
from nls.io.report import Source
from nls.missions.folder.calibration import Calibrations
from nls.missions.folder.columns import ARM, MAY_BE_0
from nls.missions.folder.folder import MissionReport
from nls.missions.folder.table import Table

NO_KERNEL = "none"
Times = dict[str, Array]  # of the rows (n, k) of files, s; closures.csv has two a row


@dataclass(frozen=True)
class Assembly:
    """The tables of a mission, and the graph that is made of them.

    Attributes
    ----------
    tables : by name.
    report : gets notes, and the lines of the factors.
    calibrations : of calibration.csv.
    times : of the rows of files, see `nls.missions.folder.timeline`.
    graph : gets the factors.
    """

    tables: dict[str, Table]
    report: MissionReport
    calibrations: Calibrations
    times: Times
    graph: FactorGraph = field(default_factory=FactorGraph)

    def add(self, factor: Factor, source: Source) -> None:
        """Add a factor, with the lines that it was read from."""
        self.graph.add(factor)
        self.report.sources.append(source)

    def of_table(self, name: str) -> list[int]:
        """The numbers of the factors that were read from a table."""
        return [k for k, source in enumerate(self.report.sources) if source.path == self.tables[name].path]

    def add_rows(self, table: Table, rows: Mask, factor: Factor) -> None:
        """Add a factor of all rows for those that count, in parts for each robust kernel; note their lines.

        Raises
        ------
        GraphFileError
            No such kernel.
        """
        index = np.flatnonzero(rows)
        kernels: dict[str, Kernel | None] = {}
        words = table.text_of("kernel") if table.has("kernel") else [NO_KERNEL] * len(table)
        for row, word in enumerate(words):
            if word not in kernels:
                try:
                    kernels[word] = None if word == NO_KERNEL else kernel_from_text(word)
                except (OptionError, NoiseModelError) as error:
                    expected = f"expected one such as huber:1.345, or none: {error}"
                    raise table.at(row, f"kernel is {word!r}; {expected}") from error
        column = np.array(words)
        for word, kernel in kernels.items():
            if len(some := index[column[index] == word]):
                self.add(factor[some] if kernel is None else factor[some].robust(kernel), table.source(some))


def columns_together(table: Table, *names: str) -> bool:
    """Whether a file has columns that need each other.

    Raises
    ------
    GraphFileError
        It has some of them.
    """
    here = [name for name in names if table.has(name)]
    if here and len(here) < len(names):
        missing = next(name for name in names if name not in here)
        raise table.at_names(f"has {here[0]} and no {missing}; they need each other")
    return bool(here)


def arms(table: Table) -> Array | None:
    """Lever arms (n, 3) of the rows, m; None where the antenna is at the center of the vehicle."""
    a = table.measured(*ARM) if columns_together(table, *ARM) else np.zeros((1, 3))
    return a if a.any() else None


def noise_of(table: Table, used: dict[str, str]) -> dict[str, float]:
    """The numbers of noise.csv by column.

    Parameters
    ----------
    table : of the file.
    used : columns that must be there, each with the table that needs it.

    Raises
    ------
    GraphFileError
        A second row, a number that cannot be, a column that is missing.
    """
    noise = one_row(table)
    for name in noise:
        if name not in MAY_BE_0:
            table.positive(name)
        else:
            number = table.measured(name)
            table.refuse_numbers(number < 0, number, "0 or above", name)
    for name, user in used.items():
        if name not in noise:
            raise table.at(0, f"there is no column {name}, which {user}.csv needs")
    return noise


def one_row(table: Table) -> dict[str, float]:
    """The numbers of a table of one row, by column.

    Raises
    ------
    GraphFileError
        A second row.
    """
    if len(table) > 1:
        raise table.at(1, "a second row; expected one")
    return dict(zip(table.names, table.floats(*table.names)[0].tolist(), strict=True))
