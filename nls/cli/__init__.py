"""The command line: one file per command; this one runs them and turns every error into one line and an exit status.

A process of its own has one thread. Libraries that are told so before they are loaded start no others. Starting and
ending threads costs more than a small graph takes. At the import of NumPy and SciPy on four cores it is 90 ms of
processor time. Settings of the user in the environment stay.
"""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Sequence
from time import perf_counter, process_time

from nls.cli.phase import INTERRUPTED, Phase
from nls.lazy import postpone

TYPE_CHECKING = False
if TYPE_CHECKING:
    import argparse

__all__ = ["command", "main"]

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_THREAD_LIMIT", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")
# Modules of NumPy that SciPy loads by ``from numpy import *``, and nobody uses: a third of the import of both.
UNUSED = ("f2py", "ma", "polynomial", "testing")


def command() -> int:
    """``nls`` as a process: one thread, Ctrl-C at any moment, then `main`."""
    if "_ARGCOMPLETE" in os.environ:  # by the shell, for a press of the tab key
        import argcomplete

        from nls.cli.parser import parser

        argcomplete.autocomplete(parser())
    phase = Phase("nls")
    phase.at_once()
    startup = process_time()
    for name in THREADS:
        os.environ.setdefault(name, "1")
    return phase.process(lambda: main(startup=startup, phase=phase))


def main(argv: Sequence[str] | None = None, startup: float = 0.0, phase: Phase | None = None) -> int:
    """Run the command line; returns the exit status.

    Parameters
    ----------
    argv : the arguments; those of the process when omitted.
    startup : seconds before this, for the report.
    phase : of the process.
    """
    began, phase = perf_counter(), Phase("nls") if phase is None else phase
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what the terminal cannot show is escaped
            stream.reconfigure(errors="backslashreplace")
    with warnings.catch_warnings():
        warnings.showwarning = _one_line_warning
        try:
            return phase.flushed(_main(argv, began, startup, phase))
        except KeyboardInterrupt:
            print(phase, file=sys.stderr)
            return INTERRUPTED


def _main(argv: Sequence[str] | None, began: float, startup: float, phase: Phase) -> int:
    from nls.cli.parser import parser

    debug, options = False, None
    try:
        options = parser().parse_args(argv)
        options.began, options.startup, options.phase = began, startup, phase
        options.argv = sys.argv[1:] if argv is None else list(argv)
        debug = getattr(options, "debug", False)
        if options.command is None and not options.version:
            parser().print_help()
            return 2
        postpone("numpy", UNUSED)
        postpone("scipy", ["sparse"])  # a small graph needs none; `import scipy.sparse` in a module would load it
        if options.version:
            return _version()
        if "file" in options:
            from nls.io.files import graph_file

            options.file = str(graph_file(options.file))
        from nls.stages import listened

        if options.command != "stream" and not getattr(options, "quiet", False):
            phase.ticker.start()
        try:
            with listened(phase.step):
                return int(options.run(options))
        finally:
            phase.ticker.close()
    except SystemExit as stop:
        return int(stop.code or 0)
    except Exception as error:  # all: a fault of ours, too, is one line and a status; --debug shows its traceback
        if debug:
            raise
        return _failed(error, phase, options)


def _failed(error: Exception, phase: Phase, options: argparse.Namespace | None) -> int:
    """One line for an error, whose cures are none of the options given, and the exit status."""
    from models.errors import LeadlineError, UnderconstrainedError
    from nls.cli.outputs import complain

    if isinstance(error, OSError) and error.filename is None and error.strerror:
        return phase.unprinted(error)  # every file has an error of its own
    known = isinstance(error, LeadlineError | OSError | MemoryError | Warning)  # as PYTHONWARNINGS=error raises
    if isinstance(error, LeadlineError):
        given = vars(options).items() if options is not None else ()
        if phase.as_read is not None:
            from nls.cli.formats import name_lines

            name_lines(error, *phase.as_read)
        error.leave_out({f"--{name.replace('_', '-')} {value}" for name, value in given})
    complain(error if known else f"internal error, please report it (--debug shows where): {error!r}")
    return 1 if isinstance(error, UnderconstrainedError) else 2


def _one_line_warning(message: Warning | str, *_: object, **__: object) -> None:
    from nls.cli.outputs import say

    say(f"nls: warning: {' '.join(str(message).split())}", error=True)


def _version() -> int:
    import nls

    print(f"leadline {nls.__version__}")
    for name, state in nls.backends().items():
        print(f"  {name:16s} {state}")
    return 0
