"""Times of a log as text, of a day and as days; and each cure of a refusal, followed to the letter."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from nls import GraphFileError
from nls.missions.importing import Imported
from tests.combinations import for_all
from tests.nls.missions.importing.logs import column, imported, refused, table

DEPTH = '[depth]\ntime_s = "t"\nz_m = "z [m]"\n'
START = datetime(2022, 8, 15, 9, 59, 38)
SINCE_1970 = 1660557578
STEP = 0.5  # s


def log_of(words: list[str]) -> str:
    """A log with these times."""
    return "t,z [m]\n" + "".join(f'"{word}",{k}\n' for k, word in enumerate(words))


def written(form: str | Callable[[datetime], str], count: int = 4) -> list[str]:
    """Times from `START`, every half second."""
    times = [START + timedelta(seconds=STEP * k) for k in range(count)]
    return [f"{t:{form}}" if isinstance(form, str) else form(t) for t in times]


def followed(folder: Path, mapping: str, most: int = 3, **logs: str) -> tuple[Imported, str]:
    """The import after the cures that its refusals print, and the mapping then."""
    for _ in range(most):
        try:
            return imported(folder, mapping, **logs), mapping
        except GraphFileError as error:
            if lines := re.search(r"leave out lines ([\d, ]+) of (\w+)\.csv", str(error)):
                text = logs[lines[2]].splitlines(keepends=True)
                logs[lines[2]] = "".join(line for k, line in enumerate(text, 1) if str(k) not in lines[1].split(", "))
                continue
            cure = re.search(r"`([^`]+)`.*? in \[(\w+)\] of the mapping", str(error))
            if cure is None:
                raise
            key, head = cure[1].split(" = ")[0], f"[{cure[2]}]\n"
            before, section = mapping.split(head)
            mapping = before + head + cure[1] + "\n" + re.sub(rf"^{key} = .*\n", "", section, flags=re.M)
    return imported(folder, mapping, **logs), mapping


@for_all(
    form=["%m/%d/%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f", "%d.%m.%y %H:%M:%S,%f", "%Y%m%dT%H%M%S.%fZ",
          "%b %d %Y %H:%M:%S.%f", "%d-%B-%Y %H:%M:%S.%f", "%Y-%j %H:%M:%S.%f", "%m/%d/%Y %I:%M:%S.%f %p",
          "%H:%M:%S.%f %d/%m/%Y", "%a %b %d %H:%M:%S.%f %Y", "%Y/%m/%d %H:%M:%S.%f+0000", "%d %b %Y, %H:%M:%S.%f UTC"]
)  # fmt: skip
def test_a_refused_form_is_named(form: str, tmp_path: Path) -> None:
    """The line that is printed reads the same time."""
    result, mapping = followed(tmp_path, DEPTH, log=log_of(written(form)))
    assert "time_format = " in mapping
    assert table(result, "depth")["time_s"].tolist() == [0, 0.5, 1, 1.5]
    assert any(note.startswith("time_zero 2022-08-15T09:59:38.0") for note in result.notes)
    zoned = form.endswith(("Z", "UTC", "+0000"))
    assert any("names no zone; its times are taken to be UTC" in note for note in result.notes) != zoned


def test_both_orders_are_named_where_both_fit(tmp_path: Path) -> None:
    said = refused(tmp_path, DEPTH, log=log_of(["8/5/2022 9:59:38", "8/6/2022 9:59:38"]))
    assert "log.csv:2: '8/5/2022 9:59:38' is no time of ISO 8601; write `time_format" in said
    assert re.findall(r'time_format = "([^"]+)"', said) == ["%m/%d/%Y %H:%M:%S", "%d/%m/%Y %H:%M:%S"]


def test_a_date_beside_times_that_have_one_is_refused(tmp_path: Path) -> None:
    """Above all sections it is for all of them."""
    for word in ("2022-08-15T09:59:38Z", "15.08.2022 09:59"):
        said = refused(tmp_path, 'date = "2022-08-15"\n' + DEPTH, log=log_of([word]))
        assert re.search(r"log\.csv:2: .*; it has a date; leave date out of \[depth\]", said)


def test_no_zone_and_no_offset_shifts_times_beyond_what_a_log_has(tmp_path: Path) -> None:
    """A zone is at most 14 h ahead; an offset of centuries is none, and its nanoseconds are no whole number."""
    for zone in ("+99:99", "-15", "+1460", "+02:75"):
        word = f"2022-08-15T09:59:38{zone}"
        assert f"log.csv:2: '{word}' is no time of ISO 8601" in refused(tmp_path, DEPTH, log=log_of([word]))
    for zone, hours in (("+14:00", 38), ("-0930", 14.5), ("+05", 29)):
        log = log_of([f"2022-08-15T00:59:38{zone}", "2022-08-16T00:59:38Z"])
        assert column(tmp_path, "depth.time_s", DEPTH, log=log) == [0, 3600 * hours]
    for offset in (1e18, -1e18, 9e9, -9e9):
        mapping = DEPTH.replace('"t"', f'{{ column = "t", offset = {offset!r} }}')
        for time in ("5", "2022-08-15T09:59:38Z"):
            said = refused(tmp_path, mapping, log=log_of([time]))
            assert re.search(r"log\.csv:2: t: .* s is no time since 1970.*unit and offset of", said)


def test_zones_and_fractions_of_a_format(tmp_path: Path) -> None:
    """Two zones, nine digits and cells that are none."""
    words = ["15.08.2022 11:59:38.250000999 +0200", "--", "15.08.2022 09:59:39.5 Z", "null"]
    mapping = DEPTH + 'time_format = "%d.%m.%Y %H:%M:%S.%f %z"\n'
    result = imported(tmp_path, mapping, log=log_of(words))
    assert table(result, "depth")["time_s"].tolist() == [0.25, 1.5]
    assert f"time_zero 2022-08-15T09:59:38.000000000Z: {SINCE_1970} s since 1970" in "\n".join(result.notes)


@for_all(step=[1.0, 0.25])
def test_times_of_a_day_pass_midnight(step: float, tmp_path: Path) -> None:
    """Of numbers, and of two columns whose date is given; another log begins after midnight."""
    t = 86399 + step * np.arange(9)
    numbers = log_of([f"{s % 86400:.2f}" for s in t])
    result, mapping = followed(tmp_path, DEPTH, log=numbers)
    assert 'date = "2022-08-14"' in mapping
    assert table(result, "depth")["time_s"].tolist() == (t - 86399).tolist()
    assert any("the times begin anew at log.csv:" in note for note in result.notes)
    clock = log_of([f"{datetime(2022, 1, 1) + timedelta(seconds=float(s)):%H:%M:%S.%f}" for s in t])
    result, _ = followed(tmp_path, DEPTH, log=clock)
    assert table(result, "depth")["time_s"].tolist() == (t - 86399).tolist()
    both = f'date = 2022-08-14\n{DEPTH}file = "log.csv"\n[poses]\ntime_s = "at"\ni = "i"\n'
    both += "date = 2022-08-15\n"
    assert column(tmp_path, "poses.time_s", both, log=numbers, poses="at,i\n5,1\n") == [6]


def test_a_week_of_gps_begins_anew(tmp_path: Path) -> None:
    result, _ = followed(tmp_path, DEPTH, log=log_of(["604798", "604799.5", "0.5", "1"]))
    assert table(result, "depth")["time_s"].tolist() == [0, 1.5, 2.5, 3]


@for_all(off=[-604800, 604800, 1e7])
def test_rows_of_another_clock_are_named(off: float, tmp_path: Path) -> None:
    """By their lines; rows that are mixed are sorted."""
    t = np.arange(40.0)
    t[[20, 31]] += off
    log = log_of([f"{s:.0f}" for s in t])
    assert "of a clock of its own: leave out lines 22, 33 of log.csv" in refused(tmp_path, DEPTH, log=log)
    assert followed(tmp_path, DEPTH, log=log)[0].rows == {"depth": 38}
    t = np.arange(40) + np.where(np.arange(40) % 2, 3, 0)
    assert "write sort = true in [depth]" in refused(tmp_path, DEPTH, log=log_of([f"{s:g}" for s in t]))


@for_all(
    clock=[(25569, 86400, ""), (40587, 86400, ""), (719529, 86400, ""), (2440587.5, 86400, ""), (0, 86400, ""),
           (116444736000000000, 1e-7, ""), (621355968000000000, 1e-7, ""), (25569, 86400, " [day]")]
)  # fmt: skip
def test_clocks_that_count_no_seconds_are_named(clock: tuple[float, float, str], tmp_path: Path) -> None:
    """Days of a spreadsheet, modified Julian ones, of MATLAB, Julian ones, since 1970; ticks of 100 ns."""
    zero, size, unit = clock
    t = [(SINCE_1970 + STEP * k) / size for k in range(9)]
    log = log_of([f"{zero + round(x)}" if size < 1 else f"{zero + x:.9f}" for x in t])
    named = DEPTH.replace('"t"', f'"t{unit}"')
    result, mapping = followed(tmp_path, named, log=log.replace("t,", f"t{unit},"))
    assert "column = " in mapping
    t = table(result, "depth")["time_s"]
    assert t - t[0] == pytest.approx(STEP * np.arange(9), abs=1e-4)
    assert any(note.startswith("time_zero 2022-08-15T09:59:3") for note in result.notes)


@for_all(first=[45631.9, 730500.0, 59000.0])
def test_seconds_that_are_as_large_as_days_stay_seconds(first: float, tmp_path: Path) -> None:
    """Every 5 ms, as the fastest table."""
    log = log_of([f"{first + 0.005 * k:.3f}" for k in range(9)])
    assert column(tmp_path, "depth.time_s", DEPTH, log=log)[-1] == pytest.approx(first + 0.04)


def test_days_of_a_slow_log_are_named_where_it_says_days(tmp_path: Path) -> None:
    """Hours apart; a header with a word that is no unit is none."""
    log = "t [days],Time [UTC],z [m]\n" + "".join(f"{44788 + k / 24},{k},{k}\n" for k in range(4))
    result, _ = followed(tmp_path, DEPTH.replace('"t"', '"t [days]"'), log=log)
    assert table(result, "depth")["time_s"] == pytest.approx(3600 * np.arange(4), abs=1e-3)
    assert column(tmp_path, "depth.time_s", DEPTH.replace('"t"', '"Time [UTC]"'), log=log) == [0, 1, 2, 3]


def test_a_clock_that_is_reset_is_not_taken_for_midnight(tmp_path: Path) -> None:
    log = log_of([f"{s}" for s in (*range(0, 60000, 1500), *range(0, 60000, 1500))])
    assert "log.csv:42: the time falls from the row before; write sort = true" in refused(tmp_path, DEPTH, log=log)


@for_all(zero=[0, 86400])
def test_clocks_with_and_without_a_date_are_cured_by_it(zero: int, tmp_path: Path) -> None:
    """A Monday: of the day, or of the week of GPS, which began on Sunday."""
    mapping = DEPTH + '[poses]\ni = "i"\ntime_s = "at"\n'
    log = log_of([f"{zero + 35978}", f"{zero + 35979}"])
    result, _ = followed(tmp_path, mapping, log=log, poses="at,i\n2022-08-15T09:59:38Z,1\n")
    assert (table(result, "depth")["time_s"].tolist(), table(result, "poses")["time_s"].tolist()) == ([0, 1], [0])
    said = refused(tmp_path, mapping, log=log_of(["0", "5"]), poses="at,i\n2022-08-15T09:59:38Z,1\n")
    assert "write time_s = { column = ..., offset = SECONDS } in [depth]" in said


def test_one_wrong_cell_changes_no_unit(tmp_path: Path) -> None:
    """Seconds with a cell of 1e18 are not nanoseconds: the cell is refused, at its line."""
    said = refused(tmp_path, DEPTH, log=log_of(["0.5", "1.5", "2.5", "1e18"]))
    assert "log.csv:5: t: 1e+18 s is no time since 1970, nor of a dive" in said
