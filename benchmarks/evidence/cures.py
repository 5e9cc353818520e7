"""Cures that the program prints, found in its words and followed to the letter.

    write `declination_rad,-0.2274,0.0009` in calibration.csv      a row of that file
    write `unit = "cm"` for z_m in [depth] of the mapping          keys of a column, or of a section
    multiply z_m by -1; divide vx_m_s, vy_m_s by 1000              numbers of a table
    subtract 18 s from time_s; add 10.1 to z_m and divide by 10    the same, one after the other
    exchange the names of lat_deg, lon_deg                         columns of a table
    leave out lines 7 to 10, 14 of depth.csv                       rows of a table
    --robust Position=cauchy:1                                     an option of `nls solve`

What names a table, column or section that is not there cannot be followed: `Unfollowable`.
"""

from __future__ import annotations

import csv
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

LOGS = ".log"  # the end of the name of a log, before its suffix
NUMBER, NAME = r"[-+]?\d[\d.]*(?:e[-+]?\d+)?", r"(?:\w+_\w+|valid|it)\b"
NAMES = rf"{NAME}(?:(?:, | and ){NAME})*"
VALUE = r"""(?:\{[^}]*\}|\[[^\]]*\]|"[^"]*"|'[^']*'|[-+\w.]+)"""
ACT = rf"(?:(?:multiply|divide)(?: {NAMES})? by {NUMBER}|(?:subtract|add) {NUMBER}(?: s)? (?:from|to) {NAMES})"
ACTS = re.compile(
    rf"(?P<act>multiply|divide|subtract|add) (?:(?P<x>{NUMBER})(?: s)? (?:from|to) (?P<to>{NAMES})|"
    rf"(?:(?P<of>{NAMES}) )?by (?P<y>{NUMBER}))"
)
FORMS = {  # by what is edited
    "calibration": rf"write `?(\w+),({NUMBER}),({NUMBER})`? in calibration\.csv",
    "key": rf"write (`[^`]+`(?: and `[^`]+`)*)(?: for ({NAMES}))? in \[(\w+)\] of the mapping",
    "cell": rf"write `?(\w+ = {VALUE})`?",
    "numbers": rf"({ACT}(?:(?:,? then|,? and) {ACT})*)",
    "names": rf"exchange the names of (?!the )({NAMES})",
    "rows": r"leave out lines? (\d[\d, to]*?)(?:,? and (\d+) more)? of ([\w.]+)\.csv",
    "option": r"--robust ((?:\w+=)?[a-z-]+:[\d.]+)",
}
ANY = re.compile("|".join(f"(?P<{name}>{form})" for name, form in FORMS.items()))
TABLE = re.compile(r"([\w.]+)\.csv")
ORIGIN = ", in origin.csv as well"
LINE, SECTION, LOG = (
    re.compile(r"\.toml:(\d+)"),
    re.compile(r"in \[(\w+)\] of the mapping"),
    re.compile(r"([\w.]+):\d+:"),
)


class Unfollowable(Exception):
    """A cure that names what is not there."""


