"""``nls-sim`` as a process: Ctrl-C ends it with one line at any moment, while NumPy is imported too."""

from __future__ import annotations

from nls.cli import UNUSED
from nls.cli.phase import Phase
from nls.lazy import postpone

__all__ = ["command"]


def command() -> int:
    """Run the command line of this process; returns the exit status."""
    phase = Phase("nls-sim")
    phase.at_once()

    def run() -> int:
        postpone("numpy", UNUSED)
        from sim.cli import main

        return main(phase=phase)

    return phase.process(run)
