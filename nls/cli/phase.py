"""How far a command is: Ctrl-C ends it at every moment with one line that says so, and with status 130."""

from __future__ import annotations

import os
import signal
import sys

__all__ = ["INTERRUPTED", "Phase"]

INTERRUPTED = 130  # exit status, 128 + SIGINT as shells have it


class Phase:
    """How far a command is; ``str`` is the line to say where Ctrl-C ended it.

    Parameters
    ----------
    program : its name.

    Attributes
    ----------
    doing : the activity of this moment, such as ``while reading survey.g2o``.
    written : files that are complete.
    """

    def __init__(self, program: str) -> None:
        self.program, self.doing = program, "at its start"
        self.written: list[str] = []

    def __str__(self) -> str:
        written = f"written: {', '.join(self.written)}" if self.written else "nothing was written"
        return f"{self.program}: interrupted {self.doing}; {written}"

    def at_once(self) -> None:
        """Let Ctrl-C end the process itself, until `now`. The imports of a start turn an exception into others.

        A process that ignores Ctrl-C goes on to do so.
        """
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self._leave)

    def now(self, doing: str) -> None:
        """Another activity, in which Ctrl-C is an exception: there is something to tidy up, or to keep."""
        self.doing = doing
        if signal.getsignal(signal.SIGINT) == self._leave:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def over(self) -> None:
        """The command is done: Ctrl-C does nothing to a process that is about to end."""
        if signal.getsignal(signal.SIGINT) in (self._leave, signal.default_int_handler):
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    def flushed(self, status: int) -> int:
        """The exit status, after standard output has taken what was printed; 2 where it does not."""
        try:
            sys.stdout.flush()
        except OSError as error:
            with open(os.devnull, "wb") as nothing:  # where Python sends the rest at its end
                os.dup2(nothing.fileno(), sys.stdout.fileno())
            return status or self.unprinted(error)
        return status

    def unprinted(self, error: OSError) -> int:
        """One line for an output that cannot be printed, none for a pipe nobody reads any more; the exit status."""
        if not isinstance(error, BrokenPipeError):
            print(f"{self.program}: standard output cannot be written: {error.strerror}", file=sys.stderr)
        return 2

    def _leave(self, *_: object) -> None:
        os.write(2, f"{self}\n".encode(errors="backslashreplace"))  # print may be at work
        os._exit(INTERRUPTED)
