"""``nls info``, ``plot``, ``view`` and ``convert``: a graph as it was read, in numbers, drawn, in another format."""

import argparse
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from models.listing import several
from nls.cli import formats
from nls.cli.graph_file import GraphFile, Read
from nls.cli.inputs import input_of
from nls.cli.outputs import PAGES, PICTURES, refuse_name, refuse_unwritable, say, say_notes, write_json
from nls.io import files
from nls.io.formats import FORMATS, format_of

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
    "semi_definite_measurements": "partly measured",
    "chi2": "chi2 of the initial guess",
}


def info(options: argparse.Namespace) -> int:
    """Read, inspect, print; returns the exit status."""
    from nls.analysis.inspection import inspect

    refuse_unwritable({"--json": options.json}, options.file)
    graph, values, report = input_of(options).read()
    options.phase.begin(f"while inspecting {options.file}")
    facts = report.counts | inspect(graph, values)
    head = {"input": report.path, "format": report.format, "dimension": report.dimension}
    options.phase.now("while writing the report")
    write_json(head | {"tags": report.tags, "notes": report.notes} | facts, options.json)
    if options.json != "-":
        say(replace(report, notes=[note for note in report.notes if note not in report.warnings]))  # already said
        for name, value in facts.items():
            say(f"  {LABELS.get(name, name.replace('_', ' ')):26s} {_shown(value)}")
    return 0


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_shown, value))
    if isinstance(value, bool | str) or value is None:
        return str(value)
    return f"{value:,}" if isinstance(value, int) else f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"


def plot(options: argparse.Namespace) -> int:
    """Read, draw, write; returns the exit status."""
    from nls.plot.picture import write_picture

    def draw(kind: GraphFile, read: Read, output: str) -> None:
        figure = kind.plan(*read)
        figure.suptitle(files.title_of(read[2].path))
        write_picture(output, figure)

    return _drawn(options, options.output, PICTURES, draw)


def view(options: argparse.Namespace) -> int:
    """Read, draw the page, write; returns the exit status."""
    name = "stdin" if options.file == "-" else files.title_of(options.file)
    remark = "poses and residuals as read, before any solve; nls solve --view shows the solution"
    known = "|".join(re.escape(suffix) for row in FORMATS.values() for suffix in row.suffixes)
    output = options.output or re.sub(rf"(?i)({known})?(\.gz)?\Z", "-view.html", name, count=1)
    return _drawn(options, output, PAGES, lambda kind, read, output: kind.view(read, remark).save(output))


def _drawn(
    options: argparse.Namespace, output: str, suffixes: Sequence[str], draw: Callable[[GraphFile, Read, str], None]
) -> int:
    """Read, draw into a file, say what is not in it; returns the exit status."""
    refuse_unwritable({"OUT": output}, options.file)
    refuse_name("OUT", output, suffixes)
    kind = input_of(options)
    read = kind.read()
    options.phase.now(f"while writing {output}")
    draw(kind, read, output)
    options.phase.written.append(output)
    say(f"written     {output}")
    say_notes(kind.not_drawn(read[2]))
    return 0


def convert(options: argparse.Namespace) -> int:
    """Read, write, say what the file leaves out; returns the exit status."""
    refuse_unwritable({"OUT": options.output})
    form = format_of(options.output, options.to, "--to FORMAT", "OUT")
    kind = input_of(options)
    kind.check_renumber(form)
    graph, values, report = kind.read()
    kind.check_format("OUT", form, report)
    options.phase.now(f"while writing {options.output}")
    data, notes = formats.rendered(options.output, form, graph, values, report, options.renumber)
    files.write_bytes(options.output, data)
    options.phase.written.append(options.output)
    holds = f"{several(len(values), 'variable')}, {several(len(graph), 'measurement')}"
    say(f"input       {report.path}: {report.format}, {holds}")
    say(f"written     {options.output}: {form}")
    say_notes([*report.notes, *notes], report.warnings)
    return 0
