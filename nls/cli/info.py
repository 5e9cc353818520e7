"""``nls info``: what is in a file, what holds it, what a solve would cost."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

from nls.cli.outputs import refuse_unwritable, write_json


def info(options: argparse.Namespace) -> int:
    """Read, inspect, print; returns the exit status."""
    from nls.analysis.inspection import inspect
    from nls.cli.formats import read

    refuse_unwritable(json=options.json, read=options.file)
    graph, values, report = read(options)
    options.phase.doing = f"while inspecting {options.file}"
    facts = report.counts | inspect(graph, values)
    head = {"input": report.path, "format": report.format, "dimension": report.dimension}
    options.phase.now("while writing the report")
    write_json(head | {"tags": report.tags, "notes": report.notes} | facts, options.json)
    if options.json != "-":
        print(replace(report, notes=[note for note in report.notes if note not in report.warnings]))  # already said
        print("\n".join(f"  {name.replace('_', ' '):26s} {_shown(value)}" for name, value in facts.items()))
    return 0


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
