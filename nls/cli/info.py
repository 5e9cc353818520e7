"""``nls info``: what is in a file, what holds it, what a solve would cost."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

from nls.cli.outputs import refuse_unwritable, say, write_json

LABELS = {  # where the identifier of a program says too little
    "components": "connected parts",
    "component_sizes": "variables of each part",
    "isolated_variables": "variables not measured",
    "numbers_in_A": "nonzeros of A",
    "numbers_in_R": "nonzeros of R, A'A = R'R",
    "factorization_mflop": "factorization, Mflop",
    "factorization_mb": "memory of R, MB",
    "sigma_smallest": "smallest sigma, m or rad",
    "sigma_largest": "largest sigma, m or rad",
    "semi_definite_measurements": "measured in part only",
    "chi2": "chi2 of the start",
}


def info(options: argparse.Namespace) -> int:
    """Read, inspect, print; returns the exit status."""
    from nls.analysis.inspection import inspect
    from nls.cli.formats import read

    refuse_unwritable({"--json": options.json}, options.file)
    graph, values, report = read(options)
    options.phase.doing = f"while inspecting {options.file}"
    facts = report.counts | inspect(graph, values)
    head = {"input": report.path, "format": report.format, "dimension": report.dimension}
    options.phase.now("while writing the report")
    write_json(head | {"tags": report.tags, "notes": report.notes} | facts, options.json)
    if options.json != "-":
        say(replace(report, notes=[note for note in report.notes if note not in report.warnings]))  # already said
        say(
            "\n".join(
                f"  {LABELS.get(name, name.replace('_', ' ')):26s} {_shown(value)}" for name, value in facts.items()
            )
        )
    return 0


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_shown, value))
    if isinstance(value, bool | str) or value is None:
        return str(value)
    return f"{value:,}" if isinstance(value, int) else f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
