"""``nls import`` and ``nls new``: what they print and write, and where other commands point to them."""

from __future__ import annotations

import re

from tests.nls.cli.shell import Shell, rows
from tests.nls.missions.folder.mission_files import raw

LOG = "t [s];depth [cm];note\n0;250;a\n1;260;b\n"
MAPPING = 'depth = { time_s = "t [s]", z_m = "depth [cm]" }\n'


def test_a_log_without_a_mapping_gives_a_draft(shell: Shell) -> None:
    shell.file(LOG, "log.csv")
    out, err = shell.both("import log.csv")
    assert '[depth]\ntime_s = "t [s]"\nz_m = "depth [cm]"\n# not used: \'note\'' in out
    assert err == "nls: this is a draft: save it as mapping.toml, correct it, and give it by --map\n"


def test_a_log_becomes_a_mission(shell: Shell) -> None:
    shell.file(LOG, "log.csv")
    shell.file(MAPPING, "mapping.toml")
    out = shell("import log.csv --map mapping.toml -o mission")
    assert rows(out, "written") == ["mission: depth 2"]
    assert "nls solve needs dvl.csv, ahrs.csv, noise.csv besides" in rows(out, "note")[-1]
    assert (shell / "mission" / "depth.csv").read_text() == "time_s,z_m\n0.0,2.5\n1.0,2.6\n"
    assert MAPPING in (shell / "mission" / "README.txt").read_text()


def test_refusals(shell: Shell) -> None:
    shell.file(LOG, "log.csv")
    shell.file(MAPPING, "mapping.toml")
    shell.file("[depth\n", "damaged.toml")
    assert "-o is missing; expected a folder for the mission: -o mission" in shell.refused(
        "import log.csv --map mapping.toml"
    )
    assert "--map is missing beside -o; a draft of a mapping: nls import LOG > mapping.toml" in shell.refused(
        "import log.csv -o mission"
    )
    assert "nothing.csv: cannot be read" in shell.refused("import nothing.csv --map mapping.toml -o mission")
    assert "nothing.toml: cannot be read" in shell.refused("import log.csv --map nothing.toml -o mission")
    assert "damaged.toml:1: is no TOML" in shell.refused("import log.csv --map damaged.toml -o mission")
    assert "cannot be read" in shell.refused("import nothing.csv")
    (shell / "folder").mkdir()
    assert "is a folder" in shell.refused("import folder")


def test_tables_that_are_no_mission_point_to_the_import(shell: Shell) -> None:
    for text in (LOG, LOG.replace(";", ","), LOG.replace(";", "\t"), "0 1 2 3.5\n1 2 3 4.5\n"):
        shell.file(text, "log.csv")
        error = shell.refused("solve log.csv")
        assert "nls import log.csv prints a mapping" in error
        assert "nls new FOLDER" in error
    (shell / "mission").mkdir()
    shell.file(LOG, "mission/log.csv")
    assert "nls import mission/log.csv prints a mapping" in shell.refused("solve mission")


def test_a_column_that_no_table_has_points_to_the_mapping(shell: Shell) -> None:
    (shell / "m").mkdir()
    for name, text in {**raw(), "dvl": "time_s,vel_x_m_s,vy_m_s,vz_m_s,valid\n0,1,1,1,1.0\n"}.items():
        shell.file(text, f"m/{name}.csv")
    error = shell.refused("solve m")
    assert "unknown column 'vel_x_m_s'; expected time_s" in error
    assert "; did you mean 'vx_m_s'?" in error
    assert '[dvl] vx_m_s = "vel_x_m_s"' in error


def test_flags_with_a_decimal_point_are_flags(shell: Shell) -> None:
    (shell / "m").mkdir()
    for name, text in raw().items():
        shell.file(re.sub(r",1$", ",1.0000", text, flags=re.M) if name == "dvl" else text, f"m/{name}.csv")
    shell("solve m")
    shell.file(raw()["dvl"].replace(",1\n", ",yes\n", 1), "m/dvl.csv")
    assert "valid is 'yes'; expected 0 or 1" in shell.refused("solve m")


def test_new_never_overwrites(shell: Shell) -> None:
    (shell / "mission").mkdir()
    shell.file("mine", "mission/mapping.toml")
    out = shell("new mission")
    assert rows(out, "note") == ["kept as they are: mapping.toml"]
    assert (shell / "mission" / "mapping.toml").read_text() == "mine"
    assert (shell / "mission" / "templates" / "dvl.csv").read_text().count("# ") == 4
    before = shell.contents()
    assert rows(shell("new mission"), "written") == ["mission: 0 templates"]
    assert shell.contents() == before
    shell("new other --map")
    assert [path.name for path in (shell / "other").iterdir()] == ["mapping.toml"]
