"""The command line: one file per command; this one runs them and turns every error into one line and an exit status."""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Sequence

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what the terminal cannot show is escaped
            stream.reconfigure(errors="backslashreplace")
    with warnings.catch_warnings():
        warnings.showwarning = _one_line_warning
        return _main(argv)


def _main(argv: Sequence[str] | None) -> int:
    from models.errors import LeadlineError, UnderconstrainedError
    from nls.cli.outputs import complain
    from nls.cli.parser import parser

    debug = False
    try:
        options = parser().parse_args(argv)
        debug = getattr(options, "debug", False)
        if options.version:
            return _version()
        if options.command is None:
            parser().print_help()
            return 2
        return int(options.run(options))
    except SystemExit as stop:
        return int(stop.code or 0)
    except UnderconstrainedError as error:
        status, message = 1, error
    except (LeadlineError, OSError, MemoryError) as error:
        status, message = 2, error  # type: ignore[assignment]
    except KeyboardInterrupt:
        print("nls: interrupted before there was an estimate", file=sys.stderr)
        return 1
    except Exception as error:  # a fault of ours: a user still gets one line, and the way to the traceback
        status, message = 2, f"internal error, please report it (--debug shows where): {error!r}"  # type: ignore[assignment]
        if debug:
            raise
    if debug:
        raise message
    if not isinstance(message, BrokenPipeError):
        complain(message)
    return status


def _one_line_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"nls: warning: {' '.join(str(message).split())}", file=sys.stderr)


def _version() -> int:
    import nls

    print(f"leadline {nls.__version__}")
    for name, state in nls.backends().items():
        print(f"  {name:16s} {state}")
    return 0
