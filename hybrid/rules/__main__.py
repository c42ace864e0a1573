"""Compile all rules now, for an image of a machine, say: ``python -m hybrid.rules``."""

import sys

from . import library

if __name__ == "__main__":
    sys.exit(not library.build())
