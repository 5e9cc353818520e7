"""noise.csv: one standard deviation for each kind of measurement of a log."""

from __future__ import annotations

from nls.io.mission.columns import MAY_BE_0
from nls.io.mission.table import Table

__all__ = ["noise_of", "one_row"]


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
        elif (number := float(table.measured(name)[0, 0])) < 0:
            raise table.at(0, f"{name} is {number!r}; expected 0 or above")
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
