"""Mappings that are none, and logs that they do not fit: each mistake with its line and what to write."""

from __future__ import annotations

from pathlib import Path

from nls.missions.importing import Mapping
from tests.combinations import for_all
from tests.nls.io.g2o_files import cases
from tests.nls.missions.importing.logs import refused

LOG = "t,depth,word,Altitude [m],p [dbar],late\n0,5,deep,-5,5,0\n1,5,deep,-5,5,700000\n"
DEPTH = '[depth]\ntime_s = "t"\nz_m = "depth"'

# a mapping, of which DEPTH stands for the three lines above; words of the error
REFUSED = cases(r"""
[dvl | :1: is no TOML
a = 1\n\nb = "x\n | :3: is no TOML
[dvl]\nvalid = [1, 2\n\n\n\n | :2: is no TOML: Unclosed array
[dvl]\nvalid = [1, 2\n\n\nvx_m_s = 3 | :2: is no TOML: Unclosed array
[dvl]\nvalid = '''abc\n\n\n | :2: is no TOML: Expected "'''"
[dvl]\nvalid =\n\n\n | :2: is no TOML: Invalid value
 | mapping.toml: has no section
[dvll] | :1: [dvll] is no table of a mission; did you mean 'dvl'?
seperator = ';'\n[dvl] | :1: 'seperator' is no table of a mission and no option; did you mean 'separator'?
[depth]\nz_m = 1\n\n[dvl]\nvx = "u" | :5: dvl.csv has no column 'vx'; did you mean 'vx_m_s'?; write vx_m_s = "u"
dvl.vx = "u" | :1: dvl.csv has no column 'vx'
dvl = { time_s = "t", vx = "u" } | :1: dvl.csv has no column 'vx'
[contacts]\ncolour = "red" | :2: contacts.csv has no column 'colour'; it has i, time_s, landmark
[dvl]\nvelocity = ["a", "b"] | :2: velocity is ['a', 'b']; expected a list for vx_m_s, vy_m_s, vz_m_s
[dvl]\nvx_m_s = { colum = "a" } | :2: vx_m_s: 'colum' is no key of a column; did you mean 'column'?
[dvl]\nvx_m_s = { column = "a", unit = "m" } | unit 'm' is not one of m/s, mm/s
[dvl]\nvx_m_s = { column = "a", unit = [] } | :2: vx_m_s: unit [] is not one of m/s, mm/s
[dvl]\nvx_m_s = { column = "a", sign = 2 } | sign is 2; expected 1 or -1
[dvl]\nvx_m_s = { column = "a", unit = "m/s", scale = 2 } | unit and scale are both given
[dvl]\nvx_m_s = { column = "a", up = true } | up = true is for z_m alone
[dvl]\nvx_m_s = { column = "a", scale = nan } | :2: vx_m_s: scale is nan; expected a finite number
[dvl]\nvx_m_s = { column = "a", scale = 0 } | scale is 0; expected a finite number other than 0
[dvl]\nvx_m_s = [1] | vx_m_s: [1] is not possible; expected the name of a column
[dvl]\nframe = "ENV" | :2: frame is 'ENV'; expected one of NED, ENU
[dvl]\nskip = -1 | skip is -1; expected a whole number
[ahrs]\nquaternion = [1, 2] | expected a list of 4 columns, or of 4 numbers: x, y, z, w
[fixes]\nx_m = "x"\nsigma_x_m = -2 | :3: sigma_x_m: -2 is not possible; expected a standard deviation above 0, 1e-12 to
[noise]\nsigma_z_m = 0.0 | :2: sigma_z_m: 0.0 is not possible
[noise]\nscale = -0.1 | :2: scale: -0.1 is not possible; expected 0 or above
[noise]\nsigma_z_m = inf | :2: sigma_z_m: inf is not possible; expected a finite number
[path]\nx_m = 1\nsigma_position = [1, 0, 1] | :3: sigma_y_m: 0 is not possible
[[fixes]]\nx_m = "x"\n[[fixes]]\nx_m = 1\nsigma_x_m = 0 | :5: sigma_x_m: 0 is not possible
[poses]\ni = { row = 10000000000000000000000000000000000000000 } | :2: i: row is 1000
[poses]\ni = { row = true } | row is True; expected the number of the first row, such as { row = 0 }
[sonar]\nname = '''a\nb''' | expected one line [name = '''a]
time_s = "t"\nseparator = "ab"\n\n[depth]\nz_m = "depth" | :2: separator is 'ab'
DEPTH\nmissing = true | :4: missing is True; expected numbers and words that stand for none
DEPTH\nmissing = [1, []] | :4: missing is [1, []]; expected numbers
DEPTH\nmissing = { z = 1 } | :4: missing: 'z' is not mapped here; did you mean 'z_m'?
DEPTH\nmissing = inf | :4: missing is inf; expected
DEPTH\nrows = [] | :4: rows is []; expected [first], or [first, last]
DEPTH\nrows = [9] | :4: rows = [9] leaves no row
DEPTH\nmissing_together = 0 | :4: missing_together is 0; expected a table of such by column
DEPTH\nmissing_together = { z = 0 } | :4: missing_together: 'z' is not mapped here; did you mean 'z_m'?
DEPTH\ntime_format = 5 | :4: time_format is 5; expected how times are written, such as '%m/%d/%Y
DEPTH\ntime_format = "%m/%d %H:%M" | :4: time_format = '%m/%d %H:%M' names no year; expected %Y or %y, or write `date =
DEPTH\ntime_format = "%Y %H:%M" | :4: time_format = '%Y %H:%M' reads 2022-08-25 13:59 as 2022-01-01 13:59
DEPTH\ntime_format = "%Y %Q" | 'Q' is a bad directive
DEPTH\ntime_format = "%Y %Y" | has a directive twice
DEPTH\ntime_format = "%d.%m.%Y %H:%M %Z" | write %z for +02:00
DEPTH\ntime_format = "%Y%m%d %H" | log.csv:2: '0' does not fit %Y%m%d %H, of a year in 1970 to 2190; expected
DEPTH\ndate = "15.08.2022" | :4: date is '15.08.2022'; expected the day of the first row
DEPTH\ndate = "2022-08-15"\ntime_format = "%d.%m.%Y %H:%M" | has a date and so has date; leave date out
DEPTH\n[noise]\ntime_format = "%Y" | :5: [noise] has no column of times; leave time_format out
DEPTH\n[poses]\ni = 0\ntime_s = 1\ndate = "2022-08-15" | [poses] has no column of times; leave date out
[depth]\ntime_s = "late"\nz_m = "depth"\ndate = "2022-08-15" | log.csv:3: 700000 s is later than a day or a week of GPS;
[depth]\ntime_s = "t"\nz_m = "dept" | :3: log.csv has no column 'dept'; write z_m = "depth"; it has
[depth]\ntime_s = "t" | :1: [depth] has no z_m; write z_m = "depth"
[depth]\ntime_s = "t"\nz_m = "Altitude [m]" | write z_m = { column = "Altitude [m]", up = true }, or up = false
[depth]\ntime_s = "t"\nz_m = "p [dbar]" | 'p [dbar]' is in dbar, pressure; z_m is a length, m; scale and offset
[depth]\ntime_s = "t"\nz_m = { column = "depth", unit = "dbar" } | ; of a pressure give scale
[depth]\ntime_s = "t"\nz_m = "word" | 'deep' is not a number; correct it, or name another column; in the mapping write
[depth]\ntime_s = "word"\nz_m = "depth" | log.csv:2: word: 'deep' is not a number
[depth]\ntime_s = 3\nz_m = "depth" | time_s is a constant, and times rise
[depth]\ntime_s = "Altitude [m]"\nz_m = "depth" | 'Altitude [m]' is in m, length; time_s is a time, s
[depth]\ntime_s = { column = "t", scale = 1e10 }\nz_m = "depth" | log.csv:3: t: 1e+10 s is no time
DEPTH\njoin = 3 | mapping.toml:4:
DEPTH\nskip = 9 | has no row; expected a line of names and rows of values; correct skip
DEPTH\nwhere = { column = "x", equals = 1 } | mapping.toml:4:
sonar.file = "log.csv" | mapping.toml:1: [sonar] uses no column of log.csv; name one of its columns, or leave file out
[motion]\nsigma_walk_m_sqrt_s = 1 | mapping.toml: uses no column of log.csv; write the name of one
""")


