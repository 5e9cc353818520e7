"""``nls import``: logs as a mission folder by a mapping; without one a draft of it."""

from __future__ import annotations

import argparse

from nls.cli.outputs import say


def import_logs(options: argparse.Namespace) -> int:
    """Write a mission, or print a draft of a mapping; returns the exit status."""
    from models.errors import OptionError
    from nls.missions.importing import draft, import_logs, read_mapping, write_imported

    options.phase.now(f"while reading {options.logs[0]}")
    if options.map is None:
        if options.output is not None:
            raise OptionError("--map is missing beside -o; a draft of a mapping: nls import LOG > mapping.toml")
        say(draft(options.logs).removesuffix("\n"))
        say("nls: this is a draft: save it as mapping.toml, correct it, and give it by --map", error=True)
        return 0
    if options.output is None:
        raise OptionError("-o is missing; expected a folder for the mission: -o mission")
    imported = import_logs(options.logs, read_mapping(options.map))
    options.phase.now(f"while writing {options.output}")
    try:
        options.phase.written += write_imported(options.output, imported, [*options.logs, options.map])
    except OptionError as error:
        raise OptionError("-o", error.value, error.allowed) from error
    say(f"input       {', '.join(options.logs)}")
    say(f"written     {options.output}: " + ", ".join(f"{name} {count}" for name, count in imported.rows.items()))
    for note in imported.notes:
        say(f"note        {note}")
    return 0
