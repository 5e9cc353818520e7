"""Templates: uncommented, each table reads back as the table it is, and the mapping as a mapping."""

from __future__ import annotations

import re
from pathlib import Path

from nls.missions.folder.columns import COLUMNS, OPTIONAL
from nls.missions.folder.table import Table
from nls.missions.importing import Mapping, templates


def test_every_template_reads_back(tmp_path: Path) -> None:
    files = templates()
    assert set(files) == {"mapping.toml", *(f"templates/{name}.csv" for name in COLUMNS)}
    for name, columns in COLUMNS.items():
        text = files[f"templates/{name}.csv"].decode()
        *comments, head, example = text.splitlines()
        assert all(line.startswith("# ") for line in [*comments, example])
        assert not head.startswith("#")
        file = tmp_path / f"{name}.csv"
        file.write_text("\n".join([*comments, head, example.removeprefix("# ")]) + "\n")
        table = Table(file, columns, OPTIONAL.get(name, ()))
        assert len(table) == 1
        table.measured(*(column for column in table.names if column not in ("name", "kernel")))


def test_the_mapping_is_one_when_uncommented() -> None:
    text = templates(mapping=True)["mapping.toml"].decode()
    assert [section.table for section in Mapping(text, "m.toml").sections] == ["noise"]
    sections = re.sub(r"^# (?=\[|\w+ *= \")", "", text.split("\n\n# time_s")[1].split("\n", 1)[1], flags=re.M)
    tables = [section.table for section in Mapping(sections, "m.toml").sections]
    assert tables == ["dvl", "ahrs", "depth", "path", "motion", "fixes", "contacts", "sonar", "noise"]
