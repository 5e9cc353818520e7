"""Templates of a mission, to be filled by hand or by a script: heads, units and an example row each."""

import tomllib
from pathlib import Path
from typing import Any

from nls.missions.folder.columns import COLUMNS, LOG, TRACK, optional
from nls.missions.importing.headers import mission_unit

TEXTS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("templates.toml").read_text(encoding="utf-8"))
NOISE: str = TEXTS["noise"]
ABOUT, ALTERNATIVES, EXAMPLES = TEXTS["about"], TEXTS["alternatives"], TEXTS["examples"]


def templates(mapping: bool = False) -> dict[str, bytes]:
    """The files of ``nls new`` by name: mapping.toml, and unless it is asked for alone a template of each table.

    Examples
    --------
    >>> print(templates()["templates/depth.csv"].decode())
    # depth.csv: depth, down. Needed for a raw log.
    # s, m
    time_s,z_m
    # 0.0,5.0
    >>> list(templates(mapping=True))
    ['mapping.toml']
    """
    sections = map(_section, (*LOG[:3], "path", "motion", "fixes", "contacts", "sonar"))
    files = {"mapping.toml": (TEXTS["head"] + "\n".join([*sections, NOISE])).encode()}
    if not mapping:
        files |= {f"templates/{table}.csv": _template(table).encode() for table in COLUMNS}
    return files


def _template(table: str) -> str:
    """Head and one example of a table."""
    columns = [name for name in COLUMNS[table] if name not in ALTERNATIVES.get(table, ())]
    need = f" Needed for {'a raw log' if table in LOG else 'an integrated track'}." if table in (*LOG, *TRACK) else ""
    lines = [f"# {table}.csv: {ABOUT[table]}.{need}"]
    lines.append("# " + ", ".join(mission_unit(name)[1] or "-" for name in columns))
    if left_out := [name for name in columns if name in optional(table, LOG)]:
        lines.append(f"# may be left out: {', '.join(left_out)}")
    if others := ALTERNATIVES.get(table):
        lines.append(f"# other columns: {', '.join(others)}")
    return "\n".join([*lines, ",".join(columns), "# " + ",".join(example(table, column) for column in columns)]) + "\n"


def _section(table: str) -> str:
    """A section of the mapping, commented out."""
    columns = [name for name in COLUMNS[table] if name not in (*ALTERNATIVES.get(table, ()), "kernel", "delay_s")]
    columns = [name for name in columns if not name.startswith("arm_")]
    width = max(map(len, columns))
    units = {name: mission_unit(name)[1] for name in columns}
    remarks = {name: f"   # {unit}" if unit else "" for name, unit in units.items()}
    lines = [f'# {name:{width}} = "COLUMN OF THE LOG"{remark}' for name, remark in remarks.items()]
    return "\n".join([f"# [{table}]   # {ABOUT[table]}", *lines, ""])


def example(table: str, column: str) -> str:
    """A value that a column of a table may have.

    Examples
    --------
    >>> example("sonar", "beams"), example("contacts", "sigma_range_m"), example("zpr", "sigma_z_m")
    ('256', '0.02', '0.5')
    """
    known: str | None = EXAMPLES.get(f"{table}.{column}", EXAMPLES.get(column))
    if known is not None:
        return known
    unit = mission_unit(column)[1]
    small: str = TEXTS["small"].get(unit, "1.0")
    return small if column.startswith("sigma") or unit in ("rad", "m/s") else "0.0" if unit else "1.0"
