"""A mapping that is none: each mistake with its line and what to write."""

from __future__ import annotations

import pytest

from nls import GraphFileError
from nls.missions.importing import Mapping
from tests.combinations import for_all


@for_all(
    case=[
        ("[dvl\n", "m.toml:1: is no TOML"),
        ('a = 1\n\nb = "x\n', "m.toml:3: is no TOML"),
        ("[dvl]\nvalid = [1, 2\n\n\n\n", "m.toml:2: is no TOML: Unclosed array"),
        ("[dvl]\nvalid = [1,\n2 3]\n\n", "m.toml:3: is no TOML: Unclosed array"),
        ("[dvl]\nvalid = [1, 2\n\n\nvx_m_s = 3\n", "m.toml:2: is no TOML: Unclosed array"),
        ('[dvl]\nvalid = """abc\n\n\n', "m.toml:2: is no TOML: Unterminated string"),
        ("[dvl]\nvalid =\n\n\n", "m.toml:2: is no TOML: Invalid value"),
        ("", "has no section"),
        ("[dvll]\n", "m.toml:1: [dvll] is no table of a mission; did you mean 'dvl'?"),
        (
            "seperator = ';'\n[dvl]\n",
            "m.toml:1: 'seperator' is no table of a mission and no option; did you mean 'separator'?",
        ),
        (
            '[depth]\nz_m = 1\n\n[dvl]\nvx = "u"\n',
            "m.toml:5: dvl.csv has no column 'vx'; did you mean 'vx_m_s'?; write vx_m_s = \"u\"",
        ),
        ('dvl.vx = "u"\n', "m.toml:1: dvl.csv has no column 'vx'"),
        ('dvl = { time_s = "t", vx = "u" }\n', "m.toml:1: dvl.csv has no column 'vx'"),
        ('[contacts]\ncolour = "red"\n', "m.toml:2: contacts.csv has no column 'colour'; it has i, time_s, landmark"),
        (
            '[dvl]\nvelocity = ["a", "b"]\n',
            "m.toml:2: velocity is ['a', 'b']; expected a list for vx_m_s, vy_m_s, vz_m_s",
        ),
        (
            '[dvl]\nvx_m_s = { colum = "a" }\n',
            "m.toml:2: vx_m_s: 'colum' is no key of a column; did you mean 'column'?",
        ),
        ('[dvl]\nvx_m_s = { column = "a", unit = "m" }\n', "unit 'm' is not one of m/s, mm/s"),
        ('[dvl]\nvx_m_s = { column = "a", unit = 0 }\n', "m.toml:2: vx_m_s: unit 0 is not one of m/s, mm/s"),
        ('[dvl]\nvx_m_s = { column = "a", unit = [] }\n', "m.toml:2: vx_m_s: unit [] is not one of m/s, mm/s"),
        ('[dvl]\nvx_m_s = { column = "a", sign = 2 }\n', "sign is 2; expected 1 or -1"),
        ('[dvl]\nvx_m_s = { column = "a", unit = "m/s", scale = 2 }\n', "unit and scale are both given"),
        ('[dvl]\nvx_m_s = { column = "a", up = true }\n', "up = true is for z_m alone"),
        ('[dvl]\nframe = "ENV"\n', "m.toml:2: frame is 'ENV'; expected one of NED, ENU"),
        ("[dvl]\nskip = -1\n", "skip is -1; expected a whole number"),
        ("[ahrs]\nquaternion = [1, 2]\n", "expected a list of 4 columns, or of 4 numbers: x, y, z, w"),
        (
            '[fixes]\nx_m = "x"\nsigma_x_m = -2\n',
            "m.toml:3: sigma_x_m: -2 is not possible; expected a standard deviation above 0, 1e-12 to 1e12; write one, "
            "such as sigma_x_m = 2.0",
        ),
        ("[noise]\nsigma_z_m = 0.0\n", "m.toml:2: sigma_z_m: 0.0 is not possible"),
        ("[noise]\nscale = -0.1\n", "m.toml:2: scale: -0.1 is not possible; expected 0 or above"),
        ("[noise]\nsigma_z_m = inf\n", "m.toml:2: sigma_z_m: inf is not possible; expected a finite number"),
        (f"[noise]\nsigma_z_m = 1{'0' * 400}\n", "is not possible; expected a finite number"),
        ("[path]\nx_m = 1\nsigma_position = [1, 0, 1]\n", "m.toml:3: sigma_y_m: 0 is not possible"),
        ('[dvl]\nvx_m_s = { column = "a", scale = nan }\n', "m.toml:2: vx_m_s: scale is nan; expected a finite number"),
        ('[[fixes]]\nx_m = "x"\n[[fixes]]\nx_m = 1\nsigma_x_m = 0\n', "m.toml:5: sigma_x_m: 0 is not possible"),
        ('[dvl]\nvx_m_s = { column = "a", scale = 0 }\n', "scale is 0; expected a finite number other than 0"),
        (f"[poses]\ni = {{ row = 1{'0' * 40} }}\n", "m.toml:2: i: row is 1000"),
        ("[poses]\ni = { row = true }\n", "row is True; expected the number of the first row, such as { row = 0 }"),
        ('[sonar]\nname = "a\\nb"\n', "m.toml:2: name: 'a\\nb' is not possible; expected one line"),
        ("[dvl]\nvx_m_s = [1]\n", "vx_m_s: [1] is not possible; expected the name of a column"),
    ]
)
def test_mistakes(case: tuple[str, str]) -> None:
    with pytest.raises(GraphFileError) as error:
        Mapping(case[0], "m.toml")
    assert case[1] in str(error.value)


def test_what_stands_above_all_sections() -> None:
    """It is for every table that has it; a section may say otherwise, and a row of a pose has no time."""
    text = 'time_s = "t"\nsort = true\ndepth.z_m = "z"\nnoise.scale = 0.1\n'
    text += 'ahrs = { time_s = "u", sort = false }\ntruth.i = "k"\n'
    depth, noise, ahrs, truth = Mapping(text, "m.toml").sections
    assert [depth.cells["time_s"].columns, ahrs.cells["time_s"].columns] == [("t",), ("u",)]
    assert [depth.options["sort"], ahrs.options["sort"]] == [True, False]
    assert ("time_s" in noise.cells, "time_s" in truth.cells) == (False, False)


def test_an_option_above_all_sections_has_its_own_line() -> None:
    with pytest.raises(GraphFileError, match=r"m\.toml:2: separator is 'ab'"):
        Mapping('time_s = "t"\nseparator = "ab"\n\n[depth]\nz_m = "z"\n', "m.toml")
