"""How far a command is: a terminal shows it, and Ctrl-C ends it at every moment with one line and status 130."""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
from collections.abc import Callable

from nls.cli.ticker import Ticker

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

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
    outcome : the words of the line where no file is complete; of one activity.
    ticker : shows them on a terminal, from its start on.
    as_read : the graph and its report, once they are read; an error may be about one of the measurements.
    """

    def __init__(self, program: str) -> None:
        self.program, self.ticker = program, Ticker()
        self.begin("at its start")
        self.written: list[str] = []
        self.as_read: Any = None

    def __str__(self) -> str:
        written = f"written: {', '.join(self.written)}" if self.written else self.outcome
        words = f"{self.program}: interrupted {self.doing}{self._step and f': {self._step}'}; {written}"
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in words)  # imports nothing in their midst

    def begin(self, doing: str) -> None:
        """Another activity."""
        self.doing, self._step, self.outcome = doing, "", "nothing was written"
        self.ticker.say(doing.removeprefix("while "))

    def step(self, words: str) -> None:
        """The latest step of what is done; without words somebody else is about to write to the terminal."""
        self._step = words or self._step
        self.ticker.say(self.doing.removeprefix("while ") if words else "", words)

    def at_once(self) -> None:
        """Let Ctrl-C end the process itself, until `now`. The imports of a start turn an exception into others.

        A process that ignores Ctrl-C goes on to do so. Standard error that was closed leads to nowhere: its number is
        that of no other file, and `print` has a place for it.
        """
        if sys.stderr is None:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            if nowhere != 2:
                os.dup2(nowhere, 2)
            sys.stderr = os.fdopen(2, "w", closefd=False)
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self._leave)

    def now(self, doing: str) -> None:
        """Another activity, in which Ctrl-C is an exception: there is something to tidy up, or to keep."""
        self.begin(doing)
        if signal.getsignal(signal.SIGINT) == self._leave:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def over(self) -> None:
        """The command is done: Ctrl-C does nothing to a process that is about to end."""
        self.ticker.close()
        if signal.getsignal(signal.SIGINT) in (self._leave, signal.default_int_handler):
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    def process(self, run: Callable[[], int]) -> int:
        """The exit status of a command that is a process of its own, whatever else happens to it.

        Ctrl-C between its phases, or a second time, ends it as any other. It goes on where nobody reads its standard
        output any more (``nls explain graph.g2o | head -1``): files are written, and the status is that of the command.
        """
        gc.set_threshold(100_000)  # 60,000 of imports stay; to search them takes 28 of 880 million instructions
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout = _patient(sys.stdout)
        try:
            return run()
        except KeyboardInterrupt:
            self.over()
            print(self, file=sys.stderr)
            return INTERRUPTED
        finally:
            self.over()
            gc.freeze()  # Python ends without a search for garbage: 50 ms of processor time less

    def flushed(self, status: int) -> int:
        """The exit status, after standard output has taken what was printed; 2 where it does not."""
        if sys.stdout is None:  # closed by the shell: nothing was printed
            return status
        try:
            sys.stdout.flush()
        except OSError as error:
            with open(os.devnull, "wb") as nothing:  # where Python sends the rest at its end
                os.dup2(nothing.fileno(), sys.stdout.fileno())
            return status or self.unprinted(error)
        return status

    def unprinted(self, error: OSError) -> int:
        """One line for an output that cannot be printed; the exit status."""
        print(f"{self.program}: standard output cannot be written: {error.strerror}", file=sys.stderr)
        return 2

    def _leave(self, *_: object) -> None:
        self.ticker.close()
        os.write(2, f"{self}\n".encode(errors="backslashreplace"))  # print may be at work
        os._exit(INTERRUPTED)


class _Output(io.FileIO):
    """A file that takes all there is to write, also when it is a pipe that was closed at its other end."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            with open(os.devnull, "wb") as nothing:
                os.dup2(nothing.fileno(), self.fileno())
            return memoryview(data).nbytes


def _patient(stream: io.TextIOWrapper) -> io.TextIOWrapper:
    """A stream over the file of another, for which a closed pipe is no error."""
    raw = _Output(stream.fileno(), "wb", closefd=False)
    return io.TextIOWrapper(
        raw if isinstance(stream.buffer, io.RawIOBase) else io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )
