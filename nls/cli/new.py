"""``nls new``: commented templates of the files of a mission."""

from __future__ import annotations

import argparse
from pathlib import Path

from nls.cli.outputs import say


def new(options: argparse.Namespace) -> int:
    """Write the templates that are not there yet; returns the exit status."""
    from nls.io.files import write_folder
    from nls.missions.importing import templates

    files = templates(options.map)
    there = [name for name in files if Path(options.folder, name).exists()]
    options.phase.now(f"while writing {options.folder}")
    for folder in sorted({str(Path(name).parent) for name in files}):
        group = {Path(name).name: data for name, data in files.items() if str(Path(name).parent) == folder}
        fresh = {name: data for name, data in group.items() if not Path(options.folder, folder, name).exists()}
        if fresh:
            options.phase.written += write_folder(Path(options.folder, folder), fresh)
    say(f"written     {options.folder}: {len(files) - len(there)} templates")
    if there:
        say(f"note        kept as they are: {', '.join(there)}")
    say("next        fill in mapping.toml for nls import, or copy the tables you have from templates/ and fill them")
    return 0