@for_all(case=REFUSED)
def test_a_mapping_is_refused(case: list[str], tmp_path: Path) -> None:
    assert case[1] in refused(tmp_path, case[0].replace("DEPTH", DEPTH) + "\n", log=LOG)


@for_all(
    case=cases(r"""
t,z\n0,1,5 | log.csv:2: 3 cells, expected 2: t, z; in the mapping where =
t,z,z\n0,1,2 | header = false and skip = 1 of the mapping call them 1, 2
t,z\n0,\n1,nan | mapping.toml:3: no row of log.csv has all that [depth] needs: z_m has none
t,z\n,1 | mapping.toml:2: no row of log.csv has all that [depth] needs: time_s has none
""")
)
def test_a_log_is_refused(case: list[str], tmp_path: Path) -> None:
    assert case[1] in refused(tmp_path, DEPTH.replace('depth"', 'z"'), log=case[0] + "\n")


def test_what_stands_above_all_sections() -> None:
    """A key there is for every table that has it; a section may say otherwise, and a row of a pose has no time."""
    text = 'time_s = "t"\nsort = true\ndepth.z_m = "z"\nnoise.scale = 0.1\n'
    text += 'ahrs = { time_s = "u", sort = false }\ntruth.i = "k"\n'
    depth, noise, ahrs, truth = Mapping(text, "m.toml").sections
    assert [depth.cells["time_s"].columns, ahrs.cells["time_s"].columns] == [("t",), ("u",)]
    assert [depth.options["sort"], ahrs.options["sort"]] == [True, False]
    assert ("time_s" in noise.cells, "time_s" in truth.cells) == (False, False)
