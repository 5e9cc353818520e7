"""``nls convert``: a graph in another format, or its poses alone."""

from __future__ import annotations

import argparse

from nls.cli.outputs import refuse_loss, refuse_unwritable, say


def convert(options: argparse.Namespace) -> int:
    """Read, write, say what the file leaves out; returns the exit status."""
    from models.listing import several
    from nls.cli.formats import output_format, read, rendered
    from nls.io.files import write_bytes
    from nls.io.formats import check_renumber

    refuse_unwritable({"OUT": options.output})
    form = output_format("OUT", options.output, options.to)
    if options.renumber:
        check_renumber(form)
    graph, values, report = read(options)
    if form != report.format:
        refuse_loss("OUT", options, f"{form} files do not hold all that {report.format} files do")
    options.phase.now(f"while writing {options.output}")
    data, notes = rendered(options.output, form, graph, values, report, options.renumber)
    write_bytes(options.output, data)
    options.phase.written.append(options.output)
    holds = f"{several(len(values), 'variable')}, {several(len(graph), 'measurement')}"
    say(f"input       {report.path}: {report.format}, {holds}")
    say(f"written     {options.output}: {form}")
    for note in [*report.notes, *notes]:
        if note not in report.warnings:
            say(f"note        {note}")
    return 0
