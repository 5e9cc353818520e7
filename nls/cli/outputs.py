"""Outputs of the commands: words for people, files, reports for programs, pictures."""

import argparse
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any

import nls
from nls.stages import announce

PICTURES = (".png", ".pdf", ".svg")
PAGES = (".html", ".htm")


class Color(StrEnum):
    """Colors of a verdict on a terminal."""

    GOOD, DOUBTFUL, BAD = "\x1b[32m", "\x1b[33m", "\x1b[31m"


def input_name(file: str) -> str:
    """The name of an input in messages, tables and pages."""
    return "<stdin>" if file == "-" else file


def say(text: object, error: bool = False, verdict: tuple[str, Color] | None = None) -> None:
    """Print for people, on standard output or standard error where it is open; controls of a terminal are escaped.

    On a terminal the line that begins with the words of the verdict has its color, unless NO_COLOR is set.
    """
    from models.visible import visible

    if (stream := sys.stderr if error else sys.stdout) is not None:  # else `print` takes the other one
        announce("")  # the line of a terminal is left to this
        lines = visible(str(text)).split("\n")
        plain = not stream.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
        if verdict is not None and not plain:
            lines = [f"{verdict[1]}{line}\x1b[0m" if line.startswith(verdict[0]) else line for line in lines]
        print("\n".join(lines), file=stream, flush=True)


def say_notes(notes: Iterable[str], known: Sequence[str] = ()) -> None:
    """Print remarks but for those that are known, such as warnings that were given."""
    for note in notes:
        if note not in known:
            say(f"note        {note}")


def live() -> bool:
    """Whether somebody sees standard output as it comes, on a terminal."""
    return sys.stdout is not None and sys.stdout.isatty()


def complain(problem: object) -> None:
    """The error in one line on standard error; its cures, with the options of the command line, one a line."""

    message, *advice = problem.lines(shell=True) if isinstance(problem, nls.LeadlineError) else [str(problem)]
    say("\n".join([f"nls: {' '.join(message.split())}", *advice]), error=True)


def refuse_unwritable(names: Mapping[str, str | None], *read: str) -> None:
    """Find out before the work, not after it, that an output cannot be written.

    Parameters
    ----------
    names : of files by option; None for one that is not asked for. That of ``--json`` may be ``-``: standard output.
        That of ``-o`` comes first; it alone may replace what is read.
    read : the inputs, each a file, the folder of a mission or ``-``.

    Raises
    ------
    OptionError
    """
    from nls.io.files import descriptor, names_folder

    identities: set[object] = set()
    inputs = set().union(*map(_inputs, read))
    for option, name in names.items():
        if option != "-o":
            identities |= inputs
        if name is None or (option == "--json" and name == "-"):
            continue
        if name == "-":
            raise nls.OptionError(option, name, "a file; only --json writes to standard output")
        if not name:
            raise nls.OptionError(option, name, "the name of a file")
        if os.path.isdir(name) or names_folder(name):
            raise nls.OptionError(option, name, f"a file, and this {'is' if os.path.isdir(name) else 'names'} a folder")
        number = descriptor(name)
        folder = os.path.dirname(os.path.realpath(name)) if number is None else "/"
        if not os.path.isdir(folder):  # unlike that of `Path` this raises nothing
            raise nls.OptionError(option, name, "a file in a folder that exists, and that you may look into")
        if _identity(name) in identities:
            same = "this is the input" if _identity(name) in inputs else "another output has this one"
            raise nls.OptionError(option, name, f"another name: {same}")
        special = number is not None or (os.path.exists(name) and not os.path.isfile(name))
        if number is not None:
            if not _writable(number):
                raise nls.OptionError(option, name, "a number that is open for writing")
        elif os.path.exists(name) and not os.access(name, os.W_OK):  # special files are written to, others replaced
            allowed = "a file that is not write-protected; --overwrite does not help: allow it with chmod, or give "
            raise nls.OptionError(option, name, allowed + "another name")
        elif not special and not os.access(folder, os.W_OK | os.X_OK):
            raise nls.OptionError(option, name, "a file in a folder you may write to")
        if not special:
            identities.add(_identity(name))


def _writable(number: int) -> bool:
    """Whether an open file of this process takes what is written."""
    import fcntl  # files have such names only where there is one

    try:
        return fcntl.fcntl(number, fcntl.F_GETFL) & os.O_ACCMODE != os.O_RDONLY
    except OSError:
        return False


def refuse_loss(option: str, options: argparse.Namespace, why: str) -> None:
    """Refuse to replace the input by a graph with less in it, unless ``--overwrite`` allows that.

    Parameters
    ----------
    option : the name of the output on the command line, such as ``-o``.
    options : of a command that reads a graph and writes one.
    why : the cause of the loss.

    Raises
    ------
    OptionError
    """

    if options.output and not options.overwrite and _identity(options.output) in _inputs(options.file):
        allowed = f"another file than the input, or --overwrite, which replaces the input: {why}"
        raise nls.OptionError(option, options.output, allowed)


def _identity(name: str) -> object:
    """The identity of a file under all of its names, links too; of one that does not exist its path."""
    try:
        status = os.fstat(sys.stdin.fileno()) if name == "-" else os.stat(name)
    except (OSError, ValueError, AttributeError):  # standard input may be closed, or no file at all
        return os.path.realpath(name)
    return status.st_dev, status.st_ino


def _inputs(read: str) -> set[object]:
    """All that is read: a file, or the tables in the folder of a mission."""
    if not os.path.isdir(read):
        return {_identity(read)}
    from nls.missions.folder.columns import COLUMNS
    from nls.missions.scans.folder import COLUMNS as OF_SCANS

    tables = (os.path.join(read, name + end) for name in {*COLUMNS, *OF_SCANS} for end in (".csv", ".csv.gz"))
    return {_identity(read), *(_identity(table) for table in tables if os.path.exists(table))}


def refuse_name(option: str, name: str | None, suffixes: Sequence[str]) -> None:
    """Refuse a name that promises a format nobody writes there.

    Raises
    ------
    OptionError
    """

    if name and not (Path(name).suffix and name.lower().endswith(tuple(suffixes))):
        raise nls.OptionError(option, name, "a file name ending in " + ", ".join(suffixes))


def write_json(report: dict[str, Any], where: str | None) -> None:
    """The report for programs, to a file or (``-``) standard output."""
    from nls.io.files import write_bytes

    if where is None:
        return
    text = json_text(report)
    if where == "-":
        announce("")
        print(text, end="")  # ASCII
    else:
        write_bytes(where, text.encode())


def json_text(report: dict[str, Any]) -> str:
    """The report for programs."""
    import json

    from models.finite import finite_or_none

    return json.dumps(finite_or_none(report), indent=1, allow_nan=False) + "\n"
