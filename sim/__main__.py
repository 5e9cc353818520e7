"""``python -m sim``, the same as ``nls-sim``."""

import sys

from sim.process import command

if __name__ == "__main__":  # processes of a Monte-Carlo import this file under another name
    sys.exit(command())
