"""``nls import`` and ``nls new``: logs as a mission folder by a mapping, a draft of it, and commented templates."""

import argparse
from pathlib import Path

import nls
from nls.cli.outputs import say, say_notes
from nls.io.files import write_folder
from nls.missions import importing


def import_logs(options: argparse.Namespace) -> int:
    """Write a mission, or print a draft of a mapping; returns the exit status."""
    options.phase.now(f"while reading {options.logs[0]}")
    if options.map is None:
        if options.output is not None:
            raise nls.OptionError("--map is missing beside -o; a draft of a mapping: nls import LOG > mapping.toml")
        say(importing.draft(options.logs).removesuffix("\n"))
        say("nls: this is a draft: save it as mapping.toml, correct it, and give it by --map", error=True)
        return 0
    if options.output is None:
        raise nls.OptionError("-o is missing; expected a folder for the mission: -o mission")
    imported = importing.import_logs(options.logs, importing.read_mapping(options.map))
    options.phase.now(f"while writing {options.output}")
    try:
        options.phase.written += importing.write_imported(options.output, imported, [*options.logs, options.map])
    except nls.OptionError as error:
        raise nls.OptionError("-o", error.value, error.allowed) from error
    say(f"input       {', '.join(options.logs)}")
    say(f"written     {options.output}: " + ", ".join(f"{name} {count}" for name, count in imported.rows.items()))
    say_notes(imported.notes)
    return 0


def new(options: argparse.Namespace) -> int:
    """Write the templates that are not there yet; returns the exit status."""
    files = importing.templates(options.map)
    there = [name for name in files if Path(options.folder, name).exists()]
    options.phase.now(f"while writing {options.folder}")
    fresh = {Path(name): data for name, data in files.items() if name not in there}
    for folder in sorted({path.parent for path in fresh}):
        group = {path.name: data for path, data in fresh.items() if path.parent == folder}
        options.phase.written += write_folder(Path(options.folder, folder), group)
    say(f"written     {options.folder}: {len(files) - len(there)} templates")
    if there:
        say(f"note        kept as they are: {', '.join(there)}")
    say("next        fill in mapping.toml for nls import, or copy the tables you have from templates/ and fill them")
    return 0
