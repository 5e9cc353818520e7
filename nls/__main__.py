"""``python -m nls``."""

import sys

from nls.cli import main

sys.exit(main())
