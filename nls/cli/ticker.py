"""A line on a terminal that says what a process does and for how long, every half second, until the process ends.

A process of its own writes it. A thread could not: a factorization by CHOLMOD keeps all other threads of Python
waiting. The words are of what was done, the seconds of the stage so far. The same process answers Ctrl-C within a step
that Python cannot stop, and ends the command at a second Ctrl-C. This file, run by itself, is that process; it imports
nothing of the library.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from time import monotonic, sleep

TYPE_CHECKING = False
if TYPE_CHECKING:
    from subprocess import Popen

QUIET, EVERY = 1.0, 0.5  # seconds before the first line, and from line to line
PATIENCE = 0.4  # seconds for the command to end by itself after a second Ctrl-C
STOPPING = "stopping after this step; Ctrl-C again ends at once"


class Ticker:
    """Words for the line, from `start` on and on a terminal alone."""

    _process: Popen[bytes] | None = None

    def start(self) -> None:
        """Begin, where standard error is a terminal whose line can be written again."""
        if sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
            from subprocess import PIPE, Popen

            heard = _hear_interrupt(False)  # the process inherits it, until it has an answer
            self._process = Popen([sys.executable, "-I", "-S", __file__], stdin=PIPE, stdout=PIPE, bufsize=0)
            _hear_interrupt(heard)

    def say(self, stage: str, step: str = "") -> None:
        """A stage, and its latest step; without a stage wait until the line is erased, for half a second."""
        if self._process is not None and self._process.stdin and self._process.stdout:
            from models.visible import visible

            words = "\t".join(" ".join(visible(text).split()) for text in (stage, step))
            with suppress(BrokenPipeError):  # somebody ended it: no line, and the work goes on
                self._process.stdin.write(f"{words}\n".encode())
            if not stage:
                self._process.stdout.read(1)

    def close(self) -> None:
        """Wait until the line is gone for good."""
        if self._process is not None:
            self._process.communicate()
            self._process = None


class _Line:
    """The line, on standard error."""

    def __init__(self) -> None:
        self.stage, self.step, self.shown = "", "", ""
        self.began = self.since = monotonic()
        self.command, self.presses = os.getppid(), list[float]()

    def draw(self) -> None:
        """Show what is done; end the command after a second Ctrl-C that it does not hear."""
        now, done = monotonic(), f"{self.stage}{self.step and f': {self.step}'}"
        if len(self.presses) > 1 and now - self.presses[1] > PATIENCE and os.getppid() == self.command:
            self.show()
            sys.stderr.write(f"interrupted within a step: {done}\n")
            os.kill(self.command, 15)
            os._exit(0)
        if (now - self.began >= QUIET or self.presses) and self.stage:
            text = f"{now - self.since:5.0f} s  {STOPPING if self.presses else done}"
            self.show(text[: (os.get_terminal_size(2).columns or 80) - 1])

    def show(self, text: str = "") -> None:
        """Replace what is shown; nothing while the shell or another command has the terminal."""
        if (text or self.shown) and _in_foreground():
            sys.stderr.write(f"\r{text.ljust(len(self.shown))}" + "\r" * (not text))
            sys.stderr.flush()
            self.shown = text


def _in_foreground() -> bool:
    """Whether the terminal is the command's: it is no job in the background (``&``)."""
    with suppress(OSError):  # the terminal of no session, which has no jobs
        return sys.platform == "win32" or os.tcgetpgrp(2) == os.getpgrp()
    return True


def _hear_interrupt(hear: bool) -> bool:
    """Let Ctrl-C arrive, or wait until it may; whether it arrived before. On Windows it never waits."""
    if sys.platform == "win32":
        return True
    how = signal.SIG_UNBLOCK if hear else signal.SIG_BLOCK
    return signal.SIGINT not in signal.pthread_sigmask(how, [signal.SIGINT])


def _tick() -> None:
    """Draw until the other end closes."""
    from threading import Lock, Thread

    line, lock = _Line(), Lock()
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as for a command in the background
        signal.signal(signal.SIGINT, lambda *_: line.presses.append(monotonic()))
    _hear_interrupt(True)

    def draw() -> None:
        while True:
            sleep(EVERY)
            with lock:
                line.draw()

    Thread(target=draw, daemon=True).start()
    with open(0, encoding="utf-8") as lines:
        for words in lines:
            stage, _, step = words.rstrip("\n").partition("\t")
            with lock:
                line.presses.clear()  # the command is between two steps
                if not stage:
                    line.show()
                    os.write(1, b"\n")
                elif stage != line.stage:
                    line.stage, line.since = stage, monotonic()
                line.step = step
    lock.acquire()  # nothing is drawn any more
    line.show()
    os._exit(0)


if __name__ == "__main__":
    _tick()
