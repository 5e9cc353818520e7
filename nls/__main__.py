"""``python -m nls``."""

import sys

from nls.cli import command

sys.exit(command())
