"""The reports for programs are what their schemas say, field by field."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator, ValidationError

import nls
import sim
from nls.cli import main
from nls.missions.folder.write import write_mission
from tests.combinations import for_all
from tests.nls.explanation.sentences import FINDINGS
from tests.nls.io.g2o_files import PLANE, write

SCHEMA, SOLVE, EVALUATE = (
    json.loads(Path(nls.__path__[0], file).read_text(encoding="utf-8"))
    for file in ("explanation/schema.json", "cli/schema.json", "cli/evaluate.json")
)
PAGE = Path(__file__).parents[3] / "docs" / "reference" / "json.md"
FREE = "VERTEX_XY 9 1 1\nEDGE_BEARING_SE2_XY 1 9 0.3 100\n"
APART = "VERTEX_SE2 10 5 5 0\nVERTEX_SE2 11 6 5 0\nEDGE_SE2 10 11 1 0 0 500 0 0 400 0 300\n"
WRONG = "EDGE_SE2 0 2 2 1 1.55 500 0 0 400 0 300\nEDGE_SE2 1 3 4 -3 1 500 0 0 400 0 300\n"


def objects(schema: Any) -> Iterator[dict[str, Any]]:
    """All objects that a schema describes."""
    if isinstance(schema, dict):
        yield from [schema] * ("properties" in schema)
        for value in schema.values():
            yield from objects(value)


@for_all(
    case=[
        *((SCHEMA, "explain", text, []) for text in (PLANE, PLANE + FREE, PLANE + WRONG, PLANE + APART)),
        *((EVALUATE, "evaluate", PLANE, words) for words in ([], ["--align", "similarity"], ["--distances", "1,1e9"])),
        (SOLVE, "solve", PLANE, ["--certify", "--covariance", "c.csv"]),
        (SOLVE, "solve", PLANE + WRONG, ["--robust", "gnc-tls"]),
        (SOLVE, "solve", PLANE + WRONG, ["--sigmas", "estimate"]),
        (SOLVE, "solve", PLANE + FREE, []),
        (SOLVE, "solve", PLANE, ["--gauge", "none"]),
        (SOLVE, "solve", PLANE, ["--init", "file", "--max-iterations", "1"]),
    ]
)
def test_reports_are_as_their_schema(
    case: tuple[dict[str, Any], str, str, list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    schema, command, text, words = case
    monkeypatch.chdir(tmp_path)
    main([command, *[str(write(tmp_path, text))] * (1 + (command == "evaluate")), "--json", "r.json", *words])
    report = json.loads(Path("r.json").read_text())
    Path("r.json").unlink()
    Draft202012Validator(schema).validate(report)
    assert report["schema"] == schema["properties"]["schema"]["const"]


def test_the_report_of_a_mission_is_as_its_schema(tmp_path: Path) -> None:
    mission, where = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=6), tmp_path / "r.json"
    write_mission(tmp_path / "m", mission.graph, mission.sonar, mission.offset, mission.truth)
    assert main(["solve", str(tmp_path / "m"), "--json", str(where), "-o", str(tmp_path / "out")]) == 0
    Draft202012Validator(SOLVE).validate(report := json.loads(where.read_text()))
    assert report["mission"]["poses"] > 10


def test_every_kind_of_finding_is_as_the_schema_and_its_page_say() -> None:
    finding = SCHEMA["properties"]["findings"]["items"]
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    for example in FINDINGS:
        Draft202012Validator(finding).validate(json.loads(json.dumps(example.record())))
        (line,) = [line for line in lines if f"`{example.kind}`" in line.split("|")[1]]
        assert not {name for name in example.numbers if f"`{name}`" not in line}, example.kind
    assert finding["properties"]["kind"]["enum"] == [kind.value for kind in nls.FindingKind]
    for schema, wrong, why in (
        (finding, FINDINGS[0].record() | {"kind": "magic"}, "is not one of"),
        (EVALUATE, {"schema": "evaluate 1"}, "is a required property"),
    ):
        with pytest.raises(ValidationError, match=why):
            Draft202012Validator(schema).validate(wrong)


def test_every_field_is_described_and_none_is_left_over() -> None:
    for described in [*objects(SCHEMA), *objects(SOLVE), *objects(EVALUATE)]:
        assert described["additionalProperties"] is False
        assert set(described["required"]) <= set(described["properties"])
        for name, field in described["properties"].items():
            assert field.get("description"), name
