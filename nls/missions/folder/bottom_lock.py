"""Which rows of dvl.csv see the bottom: marked valid, with three beams or more, and an altitude above 0."""

from __future__ import annotations

import numpy as np

from models.algebra import Mask
from models.errors import GraphFileError
from nls.missions.folder.table import Table

__all__ = ["bottom_lock", "locked_rows"]

BEAMS, MOST_BEAMS = 3, 16  # that give a velocity; that no DVL has more of


def bottom_lock(dvl: Table, notes: list[str]) -> Mask:
    """Which rows (n,) see the bottom, by all columns that say so; notes count those that a column rules out."""
    valid = np.ones(len(dvl), dtype=bool)
    if not (dvl.has("valid") or dvl.has("beams")):
        raise GraphFileError(
            "has no column 'valid' and none 'beams'; expected valid, 1 where the DVL had bottom lock, else 0, or "
            "beams, how many of its beams saw the bottom",
            dvl.path,
        )
    if dvl.has("valid"):
        valid &= dvl.flags("valid", "1 where the DVL had bottom lock, else 0")
    if dvl.has("beams"):
        beams = dvl.integers("beams")
        expected = f"expected how many see the bottom, 0 to {MOST_BEAMS}"
        dvl.refuse_rows((beams < 0) | (beams > MOST_BEAMS), lambda k: f"beams is {beams[k]}; {expected}")
        valid = locked_rows(dvl, valid, beams >= BEAMS, f"fewer than {BEAMS} beams on the bottom", notes)
    if dvl.has("altitude_m"):
        altitude = dvl.measured("altitude_m", rows=valid)[:, 0]
        valid = locked_rows(dvl, valid, altitude > 0, "an altitude that is not above 0", notes)
    return valid


def locked_rows(dvl: Table, valid: Mask, kept: Mask, reason: str, notes: list[str]) -> Mask:
    """The valid rows that are kept; a note counts the others."""
    if (left_out := valid & ~kept).any():
        many = int(left_out.sum())
        rows = "this row has" if many == 1 else f"{many} rows, this one the first, have"
        notes.append(f"{dvl.place(int(np.argmax(left_out)))}: {rows} {reason}: without bottom lock")
    return valid & kept
