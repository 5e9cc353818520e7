"""``python -m sim``, the same as ``nls-sim``."""

from sim.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
