"""``nls convert``: a graph in another format, or its poses alone."""

from __future__ import annotations

import argparse

from nls.cli.outputs import refuse_unwritable

__all__ = ["convert"]


def convert(options: argparse.Namespace) -> int:
    """Read, write, say what a trajectory leaves out; returns the exit status."""
    from models.errors import OptionError
    from nls.cli.formats import SUFFIXES, format_of, read, write

    refuse_unwritable(options.output)
    form = options.to or format_of(options.output)
    if form is None:
        raise OptionError("output file", options.output, f"a name ending in {', '.join(SUFFIXES)}, or --to FORMAT")
    graph, values, report = read(options)
    notes = write(options.output, form, graph, values, report)
    print(f"input       {options.file}: {report.format}, {len(values)} variables, {len(graph)} measurements")
    print(f"written     {options.output}: {form}")
    for note in [*report.notes, *notes]:
        print(f"note        {note}")
    return 0
