"""What the commands write: files that can be written, reports for programs, pictures."""

from __future__ import annotations

import json
import math
import os
import sys
from pathlib import Path
from typing import Any

__all__ = ["complain", "refuse_no_picture", "refuse_unwritable", "typed", "write_json"]

PICTURES = (".png", ".pdf", ".svg")
TYPED = {  # what messages of the library name, and the options of the command line in its place
    "gauge='first'": "--gauge first",
    "repair_information: True": "--repair-information",
    "graph.robust(Cauchy(1))": "--robust cauchy:1",
    "nls.initialize(graph, values)": "--init",
    "nls.certify(graph, values)": "nls solve --certify",
    "nls.gnc(graph, values)": "nls solve --robust gnc-tls",
    "linear solver 'qr'": "--linear-solver qr",
    ", see `underconstrained`": "",
    "; use preselect=False": "",
    "(`findings` has them)": "(--json has them)",
    "(`rejected` has them)": "(--json has them)",
    "; name factors with doubted=[...]": "",
}


def typed(message: str) -> str:
    """A message of the library with the options as they are typed on the command line."""
    for named, option in TYPED.items():
        message = message.replace(named, option)
    return message


def complain(message: object) -> None:
    """One line on standard error, with the options as they are typed here."""
    print(f"nls: {' '.join(typed(str(message)).split())}", file=sys.stderr)


def refuse_unwritable(*names: str | None, json: str | None = None) -> None:
    """Find out before the work, not after it, that an output cannot be written.

    Parameters
    ----------
    names : of files; None for one that is not asked for.
    json : the report for programs, which may also be ``-``: standard output.

    Raises
    ------
    OptionError
    """
    from models.errors import OptionError

    seen: set[str] = set()
    for name in [*names, None if json == "-" else json]:
        if name is None:
            continue
        if name == "-":
            raise OptionError("output file", name, "a file; only --json writes to standard output")
        if not name:
            raise OptionError("output file", name, "the name of a file")
        path = Path(name)
        folder = Path(os.path.realpath(name)).parent
        if path.is_dir() or not folder.is_dir():
            raise OptionError("output file", name, "a file in a folder that exists")
        if os.path.realpath(name) in seen:
            raise OptionError("output file", name, "a file of its own for every output")
        special = path.exists() and not path.is_file()  # a pipe or device is written to, a file is replaced
        if not os.access(path if special else folder, os.W_OK):
            raise OptionError("output file", name, "a file in a folder you may write to")
        if not special:
            seen.add(os.path.realpath(name))


def refuse_no_picture(option: str, name: str | None) -> None:
    """Refuse a picture in a format nobody draws.

    Raises
    ------
    OptionError
    """
    from models.errors import OptionError

    if name and Path(name).suffix.lower() not in PICTURES:
        raise OptionError(option, name, "a file name ending in " + ", ".join(PICTURES))


def write_json(report: dict[str, Any], where: str | None) -> None:
    """The report for programs, to a file or (``-``) standard output."""
    from nls.io.files import write_bytes

    if where is None:
        return
    text = json.dumps(_finite(report), indent=1, allow_nan=False)
    if where == "-":
        print(text)
    else:
        write_bytes(where, (text + "\n").encode())


def _finite(item: Any) -> Any:
    """A report with null for every number that is not finite: JSON has no other word for it."""
    if isinstance(item, dict):
        return {name: _finite(value) for name, value in item.items()}
    if isinstance(item, list):
        return [_finite(value) for value in item]
    return None if isinstance(item, float) and not math.isfinite(item) else item