@dataclass(frozen=True)
class Cure:
    """One cure.

    Attributes
    ----------
    form : of `FORMS`.
    words : the parts of it.
    sentence : that it stands in.
    said : where in the sentence.
    """

    form: str
    words: tuple[str | None, ...]
    sentence: str
    said: int

    @property
    def of_mapping(self) -> bool:
        """True for a cure of the mapping."""
        return self.form in ("key", "cell")

    @property
    def of_log(self) -> bool:
        """True for a cure of a log, not of a table of the mission."""
        return self.form == "rows" and f"{self.words[2]}".endswith(LOGS)

    @property
    def text(self) -> str:
        """The words as printed."""
        match = ANY.match(self.sentence, self.said)
        return match[0] if match else ""

    def map(self, mapping: dict[str, Any], written: str) -> None:
        """Edit a mapping, which was written so.

        Raises
        ------
        Unfollowable
        """
        if self.form == "key":
            line, columns, section = self.words
        else:
            line, columns, section = self.words[0], None, self._section(mapping, written)
        keys = ", ".join(re.findall("`([^`]+)`", f"{line}")) or line
        try:
            new = tomllib.loads(f"x = {{ {keys} }}")["x"]
        except (ValueError, tomllib.TOMLDecodeError) as error:
            raise Unfollowable(f"no line of a mapping: {line}") from error
        if section and not isinstance(mapping.get(section), dict):
            raise Unfollowable(f"no [{section}] in the mapping")
        place = mapping[section] if section else mapping
        if columns is None:
            for key, value in new.items():
                both = isinstance(value, dict) and isinstance(place.get(key), dict)
                place[key] = place[key] | value if both else value
            return
        for column in names_in(columns):
            cell = place.get(column, mapping.get(column))
            if not isinstance(cell, str | dict):
                raise Unfollowable(f"{column} is no column of the log in [{section}]")
            place[column] = ({"column": cell} if isinstance(cell, str) else cell) | new

    def edit(self, mission: Path) -> None:
        """Edit the tables of a mission, or the logs in a folder.

        Raises
        ------
        Unfollowable
        """
        if self.form == "calibration":
            file = mission / "calibration.csv"
            rows = read(file) if file.exists() else [["name", "value", "sigma"]]
            write(file, [row for row in rows if row[0] != self.words[0]] + [[str(word) for word in self.words]])
            return
        tables = [self.words[2] if self.form == "rows" else self._table()]
        tables += ["origin"] if self.sentence.startswith(ORIGIN, self.said + len(self.text)) else []
        for table in tables:
            file = mission / f"{table}.csv"
            if not file.exists():
                raise Unfollowable(f"no {file.name}")
            head, *rows = read(file)
            if self.form == "rows":
                spans = [list(map(int, re.findall(r"\d+", part))) for part in str(self.words[0]).split(",")]
                out = {line for span in spans for line in range(span[0], span[-1] + 1)}
                rows = [row for line, row in enumerate(rows, start=2) if line not in out]
            elif self.form == "names":
                a, b = self._columns(head, self.words[0])
                head[a], head[b] = head[b], head[a]
            else:
                self._calculate(head, rows)
            write(file, [head, *rows])

    def _calculate(self, head: list[str], rows: list[list[str]]) -> None:
        """Do one act after the other; a later one may be of the columns of the one before."""
        columns: list[int] = []
        for act in ACTS.finditer(str(self.words[0])):
            if (names := act["of"] or act["to"]) and names != "it":
                columns = self._columns(head, names)
            x = float(act["x"] or act["y"])
            for row in rows:
                for k in columns:
                    if row[k]:
                        y = float(row[k])
                        row[k] = repr({"multiply": y * x, "divide": y / x, "add": y + x, "subtract": y - x}[act["act"]])

    def _columns(self, head: list[str], words: str | None) -> list[int]:
        if missing := [name for name in names_in(words) if name not in head]:
            raise Unfollowable(f"no column {missing[0]}")
        return [head.index(name) for name in names_in(words)]

    def _table(self) -> str:
        """The table that is spoken of: the last one before the cure."""
        tables = [match[1] for match in TABLE.finditer(self.sentence, 0, self.said)]
        if not tables:
            raise Unfollowable("no table is named")
        return tables[-1]

    def _section(self, mapping: dict[str, Any], written: str) -> str | None:
        """The section that is named; else that of the line of the mapping or of the log; none above all sections."""
        if named := SECTION.search(self.sentence, self.said):
            return named[1]
        if line := LINE.search(self.sentence):
            above = re.findall(r"^\[(\w+)\]", "\n".join(written.splitlines()[: int(line[1])]), re.M)
            return above[-1] if above else None
        if log := LOG.search(self.sentence):
            for name, section in mapping.items():
                if isinstance(section, dict) and section.get("file") == log[1]:
                    return name
        raise Unfollowable("no section is named")


def cures_of(sentence: str) -> list[Cure]:
    """The cures of a sentence, in its order."""
    out = []
    for match in ANY.finditer(sentence):
        form = next(name for name in FORMS if match[name])
        words = re.match(FORMS[form], match[0])
        assert words is not None
        out.append(Cure(form, words.groups(), sentence, match.start()))
    return out


def names_in(words: str | None) -> list[str]:
    return re.split(", | and ", words or "")


def read(file: Path) -> list[list[str]]:
    with file.open(newline="", encoding="utf-8") as lines:
        return list(csv.reader(lines))


def write(file: Path, rows: list[list[str]]) -> None:
    with file.open("w", newline="", encoding="utf-8") as lines:
        csv.writer(lines, lineterminator="\n").writerows(rows)
